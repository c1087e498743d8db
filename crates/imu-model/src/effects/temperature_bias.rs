//! Temperature bias: a level that follows the sensor's temperature.

use super::described::effect;
use super::spec::{ANY, FROM_ZERO, Need, above};
use super::{At, Effect, Record, Sampler, Stage, Stream, Temperature};

effect! {
    /// A bias that follows the sensor's temperature T: `per_c`·(P − `reference_c`) + `per_c2`·(P − `reference_c`)² +
    /// `per_c_per_s`·D.
    ///
    /// P is T behind a play of full width `play_c`: P stays while T is within half the width of P, and otherwise
    /// follows half the width behind. The level on the way up therefore differs from that on the way down by
    /// `per_c`·`play_c`. P begins in the middle, P = T. Without play, P is T. (Play, or backlash: Visintin,
    /// Differential Models of Hysteresis, 1994.)
    ///
    /// D is dT/dt behind a lag of first order with time constant [`RATE_LAG_S`]: (T − L)/τ, where L follows T with that
    /// lag. D is causal and begins at 0.
    ///
    /// The Allan variance is that of the temperature's course times `per_c`², and the course is not a parameter:
    /// `None`.
    #[derive(Debug, Clone, Copy, PartialEq, Default)]
    pub struct TemperatureBias: dyn Effect, 0, Stage::Bias;
    "a bias that follows the sensor's temperature"
        => "a level that moves by {per_c:.3e} per °C", "a level that follows the temperature, but not along a line";
    per_c: f64 = ANY, "U/°C", "slope, U/°C";
    reference_c: f64 = above(-273.15), "°C", "the temperature at which it vanishes, °C";
    per_c2: f64 = ANY, "U/°C²", "curvature: per_c2·(T − reference_c)², U/°C²", Need::Unwritten(0.0);
    play_c: f64 = FROM_ZERO, "°C",
        "full width of the play between temperature and level (hysteresis), °C", Need::Unwritten(0.0);
    per_c_per_s: f64 = ANY, "U·s/°C",
        "what a temperature that changes adds, U per °C/s; dT/dt behind a lag of 10 s", Need::Unwritten(0.0);
}

/// Time constant of the lag of dT/dt for [`TemperatureBias::per_c_per_s`], s: short compared with the warming of a
/// sensor, long compared with the noise and the steps of a thermometer.
pub const RATE_LAG_S: f64 = 10.0;

impl TemperatureBias {
    /// Creates a bias with a slope alone, in U/°C, that vanishes at `reference_c`.
    pub const fn linear(per_c: f64, reference_c: f64) -> Self {
        Self { per_c, reference_c, per_c2: 0.0, play_c: 0.0, per_c_per_s: 0.0 }
    }

    /// Returns the level behind the play at `temperature_c`, U.
    fn level(&self, temperature_c: f64) -> f64 {
        let off = temperature_c - self.reference_c;
        if self.per_c2 == 0.0 { self.per_c * off } else { self.per_c * off + self.per_c2 * off * off }
    }
}

impl Effect for TemperatureBias {
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        None
    }
    fn allan_variance(&self, _m: u64, _record: Record) -> Option<f64> {
        None
    }
    /// Assumes that the temperature has not changed, so that it is in the middle of the play: an instant has no
    /// history.
    fn mean_response(&self, input: f64, at: At) -> f64 {
        input + self.level(at.temperature_c)
    }
    /// The columns are T − `reference_c`, and its square if there is curvature. Play and dT/dt are not functions of the
    /// instant.
    fn regressors(&self) -> usize {
        if self.per_c2 == 0.0 { 1 } else { 2 }
    }
    fn regress(&self, at: At, row: &mut [f64]) {
        let off = at.temperature_c - self.reference_c;
        for (place, power) in row.iter_mut().zip([off, off * off]) {
            *place = power;
        }
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        let share = -(-1.0 / (RATE_LAG_S * rate_hz)).exp_m1();
        Box::new(TemperatureSampler { bias: *self, share, behind: None })
    }
}

#[derive(Debug)]
struct TemperatureSampler {
    bias: TemperatureBias,
    /// The part of its distance to the temperature that the lag covers in a sample.
    share: f64,
    /// The temperatures behind the play and behind the lag, once a temperature was given, °C.
    behind: Option<[f64; 2]>,
}

