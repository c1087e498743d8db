//! Groups: the possible explanations of a triad's answer to a motion, each with its price. They include the effects of the
//! library. They also include columns of effects outside the library, so that an outside effect is not taken for one of the
//! library.
//!
//! A price is half of χ²'s quantile for as many degrees of freedom as the group has numbers, at the level over all
//! groups and triads (Bonferroni). Twice the nats that p numbers gain in noise of a known law are χ² with p degrees of
//! freedom (Wilks 1938, Ann. Math. Stat. 9). A bias shows in the record's mean alone, whose variance is fitted, not
//! known. The gain of a bias is therefore distributed as Fisher's F with the degrees of freedom that the levels'
//! uncertainty leaves.

use crate::averages::mean;
use crate::course::Follow;
use crate::response::{Candidate, Extra, input};
use imu_core::sample::Triad;
use imu_model::effects::triad::Axes;
use imu_model::simulator::Motion;
use statrs::distribution::{ChiSquared, ContinuousCDF as _, FisherSnedecor};
use std::ops::Range;

/// Nats by which an effect outside the library has to be better than one in it.
const CLEARLY: f64 = 3.0;
/// Time constants with which a sensor may creep after its input, s.
const CREEPS_S: [f64; 4] = [0.5, 2.0, 8.0, 32.0];
/// Time constants of filters, samples: sums of these describe any low pass of up to some ten samples.
const FOLLOWS: [f64; 4] = [0.7, 1.8, 4.5, 11.0];
/// Half widths of a play, in parts of the largest input.
const PLAYS: [f64; 3] = [0.02, 0.1, 0.3];
/// The inputs at which a curve may bend, in parts of the largest input.
const BENDS: [f64; 2] = [0.03, 0.2];

/// An effect that is not in the library.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Foreign {
    /// The output creeps after the input.
    Creep,
    /// The output follows the input with play.
    Play,
    /// The curve has terms other than a straight line and squares.
    Curve,
    /// The output has products of the inputs.
    Products,
    /// The sensor is not at the place of the reference.
    LeverArm,
    /// A gyroscope's output has squares and products of the specific force.
    ForceSquared,
    /// The output follows the input within some samples, but not by a pure delay: a filter.
    Bandwidth,
}

impl Foreign {
    /// Returns the meaning, in words that follow "the gyro".
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Creep => "creeps after its input (a memory of seconds)",
            Self::Play => "follows its input with play (hysteresis)",
            Self::Curve => "bends otherwise than a square does (a cube, or a dead band)",
            Self::Products => "shows products of the inputs of two axes",
            Self::LeverArm => "stands off the point that the reference tells the motion of (a lever arm)",
            Self::ForceSquared => "shows the square of the specific force (g²-sensitivity)",
            Self::Bandwidth => "rounds the corners of a motion as a filter does that its noise does not show",
        }
    }

    /// Returns the kinds that are searched on a triad.
    pub(super) fn of(triad: Triad) -> Vec<Self> {
        let own = if triad == Triad::Gyro { Self::ForceSquared } else { Self::LeverArm };
        vec![Self::Creep, Self::Play, Self::Curve, Self::Products, own, Self::Bandwidth]
    }
}

/// An effect of the library or outside it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Member {
    /// An effect of the library.
    Library(Candidate),
    /// An effect outside the library.
    Foreign(Foreign),
}

/// Columns of a screen that are chosen or left out together.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// The effect of the columns.
    pub member: Member,
    /// The range of the columns.
    pub columns: Range<usize>,
    /// Nats that they have to explain.
    pub price: f64,
}

/// The parameters of prices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pricing {
    /// The part of clean records in which any group may be named.
    pub level: f64,
    /// The number of examined triads.
    pub triads: usize,
    /// Degrees of freedom of the variance of the record's mean.
    pub mean_freedom: f64,
}

impl Pricing {
    /// Returns the price of `numbers` numbers among `groups` groups per triad.
    pub fn price(&self, numbers: usize, groups: usize) -> f64 {
        let chance = self.level / (groups * self.triads).max(1) as f64;
        ChiSquared::new(numbers.max(1) as f64).map_or(f64::INFINITY, |of| 0.5 * of.inverse_cdf(1.0 - chance))
    }

    /// Returns the price of a bias.
    pub fn price_of_mean(&self, numbers: usize, groups: usize) -> f64 {
        /// A variance with at least this many degrees of freedom counts as known.
        const KNOWN: f64 = 3000.0;
        let price = self.price(numbers, groups);
        let chance = self.level / (groups * self.triads).max(1) as f64;
        let Ok(of) = FisherSnedecor::new(numbers as f64, self.mean_freedom.min(KNOWN)) else { return f64::INFINITY };
        if self.mean_freedom >= KNOWN {
            return price;
        }
        // Bisection finds F's quantile over the numbers, which exceeds χ²'s.
        let (mut low, mut high) = (price, 1e4 * price);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let beyond = of.sf(2.0 * middle / numbers as f64) > chance;
            (low, high) = if beyond { (middle, high) } else { (low, middle) };
        }
        high
    }
}

