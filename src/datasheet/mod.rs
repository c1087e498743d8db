//! Datasheets: what a maker promises, and what a capture shows, compared like with like.
//!
//! Bias stability "in run" is the lowest point of the Allan deviation, so that is what it is compared with, not B. Noise
//! density is the sensor's own, before its filter window and the choice of every n-th sample; what these make of it is
//! predicted ([`Sampling`]) and stands beside the measurement.
//!
//! Which spectral density a maker prints is not said. A printed density D is compared with N as "ARW = 60·D" takes it: two-sided,
//! as N is. Read as one-sided it is N = D/√2, which is the reading that predicts D·√(800/2W) for the deviation of one sample. For the gyroscope at 40 Hz and the factory's window the prediction is 1.37e-4 or
//! 9.7e-5 rad/s/√Hz, 8.6e-4 or 6.1e-4 rad/s of a sample. Verdicts go by the larger; both stand in the comparison.
//!
//! Quantities carry their dimension as a type
//! ([`crate::units::Quantity`]): mg and m/s², rates and accelerations cannot be mixed.

mod compare;
mod sampling;
mod vn100;

pub use compare::{
    BiasComparison, ChannelComparison, Comparison, DensityComparison, Measured, Verdict, compare, compare_report,
};
pub use sampling::{FilterWindows, Sampling};
pub use vn100::vn_100;

use crate::units::{Acceleration, AngularRate, Density, Dimension, MagneticField, Quantity};

/// What a datasheet says of one triad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figures<D: Dimension> {
    /// White noise of the sensor itself.
    pub density: Density<D>,
    /// The density is printed with so many digits: the largest that rounds to it.
    pub density_limit: Density<D>,
    /// Bias stability in run, the limit; `None` where none is given.
    pub bias_stability: Option<Quantity<D>>,
    /// As the sheet prints density and stability.
    pub printed: (&'static str, &'static str),
}

/// A datasheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Datasheet {
    /// As `--datasheet` names it.
    pub name: &'static str,
    /// Which edition, and who quotes it.
    pub source: &'static str,
    /// Gyroscope.
    pub gyro: Figures<AngularRate>,
    /// Accelerometer.
    pub accel: Figures<Acceleration>,
    /// Magnetometer.
    pub mag: Figures<MagneticField>,
}

/// Why a datasheet was not found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no datasheet is called `{found}`: there is {known}")]
pub struct DatasheetError {
    /// What was asked for.
    pub found: String,
    /// What there is.
    pub known: &'static str,
}

impl Datasheet {
    /// The datasheet of that name.
    ///
    /// # Errors
    /// [`DatasheetError`] with the names there are.
    pub fn named(name: &str) -> Result<Self, DatasheetError> {
        let known = "vn-100";
        if name == known {
            return Ok(vn_100());
        }
        Err(DatasheetError { found: name.chars().take(40).collect(), known })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datasheet_is_found_by_its_name_alone() {
        assert_eq!(Datasheet::named("vn-100").unwrap().name, "vn-100");
        assert!(Datasheet::named("vn-200").unwrap_err().to_string().contains("vn-100"));
    }
}
