//! Prepared: a channel that is ready to be explained, and the spectrum of its model in its scale.

use super::course::Course;
use super::explanation::{Loud, Scedasticity, Sine};
use super::facts::Facts;
use super::gated::OfModel;
use super::grid::Grid;
use super::law::{Base, Law, Priors, Term};
use imu_core::sample::Channel;
use imu_model::effects::{Effect, EffectKind, Flicker, RandomWalk, Record, Stage, White};
use imu_model::simulator::{ChannelModel, SensorModel, Spectrum};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

/// Greatest density that may be present behind a model's filters without being stated, as a part of the white noise's
/// density before them.
const QUIET: f64 = 1e-6;

/// One channel, ready to be explained.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Prepared {
    /// The channel.
    pub channel: Channel,
    /// U per unit of the series.
    pub scale: f64,
    /// The level that was subtracted, U.
    pub level: f64,
    /// The samples less their level, in the series' scale. They are not stored with a result: they are the record's.
    #[serde(skip)]
    pub samples: Vec<f64>,
    /// The facts that the values show.
    pub facts: Facts,
    /// Samples that are not noise: missing, held or at a limit.
    pub outliers: Vec<usize>,
    /// Samples at an upper limit and at a lower one, and the limits in the series' scale.
    pub limits: [Option<f64>; 2],
    /// The declared levels of N, B and K.
    pub declared: Law,
    /// Priors of the levels.
    pub priors: Priors,
    /// The step that counts as rounding, U: the capture's, or the model's; none if the samples are as before rounding.
    pub step: Option<f64>,
    /// The model's own effects of the spectrum: places in its list, and their terms.
    pub spectral: Vec<(usize, Term)>,
    /// Bands with the spectra of the model's wandering lines.
    pub wandering: Vec<Term>,
    /// The model's lines, with the model's amplitudes.
    pub sines: Vec<Sine>,
    /// The model's lines and bands that come and go.
    pub gated: Vec<OfModel>,
    /// For each line, the place of its effect in the model's list, and its amplitude over that of the effect alone.
    pub lines: Vec<(usize, f64)>,
    /// The model's drifts and steps, each with the place of its effect and its factor.
    pub shifts: Vec<(usize, Course, f64)>,
    /// The model's stretches of another variance, with the places of their effects.
    pub loud: Vec<(usize, Loud)>,
    /// The model's intervals of bursts, whether the channel has them or not.
    pub bursts: Vec<Range<usize>>,
    /// The model's variance by temperature or time, and the place of the effect.
    pub scedasticity: Option<(usize, Scedasticity)>,
    /// Samples that the model's filters reach.
    pub reach: usize,
    /// Names of the model's effects.
    pub has: Vec<EffectKind>,
    /// Whether an effect of the model comes, goes or wanders, so that no two records are alike.
    pub changes: bool,
    /// ln of the white variance at the record's mean temperature over that at the temperature to which N refers.
    pub white_shift: f64,
    /// The part of the information on the white noise that the sent values contain: a step wider than the noise hides
    /// some.
    pub share: f64,
    /// Variance of the white noise that was added, in the series' scale squared.
    pub dither: f64,
}

/// Returns the power per sample of a channel that is not decimated: the sum of its noise, through its filters. If it is
/// decimated, [`Spectrum`] folds it.
fn plain_shape(model: &ChannelModel, grid: &Grid) -> Vec<f64> {
    let rate_hz = grid.rate_hz();
    let levels: [&dyn Effect; 3] = [&White { n: model.n }, &Flicker { b: model.b }, &RandomWalk { k: model.k }];
    let of = |f: &f64| {
        let psd = |effect: &dyn Effect| effect.psd(*f, rate_hz).unwrap_or(0.0);
        let noise = model.effects.iter().filter(|effect| effect.stage() == Stage::Noise).map(|effect| psd(&**effect));
        let before = levels.into_iter().map(psd).sum::<f64>() + noise.sum::<f64>();
        // Noise that enters behind a filter passes the filters after it.
        let filters = model.effects.iter().filter(|effect| effect.stage() == Stage::Bandwidth);
        rate_hz * filters.fold(before, |sum, filter| sum * filter.power_gain(*f, rate_hz) + psd(&**filter))
    };
    grid.frequencies_hz().iter().map(of).collect()
}

