//! The numbers to paste and their places: the input of each program, in its own convention, next to the parameters
//! themselves.

use super::form::{Entry, Form, Noise};
use super::{ImuNoise, Known, Target, filter, largest};
use imu_core::sample::{Channel, Triad};
use imu_noise::NoiseReport;
use serde::{Deserialize, Serialize};

/// `vn100d-noise-1` as returned: the parameters, and the numbers for each program.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct NoiseDocument {
    /// The parameters.
    #[serde(flatten)]
    pub report: NoiseReport,
    /// The number to paste for each program.
    pub paste: Paste,
}

impl From<NoiseReport> for NoiseDocument {
    fn from(report: NoiseReport) -> Self {
        Self { paste: Paste::of(&report), report }
    }
}

/// The number to paste for each program.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Paste {
    /// The reason why published values are larger than these.
    pub note: String,
    /// The programs that take numbers of this record.
    pub programs: Vec<Program>,
}

/// The numbers for one program.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Program {
    /// The name on the command line and in queries: `--format` and `?format=` write the file.
    pub format: String,
    /// The program's file.
    pub program: String,
    /// The program's interpretation of its numbers.
    pub takes: String,
    /// The code or document that states this.
    pub source: String,
    /// The numbers.
    pub values: Vec<Number>,
}

/// A number that a program takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Number {
    /// The program's name for the number.
    pub name: String,
    /// The channel, or the triad if one number stands for three axes: that of the largest.
    pub of: String,
    /// The kind of noise.
    pub noise: Noise,
    /// The number; null if it is not known, if a simulator gets only measured values, or if a channel is not usable.
    pub value: Option<f64>,
    /// The unit.
    pub unit: String,
    /// Whether it is a 95 % upper limit, because the record does not identify it.
    pub limit: bool,
    /// The reason why there is no number: the channels that are not usable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Triads in the table.
const TRIADS: [(Triad, [&str; 2]); 2] = [
    (Triad::Gyro, ["gyroscope white noise", "gyroscope walk"]),
    (Triad::Accel, ["accelerometer white noise", "accelerometer walk"]),
];

impl Paste {
    /// The entry of the table for a channel that is not usable.
    pub const UNUSABLE: &str = "not usable";

    /// Returns the summary of a report.
    pub fn of(report: &NoiseReport) -> Self {
        let noise = ImuNoise::of(report);
        let programs = Target::ALL.into_iter().map(|target| Program::of(target, &noise, report));
        Self {
            note: filter::INFLATED.to_owned(),
            programs: programs.filter(|program| !program.values.is_empty()).collect(),
        }
    }

    /// Returns the header of a table for the user, and its rows: a program's name, its input, and white noise and walk
    /// of gyroscope and accelerometer, the largest of the axes. There are no rows if the record has neither.
    pub fn table(&self, number: impl Fn(f64) -> String) -> (Vec<&'static str>, Vec<Vec<String>>) {
        let there =
            |triad: Triad| self.programs.iter().flat_map(|program| &program.values).any(|number| number.is_of(triad));
        let triads: Vec<(Triad, [&str; 2])> = TRIADS.into_iter().filter(|(triad, _)| there(*triad)).collect();
        let header = ["program", "takes"].into_iter().chain(triads.iter().flat_map(|(_, words)| *words)).collect();
        if triads.is_empty() {
            return (header, Vec::new());
        }
        let row = |program: &Program| {
            let mut row = vec![program.format.clone(), program.takes.clone()];
            for (triad, _) in &triads {
                row.extend(Noise::ALL.map(|noise| program.cell(*triad, noise, &number)));
            }
            row
        };
        (header, self.programs.iter().map(row).collect())
    }
}

impl Program {
    fn of(target: Target, noise: &ImuNoise, report: &NoiseReport) -> Self {
        let Form { takes, source, each_axis, entries } = target.form(noise);
        let values = entries.iter().flat_map(|entry| {
            let channels = entry.triad.channels();
            if each_axis {
                let there = channels.into_iter().zip(entry.axes).filter(|(own, _)| report.channels.contains_key(own));
                there.map(|(own, known)| Number::of(entry, own.name(), [known; 3], refusal(report, &[own]))).collect()
            } else {
                vec![Number::of(entry, entry.triad.name(), entry.axes, refusal(report, &channels))]
            }
        });
        Self {
            format: target.name().to_owned(),
            program: target.about().to_owned(),
            takes,
            source: source.to_owned(),
            values: values.collect(),
        }
    }

    fn cell(&self, triad: Triad, noise: Noise, number: impl Fn(f64) -> String) -> String {
        let own = || self.values.iter().filter(|own| own.noise == noise && own.is_of(triad));
        if own().any(|own| own.reason.is_some()) {
            return Paste::UNUSABLE.to_owned();
        }
        let valued = own().filter_map(|own| Some((own.value?, own)));
        let largest = valued.reduce(|one, other| if other.0 > one.0 { other } else { one });
        largest.map_or_else(
            || "–".to_owned(),
            |(value, own)| format!("{}{} {}", if own.limit { "< " } else { "" }, number(value), own.unit),
        )
    }
}

impl Number {
    fn of(entry: &Entry, of: &str, axes: [Known; 3], reason: Option<String>) -> Self {
        let known = largest(axes);
        let value = known.bound().filter(|value| value.is_finite() && reason.is_none());
        Self {
            name: entry.key.to_owned(),
            of: of.to_owned(),
            noise: entry.noise,
            value,
            unit: for_people(&entry.unit),
            limit: value.is_some() && matches!(known, Known::Below(_)),
            reason,
        }
    }

    fn is_of(&self, triad: Triad) -> bool {
        self.of == triad.name() || triad.channels().iter().any(|channel| self.of == channel.name())
    }
}

fn refusal(report: &NoiseReport, channels: &[Channel]) -> Option<String> {
    report.refusal(|channel| channels.contains(&channel))
}

/// Returns a unit in the form for documents.
fn for_people(ascii: &str) -> String {
    const SIGNS: [(&str, &str); 7] = [
        ("sqrt(Hz)", "√Hz"),
        ("sqrt(s)", "√s"),
        ("rt-hr", "√h"),
        ("/hr", "/h"),
        ("^2", "²"),
        ("^3", "³"),
        ("uT", "µT"),
    ];
    SIGNS.iter().fold(ascii.to_owned(), |unit, (sign, other)| unit.replace(sign, other))
}
