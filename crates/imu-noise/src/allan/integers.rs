//! The inner loop in integers, for processors without a fused multiply-add and for differences that do not fit one.
//!
//! Products of 64-bit integers do not vectorise on baseline x86-64, products of 32-bit halves do. Each width below adds
//! a bias so that differences are non-negative, multiplies halves of at most 32 bits, checks afterwards whether every
//! difference fitted, and otherwise leaves the block to the next width.

use super::block::{BIAS as OF_NEWEST, BLOCK};

/// The number of bits that the differences of a block need, as far as it is known; the next block of the same factor
/// begins with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(super) enum Width {
    #[default]
    Bits31,
    Bits47,
    Bits63,
}

impl Width {
    /// Returns the next smaller width, because signals become quiet again after a knock.
    pub(super) fn narrower(self) -> Self {
        match self {
            Self::Bits31 | Self::Bits47 => Self::Bits31,
            Self::Bits63 => Self::Bits47,
        }
    }
}

/// Computes [`super::kernel::sum_of_squares`], which defines the arguments. `width` is the width to begin with, and
/// afterwards the width that was needed.
pub(super) fn sum_of_squares(newest: &[i64], middle: &[i64], oldest: &[i64], width: &mut Width) -> u128 {
    if *width <= Width::Bits31
        && let Some(sum) = bits31(newest, middle, oldest)
    {
        return sum;
    }
    if *width <= Width::Bits47
        && let Some(sum) = bits47(newest, middle, oldest)
    {
        *width = Width::Bits47;
        return sum;
    }
    *width = Width::Bits63;
    one_by_one(newest, middle, oldest)
}

/// Returns Σd² from the sums over u = d + bias: Σu² − 2·bias·Σu + n·bias².
fn unbias(squares: u128, biased: u64, terms: usize, bias: u32) -> u128 {
    (squares + ((terms as u128) << (2 * bias))) - (u128::from(biased) << (bias + 1))
}

#[inline(always)]
fn difference(newest: i64, middle: i64, oldest: i64) -> i64 {
    newest.wrapping_sub(middle).wrapping_sub(middle.wrapping_sub(oldest))
}

fn bits31(newest: &[i64], middle: &[i64], oldest: &[i64]) -> Option<u128> {
    const BIAS: u32 = 31;
    let (mut high, mut low, mut biased, mut seen) = (0u64, 0u64, 0u64, 0u64);
    for ((x, y), z) in newest.iter().zip(middle).zip(oldest) {
        let u = difference(*x, *y, *z).wrapping_add((1 << BIAS) - OF_NEWEST) as u64;
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
        let u = difference(*x, *y, *z).wrapping_add((1 << BIAS) - OF_NEWEST) as u64;
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

/// Returns the sum term by term, for differences of any size.
pub(super) fn one_by_one(newest: &[i64], middle: &[i64], oldest: &[i64]) -> u128 {
    newest.iter().zip(middle).zip(oldest).fold(0u128, |sum, ((x, y), z)| {
        let magnitude = u128::from(difference(*x, *y, *z).wrapping_sub(OF_NEWEST).unsigned_abs());
        sum.saturating_add(magnitude * magnitude)
    })
}

// The 64-bit accumulators above hold this many terms.
const _: () = assert!(BLOCK <= 1 << 14);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_block_at_each_widths_limit_is_exact() {
        let zero = vec![0i64; BLOCK];
        for (value, width) in [
            ((1i64 << 31) - 1, Width::Bits31),
            (-(1 << 31), Width::Bits31),
            (1 << 31, Width::Bits47),
            ((1 << 47) - 1, Width::Bits47),
            (-(1 << 47), Width::Bits47),
            (1 << 47, Width::Bits63),
        ] {
            let x = vec![value.wrapping_add(OF_NEWEST); BLOCK];
            let expected = (i128::from(value) * i128::from(value)) as u128 * BLOCK as u128;
            let mut took = Width::default();
            assert_eq!((sum_of_squares(&x, &zero, &zero, &mut took), took), (expected, width), "{value}");
        }
    }

    #[test]
    fn a_width_is_left_again_when_the_signal_calms_down() {
        assert_eq!(Width::Bits63.narrower(), Width::Bits47);
        assert_eq!(Width::Bits47.narrower(), Width::Bits31);
        assert_eq!(Width::Bits31.narrower(), Width::Bits31);
    }
}
