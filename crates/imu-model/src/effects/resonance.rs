//! Resonance: noise in a narrow band, such as a structure that rings.

use super::described::effect;
use super::frequencies::{Frequencies, HalfAngle};
use super::gauss_markov::Lorentzian;
use super::spec::{ANY, FROM_ZERO, Need, above};
use super::{Effect, Extent, Moments, Record, Refusal, Sampler, Stage, Stream, each, sampled};
use std::f64::consts::{PI, TAU};

effect! {
    /// Narrow-band noise whose spectrum has a Lorentzian line at ± its frequency.
    ///
    /// It is a damped oscillation driven by white noise: autocovariance σ²·exp(−πw|t|)·(cos 2πf₀t + a·w/(2f₀)·sin
    /// 2πf₀|t|) with w the full width at half power and a its asymmetry (within ± [`Resonance::most_asymmetric`]),
    /// exact at the samples, stationary from the start. Its frequency and damping hold at any rate. The line is the
    /// same for any a; the spectrum far from it differs. The displacement of a mass on a damped spring that a white
    /// force drives has a = 1, its velocity a = −1 (Wang and Uhlenbeck 1945, Rev. Mod. Phys. 17, equation 57); if both
    /// quadratures are driven alike, a = 0.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Resonance: dyn Effect, 7, Stage::Noise, White;
    "noise in a narrow band, with a Lorentzian line"
        => "a band of vibration at {frequency_hz:.2} Hz, {bandwidth_hz:.2} Hz wide{more}";
    frequency_hz: f64 = above(0.0), "Hz", "centre, Hz; below half the rate at which it acts";
    bandwidth_hz: f64 = above(0.0), "Hz", "full width at half power, Hz";
    sigma: f64 = FROM_ZERO, "U", "root mean square, U";
    asymmetry: f64 = ANY, "",
        "0: as much noise on both sides; 1: a displacement, more below the line; -1: a velocity", Need::Unwritten(0.0);
}

impl Resonance {
    /// Creates a symmetric line.
    pub fn new(frequency_hz: f64, bandwidth_hz: f64, sigma: f64) -> Self {
        Self { frequency_hz, bandwidth_hz, sigma, asymmetry: 0.0 }
    }

    /// Returns the largest asymmetry of a line at `rate_hz`: with a larger one, the spectrum would be negative at 0 or
    /// at half the rate.
    pub fn most_asymmetric(&self, rate_hz: f64) -> f64 {
        let (decay, angle) = (self.decay(rate_hz), TAU * self.frequency_hz / rate_hz);
        angle / decay * decay.sinh() / angle.sin().abs()
    }

    /// Returns the factor of the sine in the autocovariance.
    fn odd(&self) -> f64 {
        0.5 * self.asymmetry * self.bandwidth_hz / self.frequency_hz
    }

    /// Returns the decay of the amplitude per sample.
    fn decay(&self, rate_hz: f64) -> f64 {
        PI * self.bandwidth_hz / rate_hz
    }

    /// Returns the density, U²/Hz, as a function of half the angle per sample.
    fn density(&self, rate_hz: f64) -> impl Fn(&HalfAngle) -> f64 {
        let line = Lorentzian::new(self.decay(rate_hz), rate_hz);
        let own = HalfAngle::of(self.frequency_hz, rate_hz);
        let (half_power, odd) = (0.5 * self.sigma * self.sigma, self.odd());
        move |&HalfAngle { sine, cosine, .. }| {
            let near = sine * own.cosine - cosine * own.sine;
            let far = sine * own.cosine + cosine * own.sine;
            let even = line.at(near) + line.at(far);
            if odd == 0.0 {
                return half_power * even;
            }
            let near_cosine = cosine * own.cosine + sine * own.sine;
            let far_cosine = cosine * own.cosine - sine * own.sine;
            half_power * (even + odd * (line.odd_at(far, far_cosine) - line.odd_at(near, near_cosine)))
        }
    }
}

