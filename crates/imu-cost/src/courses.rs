//! Courses: what follows from time alone, sample by sample: means, changes of variance, sines inside intervals.
//!
//! A course without randomness is the simulator's own output with that effect alone, behind the channel's filters and
//! sampling: its mean is then that of the simulator for any temperature, play or filter.
//!
//! White noise whose variance changes has Σ w_k²σ_k². Behind filters this is the variance of the steady noise times the
//! ratio of that sum to the one without change: exact without filters, and for changes that are slow compared with them.

use crate::quadrature::scale;
use crate::request::{CostError, Setting};
use crate::sources::{ChannelSources, Factor, Source};
use crate::weights::{ORDERS, Squares, Strapdown, WhiteSums};
use imu_core::sample::Channel;
use imu_model::effects::moving_average::RunningMean;
use imu_model::effects::{Bursts, Effect, Stream, StreamId, Temperature};
use imu_model::simulator::{SensorModel, Simulator};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Samples that a factor is computed for at a time.
const BLOCK: usize = 512;

/// An integral per horizon and order, in the integral's unit.
pub(crate) type Integrals = Vec<[f64; ORDERS]>;

/// A course's integrals, and the range of its values.
#[derive(Debug, Clone, Default)]
pub(crate) struct Course {
    pub means: Integrals,
    pub range: [f64; 2],
}

/// Returns the integrals of samples, one value at a time.
pub(crate) fn integrals(setting: &Setting<'_>, mut next: impl FnMut() -> f64) -> Integrals {
    let mut strapdown = Strapdown::new(setting.align);
    let mut found = Vec::with_capacity(setting.horizons.len());
    (0..setting.begin).for_each(|_| {
        next();
    });
    for index in 1..=setting.samples() {
        let state = strapdown.push(next());
        if setting.horizons.get(found.len()).is_some_and(|horizon| setting.align + horizon == index) {
            found.push([1, 2, 3].map(|order: usize| state[order - 1] * scale(order, setting.rate_hz)));
        }
    }
    found
}

/// Returns a simulation of `model` at the setting's temperature.
pub(crate) fn simulator(setting: &Setting<'_>, model: &SensorModel, seed: u64) -> Result<Simulator, CostError> {
    let course = setting.temperature.clone();
    let simulator = Simulator::new(model, seed, setting.rate_hz, setting.record_s())?;
    Ok(simulator.with_temperature(move |time_s: f64| course.at(time_s)))
}

/// Returns the samples of a channel, one at a time; 0 when the simulation has ended.
pub(crate) fn samples(mut simulator: Simulator, channel: Channel) -> impl FnMut() -> f64 {
    let (mut block, mut place) = (Vec::new(), 0);
    move || {
        if place == block.len() {
            block.clear();
            block.extend_from_slice(simulator.next_block().and_then(|next| next.values(channel)).unwrap_or_default());
            place = 0;
        }
        let value = block.get(place).copied().unwrap_or_default();
        place += 1;
        value
    }
}

/// Returns the course of a source without randomness.
pub(crate) fn course(setting: &Setting<'_>, of: &ChannelSources, source: &Source) -> Result<Course, CostError> {
    let mut next = samples(simulator(setting, &of.alone(setting.model, &source.effect), 0)?, of.channel);
    let mut range = [f64::INFINITY, f64::NEG_INFINITY];
    let means = integrals(setting, || {
        let value = next();
        range = [range[0].min(value), range[1].max(value)];
        value
    });
    Ok(Course { means, range })
}

/// Returns the sums of squares of weights of white noise of variance 1 per sample times a factor, per horizon.
pub(crate) fn squares(setting: &Setting<'_>, mut power: impl FnMut() -> f64) -> Vec<WhiteSums> {
    let mut squares = Squares::new(setting.align);
    let mut found = Vec::with_capacity(setting.horizons.len());
    (0..setting.begin).for_each(|_| {
        power();
    });
    for index in 1..=setting.samples() {
        squares.push(power());
        if setting.horizons.get(found.len()).is_some_and(|horizon| setting.align + horizon == index) {
            found.push(squares.sums());
        }
    }
    found
}

