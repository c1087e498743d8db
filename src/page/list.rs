//! Lists: all captures, diagnoses, jobs and models, with a search and pages.

use super::figure::{clock, percent, plain, span};
use super::{Kind, escaped, framed, wide};
use crate::store::{CaptureRow, Found, JobKind, JobState, LIST_ROWS, ListedDiagnosis, ListedJob, ModelEntry, Search};
use std::fmt::Write as _;

/// Maximum length of a search in characters.
pub const SEARCH_MAX: usize = 200;

/// The contents of a list's page.
#[derive(Debug, Clone, Copy)]
pub struct ListView<'a, T> {
    /// What was requested.
    pub search: &'a Search,
    /// The rows.
    pub found: &'a Found<T>,
    /// Address of the previous page; `None` on the first.
    pub previous: Option<&'a str>,
    /// Address of the next page; `None` on the last.
    pub next: Option<&'a str>,
}

/// What distinguishes a list from the others.
struct List {
    /// Its name, which is its path too.
    name: &'static str,
    /// The texts of a row that are searched.
    searched: &'static str,
    /// Its columns: name and class.
    columns: &'static [(&'static str, &'static str)],
    /// A link to another page about the same: address and text.
    also: Option<(&'static str, &'static str)>,
}

/// Returns the page of all captures.
pub fn captures(view: &ListView<'_, CaptureRow>) -> String {
    const CAPTURES: List = List {
        name: "captures",
        searched: "name, note or source",
        columns: &[
            ("name", ""),
            ("begun (UTC)", "when"),
            ("length", "number"),
            ("samples", "number"),
            ("missing", "number"),
            ("state", ""),
            ("note", "text"),
            ("kept", ""),
        ],
        also: Some(("/compare", "Two captures side by side")),
    };
    page(&CAPTURES, view, |of| {
        vec![
            capture_link(of.id, Some(&of.name)),
            time(of.started_at),
            span(of.duration_s),
            of.samples.to_string(),
            of.missing.to_string(),
            of.state.name().to_owned(),
            escaped(of.note.as_deref().unwrap_or_default()),
            if of.pinned { "kept" } else { "" }.to_owned(),
        ]
    })
}

/// Returns the page of all diagnoses.
pub fn diagnoses(view: &ListView<'_, ListedDiagnosis>) -> String {
    const DIAGNOSES: List = List {
        name: "diagnoses",
        searched: "sentence, capture, simulator, verdict, state or error",
        columns: &[
            ("sentence", "text"),
            ("real", ""),
            ("simulator", ""),
            ("verdict", ""),
            ("asked for (UTC)", "when"),
            ("state", ""),
            ("error", "text"),
        ],
        also: None,
    };
    page(&DIAGNOSES, view, |of| {
        let job = &of.row.job;
        vec![
            format!("<a href=\"/diagnoses/{}\">{}</a>", job.id, escaped(&of.row.summary_or_state())),
            capture_link(job.capture, of.real.as_deref()),
            of.sim.as_deref().map_or_else(|| GONE.to_owned(), escaped),
            of.row.verdict.as_deref().map_or_else(|| "–".to_owned(), |verdict| escaped(&verdict.replace('_', " "))),
            time(Some(job.created_at)),
            state(job.state, job.progress),
            escaped(job.error.as_deref().unwrap_or_default()),
        ]
    })
}

/// Returns the page of all jobs.
pub fn jobs(view: &ListView<'_, ListedJob>) -> String {
    const JOBS: List = List {
        name: "jobs",
        searched: "kind, capture, state or error",
        columns: &[
            ("kind", ""),
            ("capture", ""),
            ("state", ""),
            ("submitted (UTC)", "when"),
            ("begun (UTC)", "when"),
            ("ended (UTC)", "when"),
            ("error", "text"),
        ],
        also: None,
    };
    page(&JOBS, view, |ListedJob { job, capture }| {
        let place = if job.kind == JobKind::Diagnosis { "/diagnoses/" } else { "/v1/jobs/" };
        vec![
            format!("<a href=\"{place}{}\">{}</a>", job.id, job.kind.name()),
            capture_link(job.capture, capture.as_deref()),
            state(job.state, job.progress),
            time(Some(job.created_at)),
            time(job.started_at),
            time(job.finished_at),
            escaped(job.error.as_deref().unwrap_or_default()),
        ]
    })
}

