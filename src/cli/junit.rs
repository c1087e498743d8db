//! JUnit reports: what continuous integration reads of limits.
//!
//! Judged limits go in; one `testsuites` element with one `testsuite` and a `testcase` per limit comes out. Every text is
//! escaped, and characters that XML does not have become U+FFFD.

use super::limits::{Judged, Verdict};
use std::fmt::Write as _;

/// A report's texts beside its limits.
#[derive(Debug)]
pub(super) struct About<'a> {
    /// The command, such as `diagnose`.
    pub(super) command: &'a str,
    /// What was compared, by name.
    pub(super) inputs: &'a [(&'a str, &'a str)],
    /// What the command found, in words.
    pub(super) summary: &'a str,
    /// Whether a limit counts as met until it is shown to be missed.
    pub(super) lenient: bool,
}

/// Returns the report.
pub(super) fn report(about: &About, all: &[Judged]) -> String {
    let count = |verdict| all.iter().filter(|one| one.verdict == verdict).count();
    let (missed, undecided) = (count(Verdict::Missed), count(Verdict::Undecided));
    let (failures, skipped) = if about.lenient { (missed, undecided) } else { (missed + undecided, 0) };
    let counts = format!("tests=\"{}\" failures=\"{failures}\" errors=\"0\" skipped=\"{skipped}\"", all.len());
    let suite = escaped(&format!("vn100d {}", about.command));
    let mut to = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites name=\"vn100d\" {counts}>\n\
         <testsuite name=\"{suite}\" {counts}>\n<properties>\n"
    );
    for (name, value) in about.inputs {
        let _ = writeln!(to, "<property name=\"{}\" value=\"{}\"/>", escaped(name), escaped(value));
    }
    to.push_str("</properties>\n");
    for one in all {
        let _ = write!(to, "<testcase classname=\"{}\" name=\"{}\">", suite.replace(' ', "."), escaped(&one.name()));
        let message = escaped(&one.sentence());
        match (one.verdict, about.lenient) {
            (Verdict::Met, _) => {}
            (Verdict::Undecided, true) => {
                let _ = write!(to, "<skipped message=\"{message}\"/>");
            }
            (verdict, _) => {
                let kind = if verdict == Verdict::Missed { "missed" } else { "not_shown" };
                let summary = escaped(about.summary);
                let _ = write!(to, "<failure type=\"{kind}\" message=\"{message}\">{message}\n{summary}</failure>");
            }
        }
        to.push_str("</testcase>\n");
    }
    let _ = writeln!(to, "<system-out>{}</system-out>\n</testsuite>\n</testsuites>", escaped(about.summary));
    to
}

/// Returns a text for an element or an attribute in double quotes.
fn escaped(text: &str) -> String {
    // Char of XML 1.0; a line end in an attribute would be read as a space.
    let allowed = |of: char| matches!(of, ' '..='\u{fffd}' | '\u{10000}'..);
    let text: String = text.chars().map(|of| if of == '\n' || allowed(of) { of } else { '\u{fffd}' }).collect();
    crate::plot::escaped(&text).replace('\n', "&#10;")
}
