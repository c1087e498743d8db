//! Together: determines whether several captures are of one sensor at one setting, so that their sums may be added.

use super::JobError;
use super::plan::Plan;
use super::request::{CAPTURES_MAX, JobParameters};
use super::sampling::of_configuration;
use crate::store::{CaptureRow, Reader};
use imu_core::sample::{Channel, FilterWindows, Triad};
use imu_diagnosis::is_same_rate;
use imu_noise::whittle::Sampling;
use std::collections::BTreeMap;

/// The properties that captures must share to be analysed together. A property that one of them does not state is no
/// difference.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// The capture's name.
    pub name: String,
    /// The rate of its samples, Hz.
    pub rate_hz: f64,
    /// The sensor's model.
    pub model: Option<String>,
    /// The sensor's serial number.
    pub serial_number: Option<String>,
    /// Filter windows of register 85.
    pub windows: Option<FilterWindows>,
    /// The sampling, by register 85 or by the options of its import.
    pub sampling: BTreeMap<Triad, Sampling>,
    /// The sensor's output: the name of its message, or the groups and fields of its binary output.
    pub output: Option<String>,
    /// Unit in which each channel was recorded.
    pub units: BTreeMap<Channel, String>,
}

impl Setting {
    /// Returns the setting of a recording of which only the rate is known.
    pub fn of_rate(name: &str, rate_hz: f64) -> Self {
        Self {
            name: name.to_owned(),
            rate_hz,
            model: None,
            serial_number: None,
            windows: None,
            sampling: BTreeMap::new(),
            output: None,
            units: BTreeMap::new(),
        }
    }

    /// Returns the setting of a capture whose samples have the rate `rate_hz`.
    pub fn of(row: &CaptureRow, rate_hz: f64) -> Self {
        let unit = |channel: &Channel| {
            let row = row.units.get(channel.name())?;
            Some((*channel, row.original_unit.clone().unwrap_or_else(|| row.unit.clone())))
        };
        Self {
            model: row.sensor.model().map(str::to_owned),
            serial_number: row.sensor.serial_number().map(str::to_owned),
            windows: row.configuration.register_85(),
            sampling: of_configuration(&row.configuration),
            output: row.configuration.output().map(str::to_owned),
            units: row.channels.iter().filter_map(unit).collect(),
            ..Self::of_rate(&row.name, rate_hz)
        }
    }

    /// Returns the differences from another setting, one phrase each.
    fn differences(&self, other: &Self) -> Vec<String> {
        let mut found = Vec::new();
        let mut known = |what: &str, one: Option<String>, two: Option<String>| {
            if let (Some(one), Some(two)) = (one, two)
                && one != two
            {
                found.push(format!("{what} {one} and {two}"));
            }
        };
        known("model", self.model.clone(), other.model.clone());
        known("serial number", self.serial_number.clone(), other.serial_number.clone());
        // Two clocks do not show one rate with the same digits.
        let rate = |of: &Self| Some(of.rate_hz.to_string()).filter(|_| !is_same_rate(self.rate_hz, other.rate_hz));
        known("rate in Hz", rate(self), rate(other));
        let windows = |of: &Self| {
            let FilterWindows { mag, accel, gyro } = of.windows?;
            Some(format!("mag {mag}, accel {accel}, gyro {gyro}"))
        };
        known("filter window (register 85)", windows(self), windows(other));
        for (triad, one) in self.sampling.iter().filter(|_| windows(self).and(windows(other)).is_none()) {
            let phrase = |of: &Sampling| format!("means of {} at {} Hz", of.window.max(1), of.internal_rate_hz);
            known(&format!("sampling of {}", triad.name()), Some(phrase(one)), other.sampling.get(triad).map(phrase));
        }
        known("output", self.output.clone(), other.output.clone());
        for (channel, unit) in &self.units {
            known(&format!("unit of {channel}"), Some(unit.clone()), other.units.get(channel).cloned());
        }
        found
    }
}

/// Checks whether captures are of one sensor at one setting.
///
/// # Errors
/// [`JobError::Together`] with the difference and the captures that differ.
pub fn one_sensor(settings: &[Setting]) -> Result<(), JobError> {
    let Some((first, others)) = settings.split_first() else { return Ok(()) };
    if settings.len() > CAPTURES_MAX {
        return Err(JobError::Together(format!("{} captures are more than {CAPTURES_MAX}", settings.len())));
    }
    // Each with each: two may agree with a third that states less.
    for (index, one) in std::iter::once(first).chain(others).enumerate() {
        for other in settings.iter().skip(index + 1) {
            let differences = one.differences(other);
            if !differences.is_empty() {
                let reason = format!("`{}` and `{}` differ: {}", one.name, other.name, differences.join("; "));
                return Err(JobError::Together(reason));
            }
        }
    }
    Ok(())
}

