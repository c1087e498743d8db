//! The accumulator as bytes: a fold that continues from a checkpoint has the same statistics, bit for bit, because
//! values enter one by one and every number is kept with all its bits.

use super::{Accumulator, BINS, Bins, Moments};

const VERSION: u8 = 1;

impl Accumulator {
    /// Returns the checkpoint: little-endian, versioned, about a kilobyte (more before 64 different values have
    /// arrived).
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = vec![VERSION];
        let moments = &self.moments;
        bytes.extend(moments.count.to_le_bytes());
        for value in [moments.mean, moments.m2, moments.m3, moments.m4, self.min, self.max] {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend(self.not_finite.to_le_bytes());
        // A long seed is constant: one value represents all.
        let constant = self.seed.windows(2).all(|pair| pair[0].to_bits() == pair[1].to_bits());
        bytes.extend((self.seed.len() as u64).to_le_bytes());
        bytes.push(u8::from(constant));
        for value in self.seed.iter().take(if constant { 1 } else { usize::MAX }) {
            bytes.extend(value.to_le_bytes());
        }
        bytes.push(u8::from(self.bins.is_some()));
        if let Some(bins) = &self.bins {
            bytes.extend(bins.first.to_le_bytes());
            bytes.extend(bins.exponent.to_le_bytes());
            bytes.extend((bins.counts.len() as u64).to_le_bytes());
            for count in &bins.counts {
                bytes.extend(count.to_le_bytes());
            }
        }
        bytes
    }

    /// Returns the accumulator that wrote `bytes`; `None` if the bytes are damaged or have another version.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes;
        if take::<1>(&mut rest)? != [VERSION] {
            return None;
        }
        let count = u64::from_le_bytes(take(&mut rest)?);
        let mut values = [0.0; 6];
        for value in &mut values {
            *value = f64::from_le_bytes(take(&mut rest)?);
        }
        let [mean, m2, m3, m4, min, max] = values;
        let not_finite = u64::from_le_bytes(take(&mut rest)?);
        let length = usize::try_from(u64::from_le_bytes(take(&mut rest)?)).ok().filter(|length| *length <= 1 << 16)?;
        let seed = if take::<1>(&mut rest)? == [1] {
            if length == 0 { Vec::new() } else { vec![f64::from_le_bytes(take(&mut rest)?); length] }
        } else {
            (0..length).map(|_| Some(f64::from_le_bytes(take(&mut rest)?))).collect::<Option<Vec<f64>>>()?
        };
        let bins = if take::<1>(&mut rest)? == [1] {
            let first = i64::from_le_bytes(take(&mut rest)?);
            let exponent = i32::from_le_bytes(take(&mut rest)?);
            let bins = usize::try_from(u64::from_le_bytes(take(&mut rest)?)).ok().filter(|bins| *bins <= BINS)?;
            let counts = (0..bins).map(|_| Some(u64::from_le_bytes(take(&mut rest)?))).collect::<Option<Vec<u64>>>()?;
            Some(Bins { first, exponent, counts })
        } else {
            None
        };
        let moments = Moments { count, mean, m2, m3, m4 };
        rest.is_empty().then_some(Self { moments, min, max, not_finite, seed, bins })
    }
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (bytes, tail) = rest.split_first_chunk::<N>()?;
    *rest = tail;
    Some(*bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fold_cut_anywhere_goes_on_to_the_same_bits() {
        let wandering = |index: usize| (index as f64 * 0.37).sin() * (index as f64) - 9.8;
        let late = |index: usize| if index < 200 { 0.0 } else { index as f64 };
        let constant = |_: usize| -0.0;
        let series: [&dyn Fn(usize) -> f64; 3] = [&wandering, &late, &constant];
        for value in series {
            let samples: Vec<f64> = (0..500).map(|index| if index == 77 { f64::NAN } else { value(index) }).collect();
            let mut whole = Accumulator::new();
            whole.push(&samples);
            for cut in 0..=samples.len() {
                let mut first = Accumulator::new();
                first.push(&samples[..cut]);
                let mut second = Accumulator::from_bytes(&first.to_bytes()).unwrap();
                second.push(&samples[cut..]);
                assert_eq!(second.to_bytes(), whole.to_bytes(), "cut at {cut}");
                assert_eq!(second.statistics("x"), whole.statistics("x"), "cut at {cut}");
            }
        }
    }

    #[test]
    fn a_constant_takes_little_room_and_damage_is_seen() {
        let mut constant = Accumulator::new();
        constant.push(&vec![1.5; 100_000]);
        let bytes = constant.to_bytes();
        assert!(bytes.len() < 100, "{}", bytes.len());
        for length in 0..bytes.len() {
            assert!(Accumulator::from_bytes(&bytes[..length]).is_none(), "{length}");
        }
        assert!(Accumulator::from_bytes(&[&bytes[..], &[0]].concat()).is_none());
    }
}
