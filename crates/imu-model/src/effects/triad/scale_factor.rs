//! Scale factor error: an axis shows a fixed fraction too much.

use super::{Axes, Drive, TriadEffect, diagonal, xyz};
use crate::effects::spec::{Kind, Range, number};
use crate::effects::stream::number as streams;
use crate::effects::{Spec, Stage};
use serde_json::Value;
use std::sync::Arc;

/// Each axis shows (1 + s) times its input.
///
/// Source: IEEE Std 528-2019 (scale factor error).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaleFactor {
    /// s per axis, a fraction.
    pub axes: Axes,
}

static SPEC: Spec = Spec {
    name: "scale_factor",
    stream: streams::NONE,
    stage: Stage::Scale,
    parameters: &[
        number("x", Range::Any, "fraction that the x axis shows too much"),
        number("y", Range::Any, "fraction that the y axis shows too much"),
        number("z", Range::Any, "fraction that the z axis shows too much"),
    ],
    forms: &[],
    meaning: "each axis shows a fixed fraction of its input too much",
};
pub(in crate::effects) static KIND: Kind<dyn TriadEffect> =
    Kind { spec: &SPEC, make: |values| Arc::new(ScaleFactor { axes: values.axes() }) };

impl TriadEffect for ScaleFactor {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        xyz(self.axes)
    }
    fn deviation(&self, drive: Drive) -> Axes {
        std::array::from_fn(|axis| self.axes[axis] * drive.input[axis])
    }
    fn coefficients(&self) -> Vec<f64> {
        self.axes.to_vec()
    }
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        diagonal(drive.input)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_axis_shows_its_fraction_too_much() {
        let drive = Drive { input: [10.0, -10.0, 0.0], accel_m_s2: [0.0; 3] };
        let found = ScaleFactor { axes: [0.01, 0.02, 0.03] }.deviation(drive);
        assert_eq!(found, [0.1, -0.2, 0.0]);
    }
}
