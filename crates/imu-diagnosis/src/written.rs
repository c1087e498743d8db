//! Written numbers: reads documents in which numbers that are not finite are null.

use serde::{Deserialize, Deserializer};

/// Numbers that become NaN if they were written as null.
pub(crate) trait Numbers: Sized {
    /// The form of the numbers in a document.
    type Written: for<'de> Deserialize<'de>;
    /// Returns the numbers of a written form.
    fn of(written: Self::Written) -> Self;
}

impl Numbers for f64 {
    type Written = Option<f64>;
    fn of(written: Option<f64>) -> Self {
        written.unwrap_or(f64::NAN)
    }
}

impl<T: Numbers> Numbers for [T; 2] {
    type Written = [T::Written; 2];
    fn of(written: Self::Written) -> Self {
        written.map(T::of)
    }
}

impl<T: Numbers> Numbers for Vec<T> {
    type Written = Vec<T::Written>;
    fn of(written: Self::Written) -> Self {
        written.into_iter().map(T::of).collect()
    }
}

impl<T: Numbers> Numbers for Option<T> {
    type Written = Option<T::Written>;
    fn of(written: Self::Written) -> Self {
        written.map(T::of)
    }
}

/// Reads numbers.
///
/// # Errors
/// The error of a value that does not hold such numbers.
pub(crate) fn numbers<'de, T: Numbers, D: Deserializer<'de>>(from: D) -> Result<T, D::Error> {
    T::Written::deserialize(from).map(T::of)
}