/// Returns the plan over several captures of one sensor: (id, samples) of each.
///
/// # Errors
/// [`JobError::Together`] if one is given twice or they are not of one sensor at one setting; else as [`Plan::read`].
pub(super) fn plan(reader: &Reader, captures: &[(i64, u64)], wanted: &[Channel]) -> Result<Plan, JobError> {
    let mut whole: Option<Plan> = None;
    let mut settings = Vec::new();
    for (index, (id, end_seq)) in captures.iter().enumerate() {
        if captures.iter().take(index).any(|(other, _)| other == id) {
            return Err(JobError::Together(format!("capture {id} is given twice")));
        }
        let plan = Plan::read(reader, *id, *end_seq, wanted)?;
        if captures.len() > 1 {
            settings.push(Setting::of(&reader.capture(*id)?, plan.rate_hz));
            // This check comes before the samples are put side by side.
            one_sensor(&settings)?;
        }
        whole = Some(match whole {
            None => plan,
            Some(whole) => whole.followed_by(plan)?,
        });
    }
    whole.ok_or_else(|| JobError::Together("no capture is given".to_owned()))
}

/// Returns the plan of a job: its capture's samples below `end_seq`, and all samples of further captures, since those
/// have ended.
///
/// # Errors
/// [`JobError::Together`] if one still runs; else as [`plan`].
pub(super) fn plan_of(
    reader: &Reader,
    capture_id: i64,
    end_seq: u64,
    parameters: &JobParameters,
) -> Result<Plan, JobError> {
    let mut captures = vec![(capture_id, end_seq)];
    for id in &parameters.with {
        let row = reader.capture(*id)?;
        if row.state.is_open() {
            let reason = format!("`{}` still runs: take captures that have ended", row.name);
            return Err(JobError::Together(reason));
        }
        captures.push((*id, row.samples));
    }
    plan(reader, &captures, parameters.channels.as_deref().unwrap_or(&Channel::ANALYSED))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_differs_is_named_and_what_is_not_stated_is_no_difference() {
        let plain = Setting::of_rate("a", 40.0);
        let full = Setting {
            name: "b".to_owned(),
            model: Some("VN-100".to_owned()),
            serial_number: Some("0100012345".to_owned()),
            windows: Some(FilterWindows::FACTORY),
            output: Some("VNYMR".to_owned()),
            units: [(Channel::GyroX, "rad/s".to_owned())].into(),
            ..plain.clone()
        };
        one_sensor(&[plain.clone(), full.clone(), plain.clone()]).unwrap();
        let c = |change: fn(&mut Setting)| {
            let mut setting = Setting { name: "c".to_owned(), ..full.clone() };
            change(&mut setting);
            one_sensor(&[full.clone(), plain.clone(), setting]).unwrap_err().to_string()
        };
        for (error, words) in [
            (c(|c| c.rate_hz = 100.0), "rate in Hz 40 and 100"),
            (c(|c| c.model = Some("VN-110".to_owned())), "model VN-100 and VN-110"),
            (c(|c| c.serial_number = Some("7".to_owned())), "serial number 0100012345 and 7"),
            (
                c(|c| c.windows = Some(FilterWindows { gyro: 8, ..FilterWindows::FACTORY })),
                "gyro 4 and mag 0, accel 4, gyro 8",
            ),
            (c(|c| c.output = Some("VNIMU".to_owned())), "output VNYMR and VNIMU"),
            (c(|c| c.units = [(Channel::GyroX, "deg/s".to_owned())].into()), "unit of gyro_x rad/s and deg/s"),
        ] {
            assert!(error.contains(words) && error.contains("differ"), "{error}");
        }
        // A statement at an import counts as a register does.
        let stated = |window| {
            let configuration = serde_json::json!({"sampling": {"filter_window": window, "internal_rate_hz": 800}});
            Setting { sampling: of_configuration(&configuration.into()), ..plain.clone() }
        };
        one_sensor(&[stated(4), plain.clone(), stated(4)]).unwrap();
        let sampled = one_sensor(&[stated(4), stated(8)]).unwrap_err().to_string();
        assert!(sampled.contains("sampling of gyro means of 4 at 800 Hz and means of 8 at 800 Hz"), "{sampled}");
        let rates = [99.999_989_949_392_06, 99.999_925_385_480_04, 100.0];
        one_sensor(&rates.map(|rate_hz| Setting::of_rate("r", rate_hz))).unwrap();
        // The rate is known of `a` too, and it is the first that differs.
        let rates = one_sensor(&[plain, Setting { rate_hz: 80.0, ..full }]).unwrap_err().to_string();
        assert!(rates.contains("`a` and `b` differ: rate in Hz 40 and 80"), "{rates}");
    }
}
