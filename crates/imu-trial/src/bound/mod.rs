//! Bounds: the size below which no test, of any form, names an effect in 90 % of cases.
//!
//! An oracle knows which effect may be present, on which channels, and all of its parameters, but not whether it is
//! present. It knows B and K of the noise, and fits N, which no model has right. By Neyman and Pearson's lemma, no test
//! finds the effect more often than the likelihood ratio of the two hypotheses. If an effect is spread thinly over many
//! samples, the logarithm of that ratio is about normal under either hypothesis, with means ∓G and variance 2G; G is
//! the expected gain in nats of an effect that is present. The effect is found with probability Φ(√(2G) − z). Noise
//! alone passes z as often as the diagnosis may name one kind on one channel of two ([`LEVEL`]). The bound is the size
//! at which the mean over drawn devices, frequencies, times and channels is 0.9. These are drawn as for the trial's
//! cases, at the study's length.
//!
//! | kind | G, with σ = 1, S the density of noise, white, flicker and walk |
//! |---|---|
//! | tone, comb | Σ n A²/(4 S(f)) |
//! | rate_ramp, warm_up, bias_step, temperature_bias | ½ Σ X²(f)/S(f), X the course's DCT-II without its mean |
//! | quantization_noise, gauss_markov, resonance | n ∫₀^½ (ρ − 1 − ln ρ) df, ρ the ratio of densities, N fitted |
//! | common_mode | −½ Σ ln det of the channels' correlations |
//! | variance_… | n/2 (ln of the mean of the variance − mean of its ln): n δ²/4 for a small rms log variance δ |
//! | bursts | ½ Σ L (s² − ln(1 + s²)), L the samples within |
//! | heavy_tails | ½ I n/ν², I = 24/4² |
//!
//! The diagnosis does not know these parameters beforehand: it has to try frequencies, times and kinds, and pays for
//! each. The bound is therefore a limit that no diagnosis can exceed, but not one that it can reach.
//!
//! Source: J. Neyman and E. S. Pearson, Phil. Trans. R. Soc. A 231 (1933) 289; L. Le Cam, Univ. Calif. Publ. Statist. 3
//! (1960) 37: local asymptotic normality.

mod course;
mod density;

use super::class::Role;
use super::draw::Draw;
use super::impose::Effect;
use super::kind::Kind;
use super::limit::{STUDY, one};
use super::setting::Setting;
use imu_diagnosis::Options;
use serde_json::Value;
use statrs::function::erf::{erfc, erfc_inv};
use std::f64::consts::SQRT_2;

/// Share of the cases that a bound finds.
const FOUND: f64 = 0.9;
/// Channels that are examined in the study's cases.
const CHANNELS: f64 = 2.0;
/// Number of drawn devices per kind, and the seed of their draws. A trial's draws use other purposes and are never the
/// same.
const DRAWS: u64 = 24;
const SEED: u64 = 0;
/// Halvings of the interval between two sizes.
const HALVINGS: usize = 32;
/// The range of sizes tried on each side of the limit, as a factor.
const WIDE: f64 = 1e3;
/// Fisher's information of 1/ν at 0 per sample: Student's t with constant variance is φ (1 + He₄/(4ν) + …), and He₄ has
/// variance 4! (Abramowitz and Stegun 26.7.5 gives the expansion). He₄ is orthogonal to the variance, which is fitted.
const TAILS: f64 = 24.0 / 16.0;

/// Returns the probability with which noise alone may be named as one kind on one channel.
pub fn level() -> f64 {
    Options::default().level / (CHANNELS * Kind::LIBRARY.len() as f64)
}

/// Returns the probability that an effect worth `nats` is found.
pub fn power(nats: f64) -> f64 {
    let threshold = SQRT_2 * erfc_inv(2.0 * level());
    0.5 * erfc((threshold - (2.0 * nats.max(0.0)).sqrt()) / SQRT_2)
}

/// A bound, or the reason why there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bound {
    /// The bound in the units of [`super::limit::unit`], at the study's length.
    Size(f64),
    /// A bound has no meaning, with the reason in words.
    Meaningless(&'static str),
}

/// The worth of an effect on the channels of one drawn device, as a function of its size over the drawn size.
type Nats = Box<dyn Fn(f64) -> f64>;

