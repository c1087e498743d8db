//! The search: which effects explain a series, one after the other, each paid for.

use super::evidence::{self, Candidate, Kind};
use super::law::Shape;
use super::prices::Prices;
use super::series::Series;

/// An effect that was added.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Its kind.
    pub kind: Kind,
    /// Nats.
    pub gain: f64,
    /// Nats that it had to give.
    pub price: f64,
    /// What else would have been worth its price, best first.
    pub others: Vec<(Kind, f64)>,
}

/// A complex kind that stands in for a simple one has to be better by some nats.
const SIMPLER: [(Kind, Kind, f64); 17] = [
    (Kind::WarmUp, Kind::RateRamp, 4.0),
    (Kind::BiasStep, Kind::RateRamp, 2.0),
    (Kind::TemperatureBias, Kind::RateRamp, 0.0),
    (Kind::Resonance, Kind::Tone, 4.0),
    (Kind::VarianceProfile, Kind::VariancePerDegree, 4.0),
    (Kind::VarianceProfile, Kind::VarianceInterval, 0.0),
    (Kind::HeavyTails, Kind::Spikes, 0.0),
    (Kind::LowPass, Kind::MovingAverage, 6.0),
    (Kind::GaussMarkov, Kind::RateRamp, 4.0),
    // What is outside the library has to be clearly better than what is in it.
    (Kind::Slope, Kind::GaussMarkov, 3.0),
    (Kind::Slope, Kind::QuantizationNoise, 3.0),
    (Kind::Slope, Kind::LowPass, 3.0),
    (Kind::TemperatureCurve, Kind::WarmUp, 3.0),
    (Kind::TemperatureCurve, Kind::RateRamp, 3.0),
    (Kind::TemperatureCurve, Kind::TemperatureBias, 3.0),
    (Kind::TemperatureCurve, Kind::BiasStep, 3.0),
    (Kind::TemperatureCurve, Kind::GaussMarkov, 3.0),
];

/// Explains a series as far as effects are worth their prices.
pub fn explain(series: &mut Series<'_>, prices: &Prices) -> Vec<Step> {
    const MOST: usize = 12;
    let mut steps: Vec<Step> = Vec::new();
    while steps.len() < MOST {
        let mut candidates = evidence::all(series);
        // What is named is named once: more of the same would be a failure to explain it.
        candidates.retain(|of| of.kind.repeats() || steps.iter().all(|step| step.kind.effect() != of.kind.effect()));
        let Some(step) = choose(&candidates, prices) else { break };
        let Some(chosen) = candidates.into_iter().find(|candidate| candidate.kind == step.kind) else { break };
        series.explanation = chosen.explanation;
        series.rebuild(false);
        let kind = step.kind;
        steps.push(step);
        if kind == Kind::Tone {
            more_tones(series, prices, &mut steps);
        }
    }
    other_filter(series, prices, &mut steps);
    take_back(series, prices, &mut steps);
    tails_back(series, prices, &mut steps);
    steps
}

/// Takes back tails that were stretches' before these were known.
fn tails_back(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    let last = steps.len().saturating_sub(1);
    let Some(at) = steps.iter().position(|step| step.kind == Kind::HeavyTails).filter(|at| *at < last) else { return };
    let kept = series.clone();
    series.explanation.tails = None;
    series.rebuild(false);
    let gain = evidence::outlier::heavy_tails(series).map_or(0.0, |candidate| candidate.gain);
    if gain < prices.of(Kind::HeavyTails) {
        steps.remove(at);
    } else {
        *series = kept;
    }
}

