//! The rest: a channel's samples without their disturbances, block by block, and the sums computed from them.

use super::dynamic::{Dynamic, DynamicAllan};
use super::part::Seam;
use super::temperature::Course;
use super::{Examination, Part, Portion, bridged, drift, excise, without_intervals};
use crate::allan::{AllanPoint, FixedPoint, Overlapping, TauGrid};
use crate::whittle::{DstEstimator, DstSums, Transform};
use std::collections::BTreeMap;

/// The rest of one block.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cleaned {
    /// Cut at every excluded interval: valid for averaging times that are short compared with the distance of
    /// intervals.
    pub(super) cut: Vec<Part>,
    /// Bridged across knocks and spikes, and cut at steps: valid for averaging times that are long compared with the
    /// intervals.
    pub(super) bridged: Vec<Part>,
}

/// Removes the disturbances found in a block of the record.
pub(super) fn clean(parts: Vec<Part>, block: usize, rate_hz: f64, found: &Examination) -> Cleaned {
    let mut quiet = match found.gains.get(block).and_then(Option::as_ref) {
        // Knocks first: filtering would let them ring beyond their interval.
        Some(gains) => excise::apply(bridged(parts, &found.excluded_intervals, rate_hz), gains, excise::Short::Kept),
        None => parts,
    };
    if let Some(drift) = &found.drift {
        drift::subtract(&mut quiet, rate_hz, drift);
    }
    let cut = without_intervals(&quiet, &found.excluded_intervals, rate_hz);
    let bridged = without_intervals(&bridged(quiet, &found.times(false), rate_hz), &found.times(true), rate_hz);
    Cleaned { cut, bridged }
}

/// The sums so far.
pub(super) struct Rest<'a> {
    rate_hz: f64,
    found: &'a Examination,
    transform: Transform,
    main: Option<Spectral>,
    /// The spectral sums without the temperature's part.
    cool: Option<(Spectral, &'a Course, f64)>,
    short: Octaves,
    long: Octaves,
    /// The longest bridge, samples.
    longest_bridge: usize,
    dynamic: Option<Dynamic>,
}

/// The sums of the rest.
pub(super) struct Outcome {
    /// Spectral sums, if requested.
    pub(super) sums: Option<DstSums>,
    /// The spectral sums without the temperature's part, if that matters.
    pub(super) cool: Option<DstSums>,
    /// Octaves of the overlapping Allan variance.
    pub(super) points: Vec<AllanPoint>,
    pub(super) dynamic: Option<DynamicAllan>,
}

impl<'a> Rest<'a> {
    /// Creates the rest. `course` is the temperature with the channel's dependence on it, if that is significant;
    /// `sums` is whether spectral sums are needed.
    pub(super) fn new(
        rate_hz: f64,
        scale: FixedPoint,
        found: &'a Examination,
        course: Option<(&'a Course, f64)>,
        sums: bool,
    ) -> Self {
        let bridges = found.times(false);
        let longest_s = bridges.iter().map(|(from, to)| to - from).fold(0.0, f64::max);
        let longest_bridge = (longest_s * rate_hz).ceil() as usize;
        let span_s = found.span_s.unwrap_or((0.0, 0.0));
        let longest = ((span_s.1 - span_s.0) * rate_hz).round() as u64;
        Self {
            rate_hz,
            found,
            transform: Transform::new(),
            main: sums.then(|| Spectral::new(scale, longest_bridge)),
            cool: course.map(|(course, per_c)| (Spectral::new(scale, longest_bridge), course, per_c)),
            short: Octaves::new(scale, longest.min(4 * (Octaves::LONGER * longest_bridge) as u64)),
            long: Octaves::new(scale, longest),
            longest_bridge,
            dynamic: Dynamic::new(span_s, rate_hz, scale),
        }
    }

    /// Takes the next block of the original record.
    pub(super) fn push(&mut self, block: usize, portion: Portion) {
        let Portion { parts, continues } = portion;
        let mut cleaned = if self.found.is_clean() {
            Cleaned { cut: Vec::new(), bridged: parts }
        } else {
            clean(parts, block, self.rate_hz, self.found)
        };
        let cut = if self.found.is_clean() { &cleaned.bridged } else { &cleaned.cut };
        if let Some(dynamic) = &mut self.dynamic {
            dynamic.push(cut, continues);
        }
        self.short.push(cut, continues, self.rate_hz);
        self.long.push(&cleaned.bridged, continues, self.rate_hz);
        let Cleaned { cut, bridged } = &mut cleaned;
        if let Some(main) = &mut self.main {
            main.push(&mut self.transform, cut, bridged, continues, self.rate_hz);
        }
        if let Some((sums, course, per_c)) = &mut self.cool {
            course.subtract(cut, self.rate_hz, *per_c);
            course.subtract(bridged, self.rate_hz, *per_c);
            sums.push(&mut self.transform, cut, bridged, continues, self.rate_hz);
        }
    }

    /// Returns the sums of all blocks pushed.
    pub(super) fn finish(mut self) -> Outcome {
        let points = Octaves::joined(self.short.finish(), self.long.finish(), self.longest_bridge);
        let transform = &mut self.transform;
        Outcome {
            sums: self.main.map(|main| main.finish(transform)),
            cool: self.cool.map(|(cool, _, _)| cool.finish(transform)),
            points,
            dynamic: self.dynamic.map(Dynamic::finish),
        }
    }
}

/// Spectral sums of blocks, across which stretches continue: of bridged samples for frequencies that are low compared
/// with the bridges, of cut samples for the others. A bridge has no noise: with 1 % of bridged samples, N would be 0.5
/// % too small.
struct Spectral {
    bridged: Stretches,
    /// The places of the bridges.
    cut: Option<Stretches>,
    longest_bridge: usize,
}

impl Spectral {
    fn new(scale: FixedPoint, longest_bridge: usize) -> Self {
        let cut = (longest_bridge > 0).then(|| Stretches::new(scale));
        Self { bridged: Stretches::new(scale), cut, longest_bridge }
    }

