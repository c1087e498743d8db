//! Bands: the frequencies at which a found effect gains likelihood.

use super::course::Course;
use super::evidence::Kind;
use super::evidence::declared::kind_of;
use super::law::Fitted;
use super::report::Sense;
use super::series::Series;
use super::steps::Step;
use std::collections::BTreeMap;

/// A band in which the effect raises the likelihood of a series.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Band {
    /// The ends of the band.
    pub(super) hz: [f64; 2],
    /// Nats gained in the band.
    pub(super) nats: f64,
    /// Whether the series is louder in the band than without the effect.
    pub(super) is_louder: bool,
}

/// The bands of the effects found on a channel.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub(super) struct Bands {
    /// The bands of spectral effects and of courses of the level.
    pub(super) kinds: BTreeMap<Kind, Band>,
    /// The bands of N, B and K against the model's values.
    pub(super) levels: [Option<Band>; 3],
}

/// A band holds this part of the gain of its effect.
const HELD: f64 = 0.9;

impl Bands {
    /// Returns the bands of an explained series. `declared`: the model's courses; `held`: the law fitted with N, B or K
    /// held at the model's value; `free`: with none held.
    pub(super) fn of(
        series: &Series<'_>,
        steps: &[Step],
        declared: &[(Course, f64)],
        free: &Fitted,
        held: &[Fitted; 3],
    ) -> Self {
        let terms = &series.explanation.law.terms;
        // The gain of an effect, all else unchanged.
        let whole = &series.fitted.logarithms;
        let of_term = |place: usize| {
            let mut law = series.explanation.law.clone();
            let term = law.terms.remove(place);
            Some((kind_of(term.shape), likelier(series, whole, &law.logarithms(series.data()))?))
        };
        // The difference from the model, against the model's own terms.
        let of_model = |step: &Step| {
            let (place, sense) = step.of_model?;
            let mut law = series.explanation.law.clone();
            if sense == Sense::Size {
                let own = terms.iter().rposition(|term| kind_of(term.shape) == step.kind)?;
                law.terms.remove(own);
            }
            Some((step.kind, likelier(series, whole, &series.logarithms_with_declared(place, &law))?))
        };
        let of_course = |kind: Kind, wanted: fn(&Course) -> bool| {
            let own = series.explanation.courses.iter().chain(declared).filter(|(course, _)| wanted(course));
            Some((kind, slowest(series, own)?))
        };
        let courses = [
            of_course(Kind::RateRamp, |of| *of == Course::Ramp),
            of_course(Kind::TemperatureBias, |of| *of == Course::Temperature),
            of_course(Kind::TemperatureCurve, |of| matches!(of, Course::Follows(_))),
            of_course(Kind::WarmUp, |of| matches!(of, Course::WarmUp(_))),
            of_course(Kind::BiasStep, |of| matches!(of, Course::Step(_))),
        ];
        let kinds = (0..terms.len()).filter_map(of_term).chain(steps.iter().filter_map(of_model));
        Self {
            kinds: kinds.chain(courses.into_iter().flatten()).collect(),
            levels: held.each_ref().map(|held| likelier(series, &free.logarithms, &held.logarithms)),
        }
    }
}

/// Returns the shortest band with most of what one spectrum gains over another in total likelihood. Both are given as
/// logarithms; only bands that gain count.
fn likelier(series: &Series<'_>, with: &[f64], without: &[f64]) -> Option<Band> {
    let counts = series.data().worth;
    let edges = &series.grid.edges;
    let logarithms = with.iter().zip(without);
    let gains: Vec<f64> = logarithms
        .clone()
        .zip(counts.iter().zip(&series.power))
        .map(|((one, other), (count, power))| 0.5 * count * ((other - one) + power * ((-other).exp() - (-one).exp())))
        .collect();
    let [from, to] = shortest_with(&gains, HELD)?;
    let changes: Vec<f64> = logarithms.map(|(one, other)| one - other).collect();
    let louder: f64 = changes[from..to].iter().zip(&gains[from..to]).map(|(change, gain)| change.signum() * gain).sum();
    Some(Band {
        hz: [hz(series, edges[from]), hz(series, edges[to])],
        nats: gains[from..to].iter().sum(),
        is_louder: louder > 0.0,
    })
}

/// Returns the band from 0 that holds most of the energy of the level's courses relative to the law.
fn slowest<'a>(series: &Series<'_>, own: impl Iterator<Item = &'a (Course, f64)>) -> Option<Band> {
    let mut sum = vec![0.0; super::course::Courses::KEPT.min(series.len())];
    for (course, factor) in own {
        let column = series.setting().courses.coefficients(*course);
        sum.iter_mut().zip(column).for_each(|(all, one)| *all += factor * one);
    }
    let energies: Vec<f64> = sum.iter().zip(&series.spectrum).map(|(c, s)| 0.5 * c * c / s).collect();
    let total: f64 = energies.iter().sum();
    let mut held = 0.0;
    let to = energies.iter().position(|energy| {
        held += energy;
        held > HELD * total
    })?;
    Some(Band { hz: [0.0, hz(series, to + 1)], nats: held, is_louder: true })
}

/// Returns the frequency of a coefficient of the transform.
fn hz(series: &Series<'_>, coefficient: usize) -> f64 {
    coefficient as f64 * series.setting().rate_hz / (2.0 * series.len() as f64)
}

/// Returns the shortest run of neighbours with a given part of the largest sum of a run. `None` if all lose.
fn shortest_with(gains: &[f64], part: f64) -> Option<[usize; 2]> {
    let (mut best, mut span) = (0.0, None);
    let (mut sum, mut start) = (0.0, 0);
    for (at, gain) in gains.iter().enumerate() {
        if sum <= 0.0 {
            (sum, start) = (0.0, at);
        }
        sum += gain;
        if sum > best {
            (best, span) = (sum, Some([start, at + 1]));
        }
    }
    let [first, last] = span?;
    // Moves the ends of the best run inwards as long as enough remains.
    let (mut from, mut to, mut left) = (first, last, best);
    loop {
        let (low, high) = (gains[from], gains[to - 1]);
        let (cheaper, is_low) = if low <= high { (low, true) } else { (high, false) };
        if to - from <= 1 || left - cheaper < part * best {
            return Some([from, to]);
        }
        left -= cheaper;
        if is_low {
            from += 1;
        } else {
            to -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortest_run_that_holds_most_is_found() {
        assert_eq!(shortest_with(&[-1.0, 0.1, 5.0, 5.0, 0.2, -3.0, 2.0], 0.9), Some([2, 4]));
        assert_eq!(shortest_with(&[0.0, 8.0, -1.0, 8.0], 0.9), Some([1, 4]));
        assert_eq!(shortest_with(&[-1.0, -2.0], 0.9), None);
        assert_eq!(shortest_with(&[], 0.9), None);
    }
}
