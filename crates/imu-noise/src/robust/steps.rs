//! Steps: levels that change between one sample and the next, and stay or return.
//!
//! The difference of the means of m samples before and after a point is normally distributed for any mixture of N, B
//! and K, with one variance over the whole record: the Allan variance. The robust spread of the difference is the
//! scale; a lasting difference far beyond it is a step.

use super::Part;
use super::event::{Event, Kind};
use super::scale::centre_and_spread;

/// The examined averaging times, s.
const TIMES_S: [f64; 4] = [1.0, 4.0, 16.0, 64.0];
/// Minimum number of averaging times in a record.
const LEAST_TIMES: usize = 40;
/// Differences beyond this many standard deviations are not noise: 3·10⁻⁹ of a normal distribution, and ten times as
/// many if the spread is based on few independent differences.
const LIMIT: f64 = 6.0;

/// Finds steps and bumps.
pub(super) fn find(parts: &[Part], rate_hz: f64) -> Vec<Event> {
    let sums: Vec<Vec<f64>> = parts.iter().map(|part| running_sums(&part.values)).collect();
    let count: usize = parts.iter().map(|part| part.values.len()).sum();
    let mut found: Vec<(Event, f64)> = Vec::new();
    for time_s in TIMES_S {
        let m = ((time_s * rate_hz).round() as usize).max(2);
        if count < LEAST_TIMES * m {
            break;
        }
        at(parts, &sums, rate_hz, m, &mut found);
    }
    found.sort_by(|a, b| a.0.from_s.total_cmp(&b.0.from_s));
    pairs(found)
}

/// Joins two steps that undo each other within a minute to one bump.
fn pairs(found: Vec<(Event, f64)>) -> Vec<Event> {
    /// Maximum time between them, s, and maximum difference of their sizes.
    const WITHIN_S: f64 = 64.0;
    let mut events: Vec<(Event, f64)> = Vec::new();
    for (event, change) in found {
        match events.last_mut() {
            Some((last, before))
                if last.kind == Kind::Step
                    && event.kind == Kind::Step
                    && event.from_s - last.to_s < WITHIN_S
                    && (-2.0..-0.5).contains(&(change / *before)) =>
            {
                last.kind = Kind::Bump;
                last.to_s = event.to_s;
                last.note = format!("the level went away by {before:.3e} and came back");
            }
            _ => events.push((event, change)),
        }
    }
    events.into_iter().map(|(event, _)| event).collect()
}

/// Returns running sums of values less their mean, with a leading 0.
fn running_sums(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let mut sums = Vec::with_capacity(values.len() + 1);
    let mut sum = 0.0;
    sums.push(sum);
    for value in values {
        sum += value - mean;
        sums.push(sum);
    }
    sums
}

fn at(parts: &[Part], sums: &[Vec<f64>], rate_hz: f64, m: usize, found: &mut Vec<(Event, f64)>) {
    let stride = (m / 8).max(1);
    // Mean after less mean before, at every stride-th point.
    let difference =
        |sums: &[f64], middle: usize| (sums[middle + m] - 2.0 * sums[middle] + sums[middle - m]) / m as f64;
    let places: Vec<(usize, usize)> = sums
        .iter()
        .enumerate()
        .flat_map(|(part, sums)| (m..sums.len().saturating_sub(m)).step_by(stride).map(move |middle| (part, middle)))
        .collect();
    let differences: Vec<f64> = places.iter().map(|(part, middle)| difference(&sums[*part], *middle)).collect();
    let Some((centre, spread)) = centre_and_spread(differences.iter().copied()).filter(|(_, spread)| *spread > 0.0)
    else {
        return;
    };
    let independent = (differences.len() * stride / (2 * m)).max(1) as f64;
    // The spread itself is only known to 1.2/√n.
    let limit = LIMIT * (1.0 + 2.0 * 1.2 / independent.sqrt());
    let score = |index: usize| (differences[index] - centre) / spread;
    let mut index = 0;
    while index < differences.len() {
        if score(index).abs() < limit {
            index += 1;
            continue;
        }
        // The largest difference beyond the limit within one averaging time.
        let end = (index..differences.len())
            .take_while(|next| places[*next].0 == places[index].0 && places[*next].1 <= places[index].1 + 2 * m)
            .last()
            .unwrap_or(index);
        let best = (index..=end).max_by(|a, b| score(*a).abs().total_cmp(&score(*b).abs())).unwrap_or(index);
        let (part, middle) = places[best];
        let time_s = parts[part].time_s(middle, rate_hz);
        let reach_s = m as f64 / rate_hz;
        if !found
            .iter()
            .any(|(event, _)| event.from_s - 2.0 * reach_s <= time_s && time_s <= event.to_s + 2.0 * reach_s)
        {
            found.push(event(&sums[part], m, middle, &parts[part], rate_hz, score(best)));
        }
        index = end + 1;
    }
}