    fn push(&mut self, transform: &mut Transform, cut: &[Part], bridged: &[Part], continues: bool, rate_hz: f64) {
        self.bridged.push(transform, bridged, continues, rate_hz);
        if let Some(stretches) = &mut self.cut {
            stretches.push(transform, cut, continues, rate_hz);
        }
    }

    fn finish(self, transform: &mut Transform) -> DstSums {
        /// Minimum number of half periods in a cut stretch of mean length.
        const HALF_PERIODS: f64 = 8.0;
        let mut sums = self.bridged.estimator.into_sums(transform);
        if let Some(cut) = self.cut {
            let mean_length = cut.samples as f64 / cut.count.max(1) as f64;
            let low = 1.0 / (Octaves::LONGER * self.longest_bridge) as f64;
            let cut = cut.estimator.into_sums(transform);
            sums.replace_above(low.max(HALF_PERIODS / (2.0 * mean_length)), &cut);
        }
        sums
    }
}

/// Spectral sums of stretches that blocks may divide.
struct Stretches {
    estimator: DstEstimator,
    seam: Seam,
    count: u64,
    samples: u64,
}

impl Stretches {
    fn new(scale: FixedPoint) -> Self {
        Self { estimator: DstEstimator::new(scale), seam: Seam::default(), count: 0, samples: 0 }
    }

    fn push(&mut self, transform: &mut Transform, parts: &[Part], continues: bool, rate_hz: f64) {
        for (part, joins) in self.seam.joins(parts, continues, rate_hz) {
            if !joins {
                self.estimator.break_segment(transform);
                self.count += 1;
            }
            self.samples += part.values.len() as u64;
            self.estimator.push(transform, &part.values);
        }
    }
}

/// Octaves of the overlapping Allan variance of blocks, across which stretches continue.
struct Octaves {
    estimator: Option<Overlapping>,
    seam: Seam,
}

impl Octaves {
    /// A bridge shorter than an averaging time by at least this factor changes the variance by a few percent of the
    /// windows that contain it.
    const LONGER: usize = 16;

    /// Joins the points of cut stretches at averaging times that are not long compared with the longest bridge, as long
    /// as they have half of the terms of bridged ones, and the other points of bridged stretches.
    fn joined(cut: Vec<AllanPoint>, bridged: Vec<AllanPoint>, longest_bridge: usize) -> Vec<AllanPoint> {
        let mut points: BTreeMap<usize, AllanPoint> = bridged.into_iter().map(|point| (point.m, point)).collect();
        for point in cut.into_iter().filter(|point| point.m < Self::LONGER * longest_bridge) {
            let bridged = points.entry(point.m).or_insert(point);
            if 2 * point.terms >= bridged.terms {
                *bridged = point;
            }
        }
        points.into_values().collect()
    }

