//! Units, samples and records of an inertial sensor: the types that all other crates here share.
//!
//! Nothing here reads a file or a clock.

pub mod ros_messages;
pub mod sample;
pub mod units;

/// Returns all variants of an enum in their order. A wrong `N` does not compile.
pub const fn variants<T: strum::VariantArray + Copy, const N: usize>() -> [T; N] {
    match T::VARIANTS.as_array() {
        Some(all) => *all,
        None => panic!("another number of variants"),
    }
}
