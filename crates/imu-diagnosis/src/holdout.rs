//! Holdout: how far the discrepancy shrinks, measured on the half of a record from which no number was fitted.

use super::course::{Course, Courses};
use super::explanation::{Explanation, LOUD, Loud};
use super::gated::Stays;
use super::law::Law;
use super::series::{Series, Setting};
use super::transform::Cosines;

/// Blocks of time in which densities are summed, for the bootstrap.
pub const BLOCKS: usize = 64;
/// Nats lost by a sine's phase, which cannot be predicted.
const PHASE: f64 = 4.0;

/// Logarithm of the density of the second half's samples, nats, in [`BLOCKS`] blocks.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Scores {
    /// Under the declared model.
    pub declared: Vec<f64>,
    /// With the levels that the first half fitted beside the effects, but without the effects.
    pub parameters: Vec<f64>,
    /// With all effects that were found; with numbers from the first half.
    pub effects: Vec<f64>,
    /// With all effects that were found; with numbers from the second half itself. This is a ceiling, too high by half
    /// a nat per number.
    pub ceiling: Vec<f64>,
    /// The number of fitted numbers.
    pub numbers: usize,
    /// The number of samples.
    pub samples: usize,
}

/// The halves of a record: data that all channels share.
#[derive(Debug)]
pub struct Halves {
    /// First sample and one past the last.
    ranges: [(usize, usize); 2],
    transforms: [Cosines; 2],
    courses: [Courses; 2],
}

impl Halves {
    /// Returns the halves of a record of `samples`. `temperature` is about its mean; `lag` is the lag behind which a
    /// level follows its rate, samples.
    pub fn new(samples: usize, temperature: Option<&[f64]>, lag: f64) -> Self {
        let middle = samples / 2;
        let ranges = [(0, middle), (middle, samples)];
        let mut transforms = ranges.map(|(from, to)| Cosines::new(to - from));
        let mut at = 0;
        let courses = ranges.map(|(from, to)| {
            at += 1;
            Courses::new(&mut transforms[at - 1], temperature.map(|t| &t[from..to]), lag)
        });
        Self { ranges, transforms, courses }
    }
}

/// The data of a half.
#[derive(Clone, Copy)]
pub struct Whole<'a> {
    /// The samples.
    pub samples: &'a [f64],
    /// The halves.
    pub halves: &'a Halves,
    /// The data of the whole record.
    pub setting: Setting<'a>,
    /// The model's own explanation.
    pub known: &'a Explanation,
    /// The complete explanation that was found.
    pub found: &'a Explanation,
    /// Its bands that come and go.
    pub stays: &'a [Stays],
}

/// Returns the structure of an explanation on the part of the record from `from` to `to`, with the numbers of the whole
/// as they apply there.
fn part(of: &Explanation, from: usize, to: usize, whole: usize) -> Explanation {
    let n = to - from;
    let mut part = of.clone();
    part.courses = of
        .courses
        .iter()
        .filter_map(|(course, factor)| match *course {
            Course::Ramp => Some((Course::Ramp, factor * n as f64 / whole as f64)),
            Course::Temperature | Course::Follows(_) => Some((*course, *factor)),
            Course::WarmUp(tau) => Some((Course::WarmUp(tau), factor * (-(from as f64) / tau).exp())),
            Course::Step(at) => (at > from && at < to).then(|| (Course::Step(at - from), *factor)),
        })
        .collect();
    part.sines.iter_mut().for_each(|sine| sine.quadratures = sine.later(from));
    part.gated = of.gated.iter().map(|sine| sine.part(from, to)).collect();
    part.outliers = of.outliers.iter().filter(|t| (from..to).contains(*t)).map(|t| t - from).collect();
    part.loud = of
        .loud
        .iter()
        .filter(|loud| loud.to > from && loud.from < to)
        .map(|loud| Loud { from: loud.from.max(from) - from, to: loud.to.min(to) - from, ratio: loud.ratio })
        .collect();
    if let Some(super::explanation::Scedasticity::Profile(values)) = &of.scedasticity {
        let at =
            |share: f64| super::explanation::profile(values, (from as f64 + share * (n - 1) as f64) as usize, whole);
        let count = values.len().max(2);
        let cut = (0..count).map(|index| at(index as f64 / (count - 1) as f64)).collect();
        part.scedasticity = Some(super::explanation::Scedasticity::Profile(cut));
    }
    part
}

