//! Forms: the numbers of a program in its own convention. A program's file and the summary ([`super::paste`]) both use
//! them.

use super::{Axis, Known};
use imu_core::sample::Triad;
use serde::{Deserialize, Serialize};

/// The kind of noise that a number describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Noise {
    /// White noise, N.
    White,
    /// The walk of the bias, K.
    Walk,
}

impl Noise {
    /// Both kinds.
    pub const ALL: [Self; 2] = [Self::White, Self::Walk];

    /// Returns the name in words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::White => "white noise",
            Self::Walk => "random walk",
        }
    }

    /// Returns N or K.
    pub(super) const fn of(self, axis: &Axis) -> Known {
        match self {
            Self::White => axis.n,
            Self::Walk => axis.k,
        }
    }
}

/// The form in which a program takes its numbers.
pub(super) struct Form {
    /// A description of the input.
    pub takes: String,
    /// The code or document that states it.
    pub source: &'static str,
    /// Whether there is a number for each axis, as `takes` then states; otherwise the largest stands for all three.
    pub each_axis: bool,
    /// The numbers.
    pub entries: Vec<Entry>,
}

/// A number with its key, as far as it is known, for each axis.
pub(super) struct Entry {
    pub key: &'static str,
    pub triad: Triad,
    pub noise: Noise,
    /// The unit in ASCII, as in files.
    pub unit: String,
    pub axes: [Known; 3],
}

impl Entry {
    /// Returns `x, y, z` in words.
    pub fn words(&self) -> String {
        super::each(self.axes)
    }
}
