//! One capture's record of a channel: examined separately, cleaned, and summed, so that sums of several captures can be fitted
//! together.

use super::rest::Rest;
use super::survey::Survey;
use super::{
    AllanMinimum, Disturbances, DynamicAllan, Examination, Levels, Part, Portion, TemperatureDependence, blocks_of,
    drift, samples_of, temperature,
};
use crate::allan::{AllanPoint, FixedPoint};
use crate::fit::{Flag, NoiseParameters};
use crate::hold_against;
use crate::whittle::{DstSums, Sampling, fit, fit_as_sampled};
use imu_core::sample::Channel;
use std::collections::BTreeMap;
use std::convert::Infallible;

/// The remainder of a channel of one capture after examination: sums, no samples.
#[derive(Debug, Clone)]
pub struct Record {
    found: Examination,
    /// Sums of the noise alone; `None` if nothing was removed and no caller needs them separately.
    noise: Option<DstSums>,
    /// The sums without the temperature's part, if that is significant.
    without_temperature: Option<DstSums>,
    /// Octaves of the Allan variance.
    points: Vec<AllanPoint>,
    temperature: Option<TemperatureDependence>,
    dynamic: Option<DynamicAllan>,
}

/// Whether a record's sums are needed even if nothing was removed from it, to add them to those of other captures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Company {
    /// The record stands alone.
    Alone,
    /// The record is one of several.
    Several,
}

/// All samples of a channel, disturbances included.
#[derive(Debug, Clone)]
pub struct All<'a> {
    sums: &'a DstSums,
    sampling: Option<&'a Sampling>,
    /// The parameters of all samples.
    pub parameters: NoiseParameters,
}

impl<'a> All<'a> {
    /// Returns the parameters of sums; `rate_hz` is finite and above 0. `sampling` states how the samples were made, if
    /// that is known.
    pub fn of(channel: Channel, rate_hz: f64, sums: &'a DstSums, sampling: Option<&'a Sampling>) -> Self {
        Self { sums, sampling, parameters: fit_as_sampled(sums, rate_hz, channel, sampling) }
    }
}

impl Record {
    /// Examines a channel of a capture. `temperature` is empty if it was not recorded.
    ///
    /// `read` returns the samples of each of `blocks` portions of the record ([`blocks_of`]) in order of time. It is
    /// called once if there is one block, otherwise twice per block.
    ///
    /// # Errors
    /// The errors of `read`.
    pub fn read<E>(
        channel: Channel,
        rate_hz: f64,
        (samples, blocks): (u64, usize),
        mut read: impl FnMut(usize) -> Result<Portion, E>,
        temperature: &Levels,
        company: Company,
    ) -> Result<Self, E> {
        let mut survey = Survey::new(rate_hz, samples);
        let mut held = None;
        for block in 0..blocks {
            let portion = read(block)?;
            survey.look(&portion);
            held = (blocks == 1).then_some(portion);
        }
        let (found, levels) = survey.settle();
        let mut rest_levels = levels.without(&found.times(true));
        if let Some(drift) = &found.drift {
            drift::subtract(&mut rest_levels, levels.rate_hz(), drift);
        }
        let regression = temperature::regress(&rest_levels, levels.rate_hz(), temperature, &found.steps_s());
        let course = regression.as_ref().filter(|(dependence, _)| dependence.significant);
        let course = course.map(|(dependence, course)| (course, dependence.per_c));
        let sums = company == Company::Several || !found.is_clean();
        let mut rest = Rest::new(rate_hz, FixedPoint::for_channel(channel), &found, course, sums);
        for block in 0..blocks {
            let portion = match held.take() {
                Some(portion) => portion,
                None => read(block)?,
            };
            rest.push(block, portion);
        }
        let outcome = rest.finish();
        Ok(Self {
            noise: outcome.sums,
            without_temperature: outcome.cool,
            points: outcome.points,
            temperature: regression.map(|(dependence, _)| dependence),
            dynamic: outcome.dynamic,
            found,
        })
    }