impl Effect for Resonance {
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        Self::SPEC.below_nyquist("frequency_hz", self.frequency_hz, rate_hz)?;
        let most = self.most_asymmetric(rate_hz);
        match self.asymmetry.abs() <= most * (1.0 + 1e-9) {
            true => Ok(()),
            false => {
                Err(Self::SPEC.refuse("asymmetry", self.asymmetry, format!("{} to {most} at {rate_hz} Hz", -most)))
            }
        }
    }
    fn extents(&self) -> Vec<Extent> {
        vec![Extent::band(self.frequency_hz, self.bandwidth_hz, 1.0)]
    }
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        Some(self.density(rate_hz)(&HalfAngle::of(frequency_hz, rate_hz)))
    }
    fn densities(&self, frequencies: &Frequencies) -> Vec<f64> {
        frequencies.map(self.density(frequencies.rate_hz()))
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let decay = self.decay(record.rate_hz);
        let step = PI * self.frequency_hz / record.rate_hz;
        // 1 − e^(−ak) cos 2xk = (1 − e^(−ak)) + 2 e^(−ak) sin² xk.
        let structure = |k: u64| {
            let k = k as f64;
            let odd = self.odd() * (2.0 * step * k).sin();
            -(-decay * k).exp_m1() + (-decay * k).exp() * (2.0 * (step * k).sin().powi(2) - odd)
        };
        Some(self.sigma * self.sigma * sampled::allan_variance(m, structure))
    }
    fn moments(&self, _record: Record) -> Option<Moments> {
        Some(Moments { variance: self.sigma * self.sigma, kurtosis: Some(3.0) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let decay = self.decay(rate_hz);
        let (sine, cosine) = (TAU * self.frequency_hz / rate_hz).sin_cos();
        let odd = self.odd();
        let (one, other) = (self.sigma * stream.normal(), self.sigma * stream.normal());
        // The quadratures' covariance is σ²·[1, −o; −o, 1 + 2o²]. The covariance of the first one is as required, and
        // the driving noise exists for every asymmetry that a spectrum allows. The rotation and the decay keep a part
        // of the covariance, and the driving noise restores the rest.
        let (twice_sine, twice_cosine) = (2.0 * sine * cosine, cosine * cosine - sine * sine);
        let kept = (-2.0 * decay).exp();
        let fresh = -(-2.0 * decay).exp_m1();
        let first = fresh - kept * odd * (twice_sine + 2.0 * odd * sine * sine);
        let second = fresh + kept * odd * twice_sine + 2.0 * odd * odd * (fresh + kept * sine * sine);
        let both = -odd * (1.0 - kept * twice_cosine) + kept * odd * odd * twice_sine;
        // Starts from the larger one: the other may be almost 0.
        let root = |square: f64| square.max(0.0).sqrt();
        let drive = if second >= first {
            let own = root(second);
            let across = both / own.max(f64::MIN_POSITIVE);
            [[root(first - across * across), across], [0.0, own]]
        } else {
            let own = root(first);
            let across = both / own.max(f64::MIN_POSITIVE);
            [[own, 0.0], [across, root(second - across * across)]]
        };
        // The oscillation's two quadratures turn and shrink per sample.
        let (cosine, sine) = ((-decay).exp() * cosine, (-decay).exp() * sine);
        let drive = drive.map(|of| of.map(|part| self.sigma * part));
        let mut state = [one, (1.0 + odd * odd).sqrt() * other - odd * one];
        each(move |value| {
            let [x, y] = state;
            *value += x;
            let (one, other) = (stream.normal(), stream.normal());
            state = [
                cosine * x - sine * y + drive[0][0] * one + drive[0][1] * other,
                sine * x + cosine * y + drive[1][0] * one + drive[1][1] * other,
            ];
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_the_line() {
        for (bandwidth_hz, asymmetry) in [(0.1, 0.0), (2.0, 0.0), (2.0, 1.0), (2.0, -1.0), (0.5, 1.2)] {
            let line = Resonance { asymmetry, ..Resonance::new(7.3, bandwidth_hz, 0.4) };
            check::agrees_with_its_closed_forms(&line, 40.0);
        }
    }

    /// Far below half the rate the driving noise of a displacement acts on one quadrature alone.
    #[test]
    fn as_asymmetric_as_it_can_be_it_has_its_variance_at_any_rate() {
        for (rate_hz, frequency_hz, bandwidth_hz, share) in [
            (1000.0, 30.0, 4.0, 1.0),
            (800.0, 60.0, 20.0, -1.0),
            (40.0, 3.0, 0.5, 1.0),
            (40.0, 17.0, 2.0, -1.0),
            (40.0, 17.0, 6.0, 1.0),
        ] {
            let line = Resonance::new(frequency_hz, bandwidth_hz, 0.4);
            let line = Resonance { asymmetry: share * line.most_asymmetric(rate_hz), ..line };
            let (mut square, mut product, mut count) = (0.0, 0.0, 0.0);
            for seed in 0..20 {
                let values = check::draw(&line, rate_hz, 50_000, seed);
                square += values.iter().map(|x| x * x).sum::<f64>();
                product += values.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>();
                count += values.len() as f64;
            }
            let (decay, angle) = (PI * bandwidth_hz / rate_hz, TAU * frequency_hz / rate_hz);
            let next = (-decay).exp() * (angle.cos() + line.odd() * angle.sin());
            let error = 5.0 / (count * decay).sqrt();
            assert!((square / count / 0.16 - 1.0).abs() < error, "{line:?}: {}", square / count / 0.16);
            assert!((product / count / 0.16 - next).abs() < error, "{line:?}: {} {next}", product / count / 0.16);
        }
    }

    #[test]
    fn a_displacement_is_an_autoregressive_process_of_second_order_at_a_high_rate() {
        // x'' + 2γx' + (ω² + γ²)x = white force: density 4γ(ω² + γ²)σ² over |ω² + γ² − φ² + 2iγφ|² (Wang and Uhlenbeck,
        // equation 39).
        let line = Resonance { asymmetry: 1.0, ..Resonance::new(3.0, 0.4, 2.0) };
        let (gamma, own) = (PI * 0.4, TAU * 3.0);
        for frequency_hz in [0.01, 1.0, 2.9, 3.3, 6.0] {
            let (turn, stiff) = (TAU * frequency_hz, own * own + gamma * gamma);
            let expected = 16.0 * gamma * stiff / ((stiff - turn * turn).powi(2) + 4.0 * gamma * gamma * turn * turn);
            let found = line.psd(frequency_hz, 1e5).unwrap();
            assert!((found / expected - 1.0).abs() < 1e-3, "{frequency_hz}: {found} {expected}");
        }
    }

    #[test]
    fn an_asymmetry_that_no_noise_has_is_refused() {
        let line = |asymmetry| Resonance { asymmetry, ..Resonance::new(7.3, 0.5, 0.4) };
        let most = line(0.0).most_asymmetric(40.0);
        assert_eq!(line(most).check(40.0), Ok(()));
        assert_eq!(line(-1.01 * most).check(40.0).unwrap_err().parameter, "asymmetry");
        for edge_hz in [1e-6, 20.0 - 1e-6] {
            let least = [most, -most].map(|most| line(most).psd(edge_hz, 40.0).unwrap());
            let flat = line(0.0).psd(edge_hz, 40.0).unwrap();
            assert!(least.iter().all(|density| *density > -1e-9 * flat), "{least:?}");
        }
    }

    #[test]
    fn the_line_has_half_its_height_at_half_its_width() {
        let line = Resonance::new(100.0, 2.0, 1.0);
        let ratio = line.psd(101.0, 800.0).unwrap() / line.psd(100.0, 800.0).unwrap();
        assert!((ratio - 0.5).abs() < 1e-3, "{ratio}");
    }
}
