//! Writes and syncs fail, hang or are refused (C2 to C5).

use super::*;
use crate::tools;

/// Runs a capture with one injected fault and audits it: nothing is lost, there is no gap, everything is committed.
fn survives(calls: &str, inject: &str) {
    let world = World::new();
    build(&world.database(), 1, 10);
    let _sensor = world.emulate(FAST);
    let configuration = "[sensor]\nrate-hz = 400\nbaud = 921600\n";
    let mut daemon = begin(&world, &strace(calls, inject), configuration, &["--capture", "1h"]);
    let begun = Instant::now();
    while world.try_get("/healthz").is_none() {
        if daemon.log().contains("error: ") {
            // The fault struck before the start was complete: systemd starts the daemon again.
            assert_eq!(daemon.wait(START), Some(74), "{}", daemon.log());
            daemon = begin(&world, &[], configuration, &["--capture", "1h"]);
        }
        assert!(begun.elapsed() < 2 * START, "{}", daemon.log());
        std::thread::sleep(Duration::from_millis(50));
    }
    until_committed(&world, 1200, Duration::from_secs(40), &daemon);
    let status = status(&world);
    let acknowledged = status["capture"]["committed"].as_i64().unwrap();
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new(), "{inject} {}", daemon.log());
    stop_and_settle(&world, &mut daemon);
    let rows =
        world.query("SELECT count(*), max(seq) + 1, (SELECT count(*) FROM gap) FROM sample WHERE capture_id = 2");
    let [count, next, gaps] = &rows[0][..] else { panic!() };
    assert_eq!(count, next, "{inject}");
    assert_eq!(*gaps, rusqlite::types::Value::Integer(0), "{inject}");
    assert!(matches!(count, rusqlite::types::Value::Integer(count) if *count >= acknowledged), "{inject}");
}

/// Injects the fault at operation 1, 2, 3 … of the writer; several worlds run at once.
fn sweep(call: &'static str, error: &'static str, operations: &[u32]) {
    let turn = std::sync::Arc::new(std::sync::Mutex::new(operations.to_vec()));
    let workers: Vec<_> = (0..4)
        .map(|_| {
            let turn = turn.clone();
            std::thread::spawn(move || {
                loop {
                    let Some(operation) = turn.lock().unwrap().pop() else { return };
                    survives(&format!("trace={call}"), &format!("inject={call}:error={error}:when={operation}"));
                }
            })
        })
        .collect();
    workers.into_iter().for_each(|worker| worker.join().unwrap());
}

fn operations(every_push: &[u32], full: u32) -> Vec<u32> {
    tools::scaled(every_push.to_vec(), (1..=full).collect())
}

/// Row C2.
#[test]
fn a_write_that_finds_no_space_loses_nothing_wherever_it_is() {
    if tools::have("strace", "faults are injected into system calls") {
        sweep("pwrite64", "ENOSPC", &operations(&[3, 14, 21, 40], 60));
    }
}

/// Row C2.
#[test]
fn a_write_that_fails_loses_nothing_wherever_it_is() {
    if tools::have("strace", "faults are injected into system calls") {
        sweep("pwrite64", "EIO", &operations(&[2, 16, 23, 55], 60));
    }
}

/// Row C3.
#[test]
fn a_sync_that_fails_loses_nothing_and_acknowledges_nothing() {
    if tools::have("strace", "faults are injected into system calls") {
        sweep("fsync", "EIO", &operations(&[1, 2, 3, 4], 12));
    }
}

/// Row C3.
#[test]
fn after_three_failures_within_a_minute_the_daemon_ends_for_systemd_to_start_it_again() {
    if !tools::have("strace", "faults are injected into system calls") {
        return;
    }
    let world = World::new();
    let _sensor = world.emulate(FAST);
    build(&world.database(), 1, 10);
    let traced = strace("trace=fsync", "inject=fsync:error=EIO:when=4+");
    let mut daemon = start(&world, &traced, "", &["--capture", "1h"]);
    until_state(&world, "storage_error", START, &daemon);
    assert_eq!(daemon.wait(Duration::from_secs(40)), Some(74), "{}", daemon.log());
    assert!(daemon.log().contains("three times within a minute"), "{}", daemon.log());
    drop(daemon);
    // From here on the test does what systemd does.
    let mut daemon = start(&world, &[], "", &[]);
    let samples = || world.try_get("/v1/status")?["capture"]["samples"].as_u64();
    let goes_on = world.until("the capture goes on", START, samples, &daemon);
    until_committed(&world, goes_on + 40, START, &daemon);
    stop_and_settle(&world, &mut daemon);
}

