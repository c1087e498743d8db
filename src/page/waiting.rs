//! Waiting: the page of a job that is not done, or has no result.

use super::{Kind, escaped, framed};

/// Returns a page that shows the state of a job and reloads itself, or shows why there is no result. `state` is the
/// job's, `progress` 0–1.
pub fn waiting(title: &str, state: &str, progress: f64, error: Option<&str>) -> String {
    let ended = matches!(state, "failed" | "cancelled");
    let sentence = match (state, error) {
        (_, Some(error)) => escaped(error),
        ("queued", None) => "it waits for its turn".to_owned(),
        ("running", None) => format!("{:.0} % done", 100.0 * progress),
        (other, None) => escaped(other),
    };
    let title = escaped(title);
    let bar = match ended {
        true => String::new(),
        false => {
            format!("<progress value=\"{}\" aria-label=\"progress of {title}\"></progress>", progress.clamp(0.0, 1.0))
        }
    };
    framed(
        &title,
        if ended { Kind::Served } else { Kind::Renewed(2) },
        &format!("<p class=\"soft\">{title}: {}</p><h1>{sentence}</h1>{bar}", escaped(state)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_of_a_running_job_refreshes_and_that_of_a_failed_one_shows_the_reason() {
        let runs = waiting("diagnosis 7", "running", 0.42, None);
        assert!(runs.contains("42 % done") && runs.contains("http-equiv=\"refresh\""), "{runs}");
        let failed = waiting("diagnosis 7", "failed", 0.0, Some("no <gyro_x>"));
        assert!(failed.contains("no &lt;gyro_x&gt;") && !failed.contains("http-equiv"), "{failed}");
    }
}