    /// Examines samples in memory as [`Self::read`] does.
    pub fn of(channel: Channel, rate_hz: f64, mut parts: Vec<Part>, temperature: &Levels, company: Company) -> Self {
        let samples: usize = parts.iter().map(|part| part.values.len()).sum();
        let blocks = blocks_of(samples as u64);
        let length = samples.div_ceil(blocks);
        let read = |block: usize| {
            Ok::<_, Infallible>(match blocks {
                1 => Portion { parts: std::mem::take(&mut parts), continues: false },
                _ => samples_of(&parts, &(block * length..(block + 1) * length), rate_hz),
            })
        };
        let Ok(record) = Self::read(channel, rate_hz, (samples as u64, blocks), read, temperature, company);
        record
    }

    /// Returns the parameters of this record alone without its disturbances, and the disturbances.
    ///
    /// `all` has all samples of the record. The returned parameters have the flags.
    pub fn alone(self, channel: Channel, rate_hz: f64, all: &All<'_>) -> (NoiseParameters, Disturbances) {
        let records = [self];
        let (mut main, fitted) = parameters_together(channel, rate_hz, &records, all);
        let [record] = records;
        main.flags.extend(record.flags(channel));
        let disturbances = Disturbances {
            with_disturbances: fitted.with_disturbances,
            k_without_temperature: fitted.k_without_temperature,
            r_without_temperature: fitted.r_without_temperature,
            ..record.disturbances(rate_hz)
        };
        (main, disturbances)
    }

    /// Returns octaves of the Allan variance without the excluded samples.
    pub fn points(&self) -> &[AllanPoint] {
        &self.points
    }

    /// Returns the lowest frequencies of the bands of vibration, Hz.
    fn foot_hz(&self) -> impl Iterator<Item = f64> {
        self.found.lines.iter().filter(|line| line.broad).map(|line| line.band_hz[0])
    }

    fn bands(&self) -> impl Iterator<Item = (f64, f64)> {
        self.found.excluded_bands_hz.iter().copied()
    }

    /// Returns the findings, as flags of the document; times count from the capture's start.
    pub fn flags(&self, channel: Channel) -> Vec<Flag> {
        let mut flags = self.found.flags(channel);
        if let Some(dynamic) = self.dynamic.as_ref().filter(|dynamic| dynamic.stationary == Some(false)) {
            let note = format!(
                "blocks of {:.0} s differ more than chance at an averaging time of {:.3} s",
                dynamic.block_s,
                dynamic.worst_tau_s.unwrap_or_default()
            );
            flags.push(Flag::whole("non_stationary", note));
        }
        flags
    }

    /// Returns the document's statement about this capture alone, besides its parameters.
    pub fn disturbances(&self, rate_hz: f64) -> Disturbances {
        let found = &self.found;
        Disturbances {
            with_disturbances: None,
            excluded_s: found.excluded_intervals.iter().fold(0.0, |sum, (from, to)| sum + to - from),
            excluded_intervals_s: found.excluded_intervals.iter().map(|(from, to)| [*from, *to]).collect(),
            excluded_bands_hz: self.bands().map(|(from, to)| [from, to]).collect(),
            lines: found.lines.clone(),
            drift: found.drift.clone(),
            temperature: self.temperature.clone(),
            k_without_temperature: None,
            r_without_temperature: None,
            dynamic: self.dynamic.clone(),
            allan_minimum: AllanMinimum::of(&self.points, rate_hz),
        }
    }
}

