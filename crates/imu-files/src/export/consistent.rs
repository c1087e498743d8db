//! Consistent filter parameters: N and K that replace the sensor's own, so that a filter's covariance is that of the real
//! errors.
//!
//! In: parameters of a sensor, a pair for each channel, the reason in words. Out: parameters for a filter's format. Where
//! the pairs come from is not known here.

use super::filter::INFLATED;
use super::{Fixed, ImuNoise, Known, Target};
use imu_core::sample::{Channel, Triad};
use std::collections::BTreeMap;

/// What a program for filters makes of noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilterKind {
    /// It takes white noise and a walk of the bias.
    WhiteAndWalk,
    /// It takes white noise, and estimates no bias.
    White,
}

impl Target {
    /// Returns what the target makes of noise; `None` if it is a simulator, which takes the sensor's own values.
    pub fn filter_kind(self) -> Option<FilterKind> {
        match self {
            Self::Kalibr
            | Self::Openvins
            | Self::VinsFusion
            | Self::OrbSlam3
            | Self::LioSam
            | Self::FastLio
            | Self::Px4
            | Self::Ardupilot => Some(FilterKind::WhiteAndWalk),
            Self::RobotLocalization | Self::Ros => Some(FilterKind::White),
            Self::Gazebo | Self::Isaac | Self::GnssInsSim | Self::Matlab => None,
        }
    }
}

impl ImuNoise {
    /// Returns N in U/√Hz and K in U/√s that a filter's file has for a channel: the values, else their limits.
    pub fn white_and_walk(&self, channel: Channel) -> [Option<f64>; 2] {
        let triads = [(Triad::Gyro, &self.gyro), (Triad::Accel, &self.accel)];
        let own = triads.into_iter().find(|(triad, _)| channel.triad() == Some(*triad));
        let place = channel.triad().and_then(|triad| triad.channels().iter().position(|other| *other == channel));
        let axis = own.and_then(|(_, axes)| axes.as_ref()?.get(place?).copied());
        axis.map_or([None; 2], |axis| [axis.n.bound(), axis.k.bound()])
    }

    /// Returns the parameters with N and K of these channels replaced, as far as they are larger than the sensor's own: a
    /// filter whose bias cannot walk does not follow one that does. An upper limit gives way to any number above 0. The
    /// other effects are in the new numbers.
    pub fn consistent(mut self, pairs: &BTreeMap<Channel, [f64; 2]>, why: String) -> Self {
        for (triad, axes) in [(Triad::Gyro, &mut self.gyro), (Triad::Accel, &mut self.accel)] {
            for (channel, axis) in triad.channels().iter().zip(axes.iter_mut().flatten()) {
                let Some([n, k]) = pairs.get(channel) else { continue };
                (axis.n, axis.k) = (axis.n.replaced(*n), axis.k.replaced(*k));
                (axis.fixed, axis.gauss_markov) = (Fixed::default(), None);
            }
        }
        self.others.clear();
        self.enlarged = Some(why);
        self
    }

    /// Returns why the numbers are smaller than published ones, or larger than the sensor's own.
    pub(super) fn note(&self) -> &str {
        self.enlarged.as_deref().unwrap_or(INFLATED)
    }
}

impl Known {
    /// Returns a consistent value in place of this one.
    fn replaced(self, by: f64) -> Self {
        match self {
            Self::Value(own) => Self::Value(own.max(by)),
            Self::Below(_) if by <= 0.0 => self,
            Self::Below(_) | Self::Nothing => Self::Value(by),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Axis;
    use super::*;

    fn noise() -> ImuNoise {
        let axis = Axis { n: Known::Value(1e-4), k: Known::Below(1e-6), ..Axis::UNKNOWN };
        ImuNoise {
            origin: "Test".to_owned(),
            caution: None,
            behind: BTreeMap::new(),
            enlarged: None,
            others: vec![("tone".to_owned(), "gyro_x".to_owned())],
            rate_hz: 40.0,
            duration_s: 60.0,
            accel: None,
            gyro: Some([axis; 3]),
            mag: None,
        }
    }

    #[test]
    fn replaced_numbers_stand_in_every_filters_file_with_their_reason() {
        assert_eq!(noise().white_and_walk(Channel::GyroY), [Some(1e-4), Some(1e-6)]);
        assert_eq!(
            (noise().white_and_walk(Channel::AccelX), noise().white_and_walk(Channel::MagX)),
            ([None; 2], [None; 2])
        );
        let pairs = [(Channel::GyroX, [4e-4, 3e-6]), (Channel::GyroY, [0.0, 0.0])].into();
        let found = noise().consistent(&pairs, "N x 4: a tone".to_owned());
        assert_eq!(found.white_and_walk(Channel::GyroX), [Some(4e-4), Some(3e-6)]);
        assert_eq!(found.white_and_walk(Channel::GyroY), [Some(1e-4), Some(1e-6)]);
        for target in Target::ALL.into_iter().filter(|target| target.filter_kind().is_some()) {
            let text = target.write(&found);
            assert!(text.contains("# N x 4: a tone") && !text.contains("Left out"), "{text}");
            assert!(!text.contains("sensor's own"), "{text}");
        }
        assert!(Target::Kalibr.write(&found).contains("gyroscope_noise_density: 4.000000e-4"));
        assert!(Target::Px4.write(&found).contains("EKF2_GYR_B_NOISE 3.000000e-5"));
    }
}
