//! The inner loop: the exact sum of `(x − 2y + z)²` over three windows of integer phases.
//!
//! If the processor has a fused multiply-add, differences become doubles (exact below 2^51), and two fused operations
//! split each square into a multiple of 2^45 and an exact rest. Sums of both stay exact, and the sum itself shows
//! afterwards whether every difference fitted. The cost does not depend on the size of the differences, so that binary
//! floats cost as much as ASCII decimals. Blocks that do not fit, and other processors, use [`integers`]. All ways give
//! the same sum; `benches/allan.rs` times them.

use super::block::{BLOCK, ORIGIN};
use super::integers::{self, Width};
use fearless_simd::Level;

/// Sums of coarse parts begin at 2^97, where doubles are multiples of [`COARSE`], and end below twice that.
const COARSE_ORIGIN: f64 = (1u128 << 97) as f64;
/// The coarse unit is 2^45.
const COARSE_BITS: u32 = 45;
const COARSE: f64 = (1u64 << COARSE_BITS) as f64;
/// Maximum number of terms per lane: this many rests of up to 2^44 stay below 2^53.
const MOST_PER_LANE: usize = 512;

/// Returns the exact sum of squares of `newest − 2·middle + oldest` over at most [`BLOCK`] terms; `newest` holds the
/// phases plus [`BIAS`](super::block::BIAS). Phases may have wrapped; the differences must be below 2^63. A sum beyond
/// 2^128 saturates.
///
/// `width` is the width that the differences of this factor needed last time, if the form depends on it.
pub(super) fn sum_of_squares(newest: &[i64], middle: &[i64], oldest: &[i64], width: &mut Width) -> u128 {
    debug_assert!(newest.len() <= BLOCK && newest.len() == middle.len() && newest.len() == oldest.len());
    match dispatched(newest, middle, oldest) {
        Some(fused) => fused.unwrap_or_else(|| integers::one_by_one(newest, middle, oldest)),
        None => integers::sum_of_squares(newest, middle, oldest, width),
    }
}

/// Returns the fused form by the widest instructions available; `None` if there is no fused multiply-add.
#[cfg(any(target_arch = "x86_64", target_arch = "x86"))]
fn dispatched(newest: &[i64], middle: &[i64], oldest: &[i64]) -> Option<Option<u128>> {
    use fearless_simd::Simd as _;
    // Detected once and cached by the crate.
    let level = Level::new();
    if let Some(avx512) = level.as_avx512() {
        return Some(avx512.vectorize(
            #[inline(always)]
            || fused::<32>(newest, middle, oldest),
        ));
    }
    let avx2 = level.as_avx2()?;
    Some(avx2.vectorize(
        #[inline(always)]
        || fused::<16>(newest, middle, oldest),
    ))
}

/// Uses the vector instructions, which every 64-bit ARM processor has.
#[cfg(target_arch = "aarch64")]
fn dispatched(newest: &[i64], middle: &[i64], oldest: &[i64]) -> Option<Option<u128>> {
    Some(fused::<16>(newest, middle, oldest))
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "x86", target_arch = "aarch64")))]
fn dispatched(_: &[i64], _: &[i64], _: &[i64]) -> Option<Option<u128>> {
    None
}

/// Adds a term to one lane's coarse sum and sum of rests.
///
/// Let c be the coarse sum, a double in [2^97, 2^98) and thus a multiple of 2^45. The fused d² + c rounds once, to such
/// a multiple again, so that the step c' − c is exact and within 2^44 of d². Then d² less the step is an integer below
/// 2^53, which the second fused operation gives exactly. All of this holds when the last c' is below 2^98: c never
/// falls.
///
/// A difference beyond ±2^51 changes the exponent of the double that its bits are read as. That double's distance from
/// the origin is still at least 2^51 (or it is NaN), because doubles are ordered as their bits: its square takes c'
/// beyond 2^98.
#[inline(always)]
fn add((newest, middle, oldest): (i64, i64, i64), (coarse, rest): (f64, f64)) -> (f64, f64) {
    let bits = newest.wrapping_sub(middle).wrapping_sub(middle.wrapping_sub(oldest));
    let difference = f64::from_bits(bits as u64) - ORIGIN;
    let next = difference.mul_add(difference, coarse);
    (next, rest + difference.mul_add(difference, -(next - coarse)))
}

/// Returns each lane's sums over whole rows. This is a separate function so that the sums stay in registers: the code
/// after it indexes lanes by a variable.
#[inline(always)]
fn rows<const LANES: usize>(
    newest: &[[i64; LANES]],
    middle: &[[i64; LANES]],
    oldest: &[[i64; LANES]],
) -> ([f64; LANES], [f64; LANES]) {
    let (mut coarse, mut rest) = ([COARSE_ORIGIN; LANES], [0.0; LANES]);
    for ((x, y), z) in newest.iter().zip(middle).zip(oldest) {
        for lane in 0..LANES {
            (coarse[lane], rest[lane]) = add((x[lane], y[lane], z[lane]), (coarse[lane], rest[lane]));
        }
    }
    (coarse, rest)
}

