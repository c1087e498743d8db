//! Courses: a model's drifts, steps and changes of variance, compared with those of a channel.

use crate::averages::mean;
use crate::course::{Course, Follow};
use crate::evidence::Kind;
use crate::evidence::loudness;
use crate::explanation::{Explanation, Scedasticity};
use crate::prepared::Prepared;
use crate::prices::Prices;
use crate::series::{Series, Setting};
use crate::spread::Spread;
use crate::transform::Cosines;
use imu_model::effects::temperature_bias::RATE_LAG_S;
use imu_model::effects::{Effect, EffectKind};
use imu_model::simulator::ChannelModel;
use std::collections::BTreeMap;

/// An effect of the model that the channel does not have with the model's numbers.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Off {
    /// Its place in the model's list.
    pub(crate) place: usize,
    /// Nats gained by the channel's own size of the effect over the model's size.
    pub(crate) otherwise: f64,
}

/// Returns the explanation with the effects about which the model is right.
pub(crate) fn as_declared(of: &Prepared) -> Explanation {
    Explanation {
        courses: of.shifts.iter().map(|(_, course, factor)| (*course, *factor)).collect(),
        sines: of.sines.clone(),
        outliers: of.outliers.clone(),
        loud: of.loud.iter().map(|(_, loud)| *loud).collect(),
        scedasticity: of.scedasticity.as_ref().map(|(_, of)| of.clone()),
        limits: of.limits,
        ..Explanation::noise(of.declared.clone())
    }
}

/// Returns the model's effects that are off by more than their price. Sizes are normal about the true ones.
pub(crate) fn off(setting: &Setting<'_>, transform: &Cosines, of: &Prepared, prices: &Prices) -> Vec<Off> {
    let mut nats: BTreeMap<usize, f64> = BTreeMap::new();
    let mut add = |place: usize, kind: Kind, otherwise: f64| {
        if otherwise > prices.of(kind) {
            *nats.entry(place).or_default() += otherwise;
        }
    };
    let series = |start| Series::new(setting, transform.clone(), of.samples.clone(), start);
    if !of.shifts.is_empty() {
        let fitted = series(as_declared(of));
        let errors = Spread::of(&fitted).courses;
        let own = fitted.explanation.courses.iter().zip(&of.shifts).zip(&errors);
        for (((_, factor), (place, course, declared)), (error, _)) in own {
            let kind = match course {
                Course::Ramp => Kind::RateRamp,
                Course::WarmUp(_) => Kind::WarmUp,
                Course::Step(_) => Kind::BiasStep,
                Course::Temperature | Course::Follows(_) => Kind::TemperatureBias,
            };
            if *error > 0.0 {
                add(*place, kind, 0.5 * ((factor - declared) / error).powi(2));
            }
            if let Course::WarmUp(tau) = course {
                add(*place, kind, of_another_time(setting, transform, of, *place, *tau));
            }
        }
    }
    if !of.loud.is_empty() || of.scedasticity.is_some() {
        let even = series(Explanation { loud: Vec::new(), scedasticity: None, ..as_declared(of) });
        variance_off(&even, of, &mut add);
    }
    nats.into_iter().map(|(place, otherwise)| Off { place, otherwise }).collect()
}

/// Calls `add` with place, kind and nats of each of the model's changes of variance. `even` is the series without such
/// changes.
fn variance_off(even: &Series<'_>, of: &Prepared, add: &mut impl FnMut(usize, Kind, f64)) {
    if let Some((place, declared)) = &of.scedasticity {
        let (kind, shape): (Kind, Vec<f64>) = match declared {
            Scedasticity::PerDegree(slope) => {
                let temperature = even.setting().courses.temperature().unwrap_or_default();
                (Kind::VariancePerDegree, temperature.iter().map(|t| slope * t).collect())
            }
            Scedasticity::Profile(values) => {
                let n = even.len();
                let at = |t: usize| crate::explanation::profile(values, t, n);
                (Kind::VarianceProfile, (0..n).map(at).collect())
            }
        };
        // Without a temperature, the record does not show effects that follow it.
        if shape.len() == even.len() {
            add(*place, kind, loudness::otherwise(even, &shape));
        }
    }
    let residual = even.scores();
    let mut is_loud = vec![false; residual.len()];
    of.loud.iter().for_each(|(_, loud)| is_loud[loud.from..loud.to].fill(true));
    let outside = residual.iter().zip(&is_loud).filter(|(_, is_loud)| !**is_loud);
    let outside: Vec<f64> = outside.map(|(e, _)| e * e).collect();
    let count = outside.len() as f64;
    let mean = outside.iter().sum::<f64>() / f64::max(count, 1.0);
    // Spikes and tails make a mean of squares less certain than a mean of squares of normal noise.
    let fourth = outside.iter().map(|square| square.min(1e3 * mean).powi(2)).sum::<f64>() / f64::max(count, 1.0);
    let certain = 2.0 / (fourth / (mean * mean).max(f64::MIN_POSITIVE) - 1.0).max(2.0);
    for (place, loud) in &of.loud {
        let own = residual[loud.from..loud.to].iter().map(|e| e * e).sum::<f64>();
        let samples = (loud.to - loud.from) as f64;
        let kind = if loud.is_interval(residual.len(), &of.bursts) { Kind::VarianceInterval } else { Kind::Bursts };
        // For k squares of variance v with mean m, the likeliest v is m, by k/2·(m/v − 1 − ln m/v) nats.
        let ratio = (own / samples) / mean.max(f64::MIN_POSITIVE) / loud.ratio;
        let ratio = ratio.max(1e-9);
        let shared = certain * samples * count / (samples + count).max(1.0);
        add(*place, kind, 0.5 * shared * (ratio - 1.0 - ratio.ln()));
    }
}

