//! Latency: the triad's output lags behind the motion.

use super::{Axes, TriadEffect};
use crate::effects::described::effect;
use crate::effects::spec::FROM_ZERO;
use crate::effects::{Described, Refusal, Stage};
use imu_core::sample::Triad;
use std::collections::VecDeque;

effect! {
    /// The motion arrives this much late; noise does not come from the motion and is not delayed.
    ///
    /// Between samples the motion is a cubic through four of them (Lagrange). Before its start it keeps its first
    /// value.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Latency: dyn TriadEffect, 0, Stage::Latency;
    "the triad shows the motion of a moment ago";
    seconds: f64 = FROM_ZERO, "s", "by how much the motion is late, s; at most 10";
}

impl Latency {
    /// The longest latency, s: it bounds the memory.
    pub const SECONDS_MAX: f64 = 10.0;
}

impl TriadEffect for Latency {
    fn check(&self, triad: Triad) -> Result<(), Refusal> {
        if !self.triads().contains(&triad) {
            return Err(Self::SPEC.refuse("effect", format!("`latency` on {}", triad.name()), "accel or gyro"));
        }
        Self::SPEC.check(&self.parameters())?;
        if self.seconds <= Self::SECONDS_MAX {
            return Ok(());
        }
        Err(Self::SPEC.refuse("seconds", format!("{} s", self.seconds), format!("at most {} s", Self::SECONDS_MAX)))
    }
    fn delay_s(&self) -> f64 {
        self.seconds
    }
}

/// A delay by any number of samples, whole or not.
#[derive(Debug)]
pub struct DelayLine {
    /// Weights of the samples from `skip` back on.
    weights: [f64; 4],
    skip: usize,
    /// Past values, the latest first.
    past: VecDeque<Axes>,
}

impl DelayLine {
    /// Creates a delay by `samples` (0 or more).
    pub fn new(samples: f64) -> Self {
        let (skip, weights) = Self::nodes(samples);
        Self { weights, skip, past: VecDeque::new() }
    }

    /// Returns the samples that make up a delay by `samples` (0 or more): how many of the latest to skip, and the
    /// weights of the next four.
    pub fn nodes(samples: f64) -> (usize, [f64; 4]) {
        // The four nodes skip, skip + 1 … lie around the delay, as far as such recent samples exist.
        let skip = (samples.floor() - 1.0).max(0.0);
        let at = samples - skip;
        let weights = std::array::from_fn(|node| {
            let others = (0..4).filter(|other| *other != node);
            others.map(|other| (at - f64::from(other as u8)) / (node as f64 - f64::from(other as u8))).product()
        });
        (skip as usize, weights)
    }

    /// Takes the present values and returns the delayed ones.
    pub fn next(&mut self, present: Axes) -> Axes {
        if self.past.is_empty() {
            self.past.resize(self.skip + 4, present);
        }
        self.past.pop_back();
        self.past.push_front(present);
        std::array::from_fn(|axis| {
            self.weights.iter().zip(self.past.iter().skip(self.skip)).map(|(weight, past)| weight * past[axis]).sum()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_motion_of_a_moment_ago_is_shown() {
        for delay in [0.0, 0.3, 1.0, 1.5, 2.25, 7.0, 40.6] {
            let mut line = DelayLine::new(delay);
            let motion = |time: f64| [(0.05 * time).sin(), 2.0, 0.1 * time];
            for index in 0..300_u32 {
                let found = line.next(motion(f64::from(index)));
                if f64::from(index) > delay + 4.0 {
                    for (found, expected) in found.into_iter().zip(motion(f64::from(index) - delay)) {
                        // A cubic misses a sine of 0.05 rad per sample by less than 0.05⁴.
                        assert!((found - expected).abs() < 0.05_f64.powi(4), "{delay} {index}");
                    }
                }
            }
        }
    }

    #[test]
    fn before_its_start_the_motion_is_as_at_the_start() {
        let mut line = DelayLine::new(2.0);
        let found: Vec<f64> = [5.0, 6.0, 7.0, 8.0].map(|x| line.next([x, 0.0, 0.0])[0]).to_vec();
        assert_eq!(found, [5.0, 5.0, 5.0, 6.0]);
    }

    #[test]
    fn a_latency_without_bound_is_refused() {
        assert!(Latency { seconds: 11.0 }.check(Triad::Gyro).is_err());
        assert!(Latency { seconds: -1.0 }.check(Triad::Gyro).is_err());
        assert!(Latency { seconds: 0.01 }.check(Triad::Gyro).is_ok());
    }
}
