//! Saturation of a triad: the same range on each axis.

use super::TriadEffect;
use crate::effects::spec::{self, Kind, number};
use crate::effects::stream::number as streams;
use crate::effects::{Spec, Stage};
use imu_core::sample::Triad;
use serde_json::Value;
use std::sync::Arc;

/// No axis shows more than ± the range, motion and noise alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Saturation {
    /// U.
    pub range: f64,
}

static SPEC: Spec = Spec {
    name: "saturation",
    stream: streams::NONE,
    stage: Stage::Saturation,
    parameters: &[number("range", spec::Range::Above(0.0), "largest magnitude that an axis shows, U")],
    forms: &[],
    meaning: "values beyond ± the range become its ends",
};
pub(in crate::effects) static KIND: Kind<dyn TriadEffect> =
    Kind { spec: &SPEC, make: |values| Arc::new(Saturation { range: values.number("range") }) };

impl TriadEffect for Saturation {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("range", self.range.into())]
    }
    fn triads(&self) -> &'static [Triad] {
        &[Triad::Attitude, Triad::Mag, Triad::Accel, Triad::Gyro]
    }
    fn range(&self) -> Option<f64> {
        Some(self.range)
    }
}
