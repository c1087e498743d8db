//! Intermittent: another effect that comes and goes.

use super::described::described;
use super::gauss_markov::lorentzian;
use super::spec::{FROM_ZERO, Form, Need, Parameter, Values, above};
use super::{
    Bursts, Effect, EffectKind, Extent, Line, Moments, Record, Refusal, Resonance, Sampler, Spec, Stage, Stream, Tone,
    White, profile, sampled,
};
use serde_json::{Map, Value, json};
use std::f64::consts::TAU;
use std::sync::Arc;

/// A tone, a resonance or white noise that is present only at times. The underlying process continues meanwhile, so
/// that a tone keeps its phase.
///
/// At random times with exponential stays (a random telegraph g of 0 and 1, stationary from the start): with p the share of
/// the time it is on and λ = 1/on + 1/off, E g₀g_t = p² + p(1 − p)·e^(−λt). The product's autocovariance is that times the
/// effect's own, so that a tone keeps a line of p² of its power and gets a Lorentzian foot of half width λ/2π.
/// Source of the telegraph: Machlup 1954, J. Appl. Phys. 25.
#[derive(Debug, Clone, PartialEq)]
pub struct Intermittent {
    /// The effect that comes and goes.
    pub of: Gated,
    /// When the effect is present.
    pub times: Times,
}

/// The effects that can come and go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Gated {
    /// A sine.
    Tone(Tone),
    /// A narrow band.
    Resonance(Resonance),
    /// White noise.
    White(White),
}

/// When an effect is present.
#[derive(Debug, Clone, PartialEq)]
pub enum Times {
    /// Mean lengths of the effect's stays and of the pauses between them, s.
    Random {
        /// Mean length of a stay, s.
        on_s: f64,
        /// Mean length of a pause, s.
        off_s: f64,
    },
    /// Begin and end in s after the start; overlapping intervals count once.
    Intervals(Vec<(f64, f64)>),
}

static OF_WHITE: Spec = Spec {
    stream: 0,
    parameters: &[Parameter::new("n", FROM_ZERO, "U/√Hz", "N in U/√Hz: two-sided density N²")],
    meaning: "white noise",
    ..*White::SPEC
};

/// A symmetric line.
static OF_RESONANCE: Spec = Spec {
    stream: 0,
    parameters: Resonance::SPEC.parameters.split_at(3).0,
    meaning: "noise in a narrow band, with a symmetric Lorentzian line",
    ..*Resonance::SPEC
};

const GATED: &[&Spec] = &[Tone::SPEC, &OF_RESONANCE, &OF_WHITE];

const fn in_form(name: &'static str, form: Form, meaning: &'static str) -> Parameter {
    Parameter::new(name, form, "s", meaning).needed(Need::InItsForm)
}

described! {
    Intermittent: dyn Effect, 21, Stage::Noise;
    "a tone, a resonance or white noise that comes and goes, at random or inside intervals"
        => "vibration that comes and goes{more}";
    [
        Parameter::new("of", Form::Effect(GATED), "", "the effect that comes and goes"),
        in_form("on_s", above(0.0), "mean length of a stay, s"),
        in_form("off_s", above(0.0), "mean length of a pause, s"),
        in_form("intervals", Form::Intervals, "[from_s, to_s] after the start: it is there inside"),
    ],
    &[&["on_s", "off_s"], &["intervals"]];
    |values| {
        let of = values.effect("of");
        let number = |name: &str| of.as_ref().map_or(0.0, |of| of.number(name));
        let frequency_hz = number("frequency_hz");
        let gated = match of.as_ref().map(Values::kind) {
            Some(EffectKind::Tone) => Gated::Tone(Tone { frequency_hz, amplitude: number("amplitude") }),
            Some(EffectKind::Resonance) => {
                Gated::Resonance(Resonance::new(frequency_hz, number("bandwidth_hz"), number("sigma")))
            }
            _ => Gated::White(White { n: number("n") }),
        };
        let times = match values.optional("on_s") {
            Some(on_s) => Times::Random { on_s, off_s: values.number("off_s") },
            None => Times::Intervals(values.pairs("intervals")),
        };
        Intermittent { of: gated, times }
    },
    |of| {
        let mut parameters = vec![("of", of.of.value())];
        match &of.times {
            Times::Random { on_s, off_s } => parameters.extend([("on_s", (*on_s).into()), ("off_s", (*off_s).into())]),
            Times::Intervals(intervals) => parameters.push(("intervals", profile::value(intervals))),
        }
        parameters
    }
}

impl Gated {
    fn effect(&self) -> &dyn Effect {
        match self {
            Self::Tone(of) => of,
            Self::Resonance(of) => of,
            Self::White(of) => of,
        }
    }

