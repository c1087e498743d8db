//! Datasheets of other sensors, from a TOML file.
//!
//! `name`, and tables `gyro`, `accel`, `mag` with at most one noise density and one bias stability each, in a unit that
//! the key names. If the sensor averages and decimates, a table `sampling` states how; without the table, the density
//! is expected in the output unchanged. docs/noise-model.md has the keys.

use super::{Datasheet, Figures, Sampled};
use imu_core::units::{
    Dimension, Quantity, RAD_PER_DEG, SECONDS_PER_HOUR, SQRT_SECONDS_PER_SQRT_HOUR as SQRT_HOUR, STANDARD_GRAVITY_M_S2,
};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use std::num::NonZeroU32;

/// The reason why a datasheet's file is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FileError {
    /// The file is not TOML, or has unknown keys.
    #[error("{file} is no datasheet: {reason}")]
    Form {
        /// The file.
        file: String,
        /// The reader's error, with line, key and the values allowed.
        reason: String,
    },
    /// A figure is not above 0.
    #[error("{file}: `{key}` is {found}; allowed are finite numbers above 0")]
    Range {
        /// The file.
        file: String,
        /// The key, with its table.
        key: String,
        /// The number found.
        found: String,
    },
    /// A figure is given twice.
    #[error("{file}: `{first}` and `{second}` say the same; allowed is one of them")]
    Twice {
        /// The file.
        file: String,
        /// One key, with its table.
        first: String,
        /// The other key, with its table.
        second: String,
    },
    /// The file has no figure.
    #[error("{file} has no figure: allowed are tables gyro, accel and mag with a noise density or a bias stability")]
    Empty {
        /// The file.
        file: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sheet {
    name: String,
    source: Option<String>,
    gyro: Option<Gyro>,
    accel: Option<Accel>,
    mag: Option<Mag>,
    sampling: Option<Sampling>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Gyro {
    noise_density_deg_s_sqrt_hz: Option<f64>,
    noise_density_rad_s_sqrt_hz: Option<f64>,
    angle_random_walk_deg_sqrt_h: Option<f64>,
    bias_stability_deg_h: Option<f64>,
    bias_stability_rad_s: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Accel {
    noise_density_ug_sqrt_hz: Option<f64>,
    noise_density_mg_sqrt_hz: Option<f64>,
    noise_density_m_s2_sqrt_hz: Option<f64>,
    velocity_random_walk_m_s_sqrt_h: Option<f64>,
    bias_stability_ug: Option<f64>,
    bias_stability_mg: Option<f64>,
    bias_stability_m_s2: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Mag {
    noise_density_ugauss_sqrt_hz: Option<f64>,
    noise_density_nt_sqrt_hz: Option<f64>,
    bias_stability_ugauss: Option<f64>,
    bias_stability_nt: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sampling {
    #[serde(deserialize_with = "internal_rate")]
    internal_rate_hz: f64,
    filter_window: NonZeroU32,
}

fn internal_rate<'a, D: Deserializer<'a>>(from: D) -> Result<f64, D::Error> {
    let rate_hz = f64::deserialize(from)?;
    let wrong =
        || D::Error::custom(format!("`internal_rate_hz` is {rate_hz}; allowed is more than 0 and at most 1000000"));
    (rate_hz > 0.0 && rate_hz <= 1e6).then_some(rate_hz).ok_or_else(wrong)
}

/// A key, its value, the factor to the unit of the channel, and the usual name of the unit.
type Key = (&'static str, Option<f64>, f64, &'static str);

const G: f64 = STANDARD_GRAVITY_M_S2;

impl Datasheet {
    /// Returns a datasheet from the text of a TOML file; `file` is its name in errors.
    ///
    /// # Errors
    /// [`FileError`] with the file, the key, and the values allowed.
    pub fn from_toml(text: &str, file: &str) -> Result<Self, FileError> {
        let form = |reason: String| FileError::Form { file: file.to_owned(), reason };
        let sheet: Sheet = toml::from_str(text).map_err(|error| form(error.to_string()))?;
        let gyro = sheet.gyro.map(|of| {
            let densities: [Key; 3] = [
                ("gyro.noise_density_deg_s_sqrt_hz", of.noise_density_deg_s_sqrt_hz, RAD_PER_DEG, "deg/s/√Hz"),
                ("gyro.noise_density_rad_s_sqrt_hz", of.noise_density_rad_s_sqrt_hz, 1.0, "rad/s/√Hz"),
                (
                    "gyro.angle_random_walk_deg_sqrt_h",
                    of.angle_random_walk_deg_sqrt_h,
                    RAD_PER_DEG / SQRT_HOUR,
                    "deg/√h",
                ),
            ];
            let stabilities: [Key; 2] = [
                ("gyro.bias_stability_deg_h", of.bias_stability_deg_h, RAD_PER_DEG / SECONDS_PER_HOUR, "deg/h"),
                ("gyro.bias_stability_rad_s", of.bias_stability_rad_s, 1.0, "rad/s"),
            ];
            figures(&densities, &stabilities, file)
        });
        let accel = sheet.accel.map(|of| {
            let densities: [Key; 4] = [
                ("accel.noise_density_ug_sqrt_hz", of.noise_density_ug_sqrt_hz, 1e-6 * G, "µg/√Hz"),
                ("accel.noise_density_mg_sqrt_hz", of.noise_density_mg_sqrt_hz, 1e-3 * G, "mg/√Hz"),
                ("accel.noise_density_m_s2_sqrt_hz", of.noise_density_m_s2_sqrt_hz, 1.0, "m/s²/√Hz"),
                (
                    "accel.velocity_random_walk_m_s_sqrt_h",
                    of.velocity_random_walk_m_s_sqrt_h,
                    1.0 / SQRT_HOUR,
                    "m/s/√h",
                ),
            ];
            let stabilities: [Key; 3] = [
                ("accel.bias_stability_ug", of.bias_stability_ug, 1e-6 * G, "µg"),
                ("accel.bias_stability_mg", of.bias_stability_mg, 1e-3 * G, "mg"),
                ("accel.bias_stability_m_s2", of.bias_stability_m_s2, 1.0, "m/s²"),
            ];
            figures(&densities, &stabilities, file)
        });
        let mag = sheet.mag.map(|of| {
            let densities: [Key; 2] = [
                ("mag.noise_density_ugauss_sqrt_hz", of.noise_density_ugauss_sqrt_hz, 1e-6, "µgauss/√Hz"),
                ("mag.noise_density_nt_sqrt_hz", of.noise_density_nt_sqrt_hz, 1e-5, "nT/√Hz"),
            ];
            let stabilities: [Key; 2] = [
                ("mag.bias_stability_ugauss", of.bias_stability_ugauss, 1e-6, "µgauss"),
                ("mag.bias_stability_nt", of.bias_stability_nt, 1e-5, "nT"),
            ];
            figures(&densities, &stabilities, file)
        });
        let sampled = match sheet.sampling {
            Some(Sampling { internal_rate_hz, filter_window }) => {
                Sampled::Stated { internal_rate_hz, filter_window: filter_window.get() }
            }
            None => Sampled::AsSent,
        };
        let (gyro, accel, mag) = (gyro.transpose()?, accel.transpose()?, mag.transpose()?);
        let empty = |of: Option<(bool, bool)>| of.is_none_or(|(density, stability)| !density && !stability);
        if [gyro.as_ref().map(has), accel.as_ref().map(has), mag.as_ref().map(has)].into_iter().all(empty) {
            return Err(FileError::Empty { file: file.to_owned() });
        }
        Ok(Self {
            name: sheet.name,
            source: sheet.source.unwrap_or_else(|| file.to_owned()),
            sampled,
            gyro,
            accel,
            mag,
        })
    }
}

/// Returns whether there is a density, and a stability.
fn has<D: Dimension>(of: &Figures<D>) -> (bool, bool) {
    (of.density.is_some(), of.bias_stability.is_some())
}

fn figures<D: Dimension>(densities: &[Key], stabilities: &[Key], file: &str) -> Result<Figures<D>, FileError> {
    let (density, stability) = (one(densities, file)?, one(stabilities, file)?);
    let printed =
        |of: &Option<(f64, String)>| of.as_ref().map_or_else(|| "none given".to_owned(), |(_, text)| text.clone());
    let printed = (printed(&density), printed(&stability));
    let density = density.map(|(value, _)| Quantity::held(value).per_root_hertz());
    let bias_stability = stability.map(|(value, _)| Quantity::held(value));
    Ok(Figures { density, density_limit: density, bias_stability, printed })
}

/// Returns the one given key: its value in the channel's unit, and as written.
fn one(keys: &[Key], file: &str) -> Result<Option<(f64, String)>, FileError> {
    let mut found: Option<(&Key, f64)> = None;
    for key in keys {
        let Some(value) = key.1 else { continue };
        if !(value.is_finite() && value > 0.0) {
            let (file, key) = (file.to_owned(), key.0.to_owned());
            return Err(FileError::Range { file, key, found: value.to_string() });
        }
        if let Some((first, _)) = found {
            let (first, second) = (first.0.to_owned(), key.0.to_owned());
            return Err(FileError::Twice { file: file.to_owned(), first, second });
        }
        found = Some((key, value));
    }
    Ok(found.map(|((_, _, factor, unit), value)| (value * factor, format!("{value} {unit}"))))
}

#[cfg(test)]
mod tests {
    use super::super::vn_100;
    use super::*;

    fn read(text: &str) -> Result<Datasheet, FileError> {
        Datasheet::from_toml(text, "own.toml")
    }

    /// The VN-100's own figures in other units give its own datasheet.
    #[test]
    fn figures_of_a_file_are_those_of_the_sheet_in_any_unit() {
        let own = vn_100();
        let density = |of: &Datasheet| of.gyro.as_ref().unwrap().density.unwrap().value();
        for text in [
            "noise_density_deg_s_sqrt_hz = 0.0035",
            "angle_random_walk_deg_sqrt_h = 0.21",
            "noise_density_rad_s_sqrt_hz = 6.108652e-5",
        ] {
            let found = read(&format!("name = 'x'\n[gyro]\n{text}")).unwrap();
            assert!((density(&found) / density(&own) - 1.0).abs() < 1e-6, "{text}");
        }
        let found =
            read("name = 'x'\n[accel]\nbias_stability_ug = 40\nvelocity_random_walk_m_s_sqrt_h = 0.0823759").unwrap();
        let (accel, own) = (found.accel.unwrap(), own.accel.unwrap());
        assert!((accel.bias_stability.unwrap().value() / own.bias_stability.unwrap().value() - 1.0).abs() < 1e-12);
        assert!((accel.density.unwrap().value() / own.density.unwrap().value() - 1.0).abs() < 1e-5);
        assert_eq!(accel.printed, ("0.0823759 m/s/√h".to_owned(), "40 µg".to_owned()));
        assert!(found.gyro.is_none() && found.source == "own.toml");
        let mag = read("name = 'x'\n[mag]\nnoise_density_nt_sqrt_hz = 14").unwrap().mag.unwrap();
        assert!((mag.density.unwrap().value() / 140e-6 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_density_is_expected_as_it_stands_unless_the_file_states_how_samples_are_made() {
        let as_sent = read("name = 'x'\n[gyro]\nbias_stability_deg_h = 8").unwrap();
        let factor =
            |sheet: &Datasheet| sheet.sampling(40.0, None).unwrap().density_factor(imu_core::sample::Triad::Gyro);
        assert!((factor(&as_sent) - 1.0).abs() < 1e-12);
        let text =
            "name = 'x'\n[gyro]\nbias_stability_deg_h = 8\n[sampling]\ninternal_rate_hz = 800\nfilter_window = 4";
        assert!((factor(&read(text).unwrap()) - 5f64.sqrt()).abs() < 1e-12);
        assert!((factor(&vn_100()) - 5f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn errors_name_the_file_the_key_and_what_is_allowed() {
        for (text, parts) in [
            ("name = 'x'\n[gyro]\nbias_deg_h = 8", ["own.toml", "bias_deg_h", "`bias_stability_deg_h`"]),
            ("name = 'x'\nnoise = 3", ["own.toml", "`noise`", "`sampling`"]),
            ("[gyro]\nbias_stability_deg_h = 8", ["own.toml", "missing field", "`name`"]),
            ("name = 'x'\n[gyro]\nbias_stability_deg_h = -8", ["own.toml", "gyro.bias_stability_deg_h", "above 0"]),
            ("name = 'x'\n[gyro]\nbias_stability_deg_h = nan", ["own.toml", "gyro.bias_stability_deg_h", "above 0"]),
            (
                "name = 'x'\n[accel]\nbias_stability_mg = 8\nbias_stability_ug = 8000",
                ["own.toml", "accel.bias_stability_ug", "accel.bias_stability_mg"],
            ),
            (
                "name = 'x'\n[gyro]\nbias_stability_deg_h = 8\n[sampling]\ninternal_rate_hz = 1e12\nfilter_window = 4",
                ["own.toml", "line 5", "1000000000000; allowed is more than 0 and at most 1000000"],
            ),
            (
                "name = 'x'\n[gyro]\nbias_stability_deg_h = 8\n[sampling]\ninternal_rate_hz = 400\nfilter_window = 0",
                ["own.toml", "line 6", "nonzero"],
            ),
            ("name = 'x'\n[gyro]", ["own.toml", "no figure", "gyro, accel and mag"]),
            ("name = ", ["own.toml", "no datasheet", "1"]),
        ] {
            let error = read(text).unwrap_err().to_string();
            for part in parts {
                assert!(error.contains(part), "{part} is not in: {error}");
            }
        }
    }
}
