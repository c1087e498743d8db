//! Noise along a motion, by Monte Carlo: the errors of each cause in each run, with the simulator's own streams.
//!
//! Each effect draws from a stream of its own. The noise of a cause alone is therefore what it adds to the whole, and the sum over
//! the causes is a run of the whole sensor as long as errors are small. What acts on the sum (held samples, limits and
//! coarse steps that are reached) is simulated with everything else.

use super::courses::{Aligned, Courses, each_sample};
use super::path::{Navigator, Path, Small, USED, Values};
use crate::channel::nonlinear;
use crate::courses::samples;
use crate::request::{CostError, Setting};
use crate::sources::ChannelSources;
use imu_core::sample::Channel;
use imu_model::EffectKind;
use imu_model::effects::{Effect, Stage};
use imu_model::simulator::{ChannelModel, SensorModel, Simulator};
use std::sync::Arc;

/// Threads that make runs.
const THREADS: usize = 2;
/// Samples that show how much a channel's noise changes from one to the next.
const SHOWN: u64 = 4000;
/// Keeps the noise of rounding apart from N, which has the same stream.
const ROUNDING_SEED: u64 = 0x726f_756e_6469_6e67;

/// The noise of a cause on a channel.
#[derive(Debug)]
pub(super) struct Noise {
    /// The channel's place in [`USED`].
    pub channel: usize,
    pub name: &'static str,
    /// The noise is that of one model, less that of another.
    plus: SensorModel,
    minus: Option<SensorModel>,
    salt: u64,
}

/// The noise of a model, and what acts on the sum of noise and motion.
#[derive(Debug, Default)]
pub(super) struct Noises {
    pub all: Vec<Noise>,
    pub nonlinear: Vec<(Channel, &'static str)>,
}

/// One channel's effects.
struct Own<'a> {
    channel: usize,
    model: &'a SensorModel,
    of: &'a ChannelModel,
    filters: Vec<Arc<dyn Effect>>,
}

impl Own<'_> {
    /// Returns a model of this channel alone, behind its filters.
    fn alone(&self, parameters: ChannelModel, more: impl IntoIterator<Item = Arc<dyn Effect>>) -> SensorModel {
        let effects = self.filters.iter().cloned().chain(more).collect();
        let channels = [(USED[self.channel], ChannelModel { effects, ..parameters })].into();
        let (rate_hz, sampling) = (self.model.rate_hz, self.model.sampling);
        SensorModel { rate_hz, channels, sampling, ..SensorModel::default() }
    }

    fn kind(&self, kind: EffectKind) -> impl Iterator<Item = Arc<dyn Effect>> {
        self.of.effects.iter().filter(move |effect| effect.kind() == kind).cloned()
    }

    fn noise(&self, name: &'static str, plus: SensorModel) -> Noise {
        Noise { channel: self.channel, name, plus, minus: None, salt: 0 }
    }

    /// Returns the noise of all causes but rounding.
    fn noises(&self) -> Vec<Noise> {
        let mut all = Vec::new();
        let (n, b, k) = (self.of.n, self.of.b, self.of.k);
        if n > 0.0 {
            let white = || ChannelModel { n, ..ChannelModel::default() };
            let tails: Vec<_> = self.kind(EffectKind::HeavyTails).collect();
            let steady = self.alone(white(), tails.iter().cloned());
            let changes: Vec<_> = self.kind(EffectKind::VarianceChange).collect();
            all.push(self.noise("N", steady.clone()));
            if !changes.is_empty() {
                let changed = self.alone(white(), tails.into_iter().chain(changes));
                let own = self.noise(EffectKind::VarianceChange.name(), changed);
                all.push(Noise { minus: Some(steady), ..own });
            }
        }
        if b > 0.0 {
            all.push(self.noise("B", self.alone(ChannelModel { b, ..ChannelModel::default() }, [])));
        }
        if k > 0.0 {
            all.push(self.noise("K", self.alone(ChannelModel { k, ..ChannelModel::default() }, [])));
        }
        let mut seen: Vec<EffectKind> = Vec::new();
        for effect in &self.of.effects {
            let kind = effect.kind();
            let is_noisy = effect.number("white_behind").is_some_and(|n| n > 0.0);
            if seen.contains(&kind) || !(effect.stage() == Stage::Noise || is_noisy) {
                continue;
            }
            seen.push(kind);
            let mut plus = self.alone(ChannelModel::default(), []);
            if effect.stage() == Stage::Noise {
                plus = self.alone(ChannelModel::default(), self.kind(kind));
            } else if let Some(own) = plus.channels.get_mut(&USED[self.channel]) {
                // The filters of this kind keep the noise behind them.
                let filters = self.of.effects.iter().filter_map(|of| match of.kind() == kind {
                    true => Some(Arc::clone(of)),
                    false => of.noiseless(),
                });
                own.effects = filters.collect();
            }
            all.push(self.noise(effect.name(), plus));
        }
        all
    }

    /// Returns rounding to steps as noise that is added to the sent samples.
    fn rounding(&self, step: f64) -> Noise {
        let n = step / (12.0 * self.model.rate_hz).sqrt();
        let channels = [(USED[self.channel], ChannelModel { n, ..ChannelModel::default() })].into();
        let plus = SensorModel { rate_hz: self.model.rate_hz, channels, ..SensorModel::default() };
        Noise { salt: ROUNDING_SEED, ..self.noise(EffectKind::Resolution.name(), plus) }
    }

    /// Returns half the mean square of the noise's difference from one sample to the next, U².
    fn local(&self, setting: &Setting<'_>, path: &Path) -> Result<f64, CostError> {
        let unclipped = |effect: &&Arc<dyn Effect>| effect.stage() < Stage::Saturation;
        let effects = self.of.effects.iter().filter(unclipped).cloned().collect();
        let own = ChannelModel { effects, bias: None, ..self.of.clone() };
        let model =
            SensorModel { channels: [(USED[self.channel], own)].into(), ..self.alone(ChannelModel::default(), []) };
        let mut next = samples(path.simulator(setting, &model, setting.seed, false)?, USED[self.channel]);
        let count = SHOWN.min(setting.begin + setting.samples()).max(2);
        let (mut last, mut sum) = (next(), 0.0);
        for _ in 1..count {
            let value = next();
            sum += (value - last).powi(2);
            last = value;
        }
        Ok(0.5 * sum / (count - 1) as f64)
    }
}

