//! Declared effects: whether a series has the spectral effects of its model, with the model's numbers.

use super::{Candidate, Kind, line, spectral};
use crate::law::{Data, Shape};
use crate::report::Sense;
use crate::series::Series;

/// Returns the gain from leaving each of the model's spectral effects out, or from giving it other numbers if that is
/// worth more than `worth` beyond leaving it out. If `doubtful`, other numbers are searched everywhere, not only near
/// the model's.
pub fn all(series: &Series<'_>, doubtful: bool, worth: impl Fn(Kind) -> f64) -> Vec<Candidate> {
    let declared = series.setting().declared.iter();
    let as_stated = declared.filter(|(place, _)| !series.explanation.without.contains(place));
    as_stated
        .map(|(place, term)| {
            let bare = series.without_declared(*place);
            let left_out = bare.fitted.log_posterior - series.fitted.log_posterior;
            let kind = kind_of(term.shape);
            let near = spectral::with_term(&bare, term.shape, [term.numbers.clone()])
                .map(|found| spectral::candidate(&bare, kind, found));
            let anywhere = if doubtful { of_kind(&bare, kind) } else { None };
            // A line of different skirts is no other effect.
            let leaning = (term.shape == Shape::Resonance && term.numbers.len() == Shape::SYMMETRIC).then(|| {
                let numbers = term.numbers.iter().copied().chain([0.0]).collect();
                spectral::with_term(&bare, term.shape, [numbers]).map(|found| spectral::candidate(&bare, kind, found))
            });
            let leaning = leaning.flatten().map(|of| Candidate { gain: of.gain - Shape::LEANING, ..of });
            let is_filter = matches!(kind, Kind::LowPass | Kind::MovingAverage);
            let is_worth =
                |of: &Candidate| of.gain > worth(kind) && (!is_filter || gain_of_any_levels(&bare, of) > worth(kind));
            let found = near.into_iter().chain(anywhere).chain(leaning).filter(is_worth);
            match found.reduce(|a, b| if b.gain > a.gain { b } else { a }) {
                Some(of) => Candidate { gain: left_out + of.gain, of_model: Some((*place, Sense::Size)), ..of },
                None => Candidate {
                    kind,
                    gain: left_out,
                    of_model: Some((*place, Sense::Superfluous)),
                    explanation: bare.explanation,
                },
            }
        })
        .collect()
}

/// Returns the gain of a filter if B and K may have any size. A filter of another length would stand for levels that are off.
fn gain_of_any_levels(bare: &Series<'_>, of: &Candidate) -> f64 {
    let free = Data { priors: &[None, None, None], ..bare.data() };
    of.explanation.law.fit(free).log_posterior - bare.explanation.law.fit_from_several(free).log_posterior
}

fn of_kind(series: &Series<'_>, kind: Kind) -> Option<Candidate> {
    match kind {
        Kind::QuantizationNoise => spectral::quantization_noise(series),
        Kind::GaussMarkov => spectral::gauss_markov(series),
        Kind::Resonance => line::resonance(series),
        Kind::LowPass => spectral::low_pass(series),
        Kind::MovingAverage => spectral::moving_average(series),
        _ => None,
    }
}

/// Returns the kind of a term.
pub fn kind_of(shape: Shape) -> Kind {
    match shape {
        Shape::QuantizationNoise => Kind::QuantizationNoise,
        Shape::GaussMarkov => Kind::GaussMarkov,
        Shape::Resonance => Kind::Resonance,
        Shape::LowPass(_) => Kind::LowPass,
        Shape::MovingAverage(_) => Kind::MovingAverage,
        Shape::Slope(_) => Kind::Slope,
    }
}
