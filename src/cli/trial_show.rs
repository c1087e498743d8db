//! Prints the result of a trial on a terminal.

use super::figures::counted;
use super::table;
use imu_trial::page::{limit, percent, size};
use imu_trial::score::Miss;
use imu_trial::{Score, Sense, Suite};
use std::io::Write as _;

/// Maximum number of misses listed on a terminal; JSON and page have all.
const MISSES_SHOWN: usize = 12;

/// Prints a score.
pub(super) fn show(score: &Score) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    let classes: Vec<String> = score.classes.iter().map(|(name, count)| format!("{count} {name}")).collect();
    let cases = counted(score.cases as u64, "case", "cases");
    writeln!(stdout, "{cases} of seed {}: {}", score.seed, classes.join(", "))?;
    if let Some(suite) = score.suite.and_then(Suite::named) {
        writeln!(stdout, "{}", suite.described(&score.manifest_sha256))?;
    }
    if let Some(on) = &score.on {
        writeln!(
            stdout,
            "imposed on {} in {}; {} its own and set aside, {} of {} called unknown as they are",
            on.recording,
            counted(on.stretches as u64, "stretch", "stretches"),
            counted(on.own_causes as u64, "cause is", "causes are"),
            on.own_unknown.count,
            counted(on.own_unknown.of as u64, "case is", "cases are")
        )?;
    }
    let mut rows = table(&["", "", "count", "share (95 %)"]);
    for one in score.rates.stated() {
        let rate = one.rate;
        rows.add_row([
            one.name.to_owned(),
            one.meaning.to_owned(),
            format!("{} of {}", rate.count, rate.of),
            percent(rate),
        ]);
    }
    writeln!(stdout, "{rows}")?;
    if let Some(places) = score.false_places {
        writeln!(stdout, "false places per record: {places:.2}")?;
    }
    let mut rows = table(&["effect alone", "cases", "first", "unknown", "spurious", "closed", "90 % at"]);
    for of in &score.kinds {
        let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| format!("{value:.2}"));
        rows.add_row([
            of.kind.name().to_owned(),
            of.unknown.of.to_string(),
            if of.library { of.right_first.count.to_string() } else { "–".to_owned() },
            of.unknown.count.to_string(),
            if of.library { of.spurious.count.to_string() } else { "–".to_owned() },
            number(of.closed),
            number(of.size_90),
        ]);
    }
    writeln!(stdout, "{rows}")?;
    show_detection(&mut stdout, score)?;
    show_confidence(&mut stdout, score)?;
    for miss in score.misses.iter().take(MISSES_SHOWN) {
        writeln!(stdout, "{}", missed(miss))?;
    }
    let more = score.misses.len().saturating_sub(MISSES_SHOWN);
    if more > 0 { writeln!(stdout, "and {more} more: --json, --html or --out has them") } else { Ok(()) }
}

/// Returns a case with a wrong result, as a line.
fn missed(miss: &Miss) -> String {
    let has = |(kind, sense): (&imu_trial::Kind, &Sense)| match sense {
        Sense::Missing => kind.name().to_owned(),
        Sense::Superfluous => format!("{kind} superfluous"),
        Sense::Size => format!("{kind} of another size"),
        Sense::Elsewhere => format!("{kind} elsewhere"),
        Sense::Known => format!("{kind}, as the model says"),
    };
    let has: Vec<String> = miss.kinds.iter().zip(&miss.senses).map(has).collect();
    let has = if has.is_empty() { "none".to_owned() } else { has.join(" and ") };
    let size = miss.over_limit.map_or_else(String::new, |size| format!(" at {size:.1} times the limit"));
    let named: Vec<&str> = miss.named.iter().map(|cause| cause.effect.as_str()).collect();
    let named = miss.refusal.clone().unwrap_or_else(|| {
        if named.is_empty() { "nothing named".to_owned() } else { format!("named {}", named.join(", ")) }
    });
    format!("case {}: {has}{size}; {}, {named}", miss.case, miss.verdict)
}

/// Prints how many of each size were named first, and from which size on.
fn show_detection(out: &mut impl std::io::Write, score: &Score) -> std::io::Result<()> {
    let library = || score.kinds.iter().filter_map(|of| Some((of, of.detection.as_ref()?)));
    let Some((first, _)) = library().next() else { return Ok(()) };
    let mut head = vec!["size over limit".to_owned()];
    head.extend(first.curve.iter().map(|bin| bin.label()));
    let mut rows = table(&head.iter().map(String::as_str).collect::<Vec<_>>());
    for (of, _) in library() {
        let mut row = vec![of.kind.name().to_owned()];
        row.extend(of.curve.iter().map(|bin| match bin.right.of {
            0 => "–".to_owned(),
            all => format!("{}/{all}", bin.right.count),
        }));
        rows.add_row(row);
    }
    writeln!(out, "{rows}")?;
    let mut rows = table(&["named first", "50 % at (95 %)", "90 % at (95 %)", "bound", "size"]);
    for (of, at) in library() {
        let bound = at.bound_90.map_or_else(|| "–".to_owned(), size);
        rows.add_row([of.kind.name().to_owned(), limit(at.size_50), limit(at.size_90), bound, at.unit.to_owned()]);
    }
    writeln!(out, "{rows}")
}

/// Prints which part of the causes with a confidence was right.
fn show_confidence(out: &mut impl std::io::Write, score: &Score) -> std::io::Result<()> {
    let mut rows = table(&["stated confidence", "mean", "causes", "right (95 %)"]);
    for bin in score.reliability.iter().filter(|bin| bin.right.of > 0) {
        let mean = bin.mean.map_or_else(|| "–".to_owned(), |mean| format!("{mean:.3}"));
        rows.add_row([bin.label(), mean, bin.right.of.to_string(), percent(bin.right)]);
    }
    let of = &score.calibration;
    let (Some(stated), Some(error)) = (of.mean_confidence, of.expected_error) else { return Ok(()) };
    writeln!(out, "{rows}")?;
    writeln!(out, "stated {stated:.3} on average, right {}; expected calibration error {error:.3}", percent(of.right))
}
