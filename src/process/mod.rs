//! Process: priorities of threads, limits of a process, and child processes of this program that do heavy work.
//!
//! The recorder must lose no sample because of a request to the daemon. So its reader runs at a higher priority
//! ([`hurry`]), and work that can wait runs at a lower one ([`step_back`]). Work whose memory use is not known in
//! advance runs in a child ([`Child`]) with its own limits ([`confine`]), which may be killed at any time.

mod child;
mod frame;
mod limits;

pub use child::{Child, Ended, Received};
pub use frame::{Frame, FrameError, read_frame, write_frame};
pub use limits::{Confinement, Priority, confine, hurry, step_back};
