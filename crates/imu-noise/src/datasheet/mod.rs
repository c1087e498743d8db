//! Datasheets: a maker's figures, compared with a capture in the same terms.
//!
//! Bias stability "in run" is the lowest point of the Allan deviation, and is therefore compared with that point, not
//! with B. Noise density is the sensor's own, before its filter window and the choice of every n-th sample. The effect
//! of these two is predicted ([`Sampling`]) and reported beside the measurement.
//!
//! Makers do not state which spectral density they print. A printed density D is compared with N as in "ARW = 60·D":
//! two-sided, like N. Read as one-sided, N = D/√2, which predicts D·√(800/2W) for the deviation of one sample. For the
//! gyroscope at 40 Hz and the factory's window the prediction is 1.37e-4 or 9.7e-5 rad/s/√Hz, and 8.6e-4 or 6.1e-4
//! rad/s for a sample. Verdicts use the larger; the comparison has both.
//!
//! The VN-100's datasheet is built in; those of other sensors are read from a file ([`Datasheet::from_toml`]).
//!
//! Quantities carry their dimension as a type
//! ([`imu_core::units::Quantity`]): mg and m/s², rates and accelerations cannot be mixed.

mod compare;
mod file;
mod sampling;
mod vn100;

pub use compare::{
    BiasComparison, ChannelComparison, Comparison, DensityComparison, Measured, Verdict, compare, compare_report,
};
pub use file::FileError;
pub use imu_core::sample::FilterWindows;
pub use sampling::Sampling;
pub use vn100::vn_100;

use imu_core::units::{Acceleration, AngularRate, Density, Dimension, MagneticField, Quantity};

/// A datasheet's figures for one triad.
#[derive(Debug, Clone, PartialEq)]
pub struct Figures<D: Dimension> {
    /// White noise of the sensor itself; `None` if none is given.
    pub density: Option<Density<D>>,
    /// The largest density that rounds to the printed one.
    pub density_limit: Option<Density<D>>,
    /// The limit of the bias stability in run; `None` if none is given.
    pub bias_stability: Option<Quantity<D>>,
    /// Density and stability as printed.
    pub printed: (String, String),
}

/// How a sensor makes its samples from the noise to which its datasheet's density refers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sampled {
    /// Like a VN-100: register 85 has the windows, else they are the factory's.
    Register85,
    /// By means of this many samples at an internal rate; the magnetometer sends its own samples.
    Stated {
        /// The internal rate, Hz.
        internal_rate_hz: f64,
        /// Samples per mean.
        filter_window: u32,
    },
    /// Without averaging and decimation.
    AsSent,
}

/// A datasheet.
#[derive(Debug, Clone, PartialEq)]
pub struct Datasheet {
    /// The name for `--datasheet`.
    pub name: String,
    /// The edition, and the source that quotes it.
    pub source: String,
    /// How samples are made.
    pub sampled: Sampled,
    /// Figures of the gyroscope.
    pub gyro: Option<Figures<AngularRate>>,
    /// Figures of the accelerometer.
    pub accel: Option<Figures<Acceleration>>,
    /// Figures of the magnetometer.
    pub mag: Option<Figures<MagneticField>>,
}

/// The reason why a datasheet was not found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no datasheet is called `{found}`: there is {known}")]
pub struct DatasheetError {
    /// The requested name.
    pub found: String,
    /// The known names.
    pub known: &'static str,
}

/// A sensor of the datasheet sends every n-th of its samples, but the capture's rate does not fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "`{name}` has an internal rate of {internal_rate_hz} Hz, which is no whole multiple of the samples' {rate_hz:.4} Hz: correct the \
     datasheet's table `sampling`"
)]
pub struct RateError {
    /// The datasheet's name.
    pub name: String,
    /// The sensor's own rate, Hz.
    pub internal_rate_hz: f64,
    /// The capture's rate, Hz.
    pub rate_hz: f64,
}

impl Datasheet {
    /// Returns the sampling of a capture at `rate_hz`. `windows` come from its register 85, if the sensor has one.
    ///
    /// # Errors
    /// [`RateError`] if a sensor of this datasheet does not send at that rate.
    pub fn sampling(&self, rate_hz: f64, windows: Option<FilterWindows>) -> Result<Sampling, RateError> {
        let (internal_rate_hz, window) = match self.sampled {
            Sampled::Register85 => return Ok(Sampling::new(rate_hz, windows)),
            Sampled::Stated { internal_rate_hz, filter_window } => (internal_rate_hz, filter_window),
            Sampled::AsSent => (rate_hz, 1),
        };
        if sampling::every(internal_rate_hz, rate_hz).is_none() {
            return Err(RateError { name: self.name.clone(), internal_rate_hz, rate_hz });
        }
        let filter_window = FilterWindows { mag: 1, accel: window, gyro: window };
        Ok(Sampling { internal_rate_hz, mag_rate_hz: rate_hz, rate_hz, filter_window, assumed: false })
    }

    /// Returns the datasheet of that name.
    ///
    /// # Errors
    /// [`DatasheetError`] with the known names.
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
    fn a_rate_at_which_the_sensor_does_not_send_is_refused_with_both_numbers() {
        let text =
            "name = 'x'\n[gyro]\nbias_stability_deg_h = 8\n[sampling]\ninternal_rate_hz = 1000\nfilter_window = 2";
        let sheet = Datasheet::from_toml(text, "own.toml").unwrap();
        assert!(sheet.sampling(200.02, None).is_ok() && sheet.sampling(1000.0, None).is_ok());
        for rate_hz in [400.0, 2000.0] {
            let error = sheet.sampling(rate_hz, None).unwrap_err().to_string();
            assert!(error.contains("1000 Hz") && error.contains(&format!("{rate_hz}.0000 Hz")), "{error}");
        }
    }

    #[test]
    fn a_datasheet_is_found_by_its_name_alone() {
        assert_eq!(Datasheet::named("vn-100").unwrap().name, "vn-100");
        assert!(Datasheet::named("vn-200").unwrap_err().to_string().contains("vn-100"));
    }
}
