//! The drawings: the heat map, the course of a motion, the time, the spectra.

use super::super::escaped;
use super::named;
use crate::plot;
use imu_diagnosis::{ChannelSpectra, Diagnosis, Drawings};
use std::fmt::Write as _;

pub(super) fn heat(out: &mut String, drawn: &Drawings) {
    let maps = plot::heat(&drawn.spectra);
    // The spectra of a record of a motion are the motion's.
    if !maps.is_empty() && drawn.residuals.is_empty() {
        // Writing to a text cannot fail.
        let _ = write!(
            out,
            "<h2>Where in frequency</h2><p class=\"soft\">Coloured is what chance does not make. Where a spectrum is not the \
             model's parameters alone, one of a simulation is taken.</p><div class=\"figures\"><figure>{}</figure></div>",
            maps.join("</figure><figure>")
        );
    }
}

pub(super) fn timelines(out: &mut String, drawn: &Drawings) {
    let of = drawn.timelines.iter().flat_map(|of| [plot::level(of), plot::spread(of)]);
    let drawn: Vec<String> = of.filter(|svg| !svg.is_empty()).collect();
    if drawn.is_empty() {
        return;
    }
    *out += "<h2>In time</h2><p class=\"soft\"><span class=\"key real\"></span>recording\
             <span class=\"key before\"></span>a simulation of the model as it is<span class=\"key after\"></span>one of the \
             corrected model, with the same noise. How noise wanders is chance, in the recording as in a simulation; what both \
             show at the same time is not.</p>";
    let _ = write!(out, "<div class=\"figures\"><figure>{}</figure></div>", drawn.join("</figure><figure>"));
}

pub(super) fn motion(out: &mut String, report: &Diagnosis, drawn: &Drawings) {
    let residuals = &drawn.residuals;
    if residuals.is_empty() {
        return;
    }
    *out += "<h2>Beyond the motion</h2><p class=\"soft\">The recording less what a simulator shows of the motion, means: \
             <span class=\"key before\"></span>the model as it is<span class=\"key after\"></span>the corrected model. Rate and \
             specific force are those of the reference.</p>";
    named_first(out, report, residuals.iter().map(|of| (&*of.channel, plot::residuals(of))));
}

pub(super) fn spectra(out: &mut String, report: &Diagnosis, drawn: &Drawings) {
    let spectra = &drawn.spectra;
    if spectra.is_empty() {
        return;
    }
    *out += "<h2>Spectra</h2><p class=\"soft\"><span class=\"key real\"></span>recording\
             <span class=\"key before\"></span>the model as it is<span class=\"key after\"></span>the corrected model. \
             White noise stands at its N. Where a spectrum is not the model's parameters alone, one of a simulation is drawn.</p>";
    let picture = |of: &ChannelSpectra| {
        // The effects of a motion have no separate band.
        let places = report.r#where.iter().filter(|place| place.channel == of.channel && place.at.is_none());
        let bands: Vec<[f64; 2]> = places.map(|place| place.band_hz).collect();
        plot::spectra(of, &bands)
    };
    named_first(out, report, spectra.iter().map(|of| (&*of.channel, picture(of))));
}

/// Writes the pictures of channels with a finding, then the others, which are shown on request.
fn named_first<'a>(out: &mut String, report: &Diagnosis, pictures: impl Iterator<Item = (&'a str, String)>) {
    let (found, others): (Vec<_>, Vec<_>) = pictures.partition(|(channel, _)| named(report, channel));
    let all = |of: &[(&str, String)]| {
        let figures: String = of.iter().map(|(_, svg)| format!("<figure>{svg}</figure>")).collect();
        format!("<div class=\"figures\">{figures}</div>")
    };
    *out += &all(&found);
    if !others.is_empty() {
        let mut names: Vec<String> = others.iter().map(|(channel, _)| escaped(channel)).collect();
        names.dedup();
        let names = names.join(", ");
        let _ = write!(out, "<details><summary>without a finding: {names}</summary>{}</details>", all(&others));
    }
}
