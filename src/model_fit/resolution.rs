//! Resolution: the step that all of a channel's values are multiples of.

/// Finds the step of a stream of values. The first [`Resolution::KEPT`] different values are held; those that follow only have to
/// agree.
#[derive(Debug, Clone, Default)]
pub struct Resolution {
    distinct: Vec<f64>,
    /// Values seen since the last time that the distinct ones were put in order.
    fresh: Vec<f64>,
    /// Values seen in all.
    seen: u64,
}

impl Resolution {
    /// Different values that are looked at: a noise of a thousand steps shows neighbours among them.
    const KEPT: usize = 20_000;
    /// Multiples of the step have to be whole to this share of it: decimals and binary floats carry rounding.
    const WHOLE: f64 = 0.02;
    /// Fewest different values; of fewer nothing can be told.
    const LEAST: usize = 3;
    /// Fewest times that a value is seen on average where there are fewer different ones than [`Self::MANY`]: a coarse step.
    const REPEATED: u64 = 100;
    /// Different values that agree hardly by chance.
    const MANY: usize = 8;
    /// The smallest distance of two values is at most this many steps where there are thousands of them.
    const MULTIPLES: [f64; 10] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0];

    /// Takes in values; absent ones are passed over.
    pub fn push(&mut self, values: &[f64]) {
        self.seen += values.iter().filter(|value| value.is_finite()).count() as u64;
        if self.distinct.len() >= Self::KEPT {
            return;
        }
        self.fresh.extend(values.iter().filter(|value| value.is_finite()));
        if self.fresh.len() > Self::KEPT {
            self.settle();
        }
    }

    fn settle(&mut self) {
        self.distinct.append(&mut self.fresh);
        self.distinct.sort_unstable_by(f64::total_cmp);
        self.distinct.dedup();
    }

    /// The step; None where the values have none, as binary floats do.
    #[must_use]
    pub fn step(mut self) -> Option<f64> {
        self.settle();
        let different = self.distinct.len();
        if different < Self::LEAST || (different < Self::MANY && self.seen < Self::REPEATED * different as u64) {
            return None;
        }
        let largest = self.distinct.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
        let distances: Vec<f64> = self.distinct.windows(2).map(|pair| pair[1] - pair[0]).collect();
        // What lies closer than rounding is one value.
        let rounding = 8.0 * f64::EPSILON * largest;
        let smallest = distances.iter().copied().filter(|distance| *distance > rounding).reduce(f64::min)?;
        let whole = |step: f64| {
            let off = |distance: &f64| ((distance / step) - (distance / step).round()).abs();
            distances.iter().filter(|distance| **distance > rounding).all(|distance| off(distance) < Self::WHOLE)
        };
        // Steps that are small beside float rounding mean nothing.
        let step = Self::MULTIPLES.into_iter().map(|multiple| smallest / multiple).find(|step| whole(*step))?;
        let count = ((self.distinct.last()? - self.distinct.first()?) / step).round();
        // Precise by the whole range; where hardly a place on it is taken, agreement is chance.
        let step = (self.distinct.last()? - self.distinct.first()?) / count;
        (count.is_finite() && step > 4.0 * rounding && self.distinct.len() as f64 > 0.02 * count).then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Stream, StreamId};

    fn step_of(values: impl Iterator<Item = f64>) -> Option<f64> {
        let mut resolution = Resolution::default();
        for chunk in values.collect::<Vec<_>>().chunks(1000) {
            resolution.push(chunk);
        }
        resolution.step()
    }

    fn noise(seed: u64) -> impl Iterator<Item = f64> {
        let mut stream = Stream::new(seed, StreamId { owner: 0, effect: 1, instance: 0 });
        (0..50_000).map(move |_| -9.8 + 0.013 * stream.normal())
    }

    #[test]
    fn the_step_of_decimals_and_of_odd_counts_is_found() {
        for step in [0.001, 1e-4, 0.05_f64.to_radians(), 0.00333 * 9.806_65] {
            let found = step_of(noise(1).map(|value| (value / step).round() * step)).unwrap_or_default();
            // As wide as the noise or wider, a step is a step.
            assert!((found / step - 1.0).abs() < 1e-6, "{step}: {found}");
        }
        let text = |value: f64| format!("{value:.3}").parse::<f64>().unwrap();
        assert!((step_of(noise(2).map(text)).unwrap() - 0.001).abs() < 1e-12);
    }

    #[test]
    fn floats_have_no_step() {
        assert_eq!(step_of(noise(3)), None);
        assert_eq!(step_of(noise(4).map(|value| f64::from(value as f32))).filter(|step| *step > 2e-6), None);
        assert_eq!(step_of(std::iter::repeat_n(1.0, 5000)), None);
    }

    #[test]
    fn multiples_that_never_stand_side_by_side_are_steps_all_the_same() {
        let values = (0..1000).map(|index| f64::from((index * 7919) % 101 * 2 + (index % 2) * 3) * 0.01);
        assert!((step_of(values).unwrap() - 0.01).abs() < 1e-9);
    }
}