    /// Creates octaves for stretches of at most that many samples.
    fn new(scale: FixedPoint, longest: u64) -> Self {
        let estimator = TauGrid::octave(longest).ok().map(|grid| Overlapping::new(scale, grid));
        Self { estimator, seam: Seam::default() }
    }

    fn push(&mut self, parts: &[Part], continues: bool, rate_hz: f64) {
        let Some(estimator) = &mut self.estimator else { return };
        for (part, joins) in self.seam.joins(parts, continues, rate_hz) {
            if !joins {
                estimator.break_segment();
            }
            estimator.push(&part.values);
        }
    }

    fn finish(self) -> Vec<AllanPoint> {
        self.estimator.map(|estimator| estimator.into_sums().points()).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Noise;
    use super::super::{All, Company, Levels, Record};
    use super::*;
    use crate::robust::spectral_sums;
    use imu_core::sample::Channel;
    use std::convert::Infallible;

    const RATE_HZ: f64 = 40.0;

    /// Returns a record with a spike, a knock, a step, a tone and a warm-up, and their times.
    fn disturbed(count: usize) -> Vec<f64> {
        let mut noise = Noise::new(71);
        let mut values = noise.sensor(count, RATE_HZ, 2e-3, 5e-4, 2e-6);
        let sigma = 2e-3 * RATE_HZ.sqrt();
        values[count / 5] += 20.0 * sigma;
        for value in &mut values[count / 3..count / 3 + 20] {
            *value += 8.0 * sigma * noise.normal();
        }
        for (index, value) in values.iter_mut().enumerate() {
            *value += if index > count / 2 { 0.02 } else { 0.0 };
            *value += 0.5 * sigma * (2.0 * std::f64::consts::PI * 7.3 * index as f64 / RATE_HZ).sin();
            *value -= 0.03 * (-(index as f64) / RATE_HZ / 300.0).exp();
        }
        values
    }

    /// Returns the part of the document that does not depend on how often the record is read: kinds and times of flags,
    /// N and similar values with all samples.
    fn of(values: &[f64], blocks: usize) -> (crate::NoiseParameters, super::super::Disturbances) {
        let part = Part { start_s: 0.0, values: values.to_vec() };
        let sums = spectral_sums(std::slice::from_ref(&part), FixedPoint::for_channel(Channel::GyroX));
        let all = All::of(Channel::GyroX, RATE_HZ, &sums, None);
        let length = values.len().div_ceil(blocks);
        let read = |block: usize| {
            let range = block * length..((block + 1) * length).min(values.len());
            let start_s = range.start as f64 / RATE_HZ;
            let parts = vec![Part { start_s, values: values[range].to_vec() }];
            Ok::<_, Infallible>(Portion { parts, continues: true })
        };
        let none = Levels::new(RATE_HZ, 0);
        let extent = (values.len() as u64, blocks);
        let Ok(record) = Record::read(Channel::GyroX, RATE_HZ, extent, read, &none, Company::Alone);
        record.alone(Channel::GyroX, RATE_HZ, &all)
    }

    #[test]
    fn blocks_find_what_the_whole_record_shows_and_leave_the_same_noise() {
        let values = disturbed(240_000);
        let (whole, about) = of(&values, 1);
        let (blocks, about_blocks) = of(&values, 4);
        let times = |flags: &[crate::fit::Flag], kind: &str| -> Vec<f64> {
            flags.iter().filter(|flag| flag.kind == kind).filter_map(|flag| flag.from_s).collect()
        };
        for (kind, at_s) in [("spike", 1200.0), ("knock", 2000.0), ("step", 3000.0)] {
            for flags in [&whole.flags, &blocks.flags] {
                let found = times(flags, kind);
                assert!(found.len() == 1 && (found[0] - at_s).abs() < 5.0, "{kind}: {flags:?}");
            }
        }
        for (parameters, about) in [(&whole, &about), (&blocks, &about_blocks)] {
            assert_eq!(about.lines.len(), 1);
            assert!((about.lines[0].frequency_hz - 7.3).abs() < 0.02 && about.lines[0].persistent);
            assert!(about.drift.as_ref().is_some_and(|drift| drift.tau_s.is_some()), "{about:?}");
            let [low, high] = parameters.n.ci95.unwrap();
            assert!((low..=high).contains(&2e-3), "{:?}", parameters.n);
            let with = about.with_disturbances.as_ref().unwrap();
            assert!(with.n.value.unwrap() > 1.05 * 2e-3, "the tone alone adds an eighth to N²");
            // No part of the step or the warm-up counts as a walk: 0.02 in 1.7 h would be 2.6e-4.
            assert!(parameters.k.upper_limit95.or(parameters.k.value).unwrap() < 5e-5, "{:?}", parameters.k);
        }
        let ratio = whole.n.value.unwrap() / blocks.n.value.unwrap();
        assert!((ratio - 1.0).abs() < 1e-3, "{ratio}");
        let (one, four) = (about.dynamic.unwrap(), about_blocks.dynamic.unwrap());
        assert_eq!((one.blocks.len(), one.tau_s), (four.blocks.len(), four.tau_s));
    }

    #[test]
    fn what_is_clean_is_left_as_it_is_and_seams_leave_no_trace() {
        let values = Noise::new(72).sensor(120_000, RATE_HZ, 2e-3, 5e-4, 2e-5);
        let (whole, about) = of(&values, 1);
        let (blocks, about_blocks) = of(&values, 3);
        assert!(about.with_disturbances.is_none() && about_blocks.with_disturbances.is_none(), "{:?}", blocks.flags);
        assert_eq!(whole.n, blocks.n);
        // Integers: blocks that continue at the end of the last one are one stretch.
        assert_eq!(about.allan_minimum, about_blocks.allan_minimum);
        assert_eq!(about.dynamic, about_blocks.dynamic);
    }

    #[test]
    fn no_averaging_time_is_lost_between_cut_stretches_and_long_bridges() {
        let mut noise = Noise::new(74);
        let mut values = noise.sensor(200_000, RATE_HZ, 2e-3, 0.0, 0.0);
        let sigma = 2e-3 * RATE_HZ.sqrt();
        // Handled once for half a minute, and knocked every 100 s.
        for value in &mut values[30_000..31_200] {
            *value += 20.0 * sigma * noise.normal();
        }
        for knock in 1..49 {
            for value in &mut values[knock * 4000 + 500..][..20] {
                *value += 12.0 * sigma * noise.normal();
            }
        }
        let part = Part { start_s: 0.0, values };
        let found = super::super::examine(std::slice::from_ref(&part), RATE_HZ);
        let mut rest = Rest::new(RATE_HZ, FixedPoint::for_channel(Channel::GyroX), &found, None, true);
        rest.push(0, Portion { parts: vec![part], continues: false });
        let points = rest.finish().points;
        let factors: Vec<usize> = points.iter().map(|point| point.m).collect();
        assert_eq!(factors, (0..factors.len()).map(|octave| 1 << octave).collect::<Vec<_>>());
        assert!(factors.len() >= 16, "{factors:?}");
        for point in points.iter().filter(|point| point.m <= 4096) {
            let expected = 2e-3 * 2e-3 * RATE_HZ / point.m as f64;
            assert!((point.variance / expected - 1.0).abs() < 0.35, "m = {}: {}", point.m, point.variance / expected);
        }
    }

    #[test]
    fn a_fiftieth_bridged_leaves_the_density_as_it_is() {
        let mut noise = Noise::new(73);
        let mut values = noise.sensor(400_000, RATE_HZ, 2e-3, 5e-4, 2e-6);
        let sigma = 2e-3 * RATE_HZ.sqrt();
        for knock in 0..200 {
            for value in &mut values[1000 + knock * 1990..][..20] {
                *value += 10.0 * sigma * noise.normal();
            }
        }
        let (found, about) = of(&values, 1);
        assert!(about.excluded_s > 0.02 * 10_000.0, "{}", about.excluded_s);
        let n = found.n.value.unwrap();
        // The interval of 400,000 samples is ±0.24 %; bridges without noise would reduce N by 1 % and more.
        assert!((n / 2e-3 - 1.0).abs() < 4e-3, "{n}");
        let [low, high] = found.n.ci95.unwrap();
        assert!((low..=high).contains(&2e-3), "{:?}", found.n);
    }
}
