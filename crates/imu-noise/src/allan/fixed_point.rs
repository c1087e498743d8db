//! Fixed point: a channel's values as integers, so that sums are exact and do not depend on the order of their terms.

use super::AllanError;
use imu_core::sample::Channel;

/// Adding 1.5·2^52 to a double below 2^51 leaves its nearest integer (ties to even) in the low bits of its mantissa.
const ROUNDING: f64 = 6_755_399_441_055_744.0;

/// The conversion of values to integers: `round(value · 10^decimals · 2^binary)`.
///
/// The decimal factor makes the decimals of ASCII output exact integers. The binary factor gives the floats of binary
/// output as much resolution as the range allows. Sums of both kinds then have the same scale and can be added.
///
/// # Validation
/// A quantised value is below [`FixedPoint::MAGNITUDE_BITS`] bits, so that a second difference at
/// [`TauGrid::FULL_OVERLAP`](super::TauGrid::FULL_OVERLAP) stays below 2^63 (`the_worst_input_does_not_overflow`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FixedPoint {
    pub(super) decimals: u8,
    pub(super) binary: u8,
}

impl FixedPoint {
    /// Bits of a quantised value without its sign: |d| ≤ 2 · m · 2^42 < 2^63 for every m ≤ 2^20.
    pub const MAGNITUDE_BITS: u32 = 42;

    /// Returns the scale of a channel: its ASCII decimals are exact, and its range leaves the other bits.
    ///
    /// Steps: gyroscope 3.1e-11 rad/s within ±134 rad/s, accelerometer 1.2e-10 m/s² within ±524 m/s², magnetometer
    /// 1.2e-11 gauss within ±52 gauss.
    pub fn for_channel(channel: Channel) -> Self {
        let decimals = u32::try_from(channel.ascii_decimals()).unwrap_or(0);
        let range_exponent = i32::try_from(channel.range_exponent()).unwrap_or(0);
        Self { decimals: decimals as u8, binary: Self::spare_bits(decimals, range_exponent).clamp(0, 60) as u8 }
    }

    /// Returns the finest scale in which `decimals` decimals are exact and values up to `2^range_exponent` fit.
    ///
    /// # Errors
    /// [`AllanError::ScaleTooFine`] if decimals and range alone need more bits than available.
    pub fn for_range(decimals: u32, range_exponent: i32) -> Result<Self, AllanError> {
        let spare = Self::spare_bits(decimals, range_exponent);
        if decimals > 12 || !(0..=60).contains(&spare) {
            return Err(AllanError::ScaleTooFine { range_exponent, decimals, binary: 0, bits: Self::MAGNITUDE_BITS });
        }
        Ok(Self { decimals: decimals as u8, binary: spare as u8 })
    }

    /// Returns the scale with steps of exactly `10^-decimals`: the fastest scale for data with no more digits.
    ///
    /// # Errors
    /// [`AllanError::ScaleTooFine`] beyond 12 decimals.
    pub fn decimal(decimals: u32) -> Result<Self, AllanError> {
        if decimals > 12 {
            return Err(AllanError::ScaleTooFine {
                range_exponent: 0,
                decimals,
                binary: 0,
                bits: Self::MAGNITUDE_BITS,
            });
        }
        Ok(Self { decimals: decimals as u8, binary: 0 })
    }

    fn spare_bits(decimals: u32, range_exponent: i32) -> i32 {
        let decimal_bits = f64::from(decimals) * std::f64::consts::LOG2_10;
        (f64::from(Self::MAGNITUDE_BITS) - f64::from(range_exponent) - decimal_bits).floor() as i32
    }

    /// Returns the integer steps per unit of the channel.
    pub fn steps_per_unit(self) -> f64 {
        10f64.powi(i32::from(self.decimals)) * 2f64.powi(i32::from(self.binary))
    }

    /// Returns the largest value that can be represented, in the channel's unit.
    pub fn range(self) -> f64 {
        Self::largest_steps() / self.steps_per_unit()
    }

    pub(super) fn largest_steps() -> f64 {
        ((1u64 << Self::MAGNITUDE_BITS) - 1) as f64
    }

    /// Returns the value as an integer; `None` if it is not finite or out of range.
    pub fn quantise(self, value: f64) -> Option<i64> {
        Self::steps(value * self.steps_per_unit())
    }

    /// Rounds a value already multiplied by [`FixedPoint::steps_per_unit`].
    #[inline]
    pub(super) fn steps(scaled: f64) -> Option<i64> {
        // Written so that NaN is refused.
        (scaled.abs() <= Self::largest_steps())
            .then(|| ((scaled + ROUNDING).to_bits() as i64).wrapping_sub(ROUNDING.to_bits() as i64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allan::TauGrid;

    #[test]
    fn decimals_become_exact_multiples_of_one_step() {
        for channel in Channel::ANALYSED {
            let scale = FixedPoint::for_channel(channel);
            let digits = 10i64.pow(u32::from(scale.decimals));
            for numerator in [-7_123_457i64, -1, 0, 1, 3, 999, 31_337] {
                let text = format!("{}e-{}", numerator, scale.decimals);
                let value: f64 = text.parse().unwrap();
                if value.abs() < scale.range() {
                    assert_eq!(scale.quantise(value), Some(numerator << scale.binary), "{channel} {text}");
                }
            }
            assert_eq!(scale.quantise(1.0), Some(digits << scale.binary));
        }
    }

    #[test]
    fn every_value_of_a_channels_range_fits() {
        for channel in Channel::ANALYSED {
            let scale = FixedPoint::for_channel(channel);
            let range = 2f64.powi(channel.range_exponent() as i32);
            assert!(scale.range() >= range * 0.999_999, "{channel}: {} < {range}", scale.range());
            assert!(scale.steps_per_unit() > 2f64.powi(32), "{channel} is too coarse");
        }
    }

    #[test]
    fn what_is_not_a_number_or_out_of_range_has_no_integer() {
        let scale = FixedPoint::for_channel(Channel::GyroX);
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e9, -30_945.0] {
            assert_eq!(scale.quantise(value), None, "{value}");
        }
        assert!(scale.quantise(-34.9).is_some());
    }

    #[test]
    fn the_worst_input_does_not_overflow() {
        let largest = FixedPoint::largest_steps() as i128;
        assert!(2 * TauGrid::FULL_OVERLAP as i128 * largest < 1 << 63);
        assert_eq!(FixedPoint::steps(FixedPoint::largest_steps()), Some(largest as i64));
        assert_eq!(FixedPoint::steps(-FixedPoint::largest_steps()), Some(-largest as i64));
    }

    #[test]
    fn a_scale_beyond_the_bits_is_refused() {
        assert!(matches!(FixedPoint::for_range(12, 9), Err(AllanError::ScaleTooFine { .. })));
        assert!(FixedPoint::for_range(6, 7).is_ok());
        assert!(FixedPoint::decimal(13).is_err());
    }
}