/// Returns the noise of a model that has the used channels alone, each with all effects that act on it.
///
/// # Errors
/// [`CostError::Model`] if the model cannot be simulated.
pub(super) fn noises(
    path: &Path,
    setting: &Setting<'_>,
    model: &SensorModel,
    courses: &Courses,
) -> Result<Noises, CostError> {
    let mut found = Noises::default();
    for (channel, name) in USED.into_iter().enumerate() {
        let (Some(of), Some(sources)) = (model.channels.get(&name), ChannelSources::new(model, name)) else { continue };
        let filters = of.effects.iter().filter_map(|effect| effect.noiseless()).collect();
        let own = Own { channel, model, of, filters };
        found.all.extend(own.noises());
        let local = if sources.step.is_some() { own.local(setting, path)? } else { 0.0 };
        let range = courses.range[channel].map(|end| end - sources.level);
        let mut acts = nonlinear(setting, &sources, local, range);
        // A sample that is sent again is the motion of another time.
        let held = EffectKind::HeldSamples.name();
        if sources.held > 0.0 && !acts.contains(&held) {
            acts.push(held);
        }
        if let Some(step) = sources.step.filter(|_| !acts.contains(&EffectKind::Resolution.name())) {
            found.all.push(own.rounding(step));
        }
        found.nonlinear.extend(acts.into_iter().map(|effect| (name, effect)));
    }
    Ok(found)
}

impl Noise {
    /// Returns the errors of one run, by horizon.
    fn run(&self, path: &Path, setting: &Setting<'_>, seed: u64) -> Result<Vec<Values>, CostError> {
        let simulator = |model: &SensorModel| -> Result<Simulator, CostError> {
            path.simulator(setting, model, seed ^ self.salt, false)
        };
        let mut plus = samples(simulator(&self.plus)?, USED[self.channel]);
        let mut minus = match &self.minus {
            Some(model) => Some(samples(simulator(model)?, USED[self.channel])),
            None => None,
        };
        let (mut aligned, mut sums) = (Aligned::new(setting), Small::new(path, self.channel));
        for _ in 0..setting.begin + setting.samples() {
            let value = plus() - minus.as_mut().map_or(0.0, |next| next());
            if let Some([error]) = aligned.push([value]) {
                sums.push(error);
            }
        }
        Ok(sums.found)
    }

    /// Returns the errors of each run, by run and horizon.
    ///
    /// # Errors
    /// [`CostError::Model`] if the model cannot be simulated.
    pub(super) fn runs(&self, path: &Path, setting: &Setting<'_>) -> Result<Vec<Vec<Values>>, CostError> {
        runs(setting, |seed| self.run(path, setting, seed))
    }
}

/// Returns the errors of the whole sensor, by run and horizon.
///
/// # Errors
/// [`CostError::Model`] if the model cannot be simulated.
pub(super) fn whole(path: &Path, setting: &Setting<'_>, model: &SensorModel) -> Result<Vec<Vec<Values>>, CostError> {
    runs(setting, |seed| {
        let rests = setting.begin + setting.align;
        let (mut aligned, mut navigator) = (Aligned::new(setting), Navigator::new(path));
        each_sample(setting, path.simulator(setting, model, seed, true)?, |sample, values| {
            let truth = path.truth(sample, rests);
            let error = |channel: usize| values[channel].map_or(0.0, |value| value - truth[channel]);
            if let Some(errors) = aligned.push(std::array::from_fn(error)) {
                navigator.push(errors);
            }
        });
        Ok(navigator.found)
    })
}

/// Makes all runs of a setting, each from its seed.
fn runs<T: Send>(setting: &Setting<'_>, one: impl Fn(u64) -> Result<T, CostError> + Sync) -> Result<Vec<T>, CostError> {
    let seeds: Vec<u64> = (0..setting.runs as u64).map(|run| setting.seed.wrapping_add(run)).collect();
    let part = |seeds: &[u64]| seeds.iter().map(|seed| one(*seed)).collect::<Result<Vec<T>, CostError>>();
    let (first, rest) = seeds.split_at(seeds.len() / THREADS);
    std::thread::scope(|scope| {
        let beside = scope.spawn(|| part(first));
        let mut others = part(rest)?;
        let mut all = beside.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        all.append(&mut others);
        Ok(all)
    })
}
