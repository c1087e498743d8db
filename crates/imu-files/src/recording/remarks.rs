//! Remarks: the sentences about a recording, in which its findings are reported.

use super::DEFAULT_VN_RATE_HZ;
use super::doubts::shown;
use super::findings::{Doubt, Pairs, Quantisation};
use super::grid::StampGrid;
use super::info::RecordingInfo;
use super::kind::Kind;
use imu_core::sample::Channel;
use imu_core::units::counted;
use std::collections::BTreeMap;

/// A given rate is reported if it differs by more than this share from the rate found.
const RATE_DIFFERS: f64 = 0.005;
/// From this share of the samples on, late stamps are not strays but another run.
const LATE_FROM: f64 = 0.05;
/// From this share of samples on, repetitions are not chance: a coarse sensor's values repeat now and then.
const REPEATED_FROM: f64 = 1e-5;
/// A sensor that sends less than this share of its default rate was set to a lower one, or not all of it was recorded.
const SLOW: f64 = 0.5;
/// Jitter and rounding of a smaller share of the period are not reported.
const JITTER_FROM: f64 = 1e-3;
const ROUNDED_FROM: f64 = 1e-3;

impl Doubt {
    fn sentence(&self, kind: Kind) -> String {
        let Self { triad, unit, looks_like, suffix, reason } = self;
        let guess = match (looks_like, suffix) {
            (Some(like), Some(suffix)) if kind == Kind::Csv => {
                format!("was it in {like} already? Its columns would be called {triad}_x{suffix} …")
            }
            (Some(like), _) => format!("was it in {like} already?"),
            _ => "no unit that is known here fits (counts of a converter?)".to_owned(),
        };
        format!("{triad} does not look like {unit}: {reason}; {guess} It was read as {unit}, nothing was changed")
    }
}

impl RecordingInfo {
    /// Returns the sentences that a user should read about the recording.
    pub fn remarks(&self) -> Vec<String> {
        // Findings that invalidate other figures come first.
        let mut remarks: Vec<String> = self.pairs().into_iter().collect();
        remarks.extend(self.findings.doubts.iter().map(|doubt| doubt.sentence(self.kind)));
        let unit = self.stamp_choice.as_ref().and_then(|choice| choice.unit);
        remarks.extend(unit.map(|unit| format!("the stamps before $VN are in {unit}")));
        self.remark_rate(&mut remarks);
        self.remark_steps(&mut remarks);
        self.remark_rejected_stamps(&mut remarks);
        self.remark_values(&mut remarks);
        remarks
    }

    /// Reports that a given rate overrides that of the stamps, with both.
    pub fn overridden(&self) -> Option<String> {
        let (given_hz, hz) = (self.rate_hz, rate(self.overridden_rate_hz?));
        Some(match self.stamp_grid {
            Some(_) => format!("--rate {given_hz} overrides the {hz} Hz of the stamps; gaps are still theirs"),
            None => format!(
                "--rate {given_hz} overrides the stamps, which lie on a grid of {hz} Hz: they do not count, and no sample \
                 is known to be missing"
            ),
        })
    }

    fn pairs(&self) -> Option<String> {
        let Pairs { short_s, long_s } = self.findings.pairs?;
        Some(format!(
            "stamps come in pairs: steps of {} ms and of {} ms take turns, as if two messages were received at once; the rate \
             of {} Hz is that of the grid on which one of each pair lies",
            shown(1e3 * short_s),
            shown(1e3 * long_s),
            rate(self.rate_hz)
        ))
    }

    fn remark_rate(&self, remarks: &mut Vec<String>) {
        if let Some(choice) = self.stamp_choice.as_ref().filter(|choice| choice.regular.len() > 1) {
            let percent = |share: &f64| format!("{:.1} %", 100.0 * share);
            let of = |(index, share): (usize, &f64)| {
                let pairs = choice.pairs.get(index).copied().flatten();
                let pairs = pairs.map(|Pairs { short_s, long_s }| {
                    let (short_ms, long_ms) = (shown(1e3 * short_s), shown(1e3 * long_s));
                    format!(", they come in pairs: steps of {short_ms} ms and of {long_ms} ms take turns")
                });
                percent(share) + &pairs.unwrap_or_default()
            };
            let others = choice.regular.iter().enumerate().filter(|(index, _)| index + 1 != choice.column);
            let others: Vec<_> = others.map(of).collect();
            remarks.push(format!(
                "times are from the {}: {} of its steps lie within 10 % of the median step (the other stamps: {})",
                choice.name,
                choice.regular.get(choice.column - 1).map(percent).unwrap_or_default(),
                others.join(", ")
            ));
        }
        let found = &self.findings;
        let slow = self.rate_hz < SLOW * DEFAULT_VN_RATE_HZ && found.steps > 0;
        if slow && self.kind != Kind::Csv {
            remarks.push(format!(
                "the rate is {} Hz, where a VN-100's register 7 has {DEFAULT_VN_RATE_HZ} Hz unless it was changed: was all \
                 that it sent recorded?",
                rate(self.rate_hz)
            ));
        }
        if let Some(commented_hz) = found.commented_rate_hz {
            remarks.push(format!(
                "the rate of {commented_hz} Hz is that of a comment before the header (--rate HZ tells another)"
            ));
        }
        if let Some(unused_hz) = self.unused_rate_hz {
            let (differs, hz) = ((unused_hz / self.rate_hz - 1.0).abs() > RATE_DIFFERS, rate(self.rate_hz));
            let but = if differs { format!(", which lie on a grid of {hz} Hz") } else { String::new() };
            remarks.push(format!("the rate of {unused_hz} Hz of a comment is not used: the recording has stamps{but}"));
        }
        remarks.extend(self.overridden());
    }

