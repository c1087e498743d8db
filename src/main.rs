//! The `vn100d` program: parses arguments, calls [`vn100d::cli::run`], turns the outcome into an exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    // A panic ends the program whatever it was built with: half-done work is the database's to undo, and systemd starts
    // anew. As `panic = "abort"` in the profile of tests it would have every dependency built twice.
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        tell(panic);
        std::process::abort();
    }));
    vn100d::cli::main()
}
