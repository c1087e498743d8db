//! Limits of a command line: how they are read, what is found beside each, how that is printed, and which outcome
//! follows.
//!
//! `NAME=NUMBER` texts and found values go in; verdicts and an [`Outcome`] come out. A name that the command does not
//! have, a number that the quantity cannot have and a limit that is given twice are refused as wrong usage.

use super::{Outcome, usage};
use imu_cost::number;
use serde::Serialize;
use std::io::Write;

/// A quantity that may be limited: its name and the largest number that it can have.
pub(super) type Known<'a> = (&'a str, f64);

/// On which side of its number a limit holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
pub(super) enum Bound {
    #[strum(serialize = "at least")]
    AtLeast,
    #[strum(serialize = "at most")]
    AtMost,
}

impl Bound {
    /// Returns the words `at least` or `at most`.
    pub(super) fn words(self) -> &'static str {
        self.into()
    }
}

/// A limit of `--at-least` or `--at-most`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Limit {
    pub(super) name: String,
    pub(super) bound: Bound,
    pub(super) number: f64,
}

impl Limit {
    /// Returns the limits of both options.
    ///
    /// # Errors
    /// A usage error with the text that was found and with what is allowed.
    pub(super) fn all(at_least: &[String], at_most: &[String], known: &[Known]) -> anyhow::Result<Vec<Self>> {
        let least = at_least.iter().map(|text| (text, Bound::AtLeast));
        let both = least.chain(at_most.iter().map(|text| (text, Bound::AtMost)));
        let mut limits: Vec<Self> = Vec::new();
        for (text, bound) in both {
            let limit = Self::read(text, bound, known)?;
            if limits.iter().any(|other| other.name == limit.name && other.bound == bound) {
                let option = bound.words().replace(' ', "-");
                return Err(usage(format!("`--{option} {text}`: {} has such a limit already; give one", limit.name)));
            }
            limits.push(limit);
        }
        Ok(limits)
    }

    fn read(text: &str, bound: Bound, known: &[Known]) -> anyhow::Result<Self> {
        let refused = |expected: String| {
            Err(usage(format!("`--{} {text}`: expected {expected}", bound.words().replace(' ', "-"))))
        };
        let (name, number) = text.split_once('=').unwrap_or((text, ""));
        let Some((_, most)) = known.iter().find(|(known, _)| *known == name) else {
            let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
            return refused(format!("NAME=NUMBER, NAME one of {}", names.join(", ")));
        };
        match number.parse::<f64>().ok().filter(|number| number.is_finite() && (0.0..=*most).contains(number)) {
            Some(number) => Ok(Self { name: name.to_owned(), bound, number }),
            None if most.is_finite() => refused(format!("NAME=SHARE, a share of {name} from 0 to {most}")),
            None => refused(format!("NAME=NUMBER, a number for {name} of 0 or more")),
        }
    }

    /// Returns whether a value satisfies the limit.
    pub(super) fn holds(&self, value: f64) -> bool {
        match self.bound {
            Bound::AtLeast => value >= self.number,
            Bound::AtMost => value <= self.number,
        }
    }
}

/// What is known about a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Verdict {
    /// The quantity satisfies the limit.
    Met,
    /// It does not, or there is no number for it.
    Missed,
    /// The record does not show whether it does.
    Undecided,
}

/// A limit with what was found beside it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Judged {
    /// What is limited, such as `gap` or `gyro_x N`.
    pub(super) quantity: String,
    pub(super) bound: Bound,
    pub(super) limit: f64,
    /// The unit of limit, value and interval; empty for a share.
    pub(super) unit: String,
    pub(super) value: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) ci95: Option<[f64; 2]>,
    pub(super) verdict: Verdict,
    /// Why there is no number or no verdict.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) reason: Option<String>,
}

impl Judged {
    /// Returns the limit in words, such as `gap at most 0.001 nats/sample`.
    pub(super) fn name(&self) -> String {
        format!("{} {} {}", self.quantity, self.bound.words(), self.with_unit(&self.limit.to_string()))
    }

    /// Returns what was found beside the limit, as a sentence without a full stop.
    pub(super) fn sentence(&self) -> String {
        let interval =
            self.ci95.map_or_else(String::new, |[low, high]| format!(" ({} to {})", number(low), number(high)));
        let found = self.value.map_or_else(
            || "has no number".to_owned(),
            |value| format!("is {}{interval}", self.with_unit(&number(value))),
        );
        let reason = self.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
        let limit = self.with_unit(&self.limit.to_string());
        format!("{} {found}, {} {limit} is asked for{reason}", self.quantity, self.bound.words())
    }

    fn with_unit(&self, digits: &str) -> String {
        if self.unit.is_empty() { digits.to_owned() } else { format!("{digits} {}", self.unit) }
    }
}