/// Returns the parameters of several captures of one sensor, each examined separately: the sums of their noise are
/// added and fitted as one.
///
/// `all` has all samples of all captures. Flags with times belong to each capture. This result has the total excluded
/// time, the bands, and the findings in the sums.
pub fn parameters_together(
    channel: Channel,
    rate_hz: f64,
    records: &[Record],
    all: &All<'_>,
) -> (NoiseParameters, Disturbances) {
    let bands: Vec<[f64; 2]> = super::event::merged(records.iter().flat_map(Record::bands).collect())
        .into_iter()
        .map(|(from, to)| [from, to])
        .collect();
    let is_clean = records.iter().all(|record| record.found.is_clean());
    let sum = |choose: fn(&Record) -> Option<&DstSums>| {
        let mut sums = DstSums::new();
        records.iter().filter_map(choose).for_each(|own| sums.merge(own));
        fit(&sums, rate_hz, channel, &bands, all.sampling)
    };
    let is_misfit = |flag: &&Flag| flag.kind == "misfit";
    let may_be_filtered =
        all.parameters.gauss_markov.is_some() || all.parameters.flags.iter().any(|flag| is_misfit(&flag));
    let mut main = match is_clean {
        true if may_be_filtered => fit(all.sums, rate_hz, channel, &[], all.sampling),
        true => all.parameters.clone(),
        false => sum(|record| record.noise.as_ref()),
    };
    // The flags of the sums themselves are kept.
    let kept = all.parameters.flags.iter().filter(|flag| !is_misfit(flag) && !main.flags.contains(flag));
    let kept: Vec<Flag> = kept.cloned().collect();
    main.flags.extend(kept);
    if let Some(foot_hz) = records.iter().flat_map(Record::foot_hz).reduce(f64::min) {
        // The skirts of a vibration extend beyond its band; they are weakest below half of the frequency at which the
        // band begins.
        let below: Vec<[f64; 2]> = bands.iter().copied().chain([[0.5 * foot_hz, rate_hz]]).collect();
        let mut sums = DstSums::new();
        records.iter().filter_map(|record| record.noise.as_ref()).for_each(|own| sums.merge(own));
        let low = fit(&sums, rate_hz, channel, &below, all.sampling);
        if let (Some(ends), Some([least, most])) = (&mut main.n.ci95, low.n.ci95) {
            *ends = [ends[0].min(least), ends[1].max(most)];
        }
    }
    // It is not known whether samples that are far out are noise or faulty measurements. Other exclusions may have
    // removed some of them.
    let tails = records.iter().filter_map(|record| record.found.heavy_tails).map(|tails| tails.core).reduce(f64::min);
    if let (Some(core), Some(ends)) = (tails, &mut main.n.ci95) {
        let of_all = all.parameters.n.ci95.map_or(ends[1], |ends| ends[1]);
        *ends = [core * ends[0], ends[1].max(of_all)];
    }
    let points = pooled(records);
    hold_against(&mut main, &points, rate_hz, channel, &bands);
    let depends = records.iter().any(|record| record.without_temperature.is_some());
    let without = depends.then(|| sum(|record| record.without_temperature.as_ref().or(record.noise.as_ref())));
    let excluded = records.iter().flat_map(|record| &record.found.excluded_intervals);
    let disturbances = Disturbances {
        with_disturbances: (!is_clean).then(|| all.parameters.clone()),
        excluded_s: excluded.fold(0.0, |sum, (from, to)| sum + to - from),
        excluded_intervals_s: Vec::new(),
        excluded_bands_hz: bands,
        lines: Vec::new(),
        drift: None,
        temperature: None,
        k_without_temperature: without.as_ref().map(|without| without.k.clone()),
        r_without_temperature: without.map(|without| without.r),
        dynamic: None,
        allan_minimum: AllanMinimum::of(&points, rate_hz),
    };
    (main, disturbances)
}

/// Returns the octaves of all records: variances are weighted by the numbers of their terms.
fn pooled(records: &[Record]) -> Vec<AllanPoint> {
    let mut pooled: BTreeMap<usize, AllanPoint> = BTreeMap::new();
    for point in records.iter().flat_map(|record| &record.points) {
        pooled
            .entry(point.m)
            .and_modify(|sum| {
                let terms = sum.terms + point.terms;
                sum.variance += (point.variance - sum.variance) * point.terms as f64 / terms as f64;
                (sum.terms, sum.segments) = (terms, sum.segments + point.segments);
            })
            .or_insert(*point);
    }
    pooled.into_values().collect()
}
