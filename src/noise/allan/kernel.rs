//! The inner loop: the exact sum of `(x − 2y + z)²` over three windows of integer phases.
//!
//! Products of 64-bit integers do not vectorise on baseline x86-64, products of 32-bit halves do. Each width below adds a
//! bias so that differences are non-negative, multiplies halves of 32 bits or fewer, checks afterwards that every
//! difference fitted, and leaves to the next width what did not. All widths give the same sum; `benches/allan.rs` times them.

/// Terms per call: the widths' 64-bit accumulators are sized for it.
pub(super) const BLOCK: usize = 8192;

/// How many bits the differences of a block need, as far as is known; the next block of the same factor begins with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(super) enum Width {
    #[default]
    Bits24,
    Bits31,
    Bits47,
    Bits63,
}

impl Width {
    /// The next smaller width: signals calm down again after a knock.
    pub(super) fn narrower(self) -> Self {
        match self {
            Self::Bits24 | Self::Bits31 => Self::Bits24,
            Self::Bits47 => Self::Bits31,
            Self::Bits63 => Self::Bits47,
        }
    }
}

/// The exact sum of squares of `newest − 2·middle + oldest` over at most [`BLOCK`] terms, and the width that it took.
///
/// Phases may have wrapped; the differences must be below 2^63. A sum beyond 2^128 saturates.
pub(super) fn sum_of_squares(newest: &[i64], middle: &[i64], oldest: &[i64], start: Width) -> (u128, Width) {
    debug_assert!(newest.len() <= BLOCK && newest.len() == middle.len() && newest.len() == oldest.len());
    if start <= Width::Bits24
        && let Some(sum) = bits24(newest, middle, oldest)
    {
        return (sum, Width::Bits24);
    }
    if start <= Width::Bits31
        && let Some(sum) = bits31(newest, middle, oldest)
    {
        return (sum, Width::Bits31);
    }
    if start <= Width::Bits47
        && let Some(sum) = bits47(newest, middle, oldest)
    {
        return (sum, Width::Bits47);
    }
    (bits63(newest, middle, oldest), Width::Bits63)
}

#[inline(always)]
fn difference(newest: i64, middle: i64, oldest: i64) -> i64 {
    newest.wrapping_sub(middle).wrapping_sub(middle.wrapping_sub(oldest))
}

/// Σd² from the sums over u = d + bias: Σu² − 2·bias·Σu + n·bias².
fn unbias(squares: u128, biased: u64, terms: usize, bias: u32) -> u128 {
    (squares + ((terms as u128) << (2 * bias))) - (u128::from(biased) << (bias + 1))
}

fn bits24(newest: &[i64], middle: &[i64], oldest: &[i64]) -> Option<u128> {
    const BIAS: u32 = 24;
    let (mut squares, mut biased, mut seen) = (0u64, 0u64, 0u64);
    for ((x, y), z) in newest.iter().zip(middle).zip(oldest) {
        let u = difference(*x, *y, *z).wrapping_add(1 << BIAS) as u64;
        seen |= u;
        biased = biased.wrapping_add(u);
        let low = u & 0xffff_ffff;
        squares = squares.wrapping_add(low * low);
    }
    (seen >> (BIAS + 1) == 0).then(|| unbias(squares.into(), biased, newest.len(), BIAS))
}

fn bits31(newest: &[i64], middle: &[i64], oldest: &[i64]) -> Option<u128> {
    const BIAS: u32 = 31;
    let (mut high, mut low, mut biased, mut seen) = (0u64, 0u64, 0u64, 0u64);
    for ((x, y), z) in newest.iter().zip(middle).zip(oldest) {
        let u = difference(*x, *y, *z).wrapping_add(1 << BIAS) as u64;
        seen |= u;
        biased = biased.wrapping_add(u);
        let half = u & 0xffff_ffff;
        let square = half * half;
        high = high.wrapping_add(square >> 32);
        low = low.wrapping_add(square & 0xffff_ffff);
    }
    (seen >> (BIAS + 1) == 0).then(|| unbias((u128::from(high) << 32) + u128::from(low), biased, newest.len(), BIAS))
}

fn bits47(newest: &[i64], middle: &[i64], oldest: &[i64]) -> Option<u128> {
    const BIAS: u32 = 47;
    let (mut hh, mut hl, mut ll, mut biased, mut seen) = (0u64, 0u64, 0u64, 0u64, 0u64);
    for ((x, y), z) in newest.iter().zip(middle).zip(oldest) {
        let u = difference(*x, *y, *z).wrapping_add(1 << BIAS) as u64;
        seen |= u;
        biased = biased.wrapping_add(u);
        let (high, low) = ((u >> 24) & 0xffff_ffff, u & 0xff_ffff);
        hh = hh.wrapping_add(high * high);
        hl = hl.wrapping_add(high * low);
        ll = ll.wrapping_add(low * low);
    }
    (seen >> (BIAS + 1) == 0).then(|| {
        let squares = (u128::from(hh) << 48) + (u128::from(hl) << 25) + u128::from(ll);
        unbias(squares, biased, newest.len(), BIAS)
    })
}

fn bits63(newest: &[i64], middle: &[i64], oldest: &[i64]) -> u128 {
    newest.iter().zip(middle).zip(oldest).fold(0u128, |sum, ((x, y), z)| {
        let magnitude = u128::from(difference(*x, *y, *z).unsigned_abs());
        sum.saturating_add(magnitude * magnitude)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_width_gives_the_same_sum(
            bits in 1u32..62,
            raw in proptest::collection::vec(any::<(i64, i64, i64)>(), 0..200),
        ) {
            let shift = 64 - bits;
            let x: Vec<i64> = raw.iter().map(|d| d.0 >> shift).collect();
            let (y, z): (Vec<i64>, Vec<i64>) = raw.iter().map(|d| ((d.1 >> shift) / 4, (d.2 >> shift) / 4)).unzip();
            let expected = bits63(&x, &y, &z);
            for start in [Width::Bits24, Width::Bits31, Width::Bits47, Width::Bits63] {
                prop_assert_eq!(sum_of_squares(&x, &y, &z, start).0, expected);
            }
        }
    }

    #[test]
    fn a_full_block_at_each_widths_limit_is_exact() {
        let zero = vec![0i64; BLOCK];
        for (value, width) in [
            ((1i64 << 24) - 1, Width::Bits24),
            (-(1 << 24), Width::Bits24),
            (1 << 24, Width::Bits31),
            ((1 << 31) - 1, Width::Bits31),
            (-(1 << 31), Width::Bits31),
            (1 << 31, Width::Bits47),
            ((1 << 47) - 1, Width::Bits47),
            (-(1 << 47), Width::Bits47),
            (1 << 47, Width::Bits63),
        ] {
            let x = vec![value; BLOCK];
            let expected = (i128::from(value) * i128::from(value)) as u128 * BLOCK as u128;
            assert_eq!(sum_of_squares(&x, &zero, &zero, Width::Bits24), (expected, width), "{value}");
        }
    }
}
