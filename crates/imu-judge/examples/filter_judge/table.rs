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
    /// By filter, then by part; `None` for a filter that assumes no noise at all on some axis.
    pub scores: Vec<Option<Vec<Score>>>,
}

impl Judged {
    /// Judges the outcomes of all filters by parts.
    pub fn new(outcomes: &[Vec<Outcome>], parts: &[Range<usize>]) -> Self {
        let of = |own: &Vec<Outcome>| parts.iter().map(|part| score(own, part.clone())).collect();
        Self { scores: outcomes.iter().map(of).collect() }
    }

    /// Returns the number of outages and the bounds, by part.
    pub fn bounds(&self) -> Option<(usize, Vec<[f64; 2]>)> {
        let first = self.scores.iter().flatten().next()?;
        Some((first.first()?.outages, first.iter().map(|of| of.bounds).collect()))
    }

    /// Returns how much worse a filter's log score is than the best one, nats per error of the first part.
    pub fn behind(&self, filter: usize) -> Option<f64> {
        let best = self.scores.iter().flatten().map(|of| of[0].log_score).fold(f64::INFINITY, f64::min);
        self.scores[filter].as_ref().map(|of| of[0].log_score - best)
    }

    /// Returns whether a filter's log score is the best or within 2 % of it.
    pub fn is_best(&self, filter: usize) -> bool {
        self.behind(filter).is_some_and(|nats| nats <= SAME_NATS)
    }

    /// Returns whether the average NEES of each part is within its bounds.
    pub fn consistent(&self, filter: usize) -> Vec<bool> {
        self.scores[filter].iter().flatten().map(Score::is_consistent).collect()
    }

    /// Returns cells: for each filter the average NEES of each part, with `!` if it is outside its bounds.
    pub fn nees(&self) -> String {
        let own = |of: &Score| format!("{}{}", number(of.nees), if of.is_consistent() { "" } else { "!" });
        self.cells(|_, of| of.iter().map(own).collect::<Vec<_>>().join(" "))
    }

    /// Returns cells: for each filter the coverage of the first part, and how far its log score is behind the best.
    pub fn coverage(&self) -> String {
        self.cells(|at, of| {
            let mark = if self.is_best(at) { "" } else { "!" };
            format!("{:.0} % +{}{mark}", 100.0 * of[0].coverage, number(self.behind(at).unwrap_or(f64::INFINITY)))
        })
    }

    fn cells(&self, cell: impl Fn(usize, &Vec<Score>) -> String) -> String {
        let all = self.scores.iter().enumerate();
        let all = all.map(|(at, of)| of.as_ref().map_or_else(|| "–!".to_owned(), |of| cell(at, of)));
        all.collect::<Vec<_>>().join(" | ")
    }
}

/// Prints the head of a table.
pub fn head(first: &str) {
    println!("\n| {first} | {} |\n|---|{}", NAMES.join(" | "), "---|".repeat(NAMES.len()));
}

fn number(of: f64) -> String {
    if of < 9.995 { format!("{of:.2}") } else { format!("{of:.0}") }
}

/// Prints for each filter how many of the worlds are inside the bounds, and how often its log score is best.
pub fn summary(all: &[Judged]) {
    for (at, name) in NAMES.iter().enumerate() {
        let found: Vec<Vec<bool>> = all.iter().map(|of| of.consistent(at)).collect();
        let whole = found.iter().filter(|of| of.first() == Some(&true)).count();
        let triads = found.iter().flat_map(|of| of.iter().skip(1)).filter(|of| **of).count();
        let best = all.iter().filter(|of| of.is_best(at)).count();
        let worst = all.iter().filter_map(|of| of.behind(at)).fold(0.0, f64::max);
        println!(
            "{name}: NEES of all errors in its bounds in {whole} of {}, of a triad in {triads} of {}; log score best or within 2 % \
             in {best}, at most {worst:.3} nats behind",
            all.len(),
            3 * all.len(),
        );
    }
}
