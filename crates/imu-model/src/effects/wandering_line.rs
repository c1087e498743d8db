//! Wandering line: a line whose frequency and amplitude drift to and fro.

use super::described::effect;
use super::gauss_markov::lorentzian;
use super::spec::{FROM_ZERO, above};
use super::{Effect, Extent, Line, Moments, Record, Refusal, Resonance, Sampler, Stage, Stream, each, sampled};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

effect! {
    /// A·exp(u − s²)·cos θ with θ' = 2π(f₀ + d); the first θ is drawn uniformly. d and u are Gauss–Markov processes of
    /// rms `frequency_sigma_hz` and s = `amplitude_sigma` with their correlation times. The mean square is A²/2 for any
    /// s.
    ///
    /// Autocovariance (A²/2)·cos ω₀t·exp(−V/2 − s²(1 − e^(−t/T_a))), with V = 2β(t/T_f − 1 + e^(−t/T_f)), the phase's
    /// variance about its mean course, and β = (2π·`frequency_sigma_hz`·T_f)². Source: Kubo 1954, J. Phys. Soc. Japan
    /// 9. The phase is integrated exactly between samples, so that it holds at any rate.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct WanderingLine: dyn Effect, 22, Stage::Noise;
    "a line whose frequency and amplitude wander"
        => "a line about {frequency_hz:.2} Hz whose frequency wanders{more}";
    frequency_hz: f64 = above(0.0), "Hz", "mean frequency, Hz; below half the rate at which it acts";
    amplitude: f64 = FROM_ZERO, "U", "root mean square of the line times √2, U";
    frequency_sigma_hz: f64 = FROM_ZERO, "Hz", "root mean square of the frequency about its mean, Hz";
    frequency_tc_s: f64 = above(0.0), "s", "correlation time of the frequency, s";
    amplitude_sigma: f64 = FROM_ZERO, "", "root mean square of the amplitude's logarithm; up to 3";
    amplitude_tc_s: f64 = above(0.0), "s", "correlation time of the amplitude's logarithm, s";
}

/// Above this β, the sum over Lorentzian lines cancels too far: its terms grow as e^β and alternate.
const SUMMED_UP_TO: f64 = 8.0;

/// The largest `amplitude_sigma`: two standard deviations are then a factor of 400, and no record shows the mean
/// square.
const AMPLITUDE_SIGMA_MAX: f64 = 3.0;

/// Full width at half height of a normal distribution, in its standard deviation.
const HALF_HEIGHT: f64 = 2.354_820_045;

impl WanderingLine {
    /// Returns (2πσT)²: the mean square of the phase accumulated in one stay at a frequency.
    fn beta(&self) -> f64 {
        (TAU * self.frequency_sigma_hz * self.frequency_tc_s).powi(2)
    }

    /// Returns minus the logarithm of the factor that the wander applies to the autocovariance after `lag_s`.
    fn forgotten(&self, lag_s: f64) -> f64 {
        let x = lag_s / self.frequency_tc_s;
        let s2 = self.amplitude_sigma * self.amplitude_sigma;
        // x − 1 + e^−x, which rounding destroys for small x.
        let gathered = if x < 1e-3 { x * x * (0.5 - x / 6.0 + x * x / 24.0) } else { x + (-x).exp_m1() };
        self.beta() * gathered - s2 * (-lag_s / self.amplitude_tc_s).exp_m1()
    }

    /// Returns whether a line remains: its phase never wanders off.
    fn keeps_a_line(&self) -> bool {
        self.frequency_sigma_hz == 0.0
    }
}