    fn remark_steps(&self, remarks: &mut Vec<String>) {
        let found = &self.findings;
        remarks.extend(self.stamp_grid.as_ref().and_then(|grid| self.about_grid(grid)));
        if let Some(longest_s) = found.longest_gap_s {
            let when =
                found.longest_gap_utc_ns.map_or_else(String::new, |utc_ns| format!(", from {}", rfc3339(utc_ns)));
            remarks.push(format!(
                "{} missing in {}; the longest is {longest_s:.3} s{when}",
                counted(found.missing, "sample is", "samples are"),
                counted(found.gaps, "gap", "gaps")
            ));
        }
        if found.off_grid > 0 {
            remarks.push(format!(
                "stamps leave their grid {}: the clock was set, or the rate changed, so the count of missing samples is not \
                 exact",
                counted(found.off_grid, "time", "times")
            ));
        }
    }

    /// Describes how stamps differ from their grid.
    fn about_grid(&self, grid: &StampGrid) -> Option<String> {
        let found = &self.findings;
        let milliseconds = |nanos: f64| shown(1e-6 * nanos);
        let mut parts = Vec::new();
        if grid.rounding_ns as f64 > ROUNDED_FROM * grid.period_ns {
            parts.push(format!("rounded to {} ms", milliseconds(grid.rounding_ns as f64)));
        }
        if grid.jitter_ns > JITTER_FROM * grid.period_ns {
            parts.push(format!("with a jitter of {} ms", milliseconds(grid.jitter_ns)));
        }
        if let Some(longest_s) = found.longest_delay_s {
            let late = counted(found.delayed, "of them late", "of them late");
            parts.push(format!("{late} by half a period to {} ms", shown(1e3 * longest_s)));
        }
        let hz = rate(self.overridden_rate_hz.unwrap_or(self.rate_hz));
        if !grid.resolved {
            return Some(format!(
                "stamps are too coarse or jitter too much ({} ms) to tell single missing samples: the rate of {hz} Hz is their \
                 mean, and only holes are counted as missing",
                milliseconds(grid.jitter_ns.max(grid.rounding_ns as f64))
            ));
        }
        (!parts.is_empty()).then(|| format!("stamps lie on a grid of {hz} Hz, {}", parts.join(", ")))
    }

    fn remark_rejected_stamps(&self, remarks: &mut Vec<String>) {
        let found = &self.findings;
        if found.frozen_stamps > 0 {
            remarks.push(format!(
                "{} the one before, in {} of up to {} (a clock that stood still, or lines written twice): such samples are \
                 rejected as duplicates",
                counted(found.frozen_stamps, "stamp repeats", "stamps repeat"),
                counted(found.frozen_runs, "run", "runs"),
                found.longest_frozen_run
            ));
        }
        if let Some(latest_by_s) = found.latest_by_s {
            remarks.push(format!(
                "{} before the one before, by up to {} s (out of order, or a clock that was set back): such samples are \
                 rejected as duplicates",
                counted(found.late_stamps, "stamp lies", "stamps lie"),
                shown(latest_by_s)
            ));
            let share = found.late_stamps as f64 / (self.samples + found.late_stamps) as f64;
            if let Some(line) = found.first_late_line.filter(|_| share > LATE_FROM) {
                let entry = self.kind.entry();
                remarks.push(format!(
                    "{:.0} % of the samples were rejected because stamps go back: are these two runs in one file? Split it at \
                     {entry} {line}",
                    100.0 * share
                ));
            }
        }
        if found.stray_stamps > 0 {
            remarks.push(format!(
                "{} far ahead of those that follow or of another clock: such samples are rejected",
                counted(found.stray_stamps, "stamp is", "stamps are")
            ));
        }
    }