    /// Returns the effect in the form of a file.
    fn value(&self) -> Value {
        let mut entry: Map<String, Value> =
            std::iter::once(("effect".to_owned(), json!(self.effect().name()))).collect();
        if let Self::White(of) = self {
            entry.insert("n".to_owned(), of.n.into());
        } else {
            entry.extend(self.effect().parameters().into_iter().map(|(name, value)| (name.to_owned(), value)));
        }
        entry.into()
    }

    /// Returns the autocovariance over `k` samples (from 1), U².
    fn covariance(&self, k: u64, rate_hz: f64) -> f64 {
        let lag_s = k as f64 / rate_hz;
        match self {
            Self::Tone(of) => 0.5 * of.amplitude * of.amplitude * (TAU * (of.frequency_hz * lag_s).fract()).cos(),
            Self::Resonance(of) => {
                let decayed = (-std::f64::consts::PI * of.bandwidth_hz * lag_s).exp();
                of.sigma * of.sigma * decayed * (TAU * (of.frequency_hz * lag_s).fract()).cos()
            }
            Self::White(_) => 0.0,
        }
    }
}

/// Returns the share of the time for which it is on, and the rate at which its state is forgotten, 1/s.
fn telegraph(on_s: f64, off_s: f64) -> (f64, f64) {
    (on_s / (on_s + off_s), 1.0 / on_s + 1.0 / off_s)
}

impl Effect for Intermittent {
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        let refused = self.of.effect().check_at(rate_hz).err();
        refused.map_or(Ok(()), |of| Err(Self::SPEC.refuse(format!("of.{}", of.parameter), of.found, of.allowed)))
    }
    /// Inside intervals, each of them in the effect's own band.
    fn extents(&self) -> Vec<Extent> {
        let own = self.of.effect().extents();
        let Times::Intervals(intervals) = &self.times else { return own };
        let band_hz = own.first().and_then(|own| own.band_hz);
        let of = |(from_s, to_s): &(f64, f64)| Extent { band_hz, ..Extent::time(*from_s, *to_s, to_s - from_s) };
        intervals.iter().map(of).collect()
    }
    /// `None` inside intervals: over a record it is the effect's own times the share of the intervals, smeared by their
    /// lengths.
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        let Times::Random { on_s, off_s } = self.times else { return None };
        let (share, forgotten) = telegraph(on_s, off_s);
        let comes_and_goes = share * (1.0 - share);
        let broadened = |power: f64, centre_hz: f64, width_hz: f64| {
            let decay = (forgotten + std::f64::consts::PI * width_hz) / rate_hz;
            let line = |centre_hz: f64| lorentzian((frequency_hz - centre_hz) / rate_hz, decay, rate_hz);
            0.5 * power * (line(centre_hz) + line(-centre_hz))
        };
        Some(match self.of {
            Gated::White(of) => share * of.n * of.n,
            Gated::Tone(of) => comes_and_goes * broadened(0.5 * of.amplitude * of.amplitude, of.frequency_hz, 0.0),
            Gated::Resonance(of) => {
                share * share * of.psd(frequency_hz, rate_hz)?
                    + comes_and_goes * broadened(of.sigma * of.sigma, of.frequency_hz, of.bandwidth_hz)
            }
        })
    }
    /// Approximate for intervals: a tone is broadened by 1/π over the length of its stays.
    fn stationary(&self, record: Record) -> Option<Arc<dyn Effect>> {
        let Times::Intervals(intervals) = &self.times else { return None };
        let variance = self.moments(record)?.variance;
        let per_s = intervals.len() as f64 / intervals.iter().map(|(from_s, to_s)| to_s - from_s).sum::<f64>();
        let width_hz = per_s / std::f64::consts::PI;
        let band = |frequency_hz: f64, bandwidth_hz: f64| {
            Arc::new(Resonance::new(frequency_hz, bandwidth_hz, variance.sqrt())) as Arc<dyn Effect>
        };
        Some(match self.of {
            Gated::White(_) => Arc::new(White { n: (variance / record.rate_hz).sqrt() }),
            Gated::Tone(of) => band(of.frequency_hz, width_hz),
            Gated::Resonance(of) => band(of.frequency_hz, of.bandwidth_hz + width_hz),
        })
    }
    fn lines(&self) -> Vec<Line> {
        match (&self.times, self.of) {
            (Times::Random { on_s, off_s }, Gated::Tone(of)) => {
                let (share, _) = telegraph(*on_s, *off_s);
                of.lines().into_iter().map(|line| Line { power: share * share * line.power, ..line }).collect()
            }
            _ => Vec::new(),
        }
    }
    /// For intervals, only that of white noise is known; it is that of [`Bursts`].
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        match (&self.times, self.of) {
            (Times::Random { on_s, off_s }, of) => {
                let (share, forgotten) = telegraph(*on_s, *off_s);
                let variance = share * of.effect().moments(record)?.variance;
                let covariance = |k: u64| {
                    let remembered = (-forgotten * k as f64 / record.rate_hz).exp();
                    (share * share + share * (1.0 - share) * remembered) * of.covariance(k, record.rate_hz)
                };
                Some(sampled::allan_variance(m, |k| variance - covariance(k)))
            }
            (Times::Intervals(intervals), Gated::White(of)) => {
                let sigma = of.n * record.rate_hz.sqrt();
                Bursts { intervals: intervals.clone(), sigma }.allan_variance(m, record)
            }
            _ => None,
        }
    }
    /// Returns the moments of the effect, diluted by the share of the time.
    fn moments(&self, record: Record) -> Option<Moments> {
        let share = match &self.times {
            Times::Random { on_s, off_s } => telegraph(*on_s, *off_s).0,
            Times::Intervals(intervals) => {
                let bursts = Bursts { intervals: intervals.clone(), sigma: 1.0 };
                bursts.inside(record) as f64 / record.samples.max(1) as f64
            }
        };
        let own = self.of.effect().moments(record)?;
        let kurtosis = own.kurtosis.filter(|_| share > 0.0).map(|kurtosis| kurtosis / share);
        Some(Moments { variance: share * own.variance, kurtosis })
    }
    fn sampler(&self, rate_hz: f64, record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let gate = match &self.times {
            Times::Random { on_s, off_s } => {
                let (share, forgotten) = telegraph(*on_s, *off_s);
                let changes = -(-forgotten / rate_hz).exp_m1();
                let mut stream = Box::new(stream.branch());
                Gate::Random {
                    is_on: stream.uniform() < share,
                    leaves: (1.0 - share) * changes,
                    comes: share * changes,
                    stream,
                }
            }
            Times::Intervals(intervals) => {
                let mut ranges = Bursts { intervals: intervals.clone(), sigma: 1.0 }.ranges(rate_hz);
                ranges.reverse();
                Gate::Ranges { ranges, index: 0 }
            }
        };
        let of = self.of.effect().sampler(rate_hz, record_length_s, stream);
        Box::new(profile::Weighted::new(of, gate))
    }
}

