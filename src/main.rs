//! The `vn100d` program.

fn main() {}