/// Returns the bound of a kind of the library.
pub fn bound(kind: Kind) -> Bound {
    if let Some(reason) = meaningless(kind) {
        return Bound::Meaningless(reason);
    }
    let drawn: Vec<(f64, Nats)> = (0..DRAWS).filter_map(|device| draw(kind, device)).collect();
    let found = |over: f64| {
        let each = drawn.iter().map(|(drawn, nats)| power(nats(over / drawn)));
        each.sum::<f64>() / drawn.len() as f64
    };
    let (mut low, mut high) = (1.0 / WIDE, WIDE);
    if drawn.is_empty() || found(low) > FOUND || found(high) < FOUND {
        return Bound::Meaningless("it is found at any size, or at none");
    }
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        if found(middle) < FOUND { low = middle } else { high = middle }
    }
    Bound::Size((low * high).sqrt() * one(kind))
}

fn meaningless(kind: Kind) -> Option<&'static str> {
    Some(match kind {
        Kind::Resolution => "numbers that are all multiples of a step are so by no chance: any step is certain",
        Kind::HeldSamples => "no noise repeats a number exactly: one repeat is certain, and no case is without",
        Kind::Saturation => "no noise meets its greatest number three times: any share is certain",
        Kind::Spikes => "one spike of 6 standard deviations or more is enough, and no case is without",
        Kind::Timing => "the stamps of a case without it have no scatter: any is certain",
        Kind::LowPass | Kind::MovingAverage => "every filter of the cases is worth thousands of nats",
        outside if outside.effect().is_none() => "no law is known of it",
        _ => return None,
    })
}

/// Draws one device at the study's length: the drawn size over the limit, and the worth of its effect.
fn draw(kind: Kind, device: u64) -> Option<(f64, Nats)> {
    let of = |purpose: &str| Draw::device(SEED, device, &format!("bound {purpose}"));
    let mut setting = Setting::draw(&[kind], &mut of("setting"));
    setting.samples = STUDY;
    let effect = Effect::draw(kind, &setting, Role::ALONE, of("effect"), of("events")).ok()?;
    let temperature_c =
        setting.temperature.filter(|_| kind.needs_temperature()).map(|course| course.samples(STUDY, &mut of("course")));
    let parts = effect.channels.iter().map(|channel| {
        let part = setting.parts.iter().find(|part| part.channel == *channel)?;
        let white = part.white(setting.rate_hz);
        Some(On {
            parameters: effect.parameters.get(channel.name())?.clone(),
            rate_hz: setting.rate_hz,
            white,
            b: part.true_nbk[1] / white,
            k: part.walk(setting.rate_hz) / white,
        })
    });
    let parts: Vec<On> = parts.collect::<Option<_>>()?;
    let over = effect.over_limit;
    if kind == Kind::CommonMode {
        return Some((over, common(&parts)));
    }
    let nats: Vec<Nats> =
        parts.iter().map(|on| on.nats(kind, temperature_c.as_deref().unwrap_or_default())).collect::<Option<_>>()?;
    Some((over, Box::new(move |times| nats.iter().map(|of| of(times)).sum())))
}

/// An effect on one channel.
struct On {
    /// The effect's parameters, in the documented form.
    parameters: Value,
    rate_hz: f64,
    /// The white part's standard deviation, U, and flicker and walk in units of it.
    white: f64,
    b: f64,
    k: f64,
}

impl On {
    fn number(&self, name: &str) -> Option<f64> {
        self.parameters[name].as_f64()
    }

    /// Returns a parameter in units of the white part.
    fn size(&self, name: &str) -> Option<f64> {
        Some(self.number(name)? / self.white)
    }

