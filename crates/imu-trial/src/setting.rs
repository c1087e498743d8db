//! Settings: the device of a sealed case, its record's shape, and an independent model of it.

use super::draw::Draw;
use super::ground::TemperatureCourse;
use super::kind::Kind;
use super::stamps::Stamps;
use imu_core::sample::{Channel, Triad};
use imu_model::simulator::{ChannelModel, SensorModel};
use std::collections::{BTreeMap, BTreeSet};

/// Names of effects by channel.
pub type Own = BTreeMap<Channel, BTreeSet<String>>;

/// A channel of the device: its true values and its model's statements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// The channel.
    pub channel: Channel,
    /// The level, U.
    pub level: f64,
    /// The true N, B and K (docs/formats.md).
    pub true_nbk: [f64; 3],
    /// The model's N, B and K.
    pub declared_nbk: [f64; 3],
    /// The bias that the model states, U, if there is one.
    pub declared_bias: Option<f64>,
}

/// A device at rest and the shape of its record.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// Samples per second.
    pub rate_hz: f64,
    /// Samples per channel.
    pub samples: usize,
    /// The channels, in column order.
    pub parts: Vec<Part>,
    /// The temperature, if it is measured.
    pub temperature: Option<TemperatureCourse>,
    /// How samples are stamped, if they are.
    pub stamps: Option<Stamps>,
    /// The own effects of a recorded device, if it is one: no similar effect is imposed on these channels.
    pub own: Own,
}

/// Range of the cases' lengths in s, and range of their rates in Hz.
const LENGTH_S: [f64; 2] = [27.0 * 60.0, 5.0 * 3600.0];
const RATE_HZ: [f64; 2] = [40.0, 200.0];
/// Share of the cases with six channels instead of two.
pub(super) const SIX: f64 = 0.3;
/// Share of the cases with a measured temperature, among those that do not need one.
const WARM: f64 = 0.8;
/// Maximum errors of N, B and K in a model of this sensor.
pub(super) const OFF: [f64; 3] = [0.05, 0.25, 0.4];
/// Factors of the errors in a model from a data sheet or another session, and the part of the cases with such a model.
const FAR: [f64; 3] = [3.0, 30.0, 30.0];
const OF_ANOTHER: f64 = 0.35;
/// The study's B, and the step of its walk, in units of the white part per sample.
const FLICKER: f64 = 0.063;
const WALK: f64 = 8e-4;

/// Returns a number between two whose density falls as its cube: most numbers are near the lower one, so that thousands
/// of cases can be run.
fn mostly_low(draw: &mut Draw, [low, high]: [f64; 2]) -> f64 {
    draw.uniform(high.powi(-2), low.powi(-2)).powf(-0.5)
}

/// Returns N, B and K of an independent model: a little wrong, or far off.
pub(super) fn declared(true_nbk: [f64; 3], far: bool, draw: &mut Draw) -> [f64; 3] {
    let mut declared = true_nbk;
    for (at, parameter) in declared.iter_mut().enumerate() {
        *parameter *=
            if far { draw.log_uniform(1.0 / FAR[at], FAR[at]) } else { 1.0 + draw.uniform(-OFF[at], OFF[at]) };
    }
    declared
}

/// Returns whether the model of a case is far off.
pub(super) fn is_of_another(device: &mut Draw) -> bool {
    device.chance(OF_ANOTHER)
}

impl Part {
    /// Returns the standard deviation of the white part per sample, U.
    pub fn white(&self, rate_hz: f64) -> f64 {
        self.true_nbk[0] * rate_hz.sqrt()
    }

    /// Returns the step of the random walk per sample, U.
    pub fn walk(&self, rate_hz: f64) -> f64 {
        self.true_nbk[2] / rate_hz.sqrt()
    }

    fn draw(channel: Channel, rate_hz: f64, far: bool, draw: &mut Draw) -> Self {
        // N of a VN-100 in its units (data sheet), its level at rest, and how much both vary from device to device.
        let (density, level) = match channel.triad() {
            Some(Triad::Gyro) => (6e-5, 0.003 * draw.normal()),
            Some(Triad::Accel) => (1.4e-3, draw.uniform(-9.9, 9.9)),
            _ => (1.4e-4, draw.uniform(-0.5, 0.5)),
        };
        let n = density * draw.log_uniform(0.25, 6.0);
        let white = n * rate_hz.sqrt();
        let b = FLICKER * white * draw.log_uniform(0.5, 2.0);
        let k = WALK * white * 2_f64.powf(draw.uniform(-1.3, 1.3)) * rate_hz.sqrt();
        let true_nbk = [n, b, k];
        let declared_nbk = declared(true_nbk, far, draw);
        let declared_bias = draw.chance(0.2).then(|| level + 20.0 * white * draw.normal());
        Self { channel, level, true_nbk, declared_nbk, declared_bias }
    }
}

