//! Samples decimated for a plot: minimum and maximum of each channel over stretches of them.

/// Minimum and maximum of each channel over a number of consecutive samples.
#[derive(Debug, Clone)]
pub struct Bucket {
    size: u64,
    count: u64,
    first_ns: i64,
    last_ns: i64,
    extremes: Vec<(f64, f64)>,
}

impl Bucket {
    /// Creates a bucket of this many samples of this many channels.
    pub fn new(size: u64, channels: usize) -> Self {
        Self { size, count: 0, first_ns: 0, last_ns: 0, extremes: vec![(f64::NAN, f64::NAN); channels] }
    }

    /// Takes a sample; returns whether the bucket is full.
    pub fn take(&mut self, time_ns: i64, values: impl Iterator<Item = f64>) -> bool {
        if self.count == 0 {
            self.first_ns = time_ns;
            self.extremes.fill((f64::NAN, f64::NAN));
        }
        self.last_ns = time_ns;
        self.count += 1;
        for ((low, high), value) in self.extremes.iter_mut().zip(values) {
            // If one side is NaN, f64::min and max return the number on the other side.
            (*low, *high) = (low.min(value), high.max(value));
        }
        self.count >= self.size
    }

    /// Returns the row of the samples taken, at the middle of their time; `None` if there were none.
    pub fn row(&mut self) -> Option<(i64, impl Iterator<Item = f64> + '_)> {
        if self.count == 0 {
            return None;
        }
        self.count = 0;
        let middle_ns = self.first_ns + (self.last_ns - self.first_ns) / 2;
        Some((middle_ns, self.extremes.iter().flat_map(|(low, high)| [*low, *high])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_keeps_the_extremes_and_forgets_them() {
        let mut bucket = Bucket::new(2, 1);
        assert!(!bucket.take(0, [f64::NAN].into_iter()));
        assert!(bucket.take(10, [3.0].into_iter()));
        let (middle_ns, row) = bucket.row().unwrap();
        assert_eq!((middle_ns, row.collect::<Vec<_>>()), (5, vec![3.0, 3.0]));
        assert!(bucket.row().is_none());
        assert!(!bucket.take(20, [-1.0].into_iter()));
        assert!(bucket.take(30, [1.0].into_iter()));
        assert_eq!(bucket.row().unwrap().1.collect::<Vec<_>>(), [-1.0, 1.0]);
    }
}