/// Row C4.
#[test]
fn slow_syncs_cost_no_sample_and_the_status_answers_meanwhile() {
    if !tools::have("strace", "syncs are delayed") {
        return;
    }
    let world = World::new();
    let _sensor = world.emulate(FAST);
    let configuration = "[sensor]\nrate-hz = 400\nbaud = 921600\n";
    // Every tenth sync takes 2 s.
    let traced = strace("trace=fsync", "inject=fsync:delay_enter=2000000:when=4+10");
    let mut daemon = start(&world, &traced, configuration, &["--capture", "1h"]);
    let watch = Watch::start(&world);
    until_state(&world, "slow", START, &daemon);
    until_committed(&world, tools::scaled(2000, 20_000), Duration::from_secs(90), &daemon);
    watch.settle();
    let (_, metrics) = world.request("GET", "/metrics", "").unwrap();
    let slowest = metrics.lines().find_map(|line| line.strip_prefix("vn100d_slowest_commit_seconds ")).unwrap();
    assert!(slowest.parse::<f64>().unwrap() >= 2.0, "{slowest}");
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new());
    stop_and_settle(&world, &mut daemon);
}

/// Row C4.
#[test]
fn one_sync_of_many_seconds_costs_no_sample() {
    if !tools::have("strace", "syncs are delayed") {
        return;
    }
    let world = World::new();
    let _sensor = world.emulate(FAST);
    let seconds: u64 = tools::scaled(6, 20);
    let inject = format!("inject=fsync:delay_enter={}:when=5", seconds * 1_000_000);
    let configuration = format!("[sensor]\nrate-hz = {}\nbaud = 921600\n", tools::scaled(400, 800));
    let mut daemon = start(&world, &strace("trace=fsync", &inject), &configuration, &["--capture", "1h"]);
    let watch = Watch::start(&world);
    until_state(&world, "slow", START, &daemon);
    // A request that needs the disk is answered within its limits too.
    let asked = Instant::now();
    let (code, body) = world.request("POST", "/v1/captures", "{\"duration\": \"1h\"}").unwrap();
    assert_eq!(code, 409, "{body}");
    assert!(asked.elapsed() < Duration::from_secs(8), "{:?}", asked.elapsed());
    std::thread::sleep(Duration::from_secs(seconds));
    let received = status(&world)["capture"]["samples"].as_u64().unwrap();
    until_committed(&world, received, Duration::from_secs(15), &daemon);
    watch.settle();
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new());
    stop_and_settle(&world, &mut daemon);
}

/// Row C5.
#[test]
fn a_file_system_that_turns_read_only_is_reported_and_writing_goes_on_when_it_can() {
    if !tools::have("strace", "the kernel lets no file system turn read-only under an open file, and back") {
        return;
    }
    let world = World::new();
    let _sensor = world.emulate(FAST);
    let configuration = "[sensor]\nrate-hz = 400\nbaud = 921600\n";
    build(&world.database(), 1, 10);
    let traced = strace("trace=pwrite64", "inject=pwrite64:error=EROFS:when=50..58");
    let mut daemon = start(&world, &traced, configuration, &["--capture", "1h"]);
    let watch = Watch::start(&world);
    until_state(&world, "storage_readonly", START, &daemon);
    until_state(&world, "ok", START, &daemon);
    let received = status(&world)["capture"]["samples"].as_u64().unwrap();
    until_committed(&world, received, START, &daemon);
    watch.settle();
    assert_eq!(gaps(&world), Vec::<serde_json::Value>::new());
    stop_and_settle(&world, &mut daemon);
}

