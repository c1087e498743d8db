//! The effects of an inertial sensor, each with one law ([`effects`]), the simulator that they make ([`simulator`]), and the
//! motions that it goes through ([`motion`]).
//!
//! Numbers, randomness and text are arguments: nothing here reads a file or a clock.

pub mod effects;
pub mod motion;
pub mod simulator;