/// Returns the parts of the density that the whitened residual does not include: spikes, tails, and phases that cannot
/// be predicted.
fn besides(series: &Series<'_>, known: &Explanation, found: &Explanation, carried: usize) -> f64 {
    let explanation = &series.explanation;
    let n = series.len() as f64;
    let mut sum = -PHASE * explanation.sines.len().saturating_sub(known.sines.len()) as f64;
    let steps = |of: &Explanation| of.courses.iter().filter(|(course, _)| matches!(course, Course::Step(_))).count();
    let stays = |of: &Explanation| of.gated.iter().map(|sine| sine.stays.len()).sum::<usize>();
    sum -= (2.0 * n.ln() + 3.0 + PHASE) * stays(explanation).saturating_sub(stays(known)) as f64;
    sum -= (n.ln() + 3.0) * steps(explanation).saturating_sub(steps(known)) as f64;
    let new = |of: &'_ Explanation, other: &Explanation| -> Vec<Loud> {
        let is_in = |loud: &&Loud| other.loud.iter().any(|one| (one.from, one.to) == (loud.from, loud.to));
        of.loud.iter().filter(|loud| !is_in(loud)).copied().collect()
    };
    let own = new(explanation, known);
    sum -= (2.0 * n.ln() + 3.0) * own.len() as f64;
    // Loud stretches were replaced by noise of the law: the density of each of their samples is lower by the factor by which the
    // stretch is louder.
    for loud in own.iter().filter(|loud| loud.ratio > LOUD) {
        sum -= 0.5 * (loud.to - loud.from) as f64 * loud.ratio.ln();
    }
    // The same applies to the model's stretches that the record lacks: usual noise is rare at places where it should be
    // loud.
    for loud in new(known, found).iter().filter(|loud| loud.ratio > LOUD && explanation.loud.contains(loud)) {
        sum -= 0.5 * (loud.to - loud.from) as f64 * (loud.ratio.ln() + 1.0 / loud.ratio - 1.0);
    }
    if let Some(spikes) = explanation.spikes {
        let flagged = explanation.outliers.len().saturating_sub(carried) as f64 / spikes.samples.max(1) as f64;
        // Each spike costs its place and has the wide density; the value that stands for it was counted as noise.
        let (rate, variance) = (spikes.rate.clamp(1e-9, 0.5), spikes.variance);
        sum += flagged * (rate.ln() - 0.5 * variance.ln()) + (n - flagged) * (-rate).ln_1p();
    }
    if let Some(degrees) = explanation.tails {
        sum += series.nats_of_tails(degrees);
    }
    sum
}

/// Returns ln of the density of all samples under their explanation, nats.
pub(super) fn nats(series: &Series<'_>, known: &Explanation) -> f64 {
    let found = &series.explanation;
    series.density(1).iter().sum::<f64>() + besides(series, known, found, known.outliers.len())
}

