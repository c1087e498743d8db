//! Frames: which axis of the body each axis of the sensor is, with its sign, and the unit of the values.

use nalgebra::Matrix3;
use serde::Serialize;

/// An axis of the sensor is an axis of the body if it is turned away from it by less than this, °.
const ALONG_DEG: f64 = 30.0;
/// A ratio is a unit's if it is this close to it.
const UNIT_TOLERANCE: f64 = 0.2;

/// An axis of the body with a sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct SignedAxis {
    /// 0, 1 or 2 for x, y or z.
    pub axis: usize,
    /// Whether the sensor's axis points the other way.
    pub negative: bool,
}

/// The unit that a ratio shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// That of the reference.
    Same,
    /// Degrees for radians.
    Degrees,
    /// Radians where degrees are stated.
    Radians,
    /// Standard gravities for m/s².
    Gravities,
    /// m/s² where standard gravities are stated.
    MetresPerSecondSquared,
    /// Thousandths of a standard gravity for m/s².
    Milligravities,
    /// None that is known: a ratio.
    Unknown,
}

/// Axes, signs and unit of a triad.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Frames {
    /// The body's axis that each axis of the sensor is.
    pub axes: [SignedAxis; 3],
    /// Whether the sensor's axes are left-handed if the reference's are right-handed.
    pub mirrored: bool,
    /// Whether the sensor's axes are those of the body to within 30°, after the exchange of axes.
    pub aligned: bool,
    /// The unit.
    pub unit: Unit,
    /// The sensor's values are this many times the reference's.
    pub factor: f64,
    /// The rotation or reflection to which the rest is small, by rows.
    rotation: [[f64; 3]; 3],
}

impl Frames {
    /// Returns whether the sensor's axes are the body's with their signs, in the same unit.
    pub fn is_plain(&self) -> bool {
        self.aligned
            && self.unit == Unit::Same
            && self.axes.iter().enumerate().all(|(at, of)| of.axis == at && !of.negative)
    }

    /// Returns the matrix by which the body's axes become the sensor's, up to a small rotation.
    pub(crate) fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.rotation[row][column])
    }
}

/// Returns axes, signs and unit of a rotation or reflection and a ratio of values.
pub(crate) fn frames(rotation: &Matrix3<f64>, ratio: f64, is_gyro: bool) -> Frames {
    let exchange = nearest(rotation);
    let cosine = ((rotation * exchange.transpose()).trace() - 1.0) * 0.5;
    let aligned = cosine.clamp(-1.0, 1.0).acos().to_degrees() < ALONG_DEG;
    let axes = std::array::from_fn(|row| {
        let axis = exchange.row(row).iamax_full().1;
        SignedAxis { axis, negative: exchange[(row, axis)] < 0.0 }
    });
    let units: &[(Unit, f64)] = if is_gyro {
        &[
            (Unit::Same, 1.0),
            (Unit::Degrees, 180.0 / std::f64::consts::PI),
            (Unit::Radians, std::f64::consts::PI / 180.0),
        ]
    } else {
        &[
            (Unit::Same, 1.0),
            (Unit::Gravities, 1.0 / 9.806_65),
            (Unit::MetresPerSecondSquared, 9.806_65),
            (Unit::Milligravities, 1e3 / 9.806_65),
        ]
    };
    let close = |(_, factor): &&(Unit, f64)| (ratio / factor - 1.0).abs() < UNIT_TOLERANCE;
    let (unit, factor) = units.iter().find(close).copied().unwrap_or((Unit::Unknown, ratio));
    let kept = if aligned { exchange } else { *rotation };
    let rotation = std::array::from_fn(|row| std::array::from_fn(|column| kept[(row, column)]));
    Frames { axes, mirrored: kept.determinant() < 0.0, aligned, unit, factor, rotation }
}

const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// Returns all 48 exchanges of axes with signs.
pub(crate) fn exchanges() -> impl Iterator<Item = Matrix3<f64>> {
    ORDERS.iter().flat_map(|order| {
        (0..8_u8).map(|signs| {
            let sign = |row: usize| if signs & (1 << row) == 0 { 1.0 } else { -1.0 };
            Matrix3::from_fn(|row, column| if order[row] == column { sign(row) } else { 0.0 })
        })
    })
}

/// Returns the exchange of axes with signs that is nearest, of all 48.
pub(crate) fn nearest(rotation: &Matrix3<f64>) -> Matrix3<f64> {
    let of = |order: &[usize; 3]| {
        let order = *order;
        Matrix3::from_fn(|row, column| if order[row] == column { rotation[(row, column)].signum() } else { 0.0 })
    };
    let fits = |matrix: &Matrix3<f64>| matrix.component_mul(rotation).sum();
    ORDERS.iter().map(of).max_by(|one, other| fits(one).total_cmp(&fits(other))).unwrap_or_else(Matrix3::identity)
}
