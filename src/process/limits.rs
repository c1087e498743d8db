//! Limits: the resources of the machine that a thread and a process may use.

use rustix::process::{Resource, Rlimit, Signal};
use thread_priority::{RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy};

/// Nice value of threads and processes whose work can wait.
const NICE_BEHIND: i32 = 10;
/// Nice value of the reader's thread, if the system allows it (`LimitNICE=` of the unit) but no real-time priority.
const NICE_AHEAD: i32 = -10;
/// The value that makes a child the first process to be killed when memory runs out; the scale ends at 1000.
const OOM_SCORE: &str = "900";

/// Lets this thread run when no other needs the processor: the reader never waits for work that can wait.
pub fn step_back() {
    // On Linux a priority belongs to a thread, not to the process.
    if let Err(error) = rustix::process::setpriority_process(None, NICE_BEHIND) {
        tracing::warn!(message = "Background work runs at the program's own priority.", %error);
    }
}

/// The priority that [`hurry`] obtained.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Priority {
    /// The lowest real-time priority: the thread runs before all threads without one.
    RealTime,
    /// Nice -10: it runs before others of its control group.
    Nice,
    /// The ordinary priority of every other thread.
    Ordinary,
}

/// Lets this thread run before others: with the lowest real-time priority if the system allows it (`LimitRTPRIO=` of the
/// unit), else at nice -10.
///
/// A nice value orders the threads of a control group, and a service has its own group: beside a busy group a thread at
/// nice -10 was measured to wait 0.4 s for its turn.
pub fn hurry() -> Priority {
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::RoundRobin);
    let thread = thread_priority::thread_native_id();
    if thread_priority::set_thread_priority_and_policy(thread, ThreadPriority::Min, policy).is_ok() {
        Priority::RealTime
    } else if rustix::process::setpriority_process(None, NICE_AHEAD).is_ok() {
        Priority::Nice
    } else {
        Priority::Ordinary
    }
}

/// The limits of a child process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Confinement {
    /// Bytes of private memory that it may write to (`RLIMIT_DATA`); beyond them an allocation fails and the process
    /// ends.
    pub memory_bytes: u64,
    /// Seconds of processor time of all its threads together (`RLIMIT_CPU`); then the process ends.
    pub processor_s: u64,
    /// The process that it works for: it ends when that one does.
    pub parent: u32,
}

/// Confines this process: it ends with its parent, yields to all other processes, is the first to be killed when memory
/// runs out, and has limits of memory and of processor time.
///
/// # Errors
/// The error that the system reports, if a limit cannot be set, or if the parent is gone already.
pub fn confine(confinement: Confinement) -> std::io::Result<()> {
    rustix::process::set_parent_process_death_signal(Some(Signal::KILL))?;
    let parent = rustix::process::getppid().map(|pid| pid.as_raw_nonzero().get().unsigned_abs());
    if parent != Some(confinement.parent) {
        return Err(std::io::Error::other("the process that asked for this work has ended"));
    }
    step_back();
    // It was started by a path without a meaningful name; `ps` and `top` show this name.
    let _ = std::fs::write("/proc/self/comm", "vn100d-worker");
    // A process may always raise its own score; a system without the file has no such order.
    let _ = std::fs::write("/proc/self/oom_score_adj", OOM_SCORE);
    let limit = |most| Rlimit { current: Some(most), maximum: Some(most) };
    // The soft limit sends a signal that names the reason, the hard one SIGKILL, which looks like any other kill.
    let inherited = rustix::process::getrlimit(Resource::Cpu);
    let most_s = inherited.maximum.map_or(u64::MAX, |most_s| most_s.saturating_sub(1).max(1));
    let processor_s = confinement.processor_s.min(most_s).min(inherited.current.unwrap_or(u64::MAX));
    let maximum = Some(inherited.maximum.unwrap_or(processor_s + 10).min(processor_s + 10));
    rustix::process::setrlimit(Resource::Cpu, Rlimit { current: Some(processor_s), maximum })?;
    // Only the reader may have a real-time priority.
    rustix::process::setrlimit(Resource::Rtprio, limit(0))?;
    rustix::process::setrlimit(Resource::Data, limit(confinement.memory_bytes))?;
    // A core dump of half a gigabyte would use the disk space that the capture needs.
    rustix::process::setrlimit(Resource::Core, limit(0))?;
    Ok(())
}
