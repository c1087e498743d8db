//! The diagnosis of a whole record: explains every channel, and finds the shared effects, the parameters that are off,
//! and the remainder.

use super::bands::Bands;
use super::declared::courses;
use super::declared::measured::{self, MeasuredLine};
use super::error::DiagnosisError;
use super::evidence::{Kind, heavy_tails};
use super::explanation::{Explanation, Scedasticity};
use super::found::{Findings, Found};
use super::gated;
use super::grid::Grid;
use super::holdout::{self, BLOCKS, Halves, Whole};
use super::law::{Data, FREE, Fitted};
use super::modulated;
use super::nameless;
use super::omnibus::{self, Statistic};
use super::options::{BANDS, Options};
use super::outcome::Outcome;
use super::prepare::{self, Prepared, Ready};
use super::prices::{Prices, Tails};
use super::recording::Recording;
use super::search;
use super::searched_again::{Without, budget, with_fewer, with_one_filter};
use super::series::{Series, Setting};
use super::shared::{self, Shared, Whitened};
use super::spread::Spread;
use super::tiles::Tiles;
use super::wandering;
use super::work::{Parts, gathered};
use super::zero_rows;
use imu_model::effects::EffectKind;
use imu_model::effects::temperature_bias::RATE_LAG_S;
use imu_model::simulator::{ChannelModel, SensorModel};
use std::collections::BTreeSet;

/// Compares a record with a model.
///
/// # Errors
/// [`DiagnosisError`] if the inputs cannot be compared, or if the diagnosis was cancelled.
pub fn diagnose(real: &Recording, sim: &SensorModel, options: &Options<'_>) -> Result<Outcome, DiagnosisError> {
    let zeros = zero_rows::rows(real);
    let real = &*zero_rows::without(real, &zeros);
    let ready = prepare::prepare(real, sim)?;
    let samples = real.len();
    let tails = options.tails.cloned().unwrap_or_else(|| Tails::shipped(samples));
    let wanted = |kind: Kind| options.wants(kind.effect());
    let prices = Prices::new(&tails, ready.channels.len(), options.level, wanted);
    let halves = Halves::new(samples, ready.courses.temperature(), RATE_LAG_S * sim.rate_hz);
    let count = ready.channels.len();
    let explained = |number: usize, index: usize, prices: &Prices| {
        let explain = |work: &mut Parts<'_>| explain(&ready, sim, index, prices, &halves, options.believed, work);
        let mut of = Parts::whole(options.workers, number, explain);
        of.prepared.samples.clone_from(&ready.channels[index].samples);
        of
    };
    let all = |index: usize| explained(index, index, &prices);
    let mut channels = gathered(options.workers, count, all).ok_or(DiagnosisError::CalledOff)?;
    let again = |tries: &[Without]| {
        let without = |number: usize| {
            let (index, kinds) = &tries[number];
            let prices = Prices::new(&tails, count, options.level, |of| !kinds.contains(&of) && wanted(of));
            explained(number, *index, &prices)
        };
        gathered(options.workers, tries.len(), without)
    };
    let mut budget = budget(samples);
    with_fewer(&mut channels, &mut budget, &again).ok_or(DiagnosisError::CalledOff)?;
    with_one_filter(&mut channels, &mut budget, &again).ok_or(DiagnosisError::CalledOff)?;
    let whitened = |index: usize| whitened(&ready, sim, &channels[index]);
    let whitened = gathered(options.workers, count, whitened).ok_or(DiagnosisError::CalledOff)?;
    let pairs = channels.len() * channels.len().saturating_sub(1) / 2;
    let price = (pairs.max(1) as f64 * Kind::ALL.len() as f64 / options.level).ln().max(6.0);
    let shared = shared::shared(&whitened, price);
    let linked = |i: usize, j: usize| {
        let has = |of: &Shared, at: usize| of.parts.iter().any(|part| part.index == at);
        shared.iter().any(|of| has(of, i) && has(of, j))
    };
    let residuals: Vec<Vec<f64>> = whitened.into_iter().map(|of| of.residual).collect();
    for (of, value) in channels.iter_mut().zip(omnibus::crosstalk::greatest(residuals, &linked)) {
        of.statistics.push((Statistic::Crosstalk, value));
    }
    let shared = if options.wants(EffectKind::CommonMode) { shared } else { Vec::new() };
    let declares = |index: usize| channels[index].prepared.has.contains(&EffectKind::CommonMode);
    // If the model has shared noise on other channels, that of this channel is not named.
    let is_declared = shared.iter().flat_map(|of| &of.parts).any(|part| declares(part.index));
    let parts = shared.iter().flat_map(|of| of.parts.iter().map(|part| (part, of.parts.len() > 2)));
    let parts: Vec<_> = parts.filter(|(part, _)| !is_declared || declares(part.index)).collect();
    for (part, is_exact) in parts {
        beside_shared(&ready, sim, &mut channels[part.index], part.size.powi(2).min(0.98), is_exact);
    }
    let found = Found {
        channels,
        shared,
        repeats: if options.wants(EffectKind::HeldSamples) { ready.repeats } else { Vec::new() },
        further: ready.further,
        samples,
        tails,
        temperature_c: ready.reference_c,
    };
    let mut outcome = super::compose::outcome(&found, real, sim, options);
    outcome.diagnosis.notes.extend(zero_rows::note(&zeros, real.rate_hz));
    Ok(outcome)
}

