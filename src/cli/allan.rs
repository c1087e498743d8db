//! `vn100d allan`: deviation curves.

use super::analysis;
use super::args::{AllanArgs, Format};
use super::figures::{counted, hertz};
use super::{Context, Outcome, failed, print_json, table};
use crate::jobs::{JobParameters, direct};
use crate::store::printable;
use imu_noise::allan::AllanReport;
use std::io::Write as _;

/// Prints the curves.
pub(super) fn run(context: &Context, args: &AllanArgs) -> anyhow::Result<Outcome> {
    let together = analysis::open(context, &args.captures, args.rate)?;
    let (name, rejected) = (together.name(), together.rejected());
    let parameters = JobParameters { taus: args.taus, estimator: args.estimator, channels: None, with: Vec::new() };
    let report = direct::allan(&together.source, together.plan, &parameters)?;
    let of_none = report.channels.iter().filter(|(_, curve)| curve.tau_s.is_empty()).map(|(channel, _)| channel.name());
    let of_none: Vec<&str> = of_none.collect();
    if !of_none.is_empty() {
        let reason = format!(
            "{} of {name} has too few values in consecutive samples for a deviation: a channel that only some rows have is analysed \
             alone (--channels, of a file)",
            of_none.join(", ")
        );
        if of_none.len() == report.channels.len() {
            return Err(failed(reason));
        }
        eprintln!("note: {}", printable(&reason));
    }
    match (context.json, args.format) {
        (true, _) | (_, Format::Json) => print_json(&report)?,
        (_, Format::Csv) => print_csv(&report)?,
        (_, Format::Table) => print_table(&name, &report)?,
    }
    Ok(if rejected { Outcome::WithLoss } else { Outcome::Done })
}

fn print_csv(report: &AllanReport) -> anyhow::Result<()> {
    let mut writer = csv::Writer::from_writer(std::io::stdout().lock());
    writer.write_record(["channel", "unit", "tau_s", "deviation", "ci68_low", "ci68_high", "edf", "n", "noise"])?;
    for (channel, curve) in &report.channels {
        for index in 0..curve.tau_s.len() {
            writer.write_record([
                channel.name().to_owned(),
                curve.unit.clone(),
                curve.tau_s[index].to_string(),
                curve.deviation[index].to_string(),
                curve.ci68_low[index].to_string(),
                curve.ci68_high[index].to_string(),
                curve.edf[index].to_string(),
                curve.n[index].to_string(),
                curve.noise[index].name().to_owned(),
            ])?;
        }
    }
    writer.flush()?;
    Ok(())
}

/// Prints averaging times down and channels across, because a person compares channels.
fn print_table(name: &str, report: &AllanReport) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    writeln!(
        stdout,
        "{name}: {} of {} at {}, {} missing",
        report.estimator.name(),
        counted(report.samples.unwrap_or_default(), "sample", "samples"),
        hertz(report.rate_hz),
        report.missing.unwrap_or_default()
    )?;
    write!(stdout, "{}", super::stillness(report.at_rest_s, report.moving_s))?;
    let header: Vec<String> = std::iter::once("tau s".to_owned())
        .chain(report.channels.iter().map(|(channel, curve)| format!("{channel} {}", curve.unit)))
        .collect();
    let mut rows = table(&header.iter().map(String::as_str).collect::<Vec<_>>());
    let longest = report.channels.values().max_by_key(|curve| curve.tau_s.len());
    for (index, tau_s) in longest.map(|curve| curve.tau_s.as_slice()).unwrap_or_default().iter().enumerate() {
        let cells = report.channels.values().map(|curve| {
            match (curve.deviation.get(index), curve.ci68_low.get(index), curve.ci68_high.get(index)) {
                (Some(deviation), Some(low), Some(high)) if *deviation > 0.0 => {
                    format!("{deviation:.3e} ± {:.0} %", 50.0 * (high - low) / deviation)
                }
                (Some(deviation), ..) => format!("{deviation:.3e}"),
                _ => String::new(),
            }
        });
        rows.add_row(
            std::iter::once(format!("{tau_s:.6}").trim_end_matches('0').trim_end_matches('.').to_owned()).chain(cells),
        );
    }
    writeln!(stdout, "{rows}")?;
    for warning in &report.warnings {
        writeln!(stdout, "{warning}")?;
    }
    Ok(())
}