/// Takes back spectral terms that, beside what was named after them, are not worth their price any more.
fn take_back(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    if steps.len() < 2 {
        return;
    }
    loop {
        let whole = series.fitted.log_posterior;
        let terms = &series.explanation.law.terms;
        let losses = (0..terms.len()).filter_map(|at| {
            let kind = kind_of(terms[at].shape);
            // Where the model has the term itself nothing was named.
            steps.iter().any(|step| step.kind == kind).then_some(())?;
            let mut law = series.explanation.law.clone();
            law.terms.remove(at);
            let loss = whole - law.fit(series.data()).log_posterior;
            (loss < prices.of(kind)).then_some((loss, at, kind))
        });
        let Some((_, at, kind)) = losses.min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        series.explanation.law.terms.remove(at);
        let weakest = |of: &(usize, &Step)| of.1.kind == kind;
        let step = steps.iter().enumerate().filter(weakest).min_by(|a, b| a.1.gain.total_cmp(&b.1.gain));
        if let Some(step) = step.map(|(step, _)| step) {
            steps.remove(step);
        }
        series.rebuild(false);
    }
}

fn kind_of(shape: Shape) -> Kind {
    match shape {
        Shape::QuantizationNoise => Kind::QuantizationNoise,
        Shape::GaussMarkov => Kind::GaussMarkov,
        Shape::Resonance => Kind::Resonance,
        Shape::LowPass(_) => Kind::LowPass,
        Shape::MovingAverage(_) => Kind::MovingAverage,
        Shape::Slope(_) => Kind::Slope,
    }
}

/// Chosen before all else was known, a filter may be of the other kind: what is in front of it shapes the spectrum too.
fn other_filter(series: &mut Series<'_>, prices: &Prices, steps: &mut [Step]) {
    let filters = [Kind::LowPass, Kind::MovingAverage];
    let last = steps.len().saturating_sub(1);
    // The last to be chosen knew everything.
    let of_filters: Vec<usize> = (0..steps.len()).filter(|at| filters.contains(&steps[*at].kind)).collect();
    let [at] = of_filters[..] else { return };
    if at == last {
        return;
    }
    let kept = series.clone();
    series.explanation.law.terms.retain(|term| !term.is_filter());
    series.rebuild(false);
    let both = [evidence::spectral::low_pass(series), evidence::spectral::moving_average(series)];
    let candidates: Vec<Candidate> = both.into_iter().flatten().collect();
    *series = kept;
    let Some(step) = choose(&candidates, prices).filter(|step| step.kind != steps[at].kind) else { return };
    if let Some(best) = candidates.into_iter().find(|candidate| candidate.kind == step.kind) {
        series.explanation = best.explanation;
        series.rebuild(false);
        steps[at] = step;
    }
}

fn more_tones(series: &mut Series<'_>, prices: &Prices, steps: &mut Vec<Step>) {
    const MOST: usize = 24;
    /// Beyond the price: what is hardly worth it is weighed against the other effects again.
    const CLEAR: f64 = 10.0;
    for _ in 0..MOST {
        let Some(tone) = evidence::line::tone(series) else { break };
        let price = prices.of(Kind::Tone);
        if tone.gain < price + CLEAR {
            break;
        }
        series.explanation = tone.explanation;
        series.rebuild(false);
        steps.push(Step { kind: Kind::Tone, gain: tone.gain, price, others: Vec::new() });
    }
}

/// The kind to be added next; None where nothing is worth its price.
fn choose(candidates: &[Candidate], prices: &Prices) -> Option<Step> {
    let mut scores: Vec<(Kind, f64, f64)> = candidates
        .iter()
        .filter(|of| of.gain.is_finite())
        .map(|of| (of.kind, of.gain - prices.of(of.kind), of.gain))
        .collect();
    scores.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut best = *scores.first().filter(|best| best.1 > 0.0)?;
    for (complex, simple, margin) in SIMPLER {
        if best.0 == complex
            && let Some(other) = scores.iter().find(|score| score.0 == simple && score.1 > 0.0)
            && best.1 - other.1 < margin
        {
            best = *other;
        }
    }
    let others = scores.iter().filter(|score| score.0 != best.0 && score.1 > 0.0).map(|score| (score.0, score.1));
    Some(Step { kind: best.0, gain: best.2, price: prices.of(best.0), others: others.collect() })
}
