//! The page of one channel over time: the whole, or a part of it down to single samples.

use super::picture::png;
use super::{Kind, escaped, framed};
use crate::plot::number::rounded;
use std::fmt::Write as _;

/// Shortest part that is offered, s.
const SHORTEST_S: f64 = 0.5;

/// The content of the page.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeriesView<'a> {
    /// The capture's id and name.
    pub capture: (i64, &'a str),
    /// The channel's name.
    pub channel: &'a str,
    /// Its other channels.
    pub others: &'a [&'a str],
    /// How long the capture is, s.
    pub length_s: f64,
    /// The beginning of the shown part, s since the first sample.
    pub from_s: f64,
    /// The end of the shown part, s since the first sample.
    pub to_s: f64,
}

/// Returns the page.
pub fn series(view: &SeriesView<'_>) -> String {
    let SeriesView { capture: (id, name), channel, others, length_s, from_s, to_s } = *view;
    let span_s = (to_s - from_s).max(SHORTEST_S);
    let address = |from: f64, to: f64| {
        let from = from.clamp(0.0, (length_s - SHORTEST_S).max(0.0));
        let to = to.clamp(from + SHORTEST_S, length_s.max(from + SHORTEST_S));
        format!("/captures/{id}/series/{channel}?from={from:.3}&amp;to={to:.3}")
    };
    let steps = [
        ("earlier", from_s - 0.5 * span_s, to_s - 0.5 * span_s),
        ("later", from_s + 0.5 * span_s, to_s + 0.5 * span_s),
        ("closer", from_s + 0.375 * span_s, to_s - 0.375 * span_s),
        ("wider", from_s - 1.5 * span_s, to_s + 1.5 * span_s),
        ("all of it", 0.0, length_s),
    ];
    let steps: Vec<String> = steps
        .iter()
        .map(|(label, from, to)| format!("<a class=\"button\" href=\"{}\">{label}</a>", address(*from, *to)))
        .collect();
    let mut out = format!(
        "<p class=\"soft\">capture <a href=\"/captures/{id}\">{}</a></p><h1>{channel}, {} s to {} s</h1>\
         <nav aria-label=\"part\">{}</nav>\
         <figure><img class=\"zoom\" data-base=\"/captures/{id}/series/{channel}\" data-from=\"{from_s:.9}\" data-to=\"{to_s:.9}\" \
         src=\"/v1/captures/{id}/plots/timeseries-{channel}.svg?from={from_s:.9}&amp;to={to_s:.9}\" width=\"560\" height=\"280\" \
         alt=\"{channel} over time, {} s to {} s\"><figcaption>{}</figcaption></figure>\
         <p class=\"soft\">Drag across the picture to look closer. Where there are more than a thousand samples, the surface reaches \
         from the least to the greatest of each stretch.</p>",
        escaped(name),
        rounded(from_s, 6),
        rounded(to_s, 6),
        steps.join(" "),
        rounded(from_s, 6),
        rounded(to_s, 6),
        png(&format!("/v1/captures/{id}/plots/timeseries-{channel}.svg?from={from_s:.9}&to={to_s:.9}")),
    );
    // Writing to a text cannot fail.
    let _ = write!(out, "<p>The same of");
    for other in others {
        let _ = write!(
            out,
            " <a href=\"/captures/{id}/series/{other}?from={from_s:.3}&amp;to={to_s:.3}\">{}</a>",
            escaped(other)
        );
    }
    let _ = write!(
        out,
        "</p><p><a href=\"/v1/captures/{id}/samples?channels={channel}&amp;from={from_s:.9}&amp;to={to_s:.9}&amp;format=csv\">\
         these samples as CSV</a></p>"
    );
    framed(&format!("{channel} of {name}"), Kind::Served, &out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_stay_inside_the_capture() {
        let view = SeriesView {
            capture: (7, "<script>"),
            channel: "gyro_x",
            others: &["gyro_y"],
            length_s: 100.0,
            from_s: 90.0,
            to_s: 100.0,
        };
        let page = series(&view);
        assert!(page.contains("?from=95.000&amp;to=100.000") && page.contains("?from=75.000&amp;to=100.000"), "{page}");
        assert!(page.contains("?from=0.000&amp;to=100.000") && !page.contains("<script>"), "{page}");
        let png =
            "<a href=\"/v1/captures/7/plots/timeseries-gyro_x.png?from=90.000000000&amp;to=100.000000000\">PNG</a>";
        assert!(page.contains(png), "{page}");
    }
}
