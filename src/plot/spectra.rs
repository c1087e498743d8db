//! Spectra of one channel: the recording's, and the model's before and after.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::json::{numbers, numbers_or_none};
use serde::Deserialize;

/// Amplitude densities of one channel.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Spectra {
    channel: String,
    unit: String,
    #[serde(deserialize_with = "numbers")]
    pub(super) frequency_hz: Vec<f64>,
    /// Coefficients in each bin; results of earlier versions lack them.
    #[serde(default)]
    pub(super) coefficients: Vec<f64>,
    #[serde(deserialize_with = "numbers")]
    pub(super) real: Vec<f64>,
    #[serde(default, deserialize_with = "numbers_or_none")]
    pub(super) before: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "numbers_or_none")]
    pub(super) after: Option<Vec<f64>>,
    /// The record's power over the models', before and after; results of earlier versions lack it.
    #[serde(default)]
    pub(super) ratios: [Option<Vec<Option<f64>>>; 2],
    /// Which of the models' powers come from a simulation, and are as much subject to chance as the record's.
    #[serde(default)]
    pub(super) simulated: [bool; 2],
    /// By how much the variance of a power exceeds that of normal stationary noise.
    #[serde(default = "usual")]
    pub(super) scatter: f64,
}

fn usual() -> f64 {
    1.0
}

impl Spectra {
    /// The record's power over the model's in each bin, before (0) or after (1).
    pub(super) fn over_model(&self, which: usize) -> Option<Vec<f64>> {
        let model = [&self.before, &self.after][which].as_ref()?;
        Some(match &self.ratios[which] {
            Some(ratios) => ratios.iter().map(|ratio| ratio.unwrap_or(f64::NAN)).collect(),
            None => self.real.iter().zip(model).map(|(real, model)| (real / model).powi(2)).collect(),
        })
    }

    /// The channel.
    pub fn channel(&self) -> &str {
        &self.channel
    }

    /// The pictures: densities and, if the model is known, their ratio to its own, which shows what is small beside
    /// drifts. Bands in Hz are marked behind the curves. Empty if nothing is above 0.
    pub fn svg(&self, bands: &[[f64; 2]]) -> String {
        let all = [("real", Some(&self.real)), ("before", self.before.as_ref()), ("after", self.after.as_ref())];
        let curves: Vec<(&str, Vec<f64>)> =
            all.iter().filter_map(|(class, values)| Some((*class, (*values)?.clone()))).collect();
        let y = format!("density in {}/√Hz", self.unit);
        let mut out = self.drawn(&format!("Spectra of {}", self.channel), &y, 320.0, &curves, bands);
        if let Some(before) = &self.before {
            let over = |values: &[f64]| -> Vec<f64> {
                values.iter().zip(before).map(|(value, own)| if *own > 0.0 { value / own } else { 0.0 }).collect()
            };
            let ratios: Vec<(&str, Vec<f64>)> = curves.iter().map(|(class, values)| (*class, over(values))).collect();
            let title = format!("Spectra of {} over the model's", self.channel);
            out += &self.drawn(&title, "times the model", 260.0, &ratios, bands);
        }
        out
    }

    fn drawn(&self, title: &str, y: &str, height: f64, curves: &[(&str, Vec<f64>)], bands: &[[f64; 2]]) -> String {
        let frame = Frame { title, x: "frequency in Hz", y, height };
        let across = Axis::logarithmic(self.frequency_hz.iter().copied());
        let up = Axis::logarithmic(curves.iter().flat_map(|(_, values)| values).copied());
        let (Some(across), Some(up)) = (across, up) else { return String::new() };
        let mut drawing = Drawing::new(frame, across, up);
        bands.iter().for_each(|band| drawing.stretch("mark", *band, None));
        for (class, values) in curves {
            drawing.curve(class, self.frequency_hz.iter().copied().zip(values.iter().copied()));
        }
        drawing.done()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_curve_that_is_there_is_drawn_inside_the_picture() {
        let of = Spectra {
            channel: "<z>".to_owned(),
            unit: "m/s²".to_owned(),
            frequency_hz: vec![0.01, 1.0, 20.0],
            coefficients: vec![],
            real: vec![1.0, 2e-3, 0.0],
            before: None,
            after: Some(vec![1.1, 2e-3, 2e-3]),
            ratios: [None, None],
            simulated: [false; 2],
            scatter: usual(),
        };
        let svg = of.svg(&[[11.0, 12.0]]);
        assert_eq!(svg.matches("<path class=\"line").count(), 2);
        assert!(svg.contains("class=\"mark\"") && svg.contains("m/s²/√Hz") && !svg.contains("<z>"), "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        let known = Spectra { before: Some(vec![1.0, 2e-3, 1e-3]), ..of };
        let svg = known.svg(&[]);
        assert_eq!((svg.matches("<path class=\"line").count(), svg.matches("<svg").count()), (6, 2));
        assert!(svg.contains("times the model") && !svg.contains("NaN"), "{svg}");
        assert_eq!(Spectra { frequency_hz: vec![], real: vec![], after: None, ..known }.svg(&[]), "");
    }
}