/// Returns a step, or a bump if the level returns to the one before.
fn event(sums: &[f64], m: usize, middle: usize, part: &Part, rate_hz: f64, score: f64) -> (Event, f64) {
    let last = sums.len() - 1;
    let mean = |from: usize, to: usize| (to > from).then(|| (sums[to] - sums[from]) / (to - from) as f64);
    let change =
        mean(middle, (middle + m).min(last)).zip(mean(middle.saturating_sub(m), middle)).map_or(0.0, |(a, b)| a - b);
    // The levels two to four averaging times away show whether the step stayed.
    let before = mean(middle.saturating_sub(4 * m), middle.saturating_sub(2 * m));
    let after = mean((middle + 2 * m).min(last), (middle + 4 * m).min(last));
    let stays = before.zip(after).is_none_or(|(before, after)| (after - before) / change > 0.5);
    let at_s = |index: usize| part.time_s(index, rate_hz);
    let margin = (m / 4).max(2);
    let (kind, from, to) = if stays {
        (Kind::Step, middle.saturating_sub(margin), middle + margin)
    } else {
        (Kind::Bump, middle.saturating_sub(2 * m), (middle + 2 * m).min(last))
    };
    let what = if stays { "the level changed by" } else { "the level went away and came back by" };
    let note = format!("{what} {change:.3e}, {:.1} standard deviations over {:.3} s", score.abs(), m as f64 / rate_hz);
    (Event { kind, from_s: at_s(from).max(0.0), to_s: at_s(to), note }, change)
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Noise;
    use super::*;

    fn noise(seed: u64) -> Vec<f64> {
        Noise::new(seed).sensor(120_000, 40.0, 2e-3, 1e-3, 1e-4)
    }

    #[test]
    fn a_step_is_found_where_it_is_and_a_bump_is_no_step() {
        let mut values = noise(31);
        for value in &mut values[50_000..] {
            *value += 0.02;
        }
        for value in &mut values[90_000..90_160] {
            *value += 0.02;
        }
        let found = find(&[Part { start_s: 100.0, values }], 40.0);
        assert!(found.iter().any(|e| e.kind == Kind::Step && e.from_s <= 1350.1 && e.to_s >= 1349.9), "{found:?}");
        assert!(found.iter().any(|e| e.kind == Kind::Bump && e.from_s < 2352.0 && e.to_s > 2350.0), "{found:?}");
        assert!(found.len() <= 3, "{found:?}");
    }

    #[test]
    fn a_steady_ramp_and_pure_noise_have_no_steps() {
        let mut values = noise(32);
        assert!(find(&[Part { start_s: 0.0, values: values.clone() }], 40.0).is_empty());
        for (i, value) in values.iter_mut().enumerate() {
            *value += 1e-6 * i as f64;
        }
        assert!(find(&[Part { start_s: 0.0, values }], 40.0).is_empty());
    }
}
