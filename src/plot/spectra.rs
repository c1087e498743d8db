//! Spectra of one channel: the recording's, and the model's before and after.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use imu_diagnosis::ChannelSpectra;

/// Returns the pictures: densities and, if the model is known, their ratio to its own, which shows differences that are
/// small beside drifts. Bands in Hz are marked behind the curves. Empty if nothing is above 0.
pub fn spectra(of: &ChannelSpectra, bands: &[[f64; 2]]) -> String {
    let all = [("real", Some(&of.real)), ("before", of.before.as_ref()), ("after", of.after.as_ref())];
    let curves: Vec<(&str, Vec<f64>)> =
        all.iter().filter_map(|(class, values)| Some((*class, (*values)?.clone()))).collect();
    let y = format!("density in {}/√Hz", of.unit);
    let mut out = drawn(of, &format!("Spectra of {}", of.channel), &y, 320.0, &curves, bands);
    if let Some(before) = &of.before {
        let over = |values: &[f64]| -> Vec<f64> {
            values.iter().zip(before).map(|(value, own)| if *own > 0.0 { value / own } else { 0.0 }).collect()
        };
        let ratios: Vec<(&str, Vec<f64>)> = curves.iter().map(|(class, values)| (*class, over(values))).collect();
        let title = format!("Spectra of {} over the model's", of.channel);
        out += &drawn(of, &title, "times the model", 260.0, &ratios, bands);
    }
    out
}

fn drawn(
    of: &ChannelSpectra,
    title: &str,
    y: &str,
    height: f64,
    curves: &[(&str, Vec<f64>)],
    bands: &[[f64; 2]],
) -> String {
    let frame = Frame { title, x: "frequency in Hz", y, height };
    let across = Axis::logarithmic(of.frequency_hz.iter().copied());
    let up = Axis::logarithmic(curves.iter().flat_map(|(_, values)| values).copied());
    let (Some(across), Some(up)) = (across, up) else { return String::new() };
    let mut drawing = Drawing::new(frame, across, up);
    bands.iter().for_each(|band| drawing.stretch("mark", *band, None));
    for (class, values) in curves {
        drawing.curve(class, of.frequency_hz.iter().copied().zip(values.iter().copied()));
    }
    drawing.done()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_curve_that_is_there_is_drawn_inside_the_picture() {
        let of = ChannelSpectra {
            channel: "<z>".into(),
            unit: "m/s²".into(),
            frequency_hz: vec![0.01, 1.0, 20.0],
            coefficients: vec![],
            real: vec![1.0, 2e-3, 0.0],
            before: None,
            after: Some(vec![1.1, 2e-3, 2e-3]),
            ratios: [None, None],
            simulated: [false; 2],
            scatter: 1.0,
        };
        let svg = spectra(&of, &[[11.0, 12.0]]);
        assert_eq!(svg.matches("<path class=\"line").count(), 2);
        assert!(svg.contains("class=\"mark\"") && svg.contains("m/s²/√Hz") && !svg.contains("<z>"), "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        let known = ChannelSpectra { before: Some(vec![1.0, 2e-3, 1e-3]), ..of };
        let svg = spectra(&known, &[]);
        assert_eq!((svg.matches("<path class=\"line").count(), svg.matches("<svg").count()), (6, 2));
        assert!(svg.contains("times the model") && !svg.contains("NaN"), "{svg}");
        assert_eq!(spectra(&ChannelSpectra { frequency_hz: vec![], real: vec![], after: None, ..known }, &[]), "");
    }
}
