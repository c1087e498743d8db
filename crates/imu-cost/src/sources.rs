//! Sources: what makes up a channel's error, each with the law by which its share of a variance or mean is computed.
//!
//! In: a sensor model and a channel. Out: a list of sources, the filters behind them, and what acts on their sum.

use imu_core::sample::{Channel, Triad};
use imu_model::EffectKind;
use imu_model::effects::triad::Drive;
use imu_model::effects::{Effect, Flicker, RandomWalk, Stage, White};
use imu_model::simulator::response::{STAGES, stage};
use imu_model::simulator::{ChannelModel, SensorModel, effects_on};
use std::sync::Arc;

/// The law of a source.
#[derive(Debug)]
pub(crate) enum Law {
    /// Stationary noise with a density, and lines of random phase.
    Stationary,
    /// White noise whose amplitude has a factor that changes with time.
    Modulated(Factor),
    /// A course without randomness.
    Course,
    /// A sine of random phase that is there inside intervals.
    Gated { frequency_hz: f64, amplitude: f64, intervals: Vec<(f64, f64)> },
    /// No closed form: it is simulated.
    Simulated,
}

/// A factor on the amplitude of white noise.
#[derive(Debug)]
pub(crate) enum Factor {
    /// The product of changes of variance.
    Changes(Vec<Arc<dyn Effect>>),
    /// 1 inside intervals [from_s, to_s] and 0 outside.
    Intervals(Vec<(f64, f64)>),
}

/// One source of a channel's error.
#[derive(Debug)]
pub(crate) struct Source {
    /// `N`, `B`, `K` or the effect's name.
    pub cause: &'static str,
    /// The noise, or the course.
    pub effect: Arc<dyn Effect>,
    pub law: Law,
    /// The number of filters that it does not pass: it enters behind them.
    pub behind: usize,
    /// The instance and sign of noise that channels share.
    pub common: Option<(usize, f64)>,
}

impl Source {
    fn new(cause: &'static str, effect: Arc<dyn Effect>, law: Law) -> Self {
        Self { cause, effect, law, behind: 0, common: None }
    }
    /// Returns whether the source has a density from which its variance follows.
    pub(crate) fn is_spectral(&self) -> bool {
        matches!(self.law, Law::Stationary | Law::Modulated(_))
    }
    /// Returns whether the source is added to the sent samples.
    pub(crate) fn is_sent(&self) -> bool {
        !self.effect.stage().is_internal()
    }
}

/// What makes up a channel's error.
#[derive(Debug)]
pub(crate) struct ChannelSources {
    pub channel: Channel,
    pub sources: Vec<Source>,
    /// The filters of the bandwidth in the chain's order, without the noise behind them.
    pub filters: Vec<Arc<dyn Effect>>,
    /// The probability that a sample is the one before it again.
    pub held: f64,
    /// The level at rest, U, and the limits of the converter.
    pub level: f64,
    pub limits: Option<[f64; 2]>,
    /// The distance of the values that are sent, U.
    pub step: Option<f64>,
}

impl ChannelSources {
    /// Returns the sources of a channel; `None` if the model does not have it.
    pub(crate) fn new(model: &SensorModel, channel: Channel) -> Option<Self> {
        let own = model.channels.get(&channel)?;
        let effects: Vec<Arc<dyn Effect>> = effects_on(model, channel).into_iter().map(|(effect, _)| effect).collect();
        let mut all = Self {
            channel,
            sources: Vec::new(),
            filters: effects.iter().filter_map(|effect| effect.noiseless()).collect(),
            held: 0.0,
            level: own.bias.unwrap_or(0.0) + response_at_rest(model, channel),
            limits: None,
            step: None,
        };
        all.basic(own, &effects);
        let mut passed = 0;
        for effect in &effects {
            passed += usize::from(effect.stage() == Stage::Bandwidth);
            all.take(effect, passed, model.internal_rate_hz(model.rate_hz));
        }
        let ranges = channel.triad().and_then(|triad| model.triads.get(&triad));
        for range in ranges.iter().flat_map(|triad| &triad.effects).filter_map(|effect| effect.range()) {
            all.limit(-range, range);
        }
        Some(all)
    }

    /// Adds N with its changes of variance, B and K.
    fn basic(&mut self, own: &ChannelModel, effects: &[Arc<dyn Effect>]) {
        if own.n > 0.0 {
            let white: Arc<dyn Effect> = Arc::new(White { n: own.n });
            self.add("N", Arc::clone(&white), Law::Stationary);
            let mut changes: Vec<Arc<dyn Effect>> = Vec::new();
            for change in effects.iter().filter(|effect| effect.kind() == EffectKind::VarianceChange) {
                changes.push(Arc::clone(change));
                self.add(change.name(), Arc::clone(&white), Law::Modulated(Factor::Changes(changes.clone())));
            }
        }
        if own.b > 0.0 {
            self.add("B", Arc::new(Flicker { b: own.b }), Law::Stationary);
        }
        if own.k > 0.0 {
            self.add("K", Arc::new(RandomWalk { k: own.k }), Law::Stationary);
        }
    }

