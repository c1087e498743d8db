//! Block means: a channel reduced to some dozens of levels over the whole record, for changes slower than noise.

use super::Part;

/// Mean level of each of `count` equal stretches of time, and the time of its middle; `None` if less than a quarter of
/// its samples are present.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Blocks {
    pub(super) begin_s: f64,
    pub(super) length_s: f64,
    pub(super) means: Vec<Option<f64>>,
}

impl Blocks {
    pub(super) fn of(parts: &[Part], rate_hz: f64, count: usize) -> Option<Self> {
        let begin_s = parts.first()?.start_s;
        let end_s = parts.last().map(|part| part.time_s(part.values.len(), rate_hz))?;
        Self::between(parts, rate_hz, begin_s, end_s, count)
    }

    pub(super) fn between(parts: &[Part], rate_hz: f64, begin_s: f64, end_s: f64, count: usize) -> Option<Self> {
        let length_s = (end_s - begin_s) / count as f64;
        if !(length_s > 0.0 && length_s.is_finite()) {
            return None;
        }
        // Relative to one level, so that small differences of large values keep their digits.
        let level = *parts.iter().find_map(|part| part.values.first())?;
        let (mut sums, mut counts) = (vec![0.0; count], vec![0u64; count]);
        for part in parts {
            let mut from = 0;
            while from < part.values.len() {
                let block = ((part.time_s(from, rate_hz) - begin_s + 1e-9) / length_s).floor();
                let until_s = begin_s + (block + 1.0) * length_s;
                let to = (((until_s - part.start_s) * rate_hz - 1e-6).ceil().max(0.0) as usize)
                    .clamp(from + 1, part.values.len());
                if block >= 0.0 && (block as usize) < count {
                    sums[block as usize] += part.values[from..to].iter().map(|value| value - level).sum::<f64>();
                    counts[block as usize] += (to - from) as u64;
                }
                from = to;
            }
        }
        let least = 0.25 * length_s * rate_hz;
        let mean = |(sum, count): (f64, u64)| (count as f64 >= least.max(1.0)).then(|| level + sum / count as f64);
        Some(Self { begin_s, length_s, means: sums.into_iter().zip(counts).map(mean).collect() })
    }

    /// Returns the middle of a block, s.
    pub(super) fn middle_s(&self, block: usize) -> f64 {
        self.begin_s + (block as f64 + 0.5) * self.length_s
    }

    /// Returns differences of neighbours that are both present and have no step (s) between them, with the index of the
    /// first.
    pub(super) fn increments(&self, steps_s: &[f64]) -> Vec<(usize, f64)> {
        let steps = |index: usize| {
            let (from_s, to_s) =
                (self.middle_s(index) - self.length_s / 2.0, self.middle_s(index + 1) + self.length_s / 2.0);
            steps_s.iter().any(|step| (from_s..=to_s).contains(step))
        };
        let pair = |(index, pair): (usize, &[Option<f64>])| Some((index, pair[1]? - pair[0]?));
        self.means.windows(2).enumerate().filter_map(pair).filter(|(index, _)| !steps(*index)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_those_of_their_stretches_and_gaps_have_none() {
        let parts = [
            Part { start_s: 0.0, values: (0..200).map(f64::from).collect() },
            Part { start_s: 60.0, values: vec![7.0; 400] },
        ];
        let blocks = Blocks::of(&parts, 10.0, 10).unwrap();
        assert_eq!(blocks.length_s, 10.0);
        assert_eq!(blocks.means[0], Some(49.5));
        assert_eq!(blocks.means[1], Some(149.5));
        assert_eq!(blocks.means[2..6], [None; 4]);
        assert_eq!(blocks.means[6..], [Some(7.0); 4]);
        assert_eq!(blocks.increments(&[]).len(), 4);
        assert_eq!(blocks.increments(&[85.0]).len(), 2);
        assert!(Blocks::of(&[], 10.0, 10).is_none());
    }
}
