//! Cases: a part of a recording with effects that its model lacks, and its key.

use super::impose::{impose, steps};
use super::part::{Number, Part};
use crate::draw::Draw;
use crate::motion::kind::{Planned, plan_among};
use crate::motion::{Key, Kind, TrueEffect};
use imu_core::sample::Triad;
use imu_diagnosis::Recording;

/// Sizes over the limit.
const SIZES: [f64; 2] = [0.5, 100.0];
/// The other axes of an effect have at least this part of the largest size.
const LEAST: f64 = 0.2;
/// The largest numbers: a sensor with more is broken or has another unit. A scale factor or cross-axis sensitivity; a bias of a rate, rad/s,
/// and of a specific force, m/s²; a delay, s.
const RATIO_MOST: f64 = 0.1;
const BIAS_MOST: [f64; 2] = [0.2, 2.0];
const LATE_MOST_S: f64 = 0.05;
/// A delay in all is at least this part of the untouched one: what is early is no latency.
const LATE_LEAST: f64 = 0.1;
/// Angles of a mounting, rad: the library's law is of first order, and a larger one would change scale factors.
const TURNED: [f64; 2] = [1e-3, 1.7e-2];

/// Returns the effects of every case, as [`crate::motion::plan`] does: kinds among `possible`; in place of effects outside the
/// library, misalignments, which beside poses are a matter of mounting and no effect of the sensor.
///
/// # Errors
/// The word that names neither a class nor a possible kind.
pub fn plan<'a>(
    seed: u64,
    cases: usize,
    words: impl IntoIterator<Item = &'a str>,
    possible: &[Planned],
) -> Result<Vec<Vec<Planned>>, String> {
    let mut triads: Vec<Triad> = possible.iter().map(|(_, triad)| *triad).collect();
    triads.sort_unstable();
    triads.dedup();
    let turned: Vec<Planned> = triads.into_iter().map(|triad| (Kind::Misalignment, triad)).collect();
    plan_among(seed, cases, words, possible, &turned)
}

/// A sealed case.
#[derive(Debug)]
pub struct Case<'a> {
    seed: u64,
    number: usize,
    planned: &'a [Planned],
    part: &'a Part,
}

impl<'a> Case<'a> {
    /// Creates the case `number` of the sealed seed with these effects on a part.
    pub fn new(seed: u64, number: usize, planned: &'a [Planned], part: &'a Part) -> Self {
        Self { seed, number, planned, part }
    }

    /// Returns the key.
    pub fn key(&self) -> Key {
        Key {
            case: self.number,
            rate_hz: self.part.recording.rate_hz,
            samples: self.part.recording.len(),
            own_clock: false,
            effects: self.effects(),
            salt: Draw::capture(self.seed, self.number as u64, 1, "salt").salt(),
        }
    }

    /// Returns the recording.
    pub fn record(&self) -> Recording {
        impose(self.part, &self.effects())
    }

    fn effects(&self) -> Vec<TrueEffect> {
        let of = |(index, (kind, triad)): (usize, &Planned)| {
            // Recordings of one seed have sizes of their own.
            let purpose = format!("posed effect {index} on {} samples", self.part.recording.len());
            self.effect(*kind, *triad, &mut Draw::device(self.seed, self.number as u64, &purpose))
        };
        self.planned.iter().enumerate().map(of).collect()
    }

    fn effect(&self, kind: Kind, triad: Triad, draw: &mut Draw) -> TrueEffect {
        let over = draw.log_uniform(SIZES[0], SIZES[1]);
        let own = self.part.own.of(triad).map(|of| of.of_kind(kind)).unwrap_or_default();
        let known: Vec<usize> = (0..own.len()).filter(|at| own[*at].is_some()).collect();
        let triad_name = triad.name().to_owned();
        if kind == Kind::Misalignment || known.is_empty() {
            let angle = draw.log_uniform(TURNED[0], TURNED[1]);
            let along: [f64; 3] = std::array::from_fn(|_| draw.normal());
            let length = along.iter().map(|of| of * of).sum::<f64>().sqrt().max(1e-9);
            let numbers = along.map(|of| angle * of / length).to_vec();
            return TrueEffect { kind, triad: triad_name, over_limit: over, numbers, limit: angle / over };
        }
        let chosen: Vec<usize> = draw.some_of(known.len(), 1).into_iter().map(|at| known[at]).collect();
        let largest = chosen[draw.whole(0, chosen.len() - 1)];
        let most = match kind {
            Kind::Bias => BIAS_MOST[usize::from(triad == Triad::Accel)],
            Kind::Latency => LATE_MOST_S,
            _ => RATIO_MOST,
        };
        let mut numbers = vec![0.0; own.len()];
        let mut over_limit = 0.0f64;
        for at in chosen {
            let Some(number) = own[at] else { continue };
            let part = if at == largest { 1.0 } else { draw.uniform(LEAST, 1.0) };
            let size = (over * part * number.limit()).min(most);
            numbers[at] = draw.sign() * size;
            if kind == Kind::Latency {
                numbers[at] = late(number, numbers[at]);
            }
            // Values that are rounded already move by whole steps only.
            let step = steps(&self.part.model).into_iter().find(|(channel, _)| *channel == triad.channels()[at % 3]);
            if let (Kind::Bias, Some((_, step))) = (kind, step) {
                numbers[at] = numbers[at].signum() * (numbers[at].abs() / step).round().max(1.0) * step;
            }
            over_limit = over_limit.max(numbers[at].abs() / number.limit());
        }
        let limit = own[largest].map_or(0.0, |number| number.limit());
        TrueEffect { kind, triad: triad_name, over_limit, numbers, limit }
    }
}

/// Returns a change of a delay, with its sign if what remains is a latency.
fn late(own: Number, change: f64) -> f64 {
    if own.value + change >= LATE_LEAST * own.value.abs() { change } else { change.abs() }
}
