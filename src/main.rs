//! The `vn100d` program: parses arguments, calls [`vn100d::cli::run`], and returns its result as an exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    // A panic ends the program in every build: the database undoes unfinished work, and systemd restarts the program.
    // Setting `panic = "abort"` in the profile of tests would build every dependency twice.
    let default_hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        default_hook(panic);
        std::process::abort();
    }));
    vn100d::cli::main()
}