/// Whitens a channel's samples by what explains them.
fn whitened(ready: &Ready, sim: &SensorModel, of: &Findings) -> Whitened {
    let base = |grid: &Grid, without: &BTreeSet<usize>| prepare::base_of(sim, &of.prepared, grid, without);
    let setting = ready.setting(&of.prepared, &base);
    let samples = of.prepared.samples.clone();
    Whitened::of(&Series::explained(&setting, ready.transform.clone(), samples, of.explanation.clone()))
}

/// Corrects what was found on a channel's white noise for the part of its variance that other channels share. Changes of
/// the channel's own white noise do not concern that part. If the part is not known exactly, there are no intervals.
fn beside_shared(ready: &Ready, sim: &SensorModel, of: &mut Findings, shared: f64, is_exact: bool) {
    let unknown = if is_exact { 1.0 } else { f64::INFINITY };
    of.spread.loud.iter_mut().for_each(|error| *error *= unknown);
    of.spread.fourth *= (1.0 - shared).powi(2);
    for ratio in &mut of.ratios {
        *ratio = ratio.beside_shared(shared, of.average_variance);
    }
    if of.explanation.tails.is_some() {
        let base = |grid: &Grid, without: &BTreeSet<usize>| prepare::base_of(sim, &of.prepared, grid, without);
        let setting = ready.setting(&of.prepared, &base);
        let (samples, explanation) = (of.prepared.samples.clone(), of.explanation.clone());
        let series = Series::explained(&setting, ready.transform.clone(), samples, explanation);
        let (degrees, error) = heavy_tails::beside_shared(&series, shared);
        (of.explanation.tails, of.spread.tails) = (Some(degrees), error * unknown);
    }
    // The part at times when nothing changes the variance.
    let usual = (shared * of.average_variance).min(0.98);
    if of.prepared.scedasticity.is_none() {
        match &mut of.explanation.scedasticity {
            Some(Scedasticity::PerDegree(slope)) => {
                *slope /= 1.0 - usual;
                of.spread.per_degree *= unknown / (1.0 - usual);
            }
            Some(Scedasticity::Profile(values)) => {
                let own = |ln: &f64| ((ln.exp() - usual) / (1.0 - usual)).max(1e-3).ln();
                values.iter_mut().for_each(|value| *value = own(value));
            }
            None => {}
        }
    }
}

