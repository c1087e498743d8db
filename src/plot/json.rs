//! Reads numbers from JSON, in which one that is not finite was written as null.

use serde::{Deserialize, Deserializer};

/// A number; null becomes NaN, and is shown as a dash.
///
/// # Errors
/// The error of a value that is no number.
pub fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

/// The same for two.
///
/// # Errors
/// The error of a value that is no pair of numbers.
pub fn pair<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 2], D::Error> {
    let pair: [Option<f64>; 2] = Deserialize::deserialize(from)?;
    Ok(pair.map(|value| value.unwrap_or(f64::NAN)))
}

/// The same for a list.
///
/// # Errors
/// The error of a value that is no list of numbers.
pub fn numbers<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    let list: Vec<Option<f64>> = Vec::deserialize(from)?;
    Ok(list.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect())
}

/// The same for a list that may be absent.
///
/// # Errors
/// The error of a value that is no list of numbers.
pub fn numbers_or_none<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Vec<f64>>, D::Error> {
    let list: Option<Vec<Option<f64>>> = Option::deserialize(from)?;
    Ok(list.map(|list| list.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect()))
}
