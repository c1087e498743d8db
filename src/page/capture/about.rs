//! The section on the origin of the data: the sensor, its configuration, and the program.

use super::{CaptureView, escaped, opened, wide};
use serde_json::Value;
use std::fmt::Write as _;

/// Writes the table.
pub(super) fn section(out: &mut String, view: &CaptureView<'_>) {
    let of = &view.facts.row;
    let channels: Vec<&str> = of.channels.iter().map(|channel| channel.name()).collect();
    *out += "<h2>What made it</h2>";
    *out += &wide("what made it");
    *out += "<table>";
    row(out, "source", &of.source);
    row(out, "software", &of.software);
    row(out, "channels", &channels.join(", "));
    // The sensor's own statements are shown once.
    let is_new = |(key, value): &(&str, &Value)| of.sensor.entries().all(|own| own != (*key, *value));
    for (key, value) in of.sensor.entries().chain(of.configuration.entries().filter(is_new)) {
        match value {
            Value::Null => {}
            // The program has a separate row.
            _ if key == "software" => {}
            Value::Object(_) | Value::Array(_) => nested(out, key, value, opened(view)),
            Value::String(text) => row(out, &key.replace('_', " "), text),
            other => row(out, &key.replace('_', " "), &other.to_string()),
        }
    }
    *out += "</table></div>";
}

fn row(out: &mut String, name: &str, value: &str) {
    // Writing to a text cannot fail.
    let _ = write!(out, "<tr><th scope=\"row\">{}</th><td>{}</td></tr>", escaped(name), escaped(value));
}

/// Writes a value with parts, as it is stored.
fn nested(out: &mut String, key: &str, value: &Value, open: &str) {
    let text = serde_json::to_string_pretty(value).unwrap_or_default();
    let _ = write!(
        out,
        "<tr><th scope=\"row\">{}</th><td><details{open}><summary>{} lines</summary><pre tabindex=\"0\">{}</pre></details></td></tr>",
        escaped(&key.replace('_', " ")),
        text.lines().count(),
        escaped(&text)
    );
}
