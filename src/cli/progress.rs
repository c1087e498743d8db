//! Progress bars: on a terminal's standard error, hidden elsewhere.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal as _;

/// The template for a command that writes samples.
pub(super) const SAMPLES: &str = "{bar:30} {percent} % · {human_pos} of {human_len} samples · {eta} left";

/// Returns a bar with this template (indicatif's) and this length, which may be set later.
pub(super) fn bar(template: &str, length: u64) -> ProgressBar {
    let target =
        if std::io::stderr().is_terminal() { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let bar = ProgressBar::with_draw_target(Some(length), target);
    // A template that indicatif does not understand leaves its default.
    match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_goes_to_its_length() {
        assert!(ProgressStyle::with_template(SAMPLES).is_ok());
        let bar = bar(SAMPLES, 7);
        bar.inc(3);
        assert_eq!((bar.position(), bar.length()), (3, Some(7)));
    }
}
