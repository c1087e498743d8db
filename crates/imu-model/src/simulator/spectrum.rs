//! A channel's spectrum in closed form: that of the whole chain, from the same effects that the simulator samples.

use super::chain::effects_on;
use super::model::{ChannelModel, SensorModel};
use crate::effects::moving_average::boxcar_gain;
use crate::effects::spec::Nature;
use crate::effects::{Effect, EffectKind, Flicker, Line, RandomWalk, Record, Stage, White};
use imu_core::sample::Channel;
use std::sync::Arc;

/// Returns N of a channel in the usual sense: the root, in U/√Hz, of the plateau of the sent spectrum at low
/// frequencies over a record of `samples`.
///
/// N includes the sensor's own white noise, with changes of its variance, and all other noise that is white there:
/// noise that channels share, noise behind a filter, rounding, the skirt of a resonance, and all noise that folds in
/// sampling. Noise with a slope or a correlation time (B, K, slow processes, drifts) and transient noise (spikes,
/// bursts) are not part of it. A change of variance with temperature does not count. 0 for a channel that the model
/// does not have.
///
/// `imu-noise` finds the same value in a record of the model: `examples/one_n.rs`, docs/validation.md.
pub fn plateau(model: &SensorModel, channel: Channel, samples: u64) -> f64 {
    /// A frequency below all others, as a part of the rate.
    const LOWEST: f64 = 1e-9;
    let Some(of) = model.channels.get(&channel) else { return 0.0 };
    let rate_hz = model.rate_hz;
    let density = |changes: bool| {
        let own = |effect: &&Arc<dyn Effect>| match effect.kind() {
            EffectKind::VarianceChange => changes,
            _ => effect.spec().nature == Nature::White,
        };
        let white =
            ChannelModel { n: of.n, effects: of.effects.iter().filter(own).cloned().collect(), ..Default::default() };
        let channels = [(channel, white)].into();
        let alone = SensorModel { rate_hz, channels, sampling: model.sampling, ..SensorModel::default() };
        Spectrum::new(&alone, channel, Record { rate_hz, samples }).psd(LOWEST * rate_hz)
    };
    density(true).or_else(|| density(false)).unwrap_or(0.0).sqrt()
}

/// The closed forms of one channel of a model, for a record.
#[derive(Debug)]
pub struct Spectrum<'a> {
    model: &'a SensorModel,
    channel: Channel,
    record: Record,
}

impl<'a> Spectrum<'a> {
    /// Returns the spectrum of `channel` over a record of sent samples (its rate and length).
    pub fn new(model: &'a SensorModel, channel: Channel, record: Record) -> Self {
        Self { model, channel, record }
    }

    /// Returns the two-sided density in U²/Hz at `frequency_hz` (above 0, up to half the record's rate) of the
    /// channel's noise: with every filter's gain, the noise that folds in sampling, and the noise of rounding.
    /// [`Spectrum::lines`] has the lines.
    ///
    /// `None` if it depends on more than the parameters. This applies to held samples, to changes of variance with
    /// temperature or several of them, to noise that varies over time (bursts, a band or spectrum with a level,
    /// intermittent noise inside intervals), to temperature bias, and to a line that wanders slowly. A saturation
    /// counts as never reached.
    pub fn psd(&self, frequency_hz: f64) -> Option<f64> {
        let internal_hz = self.model.internal_rate_hz(self.record.rate_hz);
        let Some(sampling) = self.model.sampling else {
            return Some(self.internal_psd(frequency_hz, internal_hz)? + self.sent_psd()?);
        };
        let images = sampling.decimation(self.record.rate_hz)?;
        let mut folded = 0.0;
        for image in 0..images {
            let at_hz = frequency_hz + image as f64 * self.record.rate_hz;
            // Beyond half the internal rate, a spectrum is its own mirror image.
            let own_hz = at_hz.min(internal_hz - at_hz).abs();
            let gain = boxcar_gain(sampling.filter_window, own_hz / internal_hz);
            folded += gain * self.internal_psd(own_hz, internal_hz)?;
        }
        Some(folded + self.sent_psd()?)
    }

    /// Returns the channel's lines as they are sent: folded below half the record's rate, with every filter's gain.
    pub fn lines(&self) -> Vec<Line> {
        let (rate_hz, internal_hz) = (self.record.rate_hz, self.model.internal_rate_hz(self.record.rate_hz));
        let effects = self.effects();
        let window = self.model.sampling.map_or(1, |sampling| sampling.filter_window);
        let own = effects.iter().flat_map(|effect| effect.lines());
        own.map(|line| {
            let gain = self.bandwidth(line.frequency_hz, internal_hz);
            let within = line.frequency_hz.rem_euclid(rate_hz);
            Line {
                frequency_hz: within.min(rate_hz - within),
                power: line.power * gain * boxcar_gain(window, line.frequency_hz / internal_hz),
            }
        })
        .collect()
    }

    fn effects(&self) -> Vec<Arc<dyn Effect>> {
        effects_on(self.model, self.channel).into_iter().map(|(effect, _)| effect).collect()
    }

    /// Returns the gain of the sensor's bandwidth.
    fn bandwidth(&self, frequency_hz: f64, internal_hz: f64) -> f64 {
        self.effects().iter().map(|effect| effect.power_gain(frequency_hz, internal_hz)).product()
    }

    /// Returns the density before sampling.
    fn internal_psd(&self, frequency_hz: f64, internal_hz: f64) -> Option<f64> {
        let parameters = self.model.channels.get(&self.channel)?;
        let record = Record { rate_hz: internal_hz, samples: (self.record.length_s() * internal_hz).round() as u64 };
        let mut white = White { n: parameters.n }.psd(frequency_hz, internal_hz)?;
        let mut noise = Flicker { b: parameters.b }.psd(frequency_hz, internal_hz)?
            + RandomWalk { k: parameters.k }.psd(frequency_hz, internal_hz)?;
        let effects = self.effects();
        if effects.iter().filter(|effect| effect.kind() == EffectKind::VarianceChange).count() > 1 {
            // The mean square of their product is not the product of their mean squares.
            return None;
        }
        // In the chain's order: noise that enters behind a filter passes the filters after it.
        for effect in effects {
            match effect.stage() {
                Stage::WhitePart => white *= effect.white_moments(record)?.variance,
                Stage::Bias | Stage::Noise => noise += effect.psd(frequency_hz, internal_hz)?,
                Stage::Bandwidth => {
                    let gain = effect.power_gain(frequency_hz, internal_hz);
                    white *= gain;
                    noise = noise * gain + effect.psd(frequency_hz, internal_hz)?;
                }
                _ => {}
            }
        }
        Some(white + noise)
    }

    /// Returns the noise of the stages after sampling.
    fn sent_psd(&self) -> Option<f64> {
        let sent = self.effects();
        let sent = sent.iter().filter(|effect| matches!(effect.stage(), Stage::Resolution | Stage::Hold));
        sent.map(|effect| effect.psd(0.0, self.record.rate_hz)).sum()
    }
}