/// Whether the effect is present, sample by sample.
#[derive(Debug)]
enum Gate {
    /// With the probabilities of a change from one sample to the next.
    Random { is_on: bool, leaves: f64, comes: f64, stream: Box<Stream> },
    /// The remaining ranges, the next one last, and the next sample's index.
    Ranges { ranges: Vec<(u64, u64)>, index: u64 },
}

impl profile::Factor for Gate {
    fn next(&mut self) -> f64 {
        let is_there = match self {
            Self::Random { is_on, leaves, comes, stream } => {
                let now = *is_on;
                *is_on = if now { stream.uniform() >= *leaves } else { stream.uniform() < *comes };
                now
            }
            Self::Ranges { ranges, index } => {
                while ranges.last().is_some_and(|range| range.1 <= *index) {
                    ranges.pop();
                }
                let now = ranges.last().is_some_and(|range| range.0 <= *index);
                *index += 1;
                now
            }
        };
        f64::from(u8::from(is_there))
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    const TONE: Tone = Tone { frequency_hz: 5.0, amplitude: 0.3 };
    const BAND: Resonance = Resonance { frequency_hz: 7.3, bandwidth_hz: 0.5, sigma: 0.4, asymmetry: 0.0 };
    const NOISE: White = White { n: 0.2 };

    fn random(of: Gated) -> Intermittent {
        Intermittent { of, times: Times::Random { on_s: 4.0, off_s: 9.0 } }
    }

    fn inside(of: Gated) -> Intermittent {
        Intermittent { of, times: Times::Intervals(vec![(300.0, 350.0), (10.0, 11.0), (10.5, 40.0)]) }
    }

    #[test]
    fn what_comes_at_random_has_its_closed_forms() {
        for of in [Gated::Tone(TONE), Gated::Resonance(BAND), Gated::White(NOISE)] {
            check::agrees_with_its_closed_forms(&random(of), 40.0);
        }
    }

    #[test]
    fn what_comes_inside_intervals_has_its_closed_forms() {
        for of in [Gated::Tone(TONE), Gated::Resonance(BAND), Gated::White(NOISE)] {
            check::agrees_with_its_closed_forms(&inside(of), 40.0);
        }
    }

    #[test]
    fn a_tones_foot_is_the_telegraphs() {
        // The line itself is below the compared octaves.
        let tone = Tone { frequency_hz: 8.0 * 40.0 / check::SAMPLES as f64, amplitude: 1.0 };
        let of = Intermittent { of: Gated::Tone(tone), times: Times::Random { on_s: 0.4, off_s: 1.0 } };
        let draw = |seed| check::draw(&of, 40.0, check::SAMPLES, seed);
        check::spectrum_agrees("a tone's foot", check::Window::Hann, draw, 40.0, |f| of.psd(f, 40.0).unwrap());
    }

    #[test]
    fn stays_have_their_mean_lengths_and_a_tone_keeps_its_phase() {
        let of = random(Gated::Tone(TONE));
        let values = check::draw(&of, 40.0, 2_000_000, 6);
        let on: Vec<bool> = values.iter().map(|value| *value != 0.0).collect();
        let (mut stays, mut inside): (f64, f64) = (0.0, 0.0);
        for pair in on.windows(2) {
            stays += if pair[1] && !pair[0] { 1.0 } else { 0.0 };
            inside += if pair[1] { 1.0 } else { 0.0 };
        }
        // Some 3800 stays, each of random length: 1/√3800 of the mean length.
        assert!((inside / stays / 160.0 - 1.0).abs() < 5.0 / 3800.0_f64.sqrt(), "{inside} in {stays}");
        // Eight samples per period: samples a period apart are equal if the tone is present at both.
        let same = |i: usize| !(on[i] && on[i + 8]) || (values[i] - values[i + 8]).abs() < 1e-9;
        assert!((0..values.len() - 8).all(same));
        let far = (0..8).find(|phase| on[1_600_000 + phase] && on[*phase]);
        assert!(far.is_none_or(|phase| (values[phase] - values[1_600_000 + phase]).abs() < 1e-6));
    }

    #[test]
    fn an_entry_is_read_and_written_with_its_effect() {
        let read = |entry: Value| Intermittent::DEFINITION.read(entry.as_object().unwrap());
        let entries = [
            json!({"of": {"effect": "tone", "frequency_hz": 5.0, "amplitude": 0.1}, "on_s": 60.0, "off_s": 120.0}),
            json!({"of": {"effect": "white", "n": 0.1}, "intervals": [[1.0, 2.0]]}),
            json!({"of": {"effect": "resonance", "frequency_hz": 5.0, "bandwidth_hz": 1.0, "sigma": 2.0}, "on_s": 1.0, "off_s": 2.0}),
        ];
        for entry in entries {
            let written: Map<String, Value> = read(entry.clone())
                .unwrap()
                .parameters()
                .into_iter()
                .map(|(name, value)| (name.to_owned(), value))
                .collect();
            assert_eq!(Value::from(written), entry);
        }
    }

    #[test]
    fn senseless_entries_are_refused_with_the_place() {
        let refused = |entry: Value| {
            let read = Intermittent::DEFINITION.read(entry.as_object().unwrap()).and_then(|effect| effect.check(40.0));
            read.unwrap_err().parameter
        };
        let tone = |frequency_hz: f64| json!({"effect": "tone", "frequency_hz": frequency_hz, "amplitude": 0.1});
        assert_eq!(refused(json!({"of": tone(20.0), "on_s": 1.0, "off_s": 1.0})), "of.frequency_hz");
        assert_eq!(refused(json!({"of": tone(-1.0), "on_s": 1.0, "off_s": 1.0})), "of.frequency_hz");
        assert_eq!(
            refused(json!({"of": {"effect": "tone", "frequency_hz": 1.0}, "intervals": [[0, 1]]})),
            "of.amplitude"
        );
        assert_eq!(refused(json!({"of": {"effect": "spikes"}, "on_s": 1.0, "off_s": 1.0})), "of.effect");
        assert_eq!(refused(json!({"of": {"effect": "white", "N": 1.0}, "on_s": 1.0, "off_s": 1.0})), "of.N");
        assert_eq!(refused(json!({"of": 3, "on_s": 1.0, "off_s": 1.0})), "of");
        assert_eq!(refused(json!({"of": tone(1.0), "on_s": 0.0, "off_s": 1.0})), "on_s");
        assert_eq!(refused(json!({"of": tone(1.0), "on_s": 1.0})), "on_s");
        assert_eq!(refused(json!({"of": tone(1.0), "on_s": 1.0, "off_s": 1.0, "intervals": [[0, 1]]})), "on_s");
        assert_eq!(refused(json!({"of": tone(1.0), "intervals": [[2, 1]]})), "intervals[0]");
        assert_eq!(refused(json!({"on_s": 1.0, "off_s": 1.0})), "of");
    }
}
