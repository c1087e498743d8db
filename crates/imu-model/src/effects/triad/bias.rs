//! Bias of a triad's axes.

use super::{Axes, Drive, TriadEffect, diagonal, xyz};
use crate::effects::spec::{Kind, Range, number};
use crate::effects::stream::number as streams;
use crate::effects::{Spec, Stage};
use imu_core::sample::Triad;
use serde_json::Value;
use std::sync::Arc;

/// A constant per axis, beside each channel's own `bias`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bias {
    /// U.
    pub axes: Axes,
}

static SPEC: Spec = Spec {
    name: "bias",
    stream: streams::NONE,
    stage: Stage::Bias,
    parameters: &[
        number("x", Range::Any, "bias of the x axis, U"),
        number("y", Range::Any, "bias of the y axis, U"),
        number("z", Range::Any, "bias of the z axis, U"),
    ],
    forms: &[],
    meaning: "a constant per axis",
};
pub(in crate::effects) static KIND: Kind<dyn TriadEffect> =
    Kind { spec: &SPEC, make: |values| Arc::new(Bias { axes: values.axes() }) };

impl TriadEffect for Bias {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        xyz(self.axes)
    }
    fn triads(&self) -> &'static [Triad] {
        &[Triad::Attitude, Triad::Mag, Triad::Accel, Triad::Gyro]
    }
    fn deviation(&self, _drive: Drive) -> Axes {
        self.axes
    }
    fn coefficients(&self) -> Vec<f64> {
        self.axes.to_vec()
    }
    fn regress(&self, _drive: Drive) -> Vec<Axes> {
        diagonal([1.0; 3])
    }
}