/// Returns the page of all models.
pub fn models(view: &ListView<'_, ModelEntry>) -> String {
    const MODELS: List = List {
        name: "models",
        searched: "name or id",
        columns: &[("name", ""), ("id", ""), ("rate", "number"), ("stored (UTC)", "when"), ("more", "")],
        also: None,
    };
    page(&MODELS, view, |of| {
        vec![
            format!("<a href=\"/v1/models/{}\">{}</a>", of.id, escaped(&of.name)),
            of.id.clone(),
            format!("{} Hz", plain(of.rate_hz)),
            time(Some(of.created_at)),
            format!("<a href=\"/v1/models/{}/cost\">its cost as JSON</a>", of.id),
        ]
    })
}

/// The place of a name that is gone.
const GONE: &str = "<span class=\"soft\">deleted</span>";

fn capture_link(id: i64, name: Option<&str>) -> String {
    name.map_or_else(|| GONE.to_owned(), |name| format!("<a href=\"/captures/{id}\">{}</a>", escaped(name)))
}

fn time(at: Option<crate::store::UtcNs>) -> String {
    at.map_or_else(|| "–".to_owned(), |at| clock(&at.to_string()))
}

fn state(state: JobState, progress: f64) -> String {
    match state {
        JobState::Running => format!("running, {}", percent(progress)),
        state => state.name().to_owned(),
    }
}

fn page<T>(list: &List, view: &ListView<'_, T>, cells: impl Fn(&T) -> Vec<String>) -> String {
    let List { name, searched, columns, also } = list;
    let title: String = name[..1].to_uppercase() + &name[1..];
    let text = view.search.text.as_deref().map(escaped);
    // The form works without scripts: a browser asks for `?q=` itself.
    let mut out = format!(
        "<h1>{title}</h1><form class=\"search\" role=\"search\" action=\"/{name}\"><label>{searched} \
         <input type=\"search\" name=\"q\" maxlength=\"{SEARCH_MAX}\" value=\"{}\"></label><button>search</button></form>",
        text.as_deref().unwrap_or_default()
    );
    out += &sentence(list, view, text.as_deref());
    if let Some((address, text)) = also {
        let _ = write!(out, "<p><a href=\"{address}\">{text}</a></p>");
    }
    if !view.found.rows.is_empty() {
        out += &wide(name);
        out += "<table><tr>";
        for (column, class) in *columns {
            let _ = write!(out, "<th scope=\"col\" class=\"{class}\">{column}</th>");
        }
        out += "</tr>";
        for row in &view.found.rows {
            out += "<tr>";
            for ((_, class), cell) in columns.iter().zip(cells(row)) {
                // Writing to a text cannot fail.
                let _ = write!(out, "<td class=\"{class}\">{cell}</td>");
            }
            out += "</tr>";
        }
        out += "</table></div>";
    }
    let steps = [("prev", "previous page", view.previous), ("next", "next page", view.next)];
    let steps = steps.into_iter().filter_map(|(rel, label, address)| {
        Some(format!("<a class=\"button\" rel=\"{rel}\" href=\"{}\">{label}</a>", escaped(address?)))
    });
    let steps = steps.collect::<String>();
    if !steps.is_empty() {
        let _ = write!(out, "<nav aria-label=\"pages\">{steps}</nav>");
    }
    framed(&title, Kind::Served, &out)
}