/// Writes a line per limit.
pub(super) fn write(to: &mut dyn Write, all: &[Judged]) -> std::io::Result<()> {
    for one in all {
        let word = match one.verdict {
            Verdict::Met => "pass",
            Verdict::Missed => "FAIL",
            Verdict::Undecided => "NOT SHOWN",
        };
        writeln!(to, "{word}: {}", one.sentence())?;
    }
    Ok(())
}

/// Writes the limits that are not met to standard error, where a document fills standard output.
pub(super) fn complain(all: &[Judged]) -> std::io::Result<()> {
    let others: Vec<Judged> = all.iter().filter(|one| one.verdict != Verdict::Met).cloned().collect();
    write(&mut std::io::stderr().lock(), &others)
}

/// Prints a document as JSON, with its limits as `limits` if there are any.
pub(super) fn print_json<T: Serialize>(document: &T, limits: &[Judged]) -> anyhow::Result<()> {
    #[derive(Serialize)]
    struct Limited<'a, T> {
        #[serde(flatten)]
        document: &'a T,
        limits: &'a [Judged],
    }
    if limits.is_empty() { super::print_json(document) } else { super::print_json(&Limited { document, limits }) }
}

/// Returns how a command ends whose limits these are. `rejected` states that data was rejected, `lenient` that a limit
/// counts as met until it is shown to be missed.
pub(super) fn outcome(all: &[Judged], rejected: bool, lenient: bool) -> Outcome {
    let missed =
        all.iter().any(|one| one.verdict == Verdict::Missed || (one.verdict == Verdict::Undecided && !lenient));
    match (missed, rejected) {
        (true, _) => Outcome::LimitMissed,
        (false, true) => Outcome::WithLoss,
        (false, false) => Outcome::Done,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: [Known; 2] = [("gap", f64::INFINITY), ("closed", 1.0)];

    fn read(at_least: &[&str], at_most: &[&str]) -> Result<Vec<Limit>, String> {
        let own = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>();
        Limit::all(&own(at_least), &own(at_most), &KNOWN).map_err(|error| error.to_string())
    }

    #[test]
    fn a_limit_is_a_known_name_with_a_number_that_it_can_have() {
        let limits = read(&["closed=0.9"], &["gap=1e-3", "closed=1"]).unwrap();
        assert!(limits[0].holds(0.9) && !limits[0].holds(0.89) && limits[1].holds(1e-3) && !limits[1].holds(2e-3));
        for (text, part) in [
            ("gap", "NAME=NUMBER, a number for gap of 0 or more"),
            ("gap=-1", "`--at-most gap=-1`"),
            ("gap=nan", "a number for gap of 0 or more"),
            ("gap=inf", "a number for gap of 0 or more"),
            ("gap=", "a number for gap of 0 or more"),
            ("closed=1.5", "NAME=SHARE, a share of closed from 0 to 1"),
            ("size=1", "NAME one of gap, closed"),
            ("", "NAME one of gap, closed"),
            ("gap=1=2", "a number for gap of 0 or more"),
        ] {
            let error = read(&[], &[text]).unwrap_err();
            assert!(error.contains(part) && !error.contains('\n'), "{text}: {error}");
        }
        assert!(
            read(&[], &["gap=1", "gap=1"]).unwrap_err().contains("`--at-most gap=1`: gap has such a limit already")
        );
        assert!(read(&["closed=1.5"], &[]).unwrap_err().contains("--at-least closed=1.5"));
    }

    #[test]
    fn what_is_not_shown_is_missed_unless_it_is_allowed() {
        let of = |verdict| Judged {
            quantity: "gyro_x B".to_owned(),
            bound: Bound::AtMost,
            limit: 8.0,
            unit: "deg/h".to_owned(),
            value: Some(7.5),
            ci95: Some([6.0, 9.0]),
            verdict,
            reason: Some("the interval contains the limit".to_owned()),
        };
        let [met, missed, untold] = [Verdict::Met, Verdict::Missed, Verdict::Undecided].map(of);
        assert_eq!(outcome(std::slice::from_ref(&met), false, false), Outcome::Done);
        assert_eq!(outcome(std::slice::from_ref(&met), true, false), Outcome::WithLoss);
        assert_eq!(outcome(&[met.clone(), missed], true, true), Outcome::LimitMissed);
        assert_eq!(outcome(&[met.clone(), untold.clone()], false, false), Outcome::LimitMissed);
        assert_eq!(outcome(&[met, untold.clone()], false, true), Outcome::Done);
        assert_eq!(untold.name(), "gyro_x B at most 8 deg/h");
        let expected =
            "gyro_x B is 7.50 deg/h (6.00 to 9.00), at most 8 deg/h is asked for: the interval contains the limit";
        assert_eq!(untold.sentence(), expected);
    }
}