/// A small separate ext4 under the world's data directory, which can be made to fail like a broken disk.
struct Ext4 {
    image: PathBuf,
    data: PathBuf,
}

impl Ext4 {
    /// Returns `None` if this machine does not allow one.
    fn new(world: &World) -> Option<Self> {
        let disk = Self { image: world.path("disk.img"), data: world.path("data") };
        std::fs::create_dir_all(&disk.data).unwrap();
        std::fs::File::create(&disk.image).unwrap().set_len(64 << 20).unwrap();
        let made = Command::new("mkfs.ext4").arg("-q").arg(&disk.image).status().is_ok_and(|status| status.success());
        (made && disk.mount() && disk.trigger().exists()).then_some(disk)
    }

    fn mount(&self) -> bool {
        let options = ["-o", "loop,errors=remount-ro"];
        Command::new("mount").args(options).arg(&self.image).arg(&self.data).status().unwrap().success()
    }

    /// Returns the kernel's file for testing the handling of errors (Documentation/ABI/testing/sysfs-fs-ext4).
    fn trigger(&self) -> PathBuf {
        let mounts = std::fs::read_to_string("/proc/self/mounts").unwrap();
        let mut fields = mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>());
        let mounted = fields.find(|fields| fields.get(1).is_some_and(|path| Path::new(path) == self.data));
        let device = mounted.map(|fields| fields[0].trim_start_matches("/dev/").to_owned()).unwrap_or_default();
        Path::new("/sys/fs/ext4").join(device).join("trigger_fs_error")
    }

    /// Makes the kernel find an error in it: it is read-only from now on, also for open files.
    fn fail(&self) {
        std::fs::write(self.trigger(), "1").unwrap();
    }

    /// Unmounts and mounts it again, as an administrator does.
    fn mend(&self) {
        assert!(Command::new("umount").arg(&self.data).status().unwrap().success());
        assert!(self.mount());
    }
}

impl Drop for Ext4 {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.data).stderr(std::process::Stdio::null()).status();
    }
}

/// Row C5, by the kernel itself.
#[test]
fn a_file_system_that_the_kernel_turns_read_only_is_waited_out_and_the_capture_goes_on_after_a_remount() {
    if !tools::root("a file system of its own is mounted") {
        return;
    }
    let world = World::new();
    let Some(disk) = Ext4::new(&world) else {
        vn100_testkit::skipped(
            "no ext4 with errors on demand can be mounted here (a loop device, mkfs.ext4, trigger_fs_error)",
        );
        return;
    };
    let _sensor = world.emulate(FAST);
    let configuration = "[sensor]\nrate-hz = 400\nbaud = 921600\n";
    let mut daemon = start(&world, &[], configuration, &["--capture", "1h"]);
    until_committed(&world, 400, START, &daemon);
    let watch = Watch::start(&world);
    disk.fail();
    let failed = Instant::now();
    until_state(&world, "storage_readonly", Duration::from_secs(5), &daemon);
    println!("storage_readonly after {:?}", failed.elapsed());
    // Many attempts later it still waits: there is no loop of restarts, and nothing is dropped.
    std::thread::sleep(Duration::from_secs(tools::scaled(6, 20)));
    let waiting = status(&world);
    assert_eq!(waiting["storage"]["state"], "storage_readonly");
    assert!(waiting["storage"]["queued"].as_u64().unwrap() > 5 * 400, "{waiting}");
    assert_eq!(waiting["capture"]["gaps"], 0, "{waiting}");
    let acknowledged = committed(&world);
    watch.settle();
    assert_eq!(daemon.terminate(), Some(74), "what is in memory cannot be written: {}", daemon.log());
    disk.mend();
    let mut daemon = start(&world, &[], configuration, &[]);
    until_committed(&world, acknowledged + 400, START, &daemon);
    let gaps = gaps(&world);
    assert_eq!(gaps.len(), 1, "{gaps:?}");
    assert_eq!(gaps[0]["cause"], "daemon_stopped");
    assert!(gaps[0]["before_seq"].as_u64().unwrap() >= acknowledged, "{gaps:?}");
    stop_and_settle(&world, &mut daemon);
}
