//! The `vn100d` program: parses arguments, calls [`vn100d::cli::run`], turns the outcome into an exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    vn100d::cli::main()
}
