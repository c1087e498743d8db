//! `vn100d noise`: noise parameters.

use super::analysis::{self, Material};
use super::args::{Format, NoiseArgs};
use super::{Context, Outcome, print_json, table};
use crate::noise::allan::{FixedPoint, Overlapping, TauGrid};
use crate::noise::fit::{Estimate, NoiseReport, fit};
use crate::simulator::SensorModel;
use serde_json::Value;
use std::io::Write as _;

/// Prints the parameters.
pub(super) fn run(context: &Context, args: &NoiseArgs) -> anyhow::Result<Outcome> {
    let material = analysis::open(context, &args.capture, args.rate)?;
    material.remark();
    let report = report(&material)?;
    match (context.json, args.format) {
        (true, _) | (_, Format::Json) => print_json(&report)?,
        (_, Format::Csv) => print_csv(&report)?,
        (_, Format::Table) => print_table(&report)?,
    }
    Ok(if material.rejected { Outcome::WithLoss } else { Outcome::Done })
}

/// Fits every channel; octaves of averaging time hold all that the fit can use.
fn report(material: &Material) -> anyhow::Result<NoiseReport> {
    let grid = TauGrid::octave(material.longest())?;
    let channels = material.channels.iter().map(|(channel, segments)| {
        let mut overlapping = Overlapping::new(FixedPoint::for_channel(*channel), grid.clone());
        for segment in segments {
            overlapping.push(segment);
            overlapping.break_segment();
        }
        (*channel, fit(&overlapping.sums().points(), material.rate_hz, *channel))
    });
    Ok(NoiseReport {
        format: NoiseReport::FORMAT.to_owned(),
        capture: material.name.clone(),
        rate_hz: material.rate_hz,
        duration_s: material.duration_s(),
        samples: material.samples,
        missing: material.missing,
        complete: material.complete,
        channels: channels.collect(),
        datasheet: None,
    })
}

/// Value with its interval, or the limit below which it lies.
fn cell(estimate: &Estimate) -> String {
    match (estimate.value, estimate.ci95, estimate.upper_limit95) {
        (Some(value), Some([low, high]), _) => format!("{value:.3e} [{low:.2e}, {high:.2e}]"),
        (_, _, Some(limit)) => format!("< {limit:.2e}"),
        _ => "–".to_owned(),
    }
}

fn print_table(report: &NoiseReport) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    writeln!(
        stdout,
        "{}: {:.1} s at {} Hz, {} samples, {} missing. Values with 95 % intervals; `<`: not identified, 95 % upper limit.",
        report.capture, report.duration_s, report.rate_hz, report.samples, report.missing
    )?;
    let mut rows = table(&["channel", "unit U", "N in U/√Hz", "B in U", "K in U/√s", "fit p"]);
    for (channel, found) in &report.channels {
        rows.add_row([
            channel.name().to_owned(),
            found.unit.clone(),
            cell(&found.n),
            cell(&found.b),
            cell(&found.k),
            found.fit.p_value.map_or_else(|| "–".to_owned(), |p| format!("{p:.2}")),
        ]);
    }
    writeln!(stdout, "{rows}")?;
    for (channel, found) in &report.channels {
        for flag in &found.flags {
            writeln!(stdout, "{channel}: {} ({})", flag.note, flag.kind)?;
        }
    }
    Ok(())
}

fn print_csv(report: &NoiseReport) -> anyhow::Result<()> {
    let mut writer = csv::Writer::from_writer(std::io::stdout().lock());
    writer.write_record([
        "channel",
        "parameter",
        "unit",
        "value",
        "ci95_low",
        "ci95_high",
        "upper_limit95",
        "identified",
    ])?;
    let text = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    for (channel, found) in &report.channels {
        for (letter, estimate) in [("N", &found.n), ("B", &found.b), ("K", &found.k), ("Q", &found.q), ("R", &found.r)]
        {
            writer.write_record([
                channel.name().to_owned(),
                letter.to_owned(),
                estimate.unit.clone(),
                text(estimate.value),
                text(estimate.ci95.map(|[low, _]| low)),
                text(estimate.ci95.map(|[_, high]| high)),
                text(estimate.upper_limit95),
                estimate.identified.to_string(),
            ])?;
        }
    }
    writer.flush()?;
    Ok(())
}

/// What was found beside what the emulated sensor's model says.
pub(super) fn comparison(noise: &Value, model: &SensorModel) -> String {
    let mut rows = table(&["channel", "N model", "N found", "B model", "B found [95 %]", "K model", "K found [95 %]"]);
    for (channel, truth) in &model.channels {
        let Some(found) = noise["channels"].get(channel.name()) else { continue };
        let estimate = |letter: &str| -> String {
            serde_json::from_value::<Estimate>(found[letter].clone())
                .map_or_else(|_| "–".to_owned(), |found| cell(&found))
        };
        let n = found["N"]["value"].as_f64();
        rows.add_row([
            format!("{channel} {}", channel.unit()),
            format!("{:.3e}", truth.n),
            n.map_or_else(|| "–".to_owned(), |n| format!("{n:.3e} ({:+.2} %)", 100.0 * (n / truth.n - 1.0))),
            format!("{:.3e}", truth.b),
            estimate("B"),
            format!("{:.3e}", truth.k),
            estimate("K"),
        ]);
    }
    rows.to_string()
}
