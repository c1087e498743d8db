//! `vn100d import`: recordings become captures, through the daemon if one has the database.

use super::args::ImportArgs;
use super::client;
use super::figures::{counted, hertz};
use super::part::Part;
use super::place::another_database;
use super::progress::bar;
use super::{Context, Outcome, print_json, usage};
use crate::clock::SystemClock;
use crate::control::{ImportReport, MessageText};
use crate::daemon::import::{Source, import};
use crate::store::{ImportEnd, Store, StoreError, StoreOptions, printable};
use anyhow::Context as _;
use imu_files::recording::{ColumnMap, Input, MessageDefinition, detect, open_regular, recording_file, unmerged_log};
use std::io::Write as _;
use std::path::Path;

/// The process that writes the database.
enum Writer {
    /// This process.
    Own(Store),
    /// The daemon that answers at this address, with the token for it.
    Daemon { base_url: String, token: String },
}

/// Number of rejected lines that are printed, and number of characters of each.
const REJECTED_SHOWN: usize = 5;
const REJECTED_CHARS: usize = 90;

/// Imports each file; a file that was imported before is reported, not doubled.
pub(super) fn run(context: &Context, args: &ImportArgs) -> anyhow::Result<Outcome> {
    if args.name.is_some() && args.files.len() > 1 {
        return Err(usage("--name names one capture, but several files were given"));
    }
    // The daemon receives the options as parsed here.
    let Context { columns, definitions, part, .. } = context.clone();
    let stated = Given { columns, definitions, part };
    let writer = writer(context, args)?;
    let (mut outcome, mut answers) = (Outcome::Done, Vec::new());
    for file in &args.files {
        let file = &recording_file(file)?;
        let report = match &writer {
            Writer::Own(store) => import_here(store, file, args, &stated)?,
            Writer::Daemon { base_url, token } => send((base_url, token), file, args, &stated)?,
        };
        if report.rejected.values().any(|count| *count > 0) {
            outcome = Outcome::WithLoss;
        }
        if context.json {
            answers.push(report);
        } else {
            print_summary(&report)?;
        }
    }
    if let Writer::Own(store) = &writer {
        store.close()?;
    }
    if context.json {
        print_json(&answers)?;
    }
    Ok(outcome)
}

/// The user's statements about the recordings.
struct Given {
    columns: ColumnMap,
    definitions: Vec<MessageDefinition>,
    part: Part,
}

/// Returns the named daemon, or the one that has the database; without one, the database itself.
fn writer(context: &Context, args: &ImportArgs) -> anyhow::Result<Writer> {
    let database = context.database()?;
    let refused = if args.listen.is_some() {
        None
    } else {
        match Store::open(&database, StoreOptions::default()) {
            Ok(store) => return Ok(Writer::Own(store)),
            Err(error) if is_held_by_another(&error) => Some(error),
            Err(error) => return Err(error.into()),
        }
    };
    let base_url = context.daemon_url(args.listen.as_deref())?;
    let Some(refused) = refused else {
        let token = context.token_for(args.listen.as_deref())?;
        return Ok(Writer::Daemon { base_url, token });
    };
    // The daemon must have this very database, so that a recording does not end up in another one.
    match another_database(&base_url, &database, client::PATIENCE) {
        Err(error) if error.is_unreachable() => {
            Err(refused).context(format!("no daemon answers at {base_url} either (name its address with --listen)"))
        }
        Err(error) => Err(error.into()),
        Ok(None) => {
            // Only now: without a daemon, no token is needed, which only its user may read.
            let token = context.token_for(None)?;
            Ok(Writer::Daemon { base_url, token })
        }
        Ok(Some(theirs)) => {
            Err(refused).context(format!("the daemon at {base_url} has another database ({})", theirs.display()))
        }
    }
}

/// Returns whether another process, or another user, has the database.
fn is_held_by_another(error: &StoreError) -> bool {
    match error {
        StoreError::Locked { .. } => true,
        StoreError::Create { source, .. } => source.kind() == std::io::ErrorKind::PermissionDenied,
        _ => false,
    }
}

fn import_here(store: &Store, file: &Path, args: &ImportArgs, stated: &Given) -> anyhow::Result<ImportReport> {
    let bar = bar("{bar:40} {percent} %  {human_pos} samples", 0);
    // Another instance's daemon may capture beside it.
    crate::process::step_back();
    let Given { columns, definitions, .. } = stated;
    let (columns, definitions) = (columns.clone(), definitions.clone());
    let (rate_hz, sampling, note) = (args.rate, args.sampling.stated(), args.note.clone());
    let part = stated.part.of_recording();
    let source = Source { rate_hz, sampling, columns, definitions, part, note, ..Source::of(file) };
    let imported = import(store, &SystemClock, source, args.name.clone(), &mut |written, of| {
        bar.set_length(of);
        bar.set_position(written);
        Ok(())
    })?;
    bar.finish_and_clear();
    if let ImportEnd::Created(id) = imported.end {
        crate::jobs::leave_for_daemon(store, id)?;
    }
    Ok(imported.report)
}

