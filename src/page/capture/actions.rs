//! Actions: the requests that a capture's page offers, and the form that leads to a comparison with another capture.

use super::escaped;
use crate::page::dashboard::token;
use crate::store::{CaptureRow, ModelEntry};
use std::fmt::Write as _;

/// What a page of the daemon has beside the capture itself.
#[derive(Debug, Clone, Copy)]
pub struct Served<'a> {
    /// Whether requests need a token.
    pub token: bool,
    /// The models that the capture can be compared with.
    pub models: &'a [ModelEntry],
    /// The other captures that have ended, the latest first.
    pub captures: &'a [CaptureRow],
}

/// Writes the requests; users without scripts have curl. The comparison works without scripts.
pub(super) fn section(out: &mut String, of: &CaptureRow, served: &Served<'_>) {
    let id = of.id;
    if !of.state.is_open() && !served.captures.is_empty() {
        let _ = write!(
            out,
            "<form class=\"search\" action=\"/compare\"><input type=\"hidden\" name=\"a\" value=\"{id}\">\
             <label>side by side with <select name=\"b\">{}</select></label><button>show both</button></form>",
            options(served.captures)
        );
    }
    *out += "<section class=\"controls\" aria-label=\"actions\" hidden>";
    if of.state.is_open() {
        // Writing to a text cannot fail.
        let _ = write!(
            out,
            "<form data-post=\"/v1/captures/{id}/stop\" data-ask=\"Stop this capture?\"><button>stop</button></form>"
        );
    } else {
        let _ = write!(
            out,
            "<form data-post=\"/v1/captures/{id}/pin\" data-json=\"{{&quot;pinned&quot;:{}}}\"><button>{}</button></form>",
            !of.pinned,
            if of.pinned { "keep no longer" } else { "keep from deletion" }
        );
        diagnosis(out, id, served);
    }
    let _ = write!(
        out,
        "<form data-post=\"/v1/captures/{id}\" data-method=\"PATCH\" autocomplete=\"off\">\
         <label>name <input name=\"name\" maxlength=\"100\" value=\"{}\" required></label>\
         <label>note <input name=\"note\" maxlength=\"1000\" size=\"40\" value=\"{}\" placeholder=\"on foam, 23 °C\"></label>\
         <button>save</button></form>",
        escaped(&of.name),
        escaped(of.note.as_deref().unwrap_or_default())
    );
    *out += &token(served.token);
    *out += "<p class=\"said\" role=\"status\"></p></section>";
}

/// Writes the form of a diagnosis: against a model, a model's file or another capture, perhaps with a reference. Of two
/// fields with one name the later one counts if it is filled in.
fn diagnosis(out: &mut String, id: i64, served: &Served<'_>) {
    let models: String = served.models.iter().fold(String::new(), |mut all, of| {
        let _ = match of.name.is_empty() {
            true => write!(all, "<option value=\"{0}\">{0}</option>", of.id),
            false => write!(all, "<option value=\"{0}\">{0} ({1})</option>", of.id, escaped(&of.name)),
        };
        all
    });
    let groups: String = [("models", models), ("captures that a simulator made", options(served.captures))]
        .into_iter()
        .filter(|(_, options)| !options.is_empty())
        .map(|(label, options)| format!("<optgroup label=\"{label}\">{options}</optgroup>"))
        .collect();
    let _ = write!(out, "<form data-post=\"/v1/captures/{id}/diagnoses\" data-then=\"/diagnoses/\">");
    let file = match groups.is_empty() {
        true => "compare with a model's file",
        false => {
            let _ = write!(out, "<label>compare with <select name=\"sim\">{groups}</select></label>");
            "or with a model's file"
        }
    };
    let _ = write!(
        out,
        "<label>{file} <input name=\"sim\" type=\"file\" accept=\".json\"></label>\
         <label>motion <select name=\"reference\"><option value=\"\">unknown, or at rest</option>\
         <option value=\"still\">simulated: still</option><option value=\"tumble\">simulated: tumble</option>\
         <option value=\"rate-table\">simulated: rate table</option></select></label>\
         <label>or a reference's file <input name=\"reference\" type=\"file\" accept=\".csv,.txt,.tum,.gz\"></label>\
         <label>an encoder's axis <select name=\"reference_axis\"><option value=\"\">no encoder</option>\
         <option>x</option><option>y</option><option>z</option></select></label><button>diagnose</button></form>"
    );
}

/// Returns a choice for each capture.
pub(in crate::page) fn options(captures: &[CaptureRow]) -> String {
    captures.iter().fold(String::new(), |mut all, of| {
        let _ = write!(all, "<option value=\"{}\">{}</option>", of.id, escaped(&of.name));
        all
    })
}