/// Returns the sum by fused multiply-adds; `None` if a difference or a sum does not fit.
#[inline(always)]
fn fused<const LANES: usize>(newest: &[i64], middle: &[i64], oldest: &[i64]) -> Option<u128> {
    const { assert!(BLOCK <= MOST_PER_LANE * LANES) };
    let ((x, last_x), (y, last_y), (z, last_z)) =
        (newest.as_chunks::<LANES>(), middle.as_chunks::<LANES>(), oldest.as_chunks::<LANES>());
    let (mut coarse, mut rest) = rows(x, y, z);
    for (lane, ((x, y), z)) in last_x.iter().zip(last_y).zip(last_z).enumerate() {
        (coarse[lane], rest[lane]) = add((*x, *y, *z), (coarse[lane], rest[lane]));
    }
    // NaN does not fit, by the form of the comparison.
    if !coarse.iter().all(|sum| *sum < 2.0 * COARSE_ORIGIN) {
        return None;
    }
    let coarse: u64 = coarse.iter().map(|sum| ((sum - COARSE_ORIGIN) / COARSE) as u64).sum();
    let rest: i64 = rest.iter().map(|sum| *sum as i64).sum();
    Some((u128::from(coarse) << COARSE_BITS).wrapping_add_signed(rest.into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allan::block::BIAS;
    use proptest::prelude::*;

    fn biased(newest: &[i64]) -> Vec<i64> {
        newest.iter().map(|phase| phase.wrapping_add(BIAS)).collect()
    }

    proptest! {
        #[test]
        fn every_way_gives_the_same_sum(
            bits in 1u32..62,
            raw in proptest::collection::vec(any::<(i64, i64, i64)>(), 0..200),
        ) {
            let shift = 64 - bits;
            let x: Vec<i64> = raw.iter().map(|d| d.0 >> shift).collect();
            let (y, z): (Vec<i64>, Vec<i64>) = raw.iter().map(|d| ((d.1 >> shift) / 4, (d.2 >> shift) / 4)).unzip();
            let by_definition = raw.iter().enumerate().fold(0u128, |sum, (i, _)| {
                let d = i128::from(x[i]) - 2 * i128::from(y[i]) + i128::from(z[i]);
                sum.saturating_add((d * d) as u128)
            });
            let x = biased(&x);
            prop_assert_eq!(integers::one_by_one(&x, &y, &z), by_definition);
            prop_assert_eq!(sum_of_squares(&x, &y, &z, &mut Width::default()), by_definition);
            for sum in [fused::<16>(&x, &y, &z), fused::<32>(&x, &y, &z)] {
                // Below 2^41 even the sum over all lanes' terms fits.
                prop_assert!(sum.is_none_or(|sum| sum == by_definition) && (sum.is_some() || bits > 41));
            }
            for mut width in [Width::Bits31, Width::Bits47, Width::Bits63] {
                prop_assert_eq!(integers::sum_of_squares(&x, &y, &z, &mut width), by_definition);
            }
        }

        /// The rests of a lane add up to the largest possible value, and the sum is exact or refused for any size.
        #[test]
        fn a_full_block_is_exact_or_refused(value in any::<i64>(), shift in 7u32..60) {
            let value = value >> shift;
            let zero = vec![0i64; BLOCK];
            let x = vec![value.wrapping_add(BIAS); BLOCK];
            let expected = (i128::from(value) * i128::from(value)) as u128 * BLOCK as u128;
            for sum in [fused::<16>(&x, &zero, &zero), fused::<32>(&x, &zero, &zero)] {
                prop_assert!(sum.is_none_or(|sum| sum == expected));
                prop_assert_eq!(sum.is_some() || value.unsigned_abs() >= 1 << 43, true);
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_seen_wherever_its_bits_land() {
        let zero = vec![0i64; 100];
        // Infinities, NaN and numbers of the other sign, as which biased bits would read.
        let bits = [f64::INFINITY, f64::NEG_INFINITY, f64::NAN, -f64::NAN, -0.0, 0.0, 1.0, -1.0, f64::MIN_POSITIVE];
        let edges = [1i64 << 51, -(1 << 51) - 1, 1 << 62, -(1 << 62), i64::MAX, i64::MIN + 1, 1 << 52, 3 << 51];
        for value in bits.map(|of| (of.to_bits() as i64).wrapping_sub(BIAS)).into_iter().chain(edges) {
            let mut x = vec![BIAS + 12_345; 100];
            x[37] = value.wrapping_add(BIAS);
            assert_eq!(fused::<16>(&x, &zero, &zero), None, "{value}");
            let expected = 99 * 12_345 * 12_345 + u128::from(value.unsigned_abs()).pow(2);
            assert_eq!(sum_of_squares(&x, &zero, &zero, &mut Width::default()), expected, "{value}");
        }
    }
}