/// Sends the recording's bytes to the daemon (address and token), which may not be able to read the user's files.
fn send(
    (base_url, token): (&str, &str),
    file: &Path,
    args: &ImportArgs,
    stated: &Given,
) -> anyhow::Result<ImportReport> {
    let unreadable = || format!("{} cannot be read", file.display());
    if file.is_dir() {
        return Err(usage(format!(
            "{0} has several files, and the daemon takes one: `vn100d export {0} --out FILE.parquet` makes one of them; import \
             that",
            file.display()
        )));
    }
    // A file that is not a recording is not sent.
    detect(&Input::file(file).with_columns(stated.columns.clone()))?;
    if let Some(log) = unmerged_log(file) {
        // The daemon gets one file: data that is only in the log would be missing without notice.
        let (file, log) = (file.display(), log.display());
        return Err(usage(format!(
            "{file} was not closed by its recorder: {log} holds what is not in it yet. `sqlite3 '{file}' .tables` puts it \
             there; then import it"
        )));
    }
    let opened = open_regular(file)?;
    let length = opened.metadata().with_context(unreadable)?.len();
    let bar = bar("{bar:40} {percent} %  {bytes} sent", length);
    let mut query = vec![("file", file.display().to_string())];
    query.extend(args.name.clone().map(|name| ("name", name)));
    query.extend(args.note.clone().map(|note| ("note", note)));
    query.extend(stated.part.query());
    query.extend(args.rate.map(|rate_hz| ("rate_hz", rate_hz.to_string())));
    query.extend(args.sampling.filter_window.map(|window| ("filter_window", window.to_string())));
    query.extend(args.sampling.internal_rate.map(|rate_hz| ("internal_rate_hz", rate_hz.to_string())));
    if !stated.columns.is_empty() {
        query.push(("columns", stated.columns.to_string()));
    }
    if !stated.definitions.is_empty() {
        let text =
            |given: &MessageDefinition| MessageText { name: given.name().to_owned(), text: given.text().to_owned() };
        let texts: Vec<MessageText> = stated.definitions.iter().map(text).collect();
        query.push(("message_definitions", serde_json::to_string(&texts)?));
    }
    let body = bar.wrap_read(opened);
    let answer = client::send(base_url, "/v1/imports", &query, token, length, body);
    bar.finish_and_clear();
    let answer = answer.with_context(|| format!("{} was not imported", file.display()))?;
    serde_json::from_value(answer).context("what the daemon answered is no import's report")
}

fn print_summary(report: &ImportReport) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    let assumed = if report.rate_assumed { " (assumed: neither stamps nor --rate states it)" } else { "" };
    let rate = format!("{}{assumed}", hertz(report.rate_hz));
    let how = if report.new { "is capture" } else { "was imported before, as capture" };
    let ImportReport { file, capture, samples, missing, gaps, .. } = report;
    let [samples, gaps] = [counted(*samples, "sample", "samples"), counted(*gaps, "gap", "gaps")];
    writeln!(stdout, "{file} {how} {capture}: {samples} at {rate}, {missing} missing in {gaps}")?;
    for (cause, count) in &report.rejected {
        writeln!(stdout, "  rejected: {count} ({cause})")?;
    }
    for rejected in report.first_rejected.iter().take(REJECTED_SHOWN) {
        let text: String = rejected.text.chars().take(REJECTED_CHARS).collect();
        writeln!(stdout, "    {} {}: {}", rejected.entry, rejected.line, printable(&text))?;
    }
    for remark in &report.remarks {
        writeln!(stdout, "  {}", printable(remark))?;
    }
    if !report.ignored_columns.is_empty() {
        writeln!(stdout, "  ignored: {}", printable(&report.ignored_columns.join(", ")))?;
    }
    for conversion in &report.conversions {
        writeln!(
            stdout,
            "  {} converted from {} by {}",
            conversion.channel, conversion.original_unit, conversion.factor
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A daemon that is not there needs no token: the database decides whether an import is possible.
    #[test]
    fn a_token_that_cannot_be_read_blocks_no_import_while_no_daemon_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = free.local_addr().unwrap();
        drop(free);
        let config = folder.path().join("vn100d.toml");
        let missing = folder.path().join("token");
        std::fs::write(&config, format!("[http]\nlisten = \"{address}\"\ntoken-file = {missing:?}\n")).unwrap();
        let context = Context {
            data_dir: Some(folder.path().to_owned()),
            config: Some(config),
            json: false,
            ..Context::default()
        };
        let arguments = |listen: Option<&str>| ImportArgs {
            files: vec!["desk.csv".into()],
            rate: None,
            part: crate::cli::args::PartArgs::default(),
            sampling: crate::cli::args::SamplingArgs::default(),
            name: None,
            note: None,
            listen: listen.map(str::to_owned),
        };
        let held = Store::open(&folder.path().join("vn100d.db"), StoreOptions::default()).unwrap();
        let Err(error) = writer(&context, &arguments(None)) else { panic!("the database is held") };
        assert!(
            error.downcast_ref::<StoreError>().is_some_and(|error| matches!(error, StoreError::Locked { .. })),
            "{error:#}"
        );
        held.close().unwrap();
        // A named daemon requires the token.
        let Err(error) = writer(&context, &arguments(Some("127.0.0.1:9"))) else { panic!("there is no token") };
        assert!(error.to_string().contains("token-file"), "{error:#}");
    }
}
