//! Explanation: the known effects and the noise of a series.

use super::course::Course;
use super::law::Law;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::ops::Range;

/// A sine in a series.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Sine {
    /// Cycles per sample.
    pub cycles: f64,
    /// Factors of its cosine and its sine.
    pub quadratures: [f64; 2],
}

impl Sine {
    /// Returns the peak of the sine.
    pub fn amplitude(&self) -> f64 {
        self.quadratures[0].hypot(self.quadratures[1])
    }
    /// Changes the peak and keeps the phase.
    pub(super) fn rescale(&mut self, peak: f64) {
        let own = self.amplitude();
        self.quadratures = if own > 0.0 { self.quadratures.map(|value| value * peak / own) } else { [peak, 0.0] };
    }
    /// Returns the factors of cosine and sine if time is counted from this sample.
    pub(super) fn later(&self, samples: usize) -> [f64; 2] {
        let (s, c) = (std::f64::consts::TAU * (self.cycles * samples as f64).fract()).sin_cos();
        let [a, b] = self.quadratures;
        [a * c + b * s, b * c - a * s]
    }
    /// Adds `factor` times the sine to values.
    pub(super) fn add(&self, factor: f64, values: &mut [f64]) {
        let [a, b] = self.quadratures.map(|value| factor * value);
        turning(self.cycles, values.len(), |t, cosine, sine| values[t] += a * cosine + b * sine);
    }
}

/// A sine that is present only at times.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct GatedSine {
    /// Cycles per sample.
    pub cycles: f64,
    /// The ranges of samples in which it is present, in order.
    pub stays: Vec<Stay>,
}

/// A range of samples in which a sine is present, with a phase of its own.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Stay {
    /// First sample.
    pub from: usize,
    /// One past the last.
    pub to: usize,
    /// Factors of cosine and sine, whose phase is 0 at the first sample.
    pub quadratures: [f64; 2],
}

impl GatedSine {
    /// Returns the number of samples in all stays.
    pub fn samples(&self) -> usize {
        self.stays.iter().map(|stay| stay.to - stay.from).sum()
    }
    /// Returns the mean square of the peaks of the stays, each weighted by its length.
    pub(super) fn square(&self) -> f64 {
        let of = |stay: &Stay| (stay.to - stay.from) as f64 * stay.quadratures.iter().map(|q| q * q).sum::<f64>();
        self.stays.iter().map(of).sum::<f64>() / self.samples().max(1) as f64
    }
    /// Gives all stays the same peak and keeps their phases.
    pub(super) fn rescale(&mut self, peak: f64) {
        for stay in &mut self.stays {
            let mut sine = Sine { cycles: self.cycles, quadratures: stay.quadratures };
            sine.rescale(peak);
            stay.quadratures = sine.quadratures;
        }
    }
    /// Adds `factor` times the sine to values.
    pub(super) fn add(&self, factor: f64, values: &mut [f64]) {
        for Stay { from, to, quadratures } in &self.stays {
            Sine { cycles: self.cycles, quadratures: *quadratures }.add(factor, &mut values[*from..*to]);
        }
    }
    /// Returns the sine in the samples from `from` to `to`, counted from `from`.
    pub(super) fn part(&self, from: usize, to: usize) -> Self {
        let of = |stay: &Stay| {
            let (begin, end) = (stay.from.max(from), stay.to.min(to));
            let sine = Sine { cycles: self.cycles, quadratures: stay.quadratures };
            let own = |begin| Stay { from: begin - from, to: end - from, quadratures: sine.later(begin - stay.from) };
            (begin < end).then(|| own(begin))
        };
        Self { cycles: self.cycles, stays: self.stays.iter().filter_map(of).collect() }
    }
}

/// Returns whether a sine alternates from sample to sample, as far as a record can resolve. Such a sine has no phase.
pub(super) fn alternates(cycles: f64, samples: usize) -> bool {
    const NEAR: f64 = 0.25;
    (0.5 - cycles) * (samples as f64) < NEAR
}

/// Returns the factor by which a sum of products with a cosine or a sine is multiplied.
pub(super) fn per_product(cycles: f64, samples: usize) -> f64 {
    if alternates(cycles, samples) { 1.0 / samples as f64 } else { 2.0 / samples as f64 }
}

/// Calls `each` with cosine and sine of 2π·cycles·t for each t. The rotation is reset often enough to be exact.
pub(super) fn turning(cycles: f64, samples: usize, mut each: impl FnMut(usize, f64, f64)) {
    const RUN: usize = 256;
    let (step_sine, step_cosine) = (std::f64::consts::TAU * cycles).sin_cos();
    let mut t = 0;
    while t < samples {
        let (mut sine, mut cosine) = (std::f64::consts::TAU * (cycles * t as f64).fract()).sin_cos();
        for at in t..(t + RUN).min(samples) {
            each(at, cosine, sine);
            (cosine, sine) = (cosine * step_cosine - sine * step_sine, sine * step_cosine + cosine * step_sine);
        }
        t += RUN;
    }
}

/// A stretch with at least this ratio of variances carries no information about the noise: it is excluded.
pub(super) const LOUD: f64 = 4.0;

/// A factor on the white part's standard deviation inside a range of samples.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Loud {
    /// First sample.
    pub from: usize,
    /// One past the last.
    pub to: usize,
    /// Factor on the variance.
    pub ratio: f64,
}