impl Effect for WanderingLine {
    fn extents(&self) -> Vec<Extent> {
        let lorentzian_hz = self.beta() / (PI * self.frequency_tc_s);
        let bandwidth_hz = lorentzian_hz.min(HALF_HEIGHT * self.frequency_sigma_hz);
        vec![Extent::band(self.frequency_hz, bandwidth_hz, 1.0)]
    }
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        if self.amplitude_sigma > AMPLITUDE_SIGMA_MAX {
            let allowed =
                format!("at most {AMPLITUDE_SIGMA_MAX}: an amplitude that goes over a factor of 400 both ways");
            return Err(Self::SPEC.refuse("amplitude_sigma", self.amplitude_sigma, allowed));
        }
        Self::SPEC.below_nyquist("frequency_hz", self.frequency_hz, rate_hz)
    }
    /// Sums the Lorentzian lines into which the autocovariance expands, in powers of e^(−t/T_f) and e^(−t/T_a). `None`
    /// for a frequency that wanders slowly (β above 8, a frequency held for more than some 0.45 turns): the terms
    /// alternate, and doubles cannot hold their sum.
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        /// The smallest relevant size of a term, relative to the first.
        const LEAST: f64 = 1e-14;
        let (beta, s2) = (self.beta(), self.amplitude_sigma * self.amplitude_sigma);
        if beta > SUMMED_UP_TO {
            return None;
        }
        let cycles = |centre_hz: f64| (frequency_hz - centre_hz) / rate_hz;
        let (below, above) = (cycles(self.frequency_hz), cycles(-self.frequency_hz));
        let mut sum = 0.0;
        let mut of_frequency = (beta - s2).exp();
        for n in 0..200_u32 {
            let mut weight = of_frequency;
            for m in 0..200_u32 {
                let decay =
                    ((beta + f64::from(n)) / self.frequency_tc_s + f64::from(m) / self.amplitude_tc_s) / rate_hz;
                // A part without decay is a line.
                if decay > 0.0 {
                    sum += weight * (lorentzian(below, decay, rate_hz) + lorentzian(above, decay, rate_hz));
                }
                weight *= s2 / f64::from(m + 1);
                if f64::from(m) > s2 && weight.abs() < LEAST {
                    break;
                }
            }
            of_frequency *= -beta / f64::from(n + 1);
            if f64::from(n) > beta && of_frequency.abs() < LEAST {
                break;
            }
        }
        Some(0.25 * self.amplitude * self.amplitude * sum.max(0.0))
    }
    fn lines(&self) -> Vec<Line> {
        let power = 0.5 * self.amplitude * self.amplitude * (-self.amplitude_sigma * self.amplitude_sigma).exp();
        if self.keeps_a_line() { vec![Line { frequency_hz: self.frequency_hz, power }] } else { Vec::new() }
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let structure = |k: u64| {
            let lag_s = k as f64 / record.rate_hz;
            let turn = TAU * (self.frequency_hz * lag_s).fract();
            let forgotten = self.forgotten(lag_s);
            // 1 − e^−x cos y, without cancellation.
            -(-forgotten).exp_m1() + 2.0 * (-forgotten).exp() * (0.5 * turn).sin().powi(2)
        };
        Some(0.5 * self.amplitude * self.amplitude * sampled::allan_variance(m, structure))
    }
    /// For a slowly wandering frequency: a band as wide as the distribution of the frequency, at half its height.
    fn stationary(&self, record: Record) -> Option<Arc<dyn Effect>> {
        self.psd(self.frequency_hz, record.rate_hz).is_none().then(|| {
            let bandwidth_hz = HALF_HEIGHT * self.frequency_sigma_hz;
            let sigma = self.amplitude * std::f64::consts::FRAC_1_SQRT_2;
            Arc::new(Resonance::new(self.frequency_hz, bandwidth_hz, sigma)) as Arc<dyn Effect>
        })
    }
    fn moments(&self, _record: Record) -> Option<Moments> {
        // E A⁴ over (E A²)² is e^(4s²).
        let kurtosis = 1.5 * (4.0 * self.amplitude_sigma * self.amplitude_sigma).exp();
        Some(Moments { variance: 0.5 * self.amplitude * self.amplitude, kurtosis: Some(kurtosis) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let (x, y) = (1.0 / (rate_hz * self.frequency_tc_s), 1.0 / (rate_hz * self.amplitude_tc_s));
        let wanders = [-(-x).exp_m1(), -(-2.0 * x).exp_m1()];
        // Cycles per sample for a constant d of 1 rms.
        let turn = self.frequency_sigma_hz * self.frequency_tc_s;
        let drive = wanders[1].sqrt();
        // Covariance of the increments of d and its integral in a sample, (1 − e^−x)²; the integral's own variance is
        // integral_variance(x).
        let shared = wanders[0] * wanders[0] / drive;
        let own = (integral_variance(x) - shared * shared).max(0.0).sqrt();
        // The processes' states over their rms, and the phase in cycles.
        let mut state = [stream.normal(), stream.normal()];
        let mut cycles = stream.uniform();
        let (step, amplitude_sigma) = (self.frequency_hz / rate_hz, self.amplitude_sigma);
        let (pole, drive) = ([(-x).exp(), (-y).exp()], [drive, (-(-2.0 * y).exp_m1()).sqrt()]);
        // Cycles that the frequency's state adds in a sample, and the cycles that its drive and an independent number
        // add.
        let (carried, gathered) = (turn * wanders[0], [turn * shared, turn * own]);
        let peak = self.amplitude * (-self.amplitude_sigma * self.amplitude_sigma).exp();
        each(move |value| {
            let [frequency, amplitude] = state;
            *value += peak * (amplitude_sigma * amplitude).exp() * (TAU * cycles).cos();
            let drives = [stream.normal(), stream.normal(), stream.normal()];
            let wander = carried * frequency + gathered[0] * drives[0] + gathered[1] * drives[1];
            cycles = (cycles + step + wander).rem_euclid(1.0);
            state = [pole[0] * frequency + drive[0] * drives[0], pole[1] * amplitude + drive[1] * drives[2]];
        })
    }
}

/// Returns 2x − 3 + 4e^−x − e^−2x: the variance of the integral of a Gauss–Markov process of variance 1 over x of its
/// correlation times, given its state at the start, in squares of that time.
fn integral_variance(x: f64) -> f64 {
    if x > 0.5 {
        return 2.0 * x - 3.0 + 4.0 * (-x).exp() - (-2.0 * x).exp();
    }
    // Σ (−x)ⁿ(4 − 2ⁿ)/n! from the third power on.
    let mut power = -x * x * x / 6.0;
    let mut sum = 0.0;
    for n in 3..24_i32 {
        sum += power * (4.0 - 2.0_f64.powi(n));
        power *= -x / f64::from(n + 1);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    const LINE: WanderingLine = WanderingLine {
        frequency_hz: 7.3,
        amplitude: 0.4,
        frequency_sigma_hz: 0.3,
        frequency_tc_s: 1.0,
        amplitude_sigma: 0.3,
        amplitude_tc_s: 3.0,
    };

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_the_line() {
        for line in [
            LINE,
            // Quick: the line is as narrow as its mean frequency permits.
            WanderingLine { frequency_sigma_hz: 2.0, frequency_tc_s: 0.02, amplitude_sigma: 0.0, ..LINE },
            // Slow: no spectrum.
            WanderingLine { frequency_sigma_hz: 0.1, frequency_tc_s: 20.0, ..LINE },
            // Amplitude alone: a line on a foot.
            WanderingLine { frequency_sigma_hz: 0.0, ..LINE },
        ] {
            check::agrees_with_its_closed_forms(&line, 40.0);
        }
    }

    #[test]
    fn without_wander_it_is_a_tone() {
        let line = WanderingLine { frequency_sigma_hz: 0.0, amplitude_sigma: 0.0, ..LINE };
        let tone = super::super::Tone { frequency_hz: 7.3, amplitude: 0.4 };
        let record = Record { rate_hz: 40.0, samples: 1000 };
        assert_eq!((line.psd(7.0, 40.0), line.lines()), (Some(0.0), tone.lines()));
        for m in [1, 3, 100] {
            let (found, expected) = (line.allan_variance(m, record).unwrap(), tone.allan_variance(m, record).unwrap());
            assert!((found - expected).abs() < 1e-9 * tone.allan_variance(1, record).unwrap(), "m = {m}");
        }
        assert_eq!(line.moments(record), tone.moments(record));
    }

    #[test]
    fn its_spectrum_holds_its_power() {
        for line in [LINE, WanderingLine { frequency_sigma_hz: 0.44, amplitude_sigma: 1.0, ..LINE }] {
            let bins = 200_000_u32;
            let sum: f64 =
                (0..bins).map(|bin| line.psd((f64::from(bin) + 0.5) * 20.0 / f64::from(bins), 40.0).unwrap()).sum();
            let power = 2.0 * sum * 20.0 / f64::from(bins);
            assert!((power / 0.08 - 1.0).abs() < 1e-6, "{power}");
        }
        assert_eq!(WanderingLine { frequency_tc_s: 2.0, ..LINE }.psd(7.0, 40.0), None);
    }

    #[test]
    fn an_integral_gathers_as_much_in_one_step_as_in_two() {
        // The two branches meet, and small steps go as 2x³/3.
        assert!((integral_variance(0.5) / integral_variance(0.5 + 1e-12) - 1.0).abs() < 1e-9);
        assert!((integral_variance(1e-5) / (2e-15 / 3.0) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn senseless_parameters_are_refused() {
        assert_eq!(LINE.check(40.0), Ok(()));
        for wrong in [
            WanderingLine { frequency_hz: 20.0, ..LINE },
            WanderingLine { amplitude: -1.0, ..LINE },
            WanderingLine { frequency_sigma_hz: -1.0, ..LINE },
            WanderingLine { frequency_tc_s: 0.0, ..LINE },
            WanderingLine { amplitude_sigma: -0.1, ..LINE },
            WanderingLine { amplitude_sigma: 3.1, ..LINE },
            WanderingLine { amplitude_tc_s: 0.0, ..LINE },
        ] {
            assert!(wrong.check(40.0).is_err(), "{wrong:?}");
        }
    }
}
