//! Words: the parameters of a channel beside their table, as sentences for people.
//!
//! They begin without a capital and end without a full stop, so that they may follow a channel's name.

use super::fit::{Bandwidth, Flag, NoiseParameters};

impl Bandwidth {
    /// Returns the filter: `a moving average of 4 samples (register 85)`.
    pub fn words(&self) -> String {
        let kind = match self.kind.as_str() {
            "moving_average" => "a moving average",
            "low_pass" => "a low pass",
            _ => "a filter of another shape",
        };
        let order = self.order.map(|order| format!(" of order {order}")).unwrap_or_default();
        let of = if self.unit == "Hz" { "at" } else { "of" };
        let value = self.value.map(|value| match self.ci95 {
            None if value.fract() == 0.0 => format!(" {of} {value} {}", self.unit),
            Some([low, high]) => format!(" {of} {value:.4} {} [{low:.4}, {high:.4}]", self.unit),
            None => format!(" {of} {value:.4} {}", self.unit),
        });
        format!("{kind}{order}{} ({})", value.unwrap_or_default(), self.source)
    }
}

impl Flag {
    /// Returns the flag's kind, its time and its note: `spike at 108.30–108.33 s: 7.9 standard deviations from its
    /// neighbours`.
    pub fn words(&self) -> String {
        let when = match (self.from_s, self.to_s) {
            (Some(from), Some(to)) => format!(" at {from:.2}–{to:.2} s"),
            _ => String::new(),
        };
        format!("{}{when}: {}", self.kind.replace('_', " "), self.note)
    }
}

impl NoiseParameters {
    /// Returns the filter, the sensor's own density, the lowest deviation beside B, how long to record, and why no walk
    /// shows.
    pub fn sentences(&self, number: impl Fn(f64) -> String) -> Vec<String> {
        let mut all = Vec::new();
        if let Some(filter) = &self.bandwidth {
            let behind = filter.white_behind.map(|n| format!("; white noise behind it {} {}", number(n), self.n.unit));
            let up_to = filter.up_to_hz.map(|hz| format!("; the fit leaves out frequencies above {hz:.3} Hz"));
            all.push(format!("behind {}{}{}", filter.words(), behind.unwrap_or_default(), up_to.unwrap_or_default()));
        }
        if let Some(internal) = self.n.internal {
            all.push(format!("the sensor's own density is {} {}", number(internal), self.n.unit));
        }
        if let Some(lowest) = &self.minimum {
            all.push(format!(
                "lowest Allan deviation {} {unit} at {}; over 0.664 that is {} {unit}, and B is at most this, to within the scatter \
                 of the curve",
                number(lowest.deviation),
                span(lowest.tau_s),
                number(lowest.over_0_664),
                unit = self.unit
            ));
        }
        // Parameters that contradict the curve do not determine how long to record, nor why a parameter is absent.
        if !self.usable {
            return all;
        }
        let times = [("B", self.record_needed.b), ("K", self.record_needed.k)];
        let times: Vec<String> =
            times.into_iter().filter_map(|(letter, s)| Some(format!("{} for {letter}", span(s?)))).collect();
        if !times.is_empty() {
            all.push(format!("to know a value to ±20 %, record at rest and without a gap: {}", times.join(", ")));
        }
        if self.b.upper_limit95.is_some() {
            all.push("no flicker is seen, so the record does not show how long B needs".to_owned());
        }
        if let Some((beyond_s, limit)) = self.walk_shows_beyond_s.zip(self.k.upper_limit95) {
            let ends_s = self.fit.curve.as_ref().and_then(|curve| curve.tau_s.last().copied());
            let ends = match ends_s {
                Some(ends_s) if ends_s > beyond_s => {
                    format!(
                        "; this record's curve ends at {}, but its last points are of too few averages",
                        span(ends_s)
                    )
                }
                Some(ends_s) => format!("; this record's curve ends at {}", span(ends_s)),
                None => String::new(),
            };
            all.push(format!(
                "no random walk is seen, hence no slope of +½: one as large as its limit, {} {}, would rise above the lowest \
                 deviation beyond {}{ends}",
                number(limit),
                self.k.unit,
                span(beyond_s)
            ));
        }
        all
    }
}

/// Kinds of flags of which a channel may have many: the name in JSON, one of them, several.
const COUNTED: [(&str, &str, &str); 7] = [
    ("spike", "spike", "spikes"),
    ("knock", "knock", "knocks"),
    ("handling", "stretch of handling", "stretches of handling"),
    ("bump", "bump", "bumps"),
    ("step", "step", "steps"),
    ("line", "line", "lines"),
    ("vibration", "band of vibration", "bands of vibration"),
];

/// Returns the number of each kind of disturbance (`9 spikes, 12 knocks, 5 lines`) if there is one, the flags that it
/// counts, and the other flags.
pub fn grouped(flags: &[Flag]) -> (Option<String>, Vec<&Flag>, Vec<&Flag>) {
    let (counted, others): (Vec<&Flag>, Vec<&Flag>) =
        flags.iter().partition(|flag| COUNTED.iter().any(|(kind, ..)| flag.kind == *kind));
    let words = COUNTED.iter().filter_map(|(kind, one, several)| {
        let count = counted.iter().filter(|flag| flag.kind == *kind).count();
        (count > 0).then(|| format!("{count} {}", if count == 1 { one } else { several }))
    });
    let words = words.collect::<Vec<_>>().join(", ");
    (Some(words).filter(|words| !words.is_empty()), counted, others)
}

/// Returns a time in a suitable unit.
fn span(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => {
            let text = format!("{s:.3}");
            format!("{} s", text.trim_end_matches('0').trim_end_matches('.'))
        }
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 72.0 * 3600.0 => format!("{:.1} h", s / 3600.0),
        s if s < 61.0 * 86_400.0 => format!("{:.0} days", s / 86_400.0),
        s if s < 730.0 * 86_400.0 => format!("{:.0} months", s / 86_400.0 / 30.44),
        s => format!("{:.0} years", s / 86_400.0 / 365.25),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disturbances_are_counted_by_kind_and_other_flags_stay_sentences() {
        let kinds = ["line", "spike", "misfit", "line", "handling", "line"];
        let flags: Vec<Flag> = kinds.iter().map(|kind| Flag::whole(kind, "a note")).collect();
        let (words, counted, others) = grouped(&flags);
        assert_eq!(words.as_deref(), Some("1 spike, 1 stretch of handling, 3 lines"));
        assert_eq!((counted.len(), others.len(), others[0].kind.as_str()), (5, 1, "misfit"));
        assert_eq!(grouped(&flags[2..3]).0, None);
    }

    #[test]
    fn long_times_are_given_in_days_months_and_years() {
        let day = 86_400.0;
        let spans = [30.0, 7100.0, 2.0 * day, 20.0 * day, 400.0 * day, 17_955.0 * day].map(span);
        assert_eq!(spans, ["30 s", "118 min", "48.0 h", "20 days", "13 months", "49 years"]);
    }
}