/// Returns the effects of the library that are fitted by regression. `reference_c` is the temperature to which a scale factor's
/// dependence on it refers; `None` if the temperature is unknown or never changes.
pub fn candidates(triad: Triad, full_scale: f64, reference_c: Option<f64>) -> Vec<Candidate> {
    let all = Candidate::all(triad, full_scale).into_iter();
    all.filter_map(|one| match one {
        Candidate::Latency | Candidate::Saturation => None,
        Candidate::TemperatureScale { .. } => {
            reference_c.map(|reference_c| Candidate::TemperatureScale { reference_c })
        }
        other => Some(other),
    })
    .collect()
}

/// Returns the groups of a screen with these candidates and extra columns.
pub fn groups(candidates: &[Candidate], own: usize, foreign: &[(Foreign, usize)], pricing: Pricing) -> Vec<Group> {
    let inside = candidates.len();
    let mut groups = Vec::new();
    let mut place = 0;
    for candidate in candidates {
        let numbers = candidate.parameters().len();
        let price = match candidate {
            Candidate::Bias => pricing.price_of_mean(numbers, inside),
            _ => pricing.price(numbers, inside),
        };
        groups.push(Group { member: Member::Library(*candidate), columns: place..place + numbers, price });
        place += numbers;
    }
    let mut place = own;
    for (of, numbers) in foreign {
        let price = pricing.price(*numbers, foreign.len()) + CLEARLY;
        groups.push(Group { member: Member::Foreign(*of), columns: place..place + numbers, price });
        place += numbers;
    }
    groups
}

/// Returns columns of effects that are not in the library.
pub fn foreign(of: Foreign, triad: Triad, motions: &[Motion], rate_hz: f64) -> Vec<Extra> {
    let inputs: [Vec<f64>; 3] =
        std::array::from_fn(|axis| motions.iter().map(|motion| input(triad, motion)[axis]).collect());
    let forces: [Vec<f64>; 3] = std::array::from_fn(|axis| motions.iter().map(|of| of.accel_m_s2[axis]).collect());
    let peak = inputs.iter().flatten().fold(0.0f64, |most, value| most.max(value.abs()));
    let mut columns: Vec<Extra> = Vec::new();
    let mut own = |axis: usize, values: Vec<f64>| {
        let mut column: [Option<Vec<f64>>; 3] = [None, None, None];
        column[axis] = Some(values);
        columns.push(column);
    };
    for axis in 0..3 {
        let values = &inputs[axis];
        match of {
            Foreign::Creep => CREEPS_S.iter().for_each(|tau_s| own(axis, creep(values, tau_s * rate_hz))),
            Foreign::Play => PLAYS.iter().for_each(|part| own(axis, play(values, part * peak))),
            Foreign::Curve => {
                own(axis, values.iter().map(|value| value.powi(3)).collect());
                let bend = |part: &f64| values.iter().map(|value| value.clamp(-part * peak, part * peak)).collect();
                BENDS.iter().for_each(|part| own(axis, bend(part)));
            }
            Foreign::Products => (0..3).for_each(|other| own(axis, product(&inputs[other], &inputs[(other + 1) % 3]))),
            Foreign::ForceSquared => (0..3).for_each(|other| own(axis, product(&forces[other], &forces[other]))),
            Foreign::Bandwidth => {
                // Without the delay to which each is equal to first order: the delay has its own column.
                FOLLOWS.iter().for_each(|samples| {
                    let late = (samples.recip().exp() - 1.0).recip();
                    let slopes = derivative(values, 1).into_iter().map(|slope| late * slope);
                    own(axis, creep(values, *samples).into_iter().zip(slopes).map(|(of, slope)| of - slope).collect());
                });
                (2..4).for_each(|order| own(axis, derivative(values, order)));
            }
            Foreign::LeverArm => {}
        }
    }
    match of {
        Foreign::LeverArm => columns.extend(lever(motions, rate_hz)),
        // One axis later than another; the mean of the three belongs to the delay.
        Foreign::Bandwidth => columns.extend([[1.0, -1.0, 0.0], [0.5, 0.5, -1.0]].map(|signs| {
            std::array::from_fn(|axis| {
                let scaled = |value: f64| signs[axis] * value;
                (signs[axis] != 0.0).then(|| derivative(&inputs[axis], 1).into_iter().map(scaled).collect())
            })
        })),
        _ => {}
    }
    columns.iter_mut().for_each(centre);
    columns.retain(|column| column.iter().flatten().flatten().any(|value| *value != 0.0));
    columns
}

