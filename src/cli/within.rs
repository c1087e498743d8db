//! `vn100d noise --within FILE`: limits on N, B and K from a TOML file, beside a report.
//!
//! A table is a triad or a channel; a channel's own limit replaces that of its triad. A key is the parameter with its
//! unit, such as `B_deg_h` (docs/ci.md has all). Unknown tables and keys, numbers that are not above 0 and two keys for
//! one parameter are refused.

use super::limits::{Bound, Judged, Verdict};
use super::usage;
use imu_core::sample::{Channel, Triad};
use imu_core::units::{
    RAD_PER_DEG, SECONDS_PER_HOUR, SQRT_SECONDS_PER_SQRT_HOUR as SQRT_HOUR, STANDARD_GRAVITY_M_S2 as G,
};
use imu_files::recording::read_small;
use imu_noise::fit::{NoiseParameters, NoiseReport, Term};
use std::collections::BTreeMap;
use std::path::Path;

/// Maximum number of bytes of a file of limits.
const BYTES: u64 = 1 << 20;
/// The triads whose noise is analysed.
const TRIADS: [Triad; 3] = [Triad::Gyro, Triad::Accel, Triad::Mag];

/// A key, its parameter, the factor to the unit of the channel, and the usual name of the unit.
type Key = (&'static str, Term, f64, &'static str);

/// Returns the keys of a triad's table.
fn keys(triad: Triad) -> &'static [Key] {
    const DEG: f64 = RAD_PER_DEG;
    match triad {
        Triad::Gyro => &[
            ("N_rad_s_sqrt_hz", Term::N, 1.0, "rad/s/√Hz"),
            ("N_deg_s_sqrt_hz", Term::N, DEG, "deg/s/√Hz"),
            ("N_deg_sqrt_h", Term::N, DEG / SQRT_HOUR, "deg/√h"),
            ("B_rad_s", Term::B, 1.0, "rad/s"),
            ("B_deg_h", Term::B, DEG / SECONDS_PER_HOUR, "deg/h"),
            ("K_rad_s_sqrt_s", Term::K, 1.0, "rad/s/√s"),
            ("K_deg_h_sqrt_h", Term::K, DEG / SECONDS_PER_HOUR / SQRT_HOUR, "deg/h/√h"),
        ],
        Triad::Accel => &[
            ("N_m_s2_sqrt_hz", Term::N, 1.0, "m/s²/√Hz"),
            ("N_mg_sqrt_hz", Term::N, 1e-3 * G, "mg/√Hz"),
            ("N_ug_sqrt_hz", Term::N, 1e-6 * G, "µg/√Hz"),
            ("N_m_s_sqrt_h", Term::N, 1.0 / SQRT_HOUR, "m/s/√h"),
            ("B_m_s2", Term::B, 1.0, "m/s²"),
            ("B_mg", Term::B, 1e-3 * G, "mg"),
            ("B_ug", Term::B, 1e-6 * G, "µg"),
            ("K_m_s2_sqrt_s", Term::K, 1.0, "m/s²/√s"),
            ("K_mg_sqrt_h", Term::K, 1e-3 * G / SQRT_HOUR, "mg/√h"),
        ],
        Triad::Mag => &[
            ("N_gauss_sqrt_hz", Term::N, 1.0, "gauss/√Hz"),
            ("N_ugauss_sqrt_hz", Term::N, 1e-6, "µgauss/√Hz"),
            ("N_nt_sqrt_hz", Term::N, 1e-5, "nT/√Hz"),
            ("B_gauss", Term::B, 1.0, "gauss"),
            ("B_ugauss", Term::B, 1e-6, "µgauss"),
            ("B_nt", Term::B, 1e-5, "nT"),
            ("K_gauss_sqrt_s", Term::K, 1.0, "gauss/√s"),
        ],
        Triad::Attitude => &[],
    }
}

/// A limit on one parameter, in its own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Limit {
    number: f64,
    factor: f64,
    unit: &'static str,
}

/// The limits of a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Limits(BTreeMap<(Channel, Term), Limit>);

/// The reason why a file of limits is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
enum Refused {
    #[error("it is no file of limits: {0}")]
    Form(String),
    #[error("there is no table `{found}`: allowed are gyro, accel, mag and their channels, such as gyro_x")]
    Table { found: String },
    #[error("`{table}` has no key `{found}`: allowed are {allowed}")]
    Key { table: String, found: String, allowed: String },
    #[error("`{table}.{key}` is {found}: allowed are finite numbers above 0")]
    Range { table: String, key: String, found: f64 },
    #[error("`{table}` has two limits on {term}: allowed is one of them")]
    Twice { table: String, term: &'static str },
    #[error("there is no limit: expected a table such as [gyro] with a key such as N_deg_sqrt_h")]
    Empty,
}

impl Limits {
    /// Reads a file of limits.
    ///
    /// # Errors
    /// An error with the file, the key, and what is allowed.
    pub(super) fn open(path: &Path) -> anyhow::Result<Self> {
        Self::read(&read_small(path, BYTES)?).map_err(|refused| usage(format!("{}: {refused}", path.display())))
    }