    /// Adds what an effect contributes; `passed` filters come up to it, itself included.
    fn take(&mut self, effect: &Arc<dyn Effect>, passed: usize, internal_hz: f64) {
        match effect.stage() {
            Stage::Bias => self.add(effect.name(), Arc::clone(effect), Law::Course),
            Stage::Noise => self.take_noise(effect, internal_hz),
            Stage::Bandwidth => {
                if let Some(n) = effect.number("white_behind").filter(|n| *n > 0.0) {
                    let effect_behind = Arc::new(White { n });
                    self.sources
                        .push(Source { behind: passed, ..Source::new(effect.name(), effect_behind, Law::Stationary) });
                }
            }
            Stage::Saturation => {
                let limit = |name: &str, open: f64| effect.number(name).unwrap_or(open);
                self.limit(limit("low", f64::NEG_INFINITY), limit("high", f64::INFINITY));
            }
            Stage::Resolution => {
                self.step = effect.number("step").into_iter().chain(self.step).reduce(f64::max);
                self.add(effect.name(), Arc::clone(effect), Law::Stationary);
            }
            Stage::Hold => {
                let own = effect.number("probability").unwrap_or(0.0);
                self.held = 1.0 - (1.0 - self.held) * (1.0 - own);
            }
            _ => {}
        }
    }

    /// Adds an effect of the stage of noise.
    fn take_noise(&mut self, effect: &Arc<dyn Effect>, internal_hz: f64) {
        let name = effect.name();
        let intervals = effect.pairs("intervals");
        let of = effect.parameter("of");
        let gated = |key: &str| of.as_ref().and_then(|of| of.get(key)).and_then(|value| value.as_f64());
        match effect.kind() {
            EffectKind::Bursts => {
                let n = effect.number("sigma").unwrap_or(0.0) / internal_hz.sqrt();
                self.add(name, Arc::new(White { n }), Law::Modulated(Factor::Intervals(intervals)));
            }
            EffectKind::Intermittent if !intervals.is_empty() => match (gated("n"), gated("amplitude")) {
                (Some(n), _) => {
                    self.add(name, Arc::new(White { n }), Law::Modulated(Factor::Intervals(intervals)));
                }
                (_, Some(amplitude)) => {
                    let frequency_hz = gated("frequency_hz").unwrap_or(0.0);
                    self.add(name, Arc::clone(effect), Law::Gated { frequency_hz, amplitude, intervals });
                }
                _ => self.add(name, Arc::clone(effect), Law::Simulated),
            },
            kind => {
                let known = effect.psd(0.01 * internal_hz, internal_hz).is_some();
                let law = if known { Law::Stationary } else { Law::Simulated };
                let instance = self.sources.iter().filter(|source| source.common.is_some()).count();
                let sign = effect.number("sigma").unwrap_or(0.0).signum();
                let common = (kind == EffectKind::CommonMode).then_some((instance, sign));
                self.sources.push(Source { common, ..Source::new(name, Arc::clone(effect), law) });
            }
        }
    }

    fn add(&mut self, cause: &'static str, effect: Arc<dyn Effect>, law: Law) {
        self.sources.push(Source::new(cause, effect, law));
    }

    fn limit(&mut self, low: f64, high: f64) {
        let [lowest, highest] = self.limits.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        self.limits = Some([lowest.max(low), highest.min(high)]);
    }

    /// Returns a model of the channel that has one effect alone, and its filters and sampling.
    pub(crate) fn alone(&self, model: &SensorModel, effect: &Arc<dyn Effect>) -> SensorModel {
        let effects = self.filters.iter().chain([effect]).cloned().collect();
        let channels = [(self.channel, ChannelModel { effects, ..ChannelModel::default() })].into();
        SensorModel { rate_hz: model.rate_hz, channels, sampling: model.sampling, ..SensorModel::default() }
    }

    /// Returns the frequencies, Hz, at which densities before sampling have peaks or bends.
    pub(crate) fn features(&self) -> Vec<f64> {
        let of = |effect: &Arc<dyn Effect>| {
            let inner = effect.parameter("of").and_then(|of| of.get("frequency_hz")?.as_f64());
            let numbers = ["frequency_hz", "cutoff_hz"].map(|name| effect.number(name));
            let bends = effect.pairs("density").into_iter().map(|(hz, _)| hz);
            numbers.into_iter().flatten().chain(inner).chain(bends).collect::<Vec<f64>>()
        };
        self.sources.iter().map(|source| &source.effect).chain(&self.filters).flat_map(of).collect()
    }
}

/// Returns the level that a triad's effects give a channel at rest without gravity, U.
fn response_at_rest(model: &SensorModel, channel: Channel) -> f64 {
    let Some(triad) = channel.triad() else { return 0.0 };
    let effects = model.triads.get(&triad).map(|triad| triad.effects.as_slice()).unwrap_or_default();
    let mut values = [0.0; 3];
    for step in STAGES {
        let own: Vec<_> = effects.iter().filter(|effect| effect.stage() == step).cloned().collect();
        values = stage(&own, Drive { input: values, ..Drive::default() });
    }
    let axis = triad.channels().iter().position(|other| *other == channel);
    axis.and_then(|axis| values.get(axis)).copied().unwrap_or(0.0)
}

/// Returns a model of these channels alone, each with all effects that act on it.
pub(crate) fn restricted(model: &SensorModel, channels: &[Channel]) -> SensorModel {
    let own = |channel: &Channel| {
        let parameters = model.channels.get(channel)?;
        let effects = effects_on(model, *channel).into_iter().map(|(effect, _)| effect).collect();
        Some((*channel, ChannelModel { effects, uncertainty: None, ..parameters.clone() }))
    };
    let named = |triad: &Triad| channels.iter().any(|channel| channel.triad() == Some(*triad));
    let triads = model.triads.iter().filter(|(triad, _)| named(triad));
    SensorModel {
        channels: channels.iter().filter_map(own).collect(),
        triads: triads.map(|(triad, of)| (*triad, of.clone())).collect(),
        ..model.clone()
    }
}