/// Returns a paragraph that states which rows are shown, or why there are none.
fn sentence<T>(list: &List, view: &ListView<'_, T>, text: Option<&str>) -> String {
    let (name, number, rows) = (list.name, view.search.page, view.found.rows.len());
    let all = || format!(" <a href=\"/{name}\">All {name}</a>");
    let (sentence, link) = match (rows, number, text) {
        (0, 1, None) => ("There are none yet.".to_owned(), String::new()),
        (0, 1, Some(text)) => (format!("None has “{text}” as a part of {}.", list.searched), all()),
        (0, number, _) => (format!("There is no page {number}."), all()),
        (rows, number, text) => {
            let first = u64::from(number - 1) * u64::from(LIST_ROWS) + 1;
            let of = text.map_or_else(String::new, |text| format!(" of those with “{text}”"));
            let link = if text.is_some() { all() } else { String::new() };
            (format!("{first} to {}{of}, the latest first.", first + rows as u64 - 1), link)
        }
    };
    format!("<p class=\"soft\">{sentence}{link}</p>")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page::rows;
    use crate::store::UtcNs;

    const HOSTILE: &str = "<script>\"'&";

    fn search(text: Option<&str>, page: u32) -> Search {
        Search { text: text.map(str::to_owned), page }
    }

    fn shown<T>(show: fn(&ListView<'_, T>) -> String, search: &Search, rows: Vec<T>) -> String {
        let found = Found { rows, more: true };
        let next = Some("/x?q=%3C&page=2\"");
        show(&ListView { search, found: &found, previous: None, next })
    }

    fn holds(page: &str, all: &[&str]) {
        for expected in all {
            assert!(page.contains(expected), "{expected}: {page}");
        }
        assert!(!page.contains("<script>") && !page.contains("<foam>") && !page.contains("<b>"), "{page}");
    }

    #[test]
    fn a_row_links_to_the_capture_and_no_text_becomes_markup() {
        let page = shown(captures, &search(Some(HOSTILE), 1), vec![rows::capture()]);
        holds(
            &page,
            &[
                "<a href=\"/captures/7\">&lt;script&gt;alert(1)</a>",
                "<td class=\"when\">2026-11-23 20:00:00</td><td class=\"number\">5 h</td><td class=\"number\">719990</td>",
                "<td class=\"number\">10</td><td class=\"\">complete</td><td class=\"text\">on &lt;foam&gt;, 23 °C</td>",
                "value=\"&lt;script&gt;&quot;'&amp;\"",
                "1 to 1 of those with “&lt;script&gt;&quot;'&amp;”, the latest first.",
                "<div class=\"wide\" role=\"group\" tabindex=\"0\" aria-label=\"captures\">",
                "<a class=\"button\" rel=\"next\" href=\"/x?q=%3C&amp;page=2&quot;\">next page</a>",
            ],
        );
        assert!(!page.contains("rel=\"prev\""), "{page}");
        let kept = CaptureRow { pinned: true, note: None, started_at: None, ..rows::capture() };
        holds(
            &shown(captures, &search(None, 2), vec![kept]),
            &["<td class=\"\">kept</td>", "51 to 51, the latest first."],
        );
    }

    #[test]
    fn an_empty_page_says_why() {
        let none = |text, page| shown(captures, &search(text, page), Vec::new());
        holds(&none(None, 1), &["There are none yet."]);
        holds(&none(Some("<b>"), 1), &["None has “&lt;b&gt;” as a part of name, note or source."]);
        holds(&none(None, u32::MAX), &["There is no page 4294967295. <a href=\"/captures\">All captures</a>"]);
        assert!(!none(None, 1).contains("<table>"));
    }

    #[test]
    fn jobs_diagnoses_and_models_have_their_columns() {
        let mut job = rows::job(3, JobKind::Noise, JobState::Running);
        job.error = Some("<b>".to_owned());
        job.started_at = Some(UtcNs(rows::BEGUN_NS));
        let page = shown(jobs, &search(None, 1), vec![ListedJob { job, capture: None }]);
        holds(&page, &["/v1/jobs/3", "deleted", "running, 25 %", "&lt;b&gt;", "<td class=\"when\">–</td>"]);
        let row = rows::diagnosis("a <b> is missing");
        let listed = ListedDiagnosis { row, real: Some("<b>".to_owned()), sim: Some("<b>unit".to_owned()) };
        let page = shown(diagnoses, &search(None, 1), vec![listed]);
        let link = "<a href=\"/diagnoses/9\">a &lt;b&gt; is missing</a>";
        holds(&page, &[link, "<a href=\"/captures/6\">&lt;b&gt;</a>", "&lt;b&gt;unit", ">effects<", ">done<"]);
        let created_at = UtcNs(rows::BEGUN_NS);
        let entry = ModelEntry { id: "model-1".to_owned(), name: "<b>".to_owned(), rate_hz: 40.0, created_at };
        let page = shown(models, &search(None, 1), vec![entry]);
        holds(&page, &["<a href=\"/v1/models/model-1\">&lt;b&gt;</a>", "40 Hz", "/v1/models/model-1/cost"]);
    }
}