impl Setting {
    /// Draws a setting on which these kinds can be imposed.
    pub fn draw(kinds: &[Kind], device: &mut Draw) -> Self {
        let rate_hz = mostly_low(device, RATE_HZ);
        let samples = (mostly_low(device, LENGTH_S) * rate_hz) as usize;
        let mut channels: Vec<Channel> = Channel::ANALYSED.to_vec();
        device.shuffle(&mut channels);
        channels.truncate(if device.chance(SIX) { 6 } else { 2 });
        channels.sort_unstable();
        let far = is_of_another(device);
        let parts = channels.into_iter().map(|channel| Part::draw(channel, rate_hz, far, device)).collect();
        let needed = kinds.iter().any(|kind| kind.needs_temperature());
        let measured = device.chance(WARM) || needed;
        let temperature = TemperatureCourse::draw(device);
        let stamps = if kinds.iter().any(|kind| kind.needs_stamps()) {
            Some(Stamps::exact(device.uniform(0.0, 5_000.0)))
        } else {
            device.chance(0.5).then(|| Stamps::draw(rate_hz, device))
        };
        Self { rate_hz, samples, parts, temperature: measured.then_some(temperature), stamps, own: Own::new() }
    }

    /// Returns whether a channel has no effect of the recording similar to a kind.
    pub fn is_free(&self, channel: Channel, kind: Kind) -> bool {
        self.own.get(&channel).is_none_or(|own| kind.like().iter().all(|effect| !own.contains(effect.name())))
    }

    /// Returns the record's length, s.
    pub fn length_s(&self) -> f64 {
        self.samples as f64 / self.rate_hz
    }

    /// Returns an independent model: with N, B and K a little wrong or far off, without effects.
    pub fn model(&self) -> SensorModel {
        self.model_with("as told", |part| part.declared_nbk, |part| part.declared_bias)
    }

    /// Returns the model with the true N, B, K and levels, without effects.
    pub fn true_model(&self) -> SensorModel {
        self.model_with("as it is", |part| part.true_nbk, |part| Some(part.level))
    }

    fn model_with(
        &self,
        name: &str,
        nbk: impl Fn(&Part) -> [f64; 3],
        bias: impl Fn(&Part) -> Option<f64>,
    ) -> SensorModel {
        let channel = |part: &Part| {
            let [n, b, k] = nbk(part);
            (part.channel, ChannelModel { n, b, k, bias: bias(part), ..ChannelModel::default() })
        };
        let channels: BTreeMap<_, _> = self.parts.iter().map(channel).collect();
        SensorModel { name: name.to_owned(), rate_hz: self.rate_hz, channels, ..SensorModel::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_stay_in_their_ranges_and_are_nothing_special() {
        let all: Vec<Setting> =
            (0..400).map(|case| Setting::draw(&[], &mut Draw::device(3, case, "setting"))).collect();
        for setting in &all {
            assert!((LENGTH_S[0] - 1.0..=LENGTH_S[1]).contains(&setting.length_s()));
            assert!((RATE_HZ[0]..=RATE_HZ[1]).contains(&setting.rate_hz));
            for part in &setting.parts {
                for ((declared, truth), far) in part.declared_nbk.iter().zip(part.true_nbk).zip(FAR) {
                    assert!((1.0 / far..=far).contains(&(declared / truth)));
                }
            }
            assert!(setting.model().check(setting.rate_hz).is_ok());
        }
        let share = |of: &dyn Fn(&Setting) -> bool| all.iter().filter(|setting| of(setting)).count() as f64 / 400.0;
        let near = |setting: &Setting| {
            setting.parts.iter().all(|part| {
                part.declared_nbk
                    .iter()
                    .zip(part.true_nbk)
                    .zip(OFF)
                    .all(|((declared, truth), off)| (declared / truth - 1.0).abs() <= off)
            })
        };
        assert!((share(&near) - (1.0 - OF_ANOTHER)).abs() < 0.1);
        assert!((share(&|setting| setting.samples % 2 == 1) - 0.5).abs() < 0.1);
        assert!((share(&|setting| setting.parts.len() == 6) - SIX).abs() < 0.1);
        assert!(share(&|setting| setting.temperature.is_some()) < 0.9);
        let mean = all.iter().map(|setting| setting.samples).sum::<usize>() / all.len();
        assert!((120_000..300_000).contains(&mean), "{mean}");
    }
}
