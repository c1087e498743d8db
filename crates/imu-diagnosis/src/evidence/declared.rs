//! Declared effects: whether a series has the spectral effects of its model, with the model's numbers.

use super::{Candidate, Kind, line, spectral};
use crate::law::Shape;
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
            let found = near.into_iter().chain(anywhere).chain(leaning);
            let otherwise = found.reduce(|a, b| if b.gain > a.gain { b } else { a });
            match otherwise.filter(|of| of.gain > worth(kind)) {
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