/// Adopts the model's own spikes and heavy tails, with the numbers that the channel shows.
fn adopt_declared(series: &mut Series<'_>, prepared: &Prepared) {
    for (kind, evidence) in [
        (EffectKind::Spikes, super::evidence::outlier::spikes as fn(&Series<'_>) -> Option<super::evidence::Candidate>),
        (EffectKind::HeavyTails, heavy_tails::heavy_tails),
    ] {
        if prepared.has.contains(&kind)
            && let Some(candidate) = evidence(series)
        {
            series.adopt(candidate.explanation);
        }
    }
}

/// Fits the law again with one of N, B and K as the model states it.
fn held_at(series: &Series<'_>, prepared: &Prepared, fitted: &Fitted, level: usize) -> Fitted {
    let changed = if level == 0 { series.average_variance().ln() } else { 0.0 };
    let fixed = (prepared.declared.levels[level] + changed).max(super::law::LEVELS[level].0);
    // A prior that is a thousandth wide is as good as a fixed value.
    let mut priors = FREE;
    priors[level] = Some((fixed, 1e-3));
    let mut law = fitted.law.clone();
    law.levels[level] = fixed;
    law.fit(Data { priors: &priors, ..series.data() })
}

/// Returns what the model states and what was found, as both are scored. The model's lines keep the model's amplitudes, unless the
/// channel has other amplitudes.
fn scored(
    series: &Series<'_>,
    prepared: &Prepared,
    mut known: Explanation,
    model: Option<&ChannelModel>,
    lines: &[MeasuredLine],
) -> (Explanation, Explanation) {
    known.sines = series.explanation.sines[..prepared.sines.len()].to_vec();
    known.sines.iter_mut().zip(&prepared.sines).for_each(|(sine, declared)| sine.rescale(declared.amplitude()));
    // So do those that come and go, with the times and phases that the channel has.
    if let Some(model) = model {
        let (places, sines): (Vec<usize>, _) = gated::as_declared(series, model, prepared.scale).into_iter().unzip();
        known.gated = sines;
        known.without.extend(places);
    }
    let mut found = series.explanation.clone();
    for (course, (_, _, factor)) in found.courses.iter_mut().zip(&prepared.shifts) {
        course.1 = *factor;
    }
    for place in (0..lines.len()).filter(|place| !lines[*place].is_off) {
        found.sines[place] = known.sines[place];
    }
    (known, found)
}

/// Returns the complete result for one channel.
fn explain(
    ready: &Ready,
    sim: &SensorModel,
    index: usize,
    prices: &Prices,
    halves: &Halves,
    believed: bool,
    work: &mut Parts<'_>,
) -> Findings {
    let mut prepared = ready.channels[index].clone();
    if !believed {
        prepared.priors = FREE;
    }
    let as_declared = courses::as_declared(&prepared);
    let off = {
        let base = |grid: &Grid, without: &BTreeSet<usize>| prepare::base_of(sim, &prepared, grid, without);
        courses::off(&ready.setting(&prepared, &base), &ready.transform, &prepared, prices)
    };
    courses::strip(&mut prepared, &off);
    let base = |grid: &Grid, without: &BTreeSet<usize>| prepare::base_of(sim, &prepared, grid, without);
    let model = sim.channels.get(&prepared.channel);
    let gates = prices.of(Kind::Intermittent).is_finite() && model.is_none_or(gated::are_known);
    let setting = Setting { gates, ..ready.setting(&prepared, &base) };
    let known = courses::as_declared(&prepared);
    let mut series = Series::new(&setting, ready.transform.clone(), prepared.samples.clone(), known.clone());
    adopt_declared(&mut series, &prepared);
    let Explanation { law, courses, loud, scedasticity, .. } = as_declared.clone();
    let known = Explanation { law, courses, loud, scedasticity, ..series.explanation.clone() };
    let declared_variance = series.average_variance();
    let steps = search::explain(&mut series, prices, work);
    let fitted = series.explanation.law.fit(Data { priors: &FREE, ..series.data() });
    let held = work.next(|| [0, 1, 2].map(|level| held_at(&series, &prepared, &fitted, level)));
    let bands = Bands::of(&series, &steps, &as_declared.courses, &fitted, &held);
    let held = held.map(|held| fitted.log_likelihood - held.log_likelihood);
    let nameless = nameless::density(&series);
    let mut parts = omnibus::component::parts(&mut series);
    let has_bands = prepared.has.iter().any(|kind| BANDS.contains(kind));
    let stays = if has_bands { Vec::new() } else { gated::stays(&series) };
    parts.retain(|part| stays.iter().all(|own| own.term != part.place));
    let (levels, wanders) = match has_bands {
        true => (Vec::new(), Vec::new()),
        false => (modulated::levels(&series, &parts), wandering::lines(&parts)),
    };
    parts.retain(|part| wanders.iter().all(|wander| wander.term != part.place));
    let evened = series.whitened_by_time();
    let after = Tiles::of(evened.as_ref().unwrap_or(&series));
    let lines = model.map(|model| measured::lines(&series, &prepared, model, prices));
    let lines = lines.unwrap_or_default();
    let statistics = match evened {
        Some(mut evened) => omnibus::statistics(&mut evened, prepared.facts.atom, &parts),
        None => omnibus::statistics(&mut series, prepared.facts.atom, &parts),
    };
    let (known, found) = scored(&series, &prepared, known, model, &lines);
    let whole = Whole {
        samples: &prepared.samples,
        halves,
        setting: Setting { white: known.law.levels[0], priors: series.priors, ..setting },
        known: &known,
        found: &found,
        stays: &stays,
    };
    let scores = work.next(|| holdout::scores(whole));
    debug_assert_eq!(scores.effects.len(), BLOCKS);
    let nats = holdout::nats(&series, &known);
    let spread = Spread::of(&series);
    let white = series.white() * prepared.scale;
    let level = prepared.level + series.mean * prepared.scale
        - courses::constant(&prepared, model, ready.reference_c, ready.courses.temperature());
    let ratios = series.white_ratios();
    let (explanation, average_variance) = (series.explanation.clone(), series.average_with(&ratios));
    drop(series);
    Findings {
        spread,
        ratios,
        average_variance,
        louder: average_variance / declared_variance,
        prepared,
        explanation,
        steps,
        fitted,
        held,
        bands,
        nameless,
        levels,
        stays,
        wanders,
        after,
        statistics,
        scores,
        nats,
        white,
        level,
        lines,
        off,
    }
}