/// Subtracts the columns' means, which belong to a bias, and scales the largest value of all axes to 1.
fn centre(column: &mut [Option<Vec<f64>>; 3]) {
    let axes = || column.iter().flatten();
    let far = |values: &Vec<f64>| {
        let mean = mean(values);
        values.iter().fold(0.0f64, |most, value| most.max((value - mean).abs()))
    };
    let most = axes().map(far).fold(0.0, f64::max);
    let scale = if most > 1e-12 { most.recip() } else { 0.0 };
    for values in column.iter_mut().flatten() {
        let mean = mean(values);
        values.iter_mut().for_each(|value| *value = (*value - mean) * scale);
    }
}

/// Returns how far values are ahead of a course that follows them with a time constant, in samples.
fn creep(values: &[f64], samples: f64) -> Vec<f64> {
    let share = 1.0 - (-samples.max(1e-9).recip()).exp();
    let mut follows = values.first().copied().unwrap_or_default();
    values
        .iter()
        .map(|value| {
            follows += share * (value - follows);
            value - follows
        })
        .collect()
}

/// Returns how far values are from a course that they drag along with a play of that half width.
fn play(values: &[f64], half: f64) -> Vec<f64> {
    let dragged = Follow::Play(2.0 * half).raw(values);
    values.iter().zip(dragged).map(|(value, dragged)| value - dragged).collect()
}

/// Returns the first, second or third difference about each value, per sample; the ends stay.
fn derivative(values: &[f64], order: usize) -> Vec<f64> {
    let last = values.len().saturating_sub(1);
    (0..values.len())
        .map(|t| {
            let at = |back: usize, on: usize| values[(t + on).saturating_sub(back).min(last)];
            match order {
                1 => 0.5 * (at(0, 1) - at(1, 0)),
                2 => at(0, 1) - 2.0 * at(0, 0) + at(1, 0),
                _ => 0.5 * (at(0, 2) - 2.0 * at(0, 1) + 2.0 * at(1, 0) - at(2, 0)),
            }
        })
        .collect()
}

fn product(one: &[f64], other: &[f64]) -> Vec<f64> {
    one.iter().zip(other).map(|(one, other)| one * other).collect()
}

/// Returns the specific force that an arm along x, y or z of length 1 adds: ω × (ω × r) + ω̇ × r.
fn lever(motions: &[Motion], rate_hz: f64) -> [[Option<Vec<f64>>; 3]; 3] {
    let n = motions.len();
    let change = |index: usize| -> Axes {
        let (before, after) = (index.saturating_sub(1), (index + 1).min(n - 1));
        let per_s = rate_hz / (after - before).max(1) as f64;
        std::array::from_fn(|axis| (motions[after].gyro_rad_s[axis] - motions[before].gyro_rad_s[axis]) * per_s)
    };
    std::array::from_fn(|arm| {
        let mut along = [0.0; 3];
        along[arm] = 1.0;
        let values: Vec<Axes> = (0..n)
            .map(|index| {
                let rate = motions[index].gyro_rad_s;
                let (inward, across) = (cross(rate, cross(rate, along)), cross(change(index), along));
                std::array::from_fn(|axis| inward[axis] + across[axis])
            })
            .collect();
        // The three axes share the arm: they keep their proportion.
        let most = values.iter().flatten().fold(0.0f64, |most, value| most.max(value.abs()));
        let scale = if most > 1e-12 { most.recip() } else { 0.0 };
        std::array::from_fn(|axis| Some(values.iter().map(|value| value[axis] * scale).collect()))
    })
}

fn cross(a: Axes, b: Axes) -> Axes {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_play_and_a_creep_are_behind_and_catch_up() {
        let values: Vec<f64> = (0..100).map(|index| if index < 50 { f64::from(index) } else { 49.0 }).collect();
        let (played, crept) = (play(&values, 3.0), creep(&values, 5.0));
        assert_eq!((played[2], played[40], played[99]), (2.0, 3.0, 3.0));
        assert!((crept[45] - 4.5).abs() < 0.1 && crept[99] < 1e-3, "{} {}", crept[45], crept[99]);
    }

    #[test]
    fn an_arm_feels_the_way_inward() {
        let motions = vec![Motion { gyro_rad_s: [0.0, 0.0, 2.0], ..Motion::default() }; 10];
        let [x, _, z] = lever(&motions, 10.0);
        // An arm of length 1 along x, turning about z, gives −ω² along x, here scaled to 1.
        assert_eq!(x[0].as_ref().unwrap()[5], -1.0);
        assert!(z.iter().flatten().flatten().all(|value| *value == 0.0));
    }

    #[test]
    fn prices_are_what_chance_reaches() {
        let pricing = Pricing { level: 0.005, triads: 1, mean_freedom: 1e9 };
        // χ² of 3 degrees of freedom is above 16.27 with a chance of 0.001.
        assert!((pricing.price(3, 5) - 8.133).abs() < 0.01);
        assert!((pricing.price_of_mean(3, 5) - 8.133).abs() < 0.02);
        assert!(Pricing { mean_freedom: 8.0, ..pricing }.price_of_mean(3, 5) > 20.0);
    }
}