/// Returns the nats gained by the likeliest of several other time constants over the model's, with free amplitude in
/// both.
fn of_another_time(setting: &Setting<'_>, transform: &Cosines, of: &Prepared, place: usize, tau: f64) -> f64 {
    const FACTORS: [f64; 8] = [0.03, 0.1, 0.3, 0.6, 1.7, 3.0, 10.0, 30.0];
    let mut others = of.clone();
    others.shifts.retain(|(own, ..)| *own != place);
    let bare = Series::new(setting, transform.clone(), of.samples.clone(), as_declared(&others));
    let gain = |factor: f64| bare.with_courses(&[Course::WarmUp(factor * tau)]).gain;
    FACTORS.into_iter().map(gain).fold(f64::NEG_INFINITY, f64::max) - gain(1.0)
}

/// Removes effects that are off from a channel's known effects, so that the search finds the channel's own effects
/// instead.
pub(crate) fn strip(of: &mut Prepared, off: &[Off]) {
    let is_off = |place: usize| off.iter().any(|of| of.place == place);
    of.shifts.retain(|(place, ..)| !is_off(*place));
    of.loud.retain(|(place, _)| !is_off(*place));
    if of.scedasticity.take_if(|(place, _)| is_off(*place)).is_some() {
        // The N is then the one at the record's temperature.
        of.declared.levels[0] -= std::mem::take(&mut of.white_shift);
    }
}

/// Returns the constant that the model's correct shifts add to the level throughout the record, U: a temperature bias
/// about another temperature than the record's mean, which courses do not include.
pub(crate) fn constant(of: &Prepared, model: Option<&ChannelModel>, mean_c: f64, about_c: Option<&[f64]>) -> f64 {
    let about = about_c.unwrap_or_default();
    let own = of.shifts.iter().filter_map(|(place, course, factor)| {
        let effect = model?.effects.get(*place)?;
        let number = |name: &str| effect.number(name).unwrap_or_default();
        let off_c = mean_c - number("reference_c");
        match course {
            Course::Temperature => Some(number("per_c") * off_c + number("per_c2") * off_c * off_c),
            Course::Follows(Follow::Play(play_c)) => {
                let behind = mean(&Follow::Play(*play_c).raw(about));
                Some(number("per_c") * (off_c + behind) + number("per_c2") * off_c * off_c)
            }
            // Factors are in the series' scale.
            Course::Follows(way) => Some(of.scale * factor * mean(&way.raw(about))),
            _ => None,
        }
    });
    own.sum()
}

/// Returns the first drifts and steps of a model's channel, each with its place in the model's list and its factor, U;
/// the rest are taken as stated.
pub(crate) fn shifts_of(
    model: &ChannelModel,
    samples: usize,
    rate_hz: f64,
    temperature_c: Option<f64>,
) -> Vec<(usize, Course, f64)> {
    /// Maximum number of courses; they are fitted together, in time that grows with the square of their number.
    const MOST: usize = 64;
    let of = |(place, effect): (usize, &std::sync::Arc<dyn Effect>)| {
        let number = |name: &str| effect.number(name).unwrap_or_default();
        let courses = match effect.kind() {
            EffectKind::RateRamp => vec![(Course::Ramp, number("R") * samples as f64 / rate_hz)],
            EffectKind::TemperatureBias => {
                let of = |mean_c: f64| of_temperature(&number, mean_c - number("reference_c"), rate_hz);
                temperature_c.map(of).unwrap_or_default()
            }
            EffectKind::WarmUp => vec![(Course::WarmUp(number("tau_s") * rate_hz), number("amplitude"))],
            EffectKind::BiasStep => {
                let at = (number("at_s") * rate_hz).ceil().max(0.0) as usize;
                // A change that is over before the record, or begins after it, is part of the record's level.
                let inside = (1..samples).contains(&at);
                inside.then(|| (Course::Step(at), number("size"))).into_iter().collect()
            }
            _ => Vec::new(),
        };
        courses.into_iter().map(move |(course, factor)| (place, course, factor))
    };
    model.effects.iter().enumerate().flat_map(of).take(MOST).collect()
}

/// Describes how a level follows the temperature about its mean, which is `off_c` from the temperature at which the
/// effect vanishes.
fn of_temperature(number: &impl Fn(&str) -> f64, off_c: f64, rate_hz: f64) -> Vec<(Course, f64)> {
    let (slope, curvature) = (number("per_c"), number("per_c2"));
    let about_mean = slope + 2.0 * curvature * off_c;
    let line = match number("play_c") {
        play if play > 0.0 => Course::Follows(Follow::Play(play)),
        _ => Course::Temperature,
    };
    let further = [
        (Course::Follows(Follow::Square), curvature),
        (Course::Follows(Follow::Rate(RATE_LAG_S * rate_hz)), number("per_c_per_s") * rate_hz),
    ];
    let further = further.into_iter().filter(|(_, factor)| *factor != 0.0);
    [(line, about_mean)].into_iter().chain(further).collect()
}
