//! Process: priorities of threads, limits of a process, and child processes of this program that do heavy work.
//!
//! The recorder must lose no sample to anything that is asked of the daemon. So its reader runs at a higher priority
//! ([`hurry`]), work that can wait runs at a lower one ([`step_back`]), and what takes memory without being sure how much runs in a
//! child ([`Child`]) with limits of its own ([`confine`]), which may be killed at any time.

mod child;
mod frame;
mod limits;

pub use child::{Child, Ended, Heard};
pub use frame::{Frame, FrameError, read_frame, write_frame};
pub use limits::{Confinement, Priority, confine, hurry, step_back};