impl Loud {
    /// Returns the nats that the stretch's own variance gains over the variance of the rest.
    pub(super) fn gain(&self) -> f64 {
        0.5 * (self.to - self.from) as f64 * (self.ratio - 1.0 - self.ratio.ln())
    }
    /// Returns whether this is a change of variance for a while, not a burst: long, or quiet. `bursts` are the
    /// intervals of the model's bursts, of any length.
    pub fn is_interval(&self, samples: usize, bursts: &[Range<usize>]) -> bool {
        let length = self.to - self.from;
        let common = |of: &Range<usize>| of.end.min(self.to).saturating_sub(of.start.max(self.from));
        let is_of_model = bursts.iter().any(|of| 2 * common(of) > length.max(of.len()));
        self.ratio < 1.0 || (length >= samples / 50 && !is_of_model)
    }
}

/// Spikes of a series.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SpikeLaw {
    /// Chance that a sample is a spike.
    pub rate: f64,
    /// Typical size, in the series' scale.
    pub size: f64,
    /// Variance of the residual at a spike.
    pub variance: f64,
    /// Standard error of the size, as a part of it.
    pub relative_error: f64,
    /// Samples that each spike spoils.
    pub samples: usize,
}

/// How the variance of the white part depends on time or temperature.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Scedasticity {
    /// ln of the variance per °C about the mean temperature.
    PerDegree(f64),
    /// ln of the variance at equally spaced instants from the first sample to the last.
    Profile(Vec<f64>),
}

/// The complete explanation of a series so far. Transformed values are built again from the samples each time, so that no step is
/// undone or applied twice.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Explanation {
    /// The spectrum.
    pub law: Law,
    /// The places in the model's list of its own spectral effects that differ from its statement.
    pub without: BTreeSet<usize>,
    /// Courses of the level and their factors.
    pub courses: Vec<(Course, f64)>,
    /// Sines.
    pub sines: Vec<Sine>,
    /// Sines that come and go.
    pub gated: Vec<GatedSine>,
    /// Samples that are not noise: spikes, held or clipped values.
    pub outliers: Vec<usize>,
    /// The law of the spikes among them.
    pub spikes: Option<SpikeLaw>,
    /// Stretches of another variance.
    pub loud: Vec<Loud>,
    /// Variance by temperature or time.
    pub scedasticity: Option<Scedasticity>,
    /// Degrees of freedom of Student's t.
    pub tails: Option<f64>,
    /// The limits at which the samples are cut off, below and above.
    pub limits: [Option<f64>; 2],
}

impl Explanation {
    /// Returns whether both explanations have the same effects, apart from their numbers.
    pub fn adds_nothing_to(&self, other: &Self) -> bool {
        let counts = |of: &Self| (of.courses.len(), of.sines.len(), of.law.terms.len(), of.loud.len());
        let variance = |of: &Self| of.loud.iter().map(|loud| (loud.from, loud.to)).collect::<Vec<_>>();
        counts(self) == counts(other)
            && self.courses == other.courses
            && variance(self) == variance(other)
            && self.without == other.without
            && self.sines == other.sines
            && self.gated == other.gated
            && self.outliers == other.outliers
            && self.scedasticity == other.scedasticity
            && (self.tails.is_some(), self.spikes.is_some()) == (other.tails.is_some(), other.spikes.is_some())
    }

    /// Keeps those stretches behind the first `known` that `is_kept` holds for.
    pub(super) fn retain_loud(&mut self, known: usize, is_kept: impl Fn(&Loud) -> bool) {
        let own = self.loud.split_off(known.min(self.loud.len()));
        self.loud.extend(own.into_iter().filter(is_kept));
    }

    /// Leaves out more samples.
    pub fn leave_out(&mut self, places: impl IntoIterator<Item = usize>) {
        self.outliers.extend(places);
        self.outliers.sort_unstable();
        self.outliers.dedup();
    }

    /// Returns the outliers of a record of `samples`, in order, and its first and last samples as far as filters reach, and those
    /// about the ends of a gated sine's stays. A filter begins from an unknown state, and the transform reflects samples that do
    /// not exist. A sine that begins in front of a filter has another course behind it.
    pub fn left_out(&self, samples: usize, reach: usize) -> Cow<'_, [usize]> {
        let reach = reach.min(samples);
        if reach == 0 {
            return Cow::Borrowed(&self.outliers);
        }
        /// Possible error of the place of an end, samples.
        const END: usize = 8;
        let mut places: Vec<usize> = (0..reach).chain(samples - reach..samples).collect();
        places.extend(&self.outliers);
        let ends = self.gated.iter().flat_map(|sine| &sine.stays).flat_map(|stay| [stay.from, stay.to]);
        places.extend(ends.flat_map(|end| end.saturating_sub(END)..(end + END + reach).min(samples)));
        places.sort_unstable();
        places.dedup();
        Cow::Owned(places)
    }

    /// Creates an explanation of noise alone.
    pub fn noise(law: Law) -> Self {
        Self { law, ..Self::default() }
    }
}

/// Returns a profile's value at sample t of n, by linear interpolation between its instants.
pub(super) fn profile(values: &[f64], t: usize, n: usize) -> f64 {
    let Some(last) = values.len().checked_sub(1).filter(|last| *last > 0) else {
        return values.first().copied().unwrap_or_default();
    };
    let place = t as f64 / (n.max(2) - 1) as f64 * last as f64;
    let (at, share) = ((place as usize).min(last - 1), place.fract());
    let share = if place >= last as f64 { 1.0 } else { share };
    values[at] + share * (values[at + 1] - values[at])
}