    fn nats(&self, kind: Kind, temperature_c: &[f64]) -> Option<Nats> {
        match kind {
            Kind::Tone => self.lines(&[(self.number("frequency_hz")?, self.size("amplitude")?)]),
            Kind::Comb => {
                let fundamental_hz = self.number("fundamental_hz")?;
                let amplitudes = self.parameters["amplitudes"].as_array()?.iter().filter_map(Value::as_f64);
                let line =
                    |(harmonic, amplitude): (u32, f64)| (f64::from(harmonic) * fundamental_hz, amplitude / self.white);
                self.lines(&(1..).zip(amplitudes).map(line).collect::<Vec<_>>())
            }
            Kind::RateRamp => {
                let slope = self.size("R")? / self.rate_hz;
                self.course((0..STUDY).map(|i| slope * i as f64).collect())
            }
            Kind::WarmUp => {
                let (size, tau) = (self.size("amplitude")?, self.number("tau_s")? * self.rate_hz);
                self.course((0..STUDY).map(|i| size * (-(i as f64) / tau).exp()).collect())
            }
            Kind::TemperatureBias => {
                let per_c = self.size("per_c")?;
                self.course(temperature_c.iter().map(|celsius| per_c * celsius).collect())
            }
            Kind::BiasStep => {
                let mut made = vec![0.0; STUDY];
                for one in self.parameters.as_array()? {
                    course::step(&mut made, one["at_s"].as_f64()? * self.rate_hz, one["size"].as_f64()? / self.white);
                }
                self.course(made)
            }
            Kind::QuantizationNoise => {
                let size = self.size("Q")? * self.rate_hz;
                self.density(None, move |cycles| density::angle(size, cycles))
            }
            Kind::GaussMarkov => {
                let (size, tau) = (self.size("sigma")?, self.number("tc_s")? * self.rate_hz);
                self.density(None, move |cycles| density::markov(size, tau, cycles))
            }
            Kind::Resonance => {
                let (size, middle) = (self.size("sigma")?, self.number("frequency_hz")? / self.rate_hz);
                let width = self.number("bandwidth_hz")? / self.rate_hz;
                let radius = 1.0 - std::f64::consts::PI * width;
                self.density(Some((middle, width)), move |cycles| density::resonance(size, radius, middle, cycles))
            }
            Kind::HeavyTails => {
                let inverse = 1.0 / self.number("degrees_of_freedom")?;
                Some(quadratic(0.5 * TAILS * STUDY as f64 * inverse * inverse))
            }
            Kind::Bursts => {
                let size = self.size("sigma")?;
                let intervals = self.parameters["intervals"].as_array()?;
                let length = |one: &Value| Some((one[1].as_f64()? - one[0].as_f64()?) * self.rate_hz);
                let within: f64 = intervals.iter().map(length).sum::<Option<f64>>()?;
                Some(Box::new(move |times| 0.5 * within * louder((times * size).powi(2))))
            }
            Kind::VarianceInterval => {
                let length_s = STUDY as f64 / self.rate_hz;
                let part = (self.number("to_s")? - self.number("from_s")?) / length_s;
                let log = 2.0 * self.number("factor")?.ln();
                Some(Box::new(move |times| loudness(&[(part, times * log), (1.0 - part, 0.0)])))
            }
            Kind::VarianceProfile => {
                let factors = self.parameters["profile"].as_array()?.iter().filter_map(|point| point[1].as_f64());
                Some(of_logs(factors.map(|factor| 2.0 * factor.ln()).collect()))
            }
            Kind::VariancePerC => {
                let per_c = 2.0 * self.number("per_c")?;
                // The temperature is smooth over thousands of samples.
                Some(of_logs(temperature_c.iter().step_by(64).map(|celsius| per_c * (celsius - 25.0)).collect()))
            }
            _ => None,
        }
    }

    /// Returns the worth of lines of frequency, Hz, and amplitude: in the limit, n A²/4 nats each in white noise.
    fn lines(&self, lines: &[(f64, f64)]) -> Option<Nats> {
        let ground = course::ground(self.b, self.k);
        let each = lines.iter().map(|(hz, size)| 0.25 * STUDY as f64 * size * size / ground(hz / self.rate_hz));
        Some(quadratic(each.sum()))
    }

    fn course(&self, course: Vec<f64>) -> Option<Nats> {
        Some(quadratic(course::nats(&course::powers(&course), course::ground(self.b, self.k))))
    }

    fn density(&self, peak: Option<(f64, f64)>, added: impl Fn(f64) -> f64) -> Option<Nats> {
        let at = density::frequencies(STUDY, peak);
        let base: Vec<f64> = at.iter().copied().map(course::ground(self.b, self.k)).collect();
        let added: Vec<f64> = at.iter().map(|cycles| added(*cycles)).collect();
        Some(Box::new(move |times| {
            let scaled: Vec<f64> = added.iter().map(|one| times * times * one).collect();
            density::nats(STUDY, &at, &base, &scaled)
        }))
    }
}

