//! `vn100d import`: recordings become captures.

use super::args::ImportArgs;
use super::{CliError, Context, Failure, Outcome, print_json};
use crate::clock::SystemClock;
use crate::daemon::import::{Imported, import};
use crate::store::{ImportEnd, Store, StoreOptions};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal as _, Write as _};

/// Imports each file; a file that was imported before is named, not doubled.
pub(super) fn run(context: &Context, args: &ImportArgs) -> anyhow::Result<Outcome> {
    if args.name.is_some() && args.files.len() > 1 {
        let message = "--name names one capture, but several files were given".to_owned();
        return Err(CliError { failure: Failure::Usage, message }.into());
    }
    let store = Store::open(&context.database()?, StoreOptions::default())?;
    let (mut outcome, mut answers) = (Outcome::Done, Vec::new());
    for file in &args.files {
        let bar = bar();
        let name = args.name.clone();
        let imported = import(&store, &SystemClock, file, args.rate, name, &mut |written, of| {
            bar.set_length(of);
            bar.set_position(written);
        })?;
        bar.finish_and_clear();
        if let ImportEnd::Created(id) = imported.end {
            crate::jobs::leave_for_daemon(&store, id)?;
        }
        if imported.info.rejected.values().any(|count| *count > 0) {
            outcome = Outcome::WithLoss;
        }
        if context.json {
            answers.push(answer(&imported));
        } else {
            tell(&imported)?;
        }
    }
    store.close()?;
    if context.json {
        print_json(&answers)?;
    }
    Ok(outcome)
}

fn answer(imported: &Imported) -> serde_json::Value {
    let (samples, missing, gaps) = imported.counts;
    serde_json::json!({
        "file": imported.info.file.display().to_string(),
        "capture": imported.end.id(),
        "new": matches!(imported.end, ImportEnd::Created(_)),
        "samples": samples,
        "missing": missing,
        "gaps": gaps,
        "rate_hz": imported.info.rate_hz,
        "rate_assumed": imported.info.rate_assumed,
        "rejected": imported.info.rejected,
        "ignored_columns": imported.info.ignored_columns,
    })
}

fn tell(imported: &Imported) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    let info = &imported.info;
    let (samples, missing, gaps) = imported.counts;
    let rate = if info.rate_assumed {
        format!("{} Hz (assumed: neither stamps nor --rate tell it)", info.rate_hz)
    } else {
        format!("{} Hz", info.rate_hz)
    };
    let how = match imported.end {
        ImportEnd::Created(id) => format!("is capture {id}"),
        ImportEnd::Known(id) => format!("was imported before, as capture {id}"),
    };
    writeln!(stdout, "{} {how}: {samples} samples at {rate}, {missing} missing in {gaps} gaps", info.file.display())?;
    for (cause, count) in &info.rejected {
        writeln!(stdout, "  rejected: {count} ({})", cause.name())?;
    }
    if !info.ignored_columns.is_empty() {
        writeln!(stdout, "  columns ignored: {}", info.ignored_columns.join(", "))?;
    }
    for conversion in &info.conversions {
        writeln!(
            stdout,
            "  {} converted from {} by {}",
            conversion.channel, conversion.original_unit, conversion.factor
        )?;
    }
    Ok(())
}

fn bar() -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {percent} %  {human_pos} samples") {
        bar.set_style(style);
    }
    if !std::io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    bar
}
