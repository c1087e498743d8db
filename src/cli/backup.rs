//! `vn100d backup`: a copy of the database.

use super::args::BackupArgs;
use super::progress::bar;
use super::{Context, Outcome, print_json};

/// Copies the database in its present state.
pub(super) fn run(context: &Context, args: &BackupArgs) -> anyhow::Result<Outcome> {
    let reader = context.reader()?;
    let bar = bar("{bytes} of {total_bytes} {bar:30} {eta}", 0);
    let report = reader.backup(&args.out, args.force, &mut |done, all| {
        bar.set_length(all);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    let report = report?;
    if context.json {
        let file = args.out.display().to_string();
        print_json(&serde_json::json!({ "file": file, "bytes": report.bytes, "seconds": report.seconds }))?;
    } else {
        eprintln!("{}: {} bytes in {:.1} s", args.out.display(), report.bytes, report.seconds);
    }
    Ok(Outcome::Done)
}
