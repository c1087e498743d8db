//! Cells of the tables, and counts of them.

use imu_judge::{ATTITUDE, NAMES, Outcome, POSITION, Score, VELOCITY, score};
use std::ops::Range;

/// Differences of log scores that count as the same: the density per error is 2 % smaller.
const SAME_NATS: f64 = 0.02;
/// What is judged: all errors, then attitude, velocity, position.
pub const PARTS: [Range<usize>; 4] =
    [ATTITUDE..POSITION + 3, ATTITUDE..VELOCITY, VELOCITY..POSITION, POSITION..POSITION + 3];

/// The scores of all filters, in the order of [`NAMES`].
pub struct Judged {
    /// By filter, then by part.
    pub scores: Vec<Vec<Score>>,
}

impl Judged {
    /// Judges the outcomes of all filters by parts; `None` without an outage.
    pub fn new(outcomes: &[Vec<Outcome>], parts: &[Range<usize>]) -> Option<Self> {
        let of = |own: &Vec<Outcome>| parts.iter().map(|part| score(own, part.clone())).collect::<Option<Vec<_>>>();
        Some(Self { scores: outcomes.iter().map(of).collect::<Option<_>>()? })
    }

    /// Returns how much worse a filter's log score is than the best one, nats per error of the first part.
    pub fn behind(&self, filter: usize) -> f64 {
        let best = self.scores.iter().map(|of| of[0].log_score).fold(f64::INFINITY, f64::min);
        self.scores[filter][0].log_score - best
    }

    /// Returns whether a filter's log score is the best or within 2 % of it.
    pub fn is_best(&self, filter: usize) -> bool {
        self.behind(filter) <= SAME_NATS
    }

    /// Returns cells: for each filter the average NEES of each part, with `!` if it is outside its bounds.
    pub fn nees(&self) -> String {
        let cell = |of: &Vec<Score>| {
            let own = |of: &Score| format!("{}{}", number(of.nees), if of.is_consistent() { "" } else { "!" });
            of.iter().map(own).collect::<Vec<_>>().join(" ")
        };
        self.scores.iter().map(cell).collect::<Vec<_>>().join(" | ")
    }

    /// Returns cells: for each filter the coverage of the first part, and how far its log score is behind the best.
    pub fn coverage(&self) -> String {
        let cell = |at: usize| {
            let mark = if self.is_best(at) { "" } else { "!" };
            format!("{:.0} % +{}{mark}", 100.0 * self.scores[at][0].coverage, number(self.behind(at)))
        };
        (0..self.scores.len()).map(cell).collect::<Vec<_>>().join(" | ")
    }
}

/// Prints the head of a table.
pub fn head(first: &str) {
    println!("\n| {first} | {} |\n|---|{}", NAMES.join(" | "), "---|".repeat(NAMES.len()));
}

fn number(of: f64) -> String {
    if of < 9.995 { format!("{of:.2}") } else { format!("{of:.0}") }
}

/// Prints for each filter how many of the worlds, or of recordings, are inside the bounds, and how often its log score is best.
pub fn summary(all: &[Judged], what: &str) {
    for (at, name) in NAMES.iter().enumerate() {
        let count = |holds: &dyn Fn(&Judged) -> bool| all.iter().filter(|of| holds(of)).count();
        let inside = count(&|of| of.scores[at][0].is_consistent());
        let best = count(&|of| of.is_best(at));
        let triads: Vec<bool> =
            all.iter().flat_map(|of| of.scores[at].iter().skip(1).map(Score::is_consistent)).collect();
        let worst = all.iter().map(|of| of.behind(at)).fold(0.0, f64::max);
        println!(
            "{name}: NEES of all errors in its bounds in {inside} of {} {what}, of triads in {} of {}; log score best or within \
             2 % in {best}, at most {worst:.3} nats behind",
            all.len(),
            triads.iter().filter(|of| **of).count(),
            triads.len(),
        );
    }
}