/// Returns the shapes of a channel's spectrum on a grid, in the series' scale, without the model's effects at the
/// places `without` of its list.
pub fn base_of(sim: &SensorModel, prepared: &Prepared, grid: &Grid, without: &BTreeSet<usize>) -> Base {
    let channel = prepared.channel;
    let record = Record { rate_hz: sim.rate_hz, samples: grid.samples as u64 };
    let listed = sim.channels.get(&channel).map(|model| model.effects.as_slice()).unwrap_or_default();
    let left = listed.iter().enumerate().filter(|(place, _)| !without.contains(place));
    let effects: Vec<Arc<dyn Effect>> =
        left.map(|(_, effect)| effect.stationary(record).unwrap_or_else(|| effect.clone())).collect();
    let bandwidth = effects.iter().filter(|effect| effect.stage() == Stage::Bandwidth);
    let filters: Vec<Arc<dyn Effect>> =
        bandwidth.clone().map(|effect| effect.noiseless().unwrap_or_else(|| Arc::clone(effect))).collect();
    let shape = |model: ChannelModel| -> Vec<f64> {
        if sim.sampling.is_none() {
            return plain_shape(&model, grid);
        }
        let alone = SensorModel { channels: [(channel, model)].into(), triads: BTreeMap::new(), ..sim.clone() };
        let spectrum = Spectrum::new(&alone, channel, record);
        grid.frequencies_hz().iter().map(|f| sim.rate_hz * spectrum.psd(*f).unwrap_or(0.0)).collect()
    };
    let plain = || ChannelModel { effects: filters.clone(), ..ChannelModel::default() };
    let shapes = [
        shape(ChannelModel { n: 1.0, ..plain() }),
        shape(ChannelModel { b: 1.0, ..plain() }),
        shape(ChannelModel { k: 1.0, ..plain() }),
    ];
    let bins = grid.counts.len();
    let mut known = vec![0.0; bins];
    for effect in effects.iter().filter(|effect| matches!(effect.stage(), Stage::Noise)) {
        let with = filters.iter().cloned().chain([effect.clone()]).collect();
        let of = shape(ChannelModel { effects: with, ..ChannelModel::default() });
        // Samples that are cut out are not in the spectrum; the shared noise of channels is in the level of white
        // noise.
        if !matches!(effect.kind(), EffectKind::Bursts | EffectKind::Spikes | EffectKind::CommonMode) {
            known.iter_mut().zip(of).for_each(|(all, one)| *all += one / prepared.scale.powi(2));
        }
    }
    let rounding = prepared.dither + prepared.step.map_or(0.0, |step| (step / prepared.scale).powi(2) / 12.0);
    let mut after = shape(ChannelModel { effects: bandwidth.cloned().collect(), ..ChannelModel::default() });
    // No record has a filter's exact zeros: numbers are rounded, and records end.
    let quiet_max = if filters.is_empty() { 0.0 } else { QUIET * prepared.declared.levels[0].exp() * sim.rate_hz };
    after.iter_mut().for_each(|behind| *behind = *behind / prepared.scale.powi(2) + rounding);
    // Before decimation, filters act at another rate: their phase at the output rate is small.
    let passed = |f: &f64| match sim.sampling {
        None => filters.iter().map(|filter| filter.power_gain(*f, sim.rate_hz)).product(),
        Some(_) => 1.0,
    };
    let passed = grid.frequencies_hz().iter().map(passed).collect();
    Base { shapes, known, after, quiet_max, gain: vec![1.0; bins], passed }
}
