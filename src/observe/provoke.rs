//! Provocation: a panic or a delay on demand, so that tests can see its effect. Only in debug builds.

/// A place where the program can be provoked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Point {
    /// A background job, before each chunk.
    Job,
    /// A request for `/metrics`.
    Handler,
}

impl Point {
    #[cfg(debug_assertions)]
    fn name(self) -> &'static str {
        match self {
            Self::Job => "job",
            Self::Handler => "handler",
        }
    }
}

/// Panics at this point if `VN100D_PROVOKE` is `panic:job` or `panic:handler`; waits 300 ms if it is `slow:job` or
/// `slow:handler`. Does nothing in a release build.
pub fn provoke(point: Point) {
    #[cfg(debug_assertions)]
    {
        let Ok(wanted) = std::env::var("VN100D_PROVOKE") else { return };
        match wanted.split_once(':') {
            Some(("panic", at)) if at == point.name() => panic!("provoked in a {at}"),
            Some(("slow", at)) if at == point.name() => std::thread::sleep(std::time::Duration::from_millis(300)),
            _ => {}
        }
    }
    #[cfg(not(debug_assertions))]
    let _ = point;
}