/// Scores the second half.
pub fn scores(whole: Whole<'_>) -> Scores {
    /// Ratio of the shares of a band that is absent from the first half.
    const ABSENT: f64 = 100.0;
    let total = whole.samples.len();
    let middle = total / 2;
    let Halves { ranges: halves, transforms, courses } = whole.halves;
    // A half names no effects.
    let setting = |half: usize| Setting { courses: &courses[half], bursts: &[], ..whole.setting };
    let (first, second) = (setting(0), setting(1));
    let samples = |half: usize| whole.samples[halves[half].0..halves[half].1].to_vec();
    let known = |half: usize| part(whole.known, halves[half].0, halves[half].1, total);
    let share = |stays: &Stays, half: usize| stays.share(halves[half].0, halves[half].1);
    let found = |half: usize| {
        let mut found = part(whole.found, halves[half].0, halves[half].1, total);
        for stays in whole.stays {
            found.law.terms[stays.term].numbers[0] += (share(stays, half) / stays.share(0, total)).ln();
        }
        found
    };
    let carried = known(1).outliers.len();
    let scored = |series: &Series<'_>, known: &Explanation| {
        let more = besides(series, known, &found(1), carried) / BLOCKS as f64;
        series.density(BLOCKS).into_iter().map(|sum| sum + more).collect::<Vec<f64>>()
    };
    let declared = scored(&Series::frozen(&second, transforms[1].clone(), samples(1), known(1)), &known(1));
    let best = Series::new(&second, transforms[1].clone(), samples(1), found(1));
    let numbers = 3
        + best.explanation.law.terms.iter().map(|term| term.numbers.len()).sum::<usize>()
        + best.explanation.courses.len()
        + 3 * best.explanation.sines.len()
        + best.explanation.gated.iter().map(|sine| 1 + 4 * sine.stays.len()).sum::<usize>();
    let ceiling = scored(&best, &known(1));
    let samples_scored = total - middle;
    let full = Series::new(&first, transforms[0].clone(), samples(0), found(0));
    let quiet = full.average_variance().ln();
    let full = full.explanation;
    // The levels of the first half, fitted beside the effects: without them they would take an effect's part.
    let mut levels = Law { levels: full.law.levels, ..known(1).law };
    levels.levels[0] -= quiet;
    let with_levels = Explanation { law: levels, ..known(1) };
    let parameters = scored(&Series::frozen(&second, transforms[1].clone(), samples(1), with_levels), &known(1));
    if whole.found.adds_nothing_to(whole.known) {
        return Scores { declared, effects: parameters.clone(), parameters, ceiling, numbers, samples: samples_scored };
    }
    let mut carried_over = found(1);
    let of_second = std::mem::replace(&mut carried_over.law, full.law.clone());
    for stays in whole.stays {
        let ratio = share(stays, 1) / share(stays, 0);
        // A half without the band shows nothing of it.
        match ratio < ABSENT {
            true => carried_over.law.terms[stays.term].numbers[0] += ratio.ln(),
            false => carried_over.law.terms[stays.term] = of_second.terms[stays.term].clone(),
        }
    }
    for (course, factor) in &mut carried_over.courses {
        let alike = |other: &Course| match (other, &*course) {
            (Course::Follows(one), Course::Follows(other)) => one == other,
            (one, other) => std::mem::discriminant(one) == std::mem::discriminant(other),
        };
        let same = full.courses.iter().find(|(other, _)| alike(other));
        match (*course, same) {
            (Course::Ramp, Some((_, learned))) => {
                *factor = learned * (halves[1].1 - halves[1].0) as f64 / (halves[0].1 - halves[0].0) as f64;
            }
            (Course::Temperature | Course::Follows(_), Some((_, learned))) => *factor = *learned,
            (Course::WarmUp(tau), Some((_, learned))) => *factor = learned * (-(middle as f64) / tau).exp(),
            _ => {}
        }
    }
    for (sine, learned) in carried_over.sines.iter_mut().zip(&full.sines) {
        sine.rescale(learned.amplitude());
    }
    for (sine, learned) in carried_over.gated.iter_mut().zip(&full.gated) {
        // A half without stays shows no amplitude.
        if !learned.stays.is_empty() {
            sine.rescale(learned.square().sqrt());
        }
    }
    // The white noise at times when nothing changes it is the same in both.
    carried_over.law.levels[0] -= quiet;
    let effects = scored(&Series::frozen(&second, transforms[1].clone(), samples(1), carried_over), &known(1));
    Scores { declared, parameters, effects, ceiling, numbers, samples: samples_scored }
}