    fn read(text: &str) -> Result<Self, Refused> {
        let tables: BTreeMap<String, BTreeMap<String, f64>> =
            toml::from_str(text).map_err(|error| Refused::Form(error.to_string()))?;
        let (mut of_triads, mut of_channels) = (BTreeMap::new(), BTreeMap::new());
        for (table, entries) in tables {
            let triad = TRIADS.into_iter().find(|triad| triad.name() == table);
            let channel = Channel::ANALYSED.into_iter().find(|channel| channel.name() == table);
            let owner = triad.or_else(|| channel?.triad()).ok_or_else(|| Refused::Table { found: table.clone() })?;
            for (term, limit) in Self::of_table(&table, owner, entries)? {
                match channel {
                    Some(channel) => drop(of_channels.insert((channel, term), limit)),
                    None => of_triads.extend(owner.channels().map(|channel| ((channel, term), limit))),
                }
            }
        }
        of_triads.extend(of_channels);
        if of_triads.is_empty() { Err(Refused::Empty) } else { Ok(Self(of_triads)) }
    }

    fn of_table(table: &str, triad: Triad, entries: BTreeMap<String, f64>) -> Result<BTreeMap<Term, Limit>, Refused> {
        let mut limits = BTreeMap::new();
        for (key, number) in entries {
            let Some((_, term, factor, unit)) = keys(triad).iter().find(|(known, ..)| *known == key) else {
                let allowed = keys(triad).iter().map(|(key, ..)| *key).collect::<Vec<_>>().join(", ");
                return Err(Refused::Key { table: table.to_owned(), found: key, allowed });
            };
            if !(number.is_finite() && number > 0.0) {
                return Err(Refused::Range { table: table.to_owned(), key, found: number });
            }
            if limits.insert(*term, Limit { number, factor: *factor, unit }).is_some() {
                return Err(Refused::Twice { table: table.to_owned(), term: term.letter() });
            }
        }
        Ok(limits)
    }

    /// Judges a report. A limit is met if the whole 95 % interval, or the upper limit of what is not identified, lies
    /// below it, missed if the whole interval lies above it, and undecided otherwise.
    pub(super) fn judge(&self, report: &NoiseReport) -> Vec<Judged> {
        let of = |(&(channel, term), limit): (&(Channel, Term), &Limit)| {
            limit.judge(channel, term, report.channels.get(&channel))
        };
        self.0.iter().map(of).collect()
    }
}

impl Limit {
    fn judge(&self, channel: Channel, term: Term, found: Option<&NoiseParameters>) -> Judged {
        let estimate = found.map(|found| found.estimate(term));
        let own = |value: f64| value / self.factor;
        let ci95 = estimate.and_then(|of| of.ci95).map(|ends| ends.map(own));
        let most = estimate.and_then(|of| of.upper_limit95).map(own);
        let (verdict, reason) = match (found, ci95, most) {
            (None, ..) => (Verdict::Missed, Some(format!("the capture has no {channel}"))),
            (Some(found), ..) if !found.usable => {
                let reason = found.reason.clone().unwrap_or_else(|| "no reason is known".to_owned());
                (Verdict::Undecided, Some(format!("the channel is not usable: {reason}")))
            }
            (_, Some([_, high]), _) if high <= self.number => (Verdict::Met, None),
            (_, Some([low, _]), _) if low > self.number => (Verdict::Missed, None),
            (Some(found), Some(_), _) => {
                (Verdict::Undecided, Some(format!("the 95 % interval contains the limit{}", longer(found, term))))
            }
            (Some(found), None, Some(most)) => {
                let below = format!("it is not identified and lies below {} {}", imu_cost::number(most), self.unit);
                if most <= self.number {
                    (Verdict::Met, Some(below))
                } else {
                    (Verdict::Undecided, Some(format!("{below}{}", longer(found, term))))
                }
            }
            (Some(_), None, None) => (Verdict::Undecided, Some("the record shows no value".to_owned())),
        };
        Judged {
            quantity: format!("{channel} {}", term.letter()),
            bound: Bound::AtMost,
            limit: self.number,
            unit: self.unit.to_owned(),
            value: estimate.and_then(|of| of.value).map(own),
            ci95,
            verdict,
            reason,
        }
    }
}

/// Returns the advice to record for longer, with the time for ±20 % if it is known.
fn longer(found: &NoiseParameters, term: Term) -> String {
    let needed_s = match term {
        Term::B => found.record_needed.b,
        Term::K => found.record_needed.k,
        _ => None,
    };
    let time =
        needed_s.map_or_else(String::new, |needed_s| format!("; {} are known to ±20 %", imu_cost::time(needed_s)));
    format!("; record for longer{time}")
}