/// Returns by what part of the steady noise's variance a factor's noise has: of a change of variance, what it adds to
/// the changes before it.
pub(crate) fn modulation(setting: &Setting<'_>, factor: &Factor) -> Integrals {
    let steady = squares(setting, || 1.0);
    let ratio = |found: Vec<WhiteSums>| -> Integrals {
        let one = |(own, steady): (&WhiteSums, &WhiteSums)| [0, 1, 2].map(|k| own.squares[k] / steady.squares[k]);
        found.iter().zip(&steady).map(one).collect()
    };
    match factor {
        Factor::Intervals(intervals) => {
            let mut is_inside = inside(intervals, setting.rate_hz);
            ratio(squares(setting, || f64::from(u8::from(is_inside()))))
        }
        Factor::Changes(changes) => {
            let all = ratio(squares(setting, powers(setting, changes)));
            let before = match changes.len() {
                1 => vec![[1.0; ORDERS]; all.len()],
                count => ratio(squares(setting, powers(setting, &changes[..count - 1]))),
            };
            let more = |(all, before): (&[f64; ORDERS], &[f64; ORDERS])| [0, 1, 2].map(|k| all[k] - before[k]);
            all.iter().zip(&before).map(more).collect()
        }
    }
}

/// Returns the square of the factor of all changes, sample by sample.
pub(crate) fn powers(setting: &Setting<'_>, changes: &[Arc<dyn Effect>]) -> impl FnMut() -> f64 + use<> {
    let (rate_hz, temperature) = (setting.rate_hz, setting.temperature.clone());
    // A change of variance draws nothing.
    let stream = || Stream::new(0, StreamId { owner: 0, effect: 0, instance: 0 });
    let mut samplers: Vec<_> =
        changes.iter().map(|change| change.sampler(rate_hz, setting.record_s(), stream())).collect();
    let (mut block, mut place, mut first) = (Vec::new(), 0, 0_u64);
    move || {
        if place == block.len() {
            let celsius: Vec<f64> = (0..BLOCK as u64).map(|k| temperature.at((first + k) as f64 / rate_hz)).collect();
            block.clear();
            block.resize(BLOCK, 1.0);
            for sampler in &mut samplers {
                sampler.act(&mut block, Temperature::Series(&celsius));
            }
            (place, first) = (0, first + BLOCK as u64);
        }
        place += 1;
        block[place - 1] * block[place - 1]
    }
}

/// Returns, from one sample to the next, whether it is inside intervals.
pub(crate) fn inside(intervals: &[(f64, f64)], rate_hz: f64) -> impl FnMut() -> bool + use<> {
    let ranges = Bursts { intervals: intervals.to_vec(), sigma: 1.0 }.ranges(rate_hz);
    let (mut sample, mut at) = (0, 0);
    move || {
        while ranges.get(at).is_some_and(|(_, to)| *to <= sample) {
            at += 1;
        }
        sample += 1;
        ranges.get(at).is_some_and(|(from, _)| *from < sample)
    }
}

/// Returns the peaks, per horizon and order, that a sine inside intervals has in the integrals.
pub(crate) fn gated(
    setting: &Setting<'_>,
    of: &ChannelSources,
    frequency_hz: f64,
    amplitude: f64,
    intervals: &[(f64, f64)],
) -> Integrals {
    let quadrature = |wave| integrals(setting, gated_wave(setting, of, frequency_hz, amplitude, intervals, wave));
    let both = |(cosine, sine): ([f64; ORDERS], [f64; ORDERS])| [0, 1, 2].map(|k| f64::hypot(cosine[k], sine[k]));
    quadrature(f64::cos).into_iter().zip(quadrature(f64::sin)).map(both).collect()
}

/// Returns the sent samples of a wave inside intervals, one at a time; `wave` is the sine or the cosine.
pub(crate) fn gated_wave(
    setting: &Setting<'_>,
    of: &ChannelSources,
    frequency_hz: f64,
    amplitude: f64,
    intervals: &[(f64, f64)],
    wave: fn(f64) -> f64,
) -> impl FnMut() -> f64 + use<> {
    let filtered: f64 = of.filters.iter().map(|filter| filter.power_gain(frequency_hz, setting.internal_hz)).product();
    let (peak, step) = (amplitude * filtered.sqrt(), frequency_hz / setting.internal_hz);
    let (mut sample, mut boxcar, ratio) = (0_u64, RunningMean::new(setting.window()), setting.ratio());
    let mut is_inside = inside(intervals, setting.internal_hz);
    let mut own = move || {
        let phase = (step * sample as f64).fract();
        sample += 1;
        boxcar.next(if is_inside() { peak * wave(TAU * phase) } else { 0.0 })
    };
    move || {
        // A sample is sent at the first of the sensor's own samples of its period.
        let sent = own();
        for _ in 1..ratio {
            own();
        }
        sent
    }
}