    fn remark_values(&self, remarks: &mut Vec<String>) {
        let found = &self.findings;
        remarks.extend(self.absent());
        remarks.extend(self.mixed_units());
        if !self.second_columns.is_empty() {
            remarks.push(format!(
                "by their names these columns are uncompensated, raw or without gravity, and no others give their channels: {}",
                self.second_columns.join(", ")
            ));
        }
        remarks.extend(self.quantisation());
        if found.repeated_samples as f64 > REPEATED_FROM * self.samples as f64 {
            remarks.push(format!(
                "{} the one before in every channel: the source was frozen or wrote them twice",
                counted(found.repeated_samples, "sample repeats", "samples repeat")
            ));
        }
        if found.restarts > 0 {
            remarks.push(format!(
                "the sensor's clock restarted {} (a reset): how long it was away nothing tells, no sample is counted missing there",
                counted(found.restarts, "time", "times")
            ));
        }
        if found.strong_fields > 0 && found.doubts.iter().all(|doubt| doubt.triad != "mag") {
            remarks.push(format!(
                "{} a magnetic field above 25 gauss, which no VN-100 can tell: was it in gauss already?",
                counted(found.strong_fields, "sample has", "samples have")
            ));
        }
    }

    /// Describes channels that lack values; those that lack equally many are listed together.
    fn absent(&self) -> Vec<String> {
        let mut groups: BTreeMap<u64, Vec<&'static str>> = BTreeMap::new();
        for (channel, count) in &self.findings.absent {
            groups.entry(*count).or_default().push(channel.name());
        }
        let samples = self.samples;
        let sentence = |(count, names): (u64, Vec<&str>)| {
            let has = if names.len() == 1 { "has" } else { "have" };
            format!("{} {has} no value in {count} of {}", names.join(" "), counted(samples, "sample", "samples"))
        };
        groups.into_iter().map(sentence).collect()
    }

    /// Describes axes of one quantity that came in different units: this may be intended, but seldom is.
    fn mixed_units(&self) -> Vec<String> {
        let mut triads: Vec<(_, Vec<(Channel, &'static str)>)> = Vec::new();
        for channel in self.channels.iter() {
            let Some(triad) = channel.triad() else { continue };
            let converted = self.conversions.iter().find(|conversion| conversion.channel == channel);
            let unit = converted.map_or(channel.unit(), |conversion| conversion.original_unit);
            match triads.iter_mut().find(|(known, _)| *known == triad) {
                Some((_, axes)) => axes.push((channel, unit)),
                None => triads.push((triad, vec![(channel, unit)])),
            }
        }
        let mixed = triads.into_iter().filter(|(_, axes)| axes.iter().any(|(_, unit)| *unit != axes[0].1));
        mixed
            .map(|(_, axes)| {
                let axes: Vec<_> = axes.iter().map(|(channel, unit)| format!("{channel} in {unit}")).collect();
                format!(
                    "columns of one quantity have different units ({}): each was converted by its own",
                    axes.join(", ")
                )
            })
            .collect()
    }

    /// Describes the steps of the values; channels with the same step are listed together.
    fn quantisation(&self) -> Option<String> {
        let mut groups: Vec<(&Quantisation, &str, Vec<&'static str>)> = Vec::new();
        for (channel, quantisation) in &self.findings.quantisation {
            let same = |group: &&mut (&Quantisation, &str, Vec<&'static str>)| {
                group.0.original_unit == quantisation.original_unit
                    && (group.0.original_step / quantisation.original_step - 1.0).abs() < 1e-4
            };
            match groups.iter_mut().find(same) {
                Some(group) => group.2.push(channel.name()),
                None => groups.push((quantisation, channel.unit(), vec![channel.name()])),
            }
        }
        let parts: Vec<String> = groups
            .into_iter()
            .map(|(found, unit, names)| {
                let converted = if found.original_unit == unit {
                    String::new()
                } else {
                    format!(" ({} {unit})", shown(found.step))
                };
                format!("{} {} {}{converted}", names.join(" "), shown(found.original_step), found.original_unit)
            })
            .collect();
        (!parts.is_empty()).then(|| format!("values come in steps: {}", parts.join(", ")))
    }
}

/// Returns a rate for display: 40.0, 1.0, 0.04245.
fn rate(hz: f64) -> String {
    if hz >= 0.95 { format!("{hz:.1}") } else { shown(hz) }
}

/// Returns UTC to the millisecond.
fn rfc3339(utc_ns: i64) -> String {
    chrono::DateTime::from_timestamp_nanos(utc_ns).to_rfc3339_opts(chrono::SecondsFormat::Millis, true)
}