fn common(parts: &[On]) -> Nats {
    let at = density::frequencies(STUDY, None);
    let ratio = |on: &On| -> Vec<f64> {
        let (share, ground) = (on.size("sigma").unwrap_or(0.0), course::ground(on.b, on.k));
        at.iter().map(|cycles| share * share / ground(*cycles)).collect()
    };
    let ratios: Vec<Vec<f64>> = parts.iter().map(ratio).collect();
    Box::new(move |times| {
        let scaled: Vec<Vec<f64>> =
            ratios.iter().map(|of| of.iter().map(|one| times * times * one).collect()).collect();
        density::shared_nats(STUDY, &at, &scaled)
    })
}

/// Returns the gain of effects whose gain is proportional to the square of the size.
fn quadratic(nats: f64) -> Nats {
    Box::new(move |times| nats * times * times)
}

/// Returns twice the nats per sample of a variance of 1 + `more` if 1 was expected.
fn louder(more: f64) -> f64 {
    more - more.ln_1p()
}

/// Returns the nats of a record whose parts, given by share and log variance, differ, if the mean variance has to be
/// fitted.
fn loudness(parts: &[(f64, f64)]) -> f64 {
    let middle: f64 = parts.iter().map(|(share, log)| share * log).sum();
    let mean: f64 = parts.iter().map(|(share, log)| share * (log - middle).exp()).sum();
    0.5 * STUDY as f64 * mean.ln()
}

fn of_logs(logs: Vec<f64>) -> Nats {
    let share = 1.0 / logs.len().max(1) as f64;
    Box::new(move |times| loudness(&logs.iter().map(|log| (share, times * log)).collect::<Vec<_>>()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twelve_nats_are_needed_for_nine_of_ten() {
        // 0.005 over 2 channels and 22 kinds is 1.136e-4, which a normal number passes at 3.686; with 1.282 for 90 %:
        // (3.686 + 1.282)²/2.
        assert!((power(12.34) - 0.9).abs() < 1e-3, "{}", power(12.34));
        assert!((power(0.0) / level() - 1.0).abs() < 1e-6);
        assert!((power(0.5 * 3.686_f64.powi(2)) - 0.5).abs() < 1e-3);
    }

    #[test]
    fn a_variance_that_changes_a_little_is_worth_its_mean_square() {
        // n/4 times the variance of its logarithm: a fifth of the record is louder by 0.02.
        let found = loudness(&[(0.2, 0.02), (0.8, 0.0)]);
        let expected = 65_536.0 / 4.0 * 0.16 * 4e-4;
        assert!((found / expected - 1.0).abs() < 0.01, "{found} for {expected}");
        assert!(loudness(&[(0.5, 0.3), (0.5, 0.3)]).abs() < 1e-9);
    }

    #[test]
    fn bounds_are_those_of_formulas_by_hand() {
        let size = |kind| match bound(kind) {
            Bound::Size(size) => size,
            Bound::Meaningless(reason) => panic!("{kind}: {reason}"),
        };
        // 12.34 nats on one channel: a tone of √(4·12.34/65536), tails of √(12.34/(0.75·65536)), log variance of
        // √(8·12.34/65536) in intervals and waves, of √(4·12.34/65536) by temperature. Cases have one to six channels,
        // tones 1 to 1.25 times their size: the bound over all is lower, but cases with one channel keep it within a
        // factor of 1.6.
        for (kind, alone) in [
            (Kind::Tone, 0.02744),
            (Kind::HeavyTails, 0.01584),
            (Kind::VarianceInterval, 0.0388),
            (Kind::VarianceProfile, 0.0388),
            (Kind::VariancePerC, 0.02744),
        ] {
            let found = size(kind) / alone;
            assert!((0.6..1.25).contains(&found), "{kind}: {found}");
        }
    }

    #[test]
    fn every_kind_has_a_bound_or_a_reason_and_no_bound_is_above_the_studys_limit() {
        for kind in Kind::LIBRARY.iter().copied() {
            match bound(kind) {
                Bound::Size(size) => {
                    let ratio = size / one(kind);
                    assert!((0.05..1.05).contains(&ratio), "{kind}: {ratio} of the study's limit");
                }
                Bound::Meaningless(reason) => assert!(reason.len() > 20 && meaningless(kind).is_some(), "{kind}"),
            }
        }
    }
}