impl Sampler for TemperatureSampler {
    fn act(&mut self, values: &mut [f64], temperature: Temperature<'_>) {
        let half = 0.5 * self.bias.play_c;
        for (index, value) in values.iter_mut().enumerate() {
            let now = temperature.at(index);
            let [play, lag] = self.behind.unwrap_or([now, now]);
            let play = if half > 0.0 { play.clamp(now - half, now + half) } else { now };
            *value += self.bias.level(play);
            if self.bias.per_c_per_s != 0.0 {
                *value += self.bias.per_c_per_s * (now - lag) / RATE_LAG_S;
            }
            self.behind = Some([play, lag + self.share * (now - lag)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;
    use crate::effects::Described as _;

    #[test]
    fn the_level_follows_the_temperature() {
        let effect = TemperatureBias::linear(-0.02, 20.0);
        let temperatures: Vec<f64> = (0..500).map(|i| 15.0 + 0.1 * f64::from(i)).collect();
        let mut values = vec![1.0; 500];
        effect.sampler(40.0, 1.0, check::stream(1)).act(&mut values, Temperature::Series(&temperatures));
        let mut row = [0.0];
        for (value, temperature_c) in values.iter().zip(temperatures) {
            let at = At { time_s: 0.0, temperature_c };
            effect.regress(at, &mut row);
            assert!((value - effect.mean_response(1.0, at)).abs() < 1e-14);
            assert!((value - 1.0 - effect.per_c * row[0]).abs() < 1e-14);
        }
        assert!((values[0] - 1.1).abs() < 1e-14);
    }

    /// Returns the effect's output for a course of temperatures at `rate_hz`.
    fn follow(effect: TemperatureBias, rate_hz: f64, temperatures: &[f64]) -> Vec<f64> {
        let mut values = vec![0.0; temperatures.len()];
        effect.sampler(rate_hz, 1.0, check::stream(1)).act(&mut values, Temperature::Series(temperatures));
        values
    }

    #[test]
    fn the_way_down_differs_from_the_way_up_by_the_play() {
        let up = (0..=200).map(|i| 20.0 + 0.1 * f64::from(i));
        let temperatures: Vec<f64> = up.clone().chain(up.rev()).collect();
        let effect = TemperatureBias { play_c: 3.0, ..TemperatureBias::linear(0.5, 20.0) };
        let values = follow(effect, 1.0, &temperatures);
        // The level does not move before half the play is used up; then it follows half the play behind.
        assert!(values[..=15].iter().all(|value| *value == 0.0));
        assert!((values[100] - 0.5 * (10.0 - 1.5)).abs() < 1e-12);
        assert!((values[201 + 100] - 0.5 * (10.0 + 1.5)).abs() < 1e-12);
        assert!((values[301] - values[100] - 0.5 * 3.0).abs() < 1e-12);
        // The same course repeated gives the same loop, at any speed.
        let slow: Vec<f64> = temperatures.iter().flat_map(|celsius| [*celsius; 3]).collect();
        let again = follow(effect, 1.0, &slow);
        assert!(values.iter().zip(again.chunks(3)).all(|(one, three)| three == [*one; 3]));
    }

    #[test]
    fn a_curve_is_quadratic_about_the_reference() {
        let effect = TemperatureBias { per_c2: 0.01, ..TemperatureBias::linear(-0.02, 20.0) };
        let temperatures: Vec<f64> = (0..50).map(f64::from).collect();
        let mut row = [0.0; 2];
        for (value, temperature_c) in follow(effect, 40.0, &temperatures).iter().zip(temperatures) {
            let at = At { time_s: 0.0, temperature_c };
            effect.regress(at, &mut row);
            assert!((value - (-0.02 * row[0] + 0.01 * row[1])).abs() < 1e-12);
            assert!((value - effect.mean_response(0.0, at)).abs() < 1e-12);
        }
        assert_eq!((effect.regressors(), TemperatureBias::linear(1.0, 0.0).regressors()), (2, 1));
    }

    #[test]
    fn a_temperature_that_changes_adds_its_rate_after_the_lag() {
        for rate_hz in [10.0, 40.0] {
            let effect = TemperatureBias { per_c_per_s: 2.0, ..TemperatureBias::linear(0.0, 20.0) };
            let count = (100.0 * rate_hz) as usize;
            let temperatures: Vec<f64> = (0..count).map(|i| 25.0 + 0.05 * i as f64 / rate_hz).collect();
            let values = follow(effect, rate_hz, &temperatures);
            assert_eq!(values[0], 0.0);
            // 1 − 1/e of it after one time constant; sampling is half a sample off at most.
            let after_lag = values[(RATE_LAG_S * rate_hz) as usize];
            assert!((after_lag / (0.1 * (1.0 - (-1.0_f64).exp())) - 1.0).abs() < 1.0 / (RATE_LAG_S * rate_hz));
            assert!((values[count - 1] / 0.1 - 1.0).abs() < 0.006);
        }
    }

    #[test]
    fn values_do_not_depend_on_how_the_course_is_cut() {
        let effect = TemperatureBias { per_c: 0.3, reference_c: 20.0, per_c2: 0.02, play_c: 1.0, per_c_per_s: 4.0 };
        let temperatures: Vec<f64> = (0..1000).map(|i| 25.0 + 3.0 * (0.01 * f64::from(i)).sin()).collect();
        let whole = follow(effect, 40.0, &temperatures);
        let mut sampler = effect.sampler(40.0, 1.0, check::stream(1));
        let mut pieces = vec![0.0; 1000];
        for (piece, course) in pieces.chunks_mut(77).zip(temperatures.chunks(77)) {
            sampler.act(piece, Temperature::Series(course));
        }
        assert_eq!(whole, pieces);
    }

    #[test]
    fn further_parameters_stand_only_where_they_are_not_0() {
        let keys = |effect: TemperatureBias| effect.parameters().into_iter().map(|(name, _)| name).collect::<Vec<_>>();
        assert_eq!(keys(TemperatureBias::linear(1.0, 25.0)), ["per_c", "reference_c"]);
        let played = TemperatureBias { play_c: 1.0, ..TemperatureBias::linear(1.0, 25.0) };
        assert_eq!(keys(played), ["per_c", "reference_c", "play_c"]);
        assert_eq!(played.check(40.0), Ok(()));
        assert!(TemperatureBias { play_c: -1.0, ..played }.check(40.0).is_err());
    }
}
