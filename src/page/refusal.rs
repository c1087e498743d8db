//! Refusals: an error as a page, for people who came by a link that leads nowhere.

use super::{Kind, escaped, framed};
use std::fmt::Write as _;

/// The contents of the page.
#[derive(Debug, Clone, Copy)]
pub struct RefusalView<'a> {
    /// One sentence, the same for every error of this type.
    pub title: &'a str,
    /// The error of this request, and what to do.
    pub detail: &'a str,
    /// The reasons, if there are several.
    pub reasons: &'a [String],
    /// When to try again, s.
    pub retry_after_s: Option<u32>,
    /// The path that the log has too.
    pub instance: &'a str,
}

/// Returns the page. It leads to the first page, and to the lists as every page does.
pub fn refusal(view: &RefusalView<'_>) -> String {
    let RefusalView { title, detail, reasons, retry_after_s, instance } = *view;
    let mut out = format!("<h1>{}.</h1><p>{}.</p>", escaped(title), escaped(&sentence(detail)));
    if !reasons.is_empty() {
        let reasons: String = reasons.iter().map(|reason| format!("<li>{}</li>", escaped(reason))).collect();
        // Writing to a text cannot fail.
        let _ = write!(out, "<ul>{reasons}</ul>");
    }
    if let Some(s) = retry_after_s {
        let _ = write!(out, "<p>Try again in {s} s.</p>");
    }
    let _ = write!(
        out,
        "<p><a href=\"/\">The first page</a> shows what the daemon does now. The lists above lead to all that is stored.</p>\
         <p class=\"soft\">{}</p>",
        escaped(instance)
    );
    framed(title, Kind::Served, &out)
}

/// Returns the text with a first letter in upper case.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_has_the_sentence_and_leads_on() {
        let page = refusal(&RefusalView {
            title: "There is nothing here",
            detail: "no capture `<b>`",
            reasons: &["<i>".to_owned()],
            retry_after_s: Some(5),
            instance: "/requests/1-a",
        });
        for expected in [
            "<h1>There is nothing here.</h1><p>No capture `&lt;b&gt;`.</p>",
            "<li>&lt;i&gt;</li>",
            "Try again in 5 s.",
            "<a href=\"/\">The first page</a>",
            "/requests/1-a",
            "<a href=\"/captures\">captures</a>",
            "<a href=\"/diagnoses\">diagnoses</a>",
            "<a href=\"/jobs\">jobs</a>",
            "<a href=\"/models\">models</a>",
        ] {
            assert!(page.contains(expected), "{expected}: {page}");
        }
        assert!(!page.contains("<b>") && !page.contains("<i>"), "{page}");
    }
}
