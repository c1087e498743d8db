//! Weights: each error quantity as a linear functional of a channel's samples, Σ w_k x_k, defined once here.
//!
//! The samples of the alignment come first, then those of the horizon. A sample holds over its period; the integral of
//! the held values is exact. With n samples in the horizon, m = n − k for its k-th sample, a samples in the alignment
//! and the period dt, an integral of order q has the weights
//!
//! ```text
//! horizon:    dt^q (m^q − (m − 1)^q)/q!
//! alignment: −dt^q n^q/(q! a)
//! ```
//!
//! Order 1 is an angle from a rate or a velocity from an acceleration, order 2 the integral of that, order 3 the
//! integral of order 2. The weights sum to 0: a constant has no effect, and noise whose density grows towards 0 Hz has a
//! finite one.
//!
//! In: frequencies in rad per sample, or samples and variances in order. Out: transforms of the weights, and sums.

use nalgebra::Complex;

/// The number of orders of integration: angle or velocity, its integral, and the integral of that.
pub(crate) const ORDERS: usize = 3;
/// Up to this product of frequency (rad per sample) and number of samples, a sum of weights is one smooth function;
/// above it, it is a sum of smooth functions times oscillations.
const SMOOTH_UP_TO: f64 = 2.0;

/// Numbers of samples in the alignment and in one horizon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Span {
    /// Samples of the alignment, from 1.
    pub align: f64,
    /// Samples of the horizon, from 1.
    pub horizon: f64,
}

/// A part of a transform: `amplitude`·e^(−iω·`delay`), with an amplitude that is smooth in ω.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Term {
    pub amplitude: Complex<f64>,
    /// Delay in samples.
    pub delay: f64,
}

/// Whether the sums over alignment and horizon are smooth up to a frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Smooth {
    align: bool,
    horizon: bool,
}

impl Smooth {
    /// Returns what is smooth up to `omega` in rad per sample.
    pub(crate) fn up_to(omega: f64, span: Span) -> Self {
        Self { align: omega * span.align <= SMOOTH_UP_TO, horizon: omega * span.horizon <= SMOOTH_UP_TO }
    }
}

/// Functions of one frequency that all spans share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Angle {
    omega: f64,
    /// 1/(1 − z) with z = e^(−iω).
    sum: Complex<f64>,
    /// ½(1 + z)/(1 − z), an integral by the trapezoidal rule.
    trapezoid: Complex<f64>,
    /// z/(1 − z)² + 1/6.
    twice: f64,
}

impl Angle {
    /// Returns the functions at `omega` in rad per sample, above 0 and at most π.
    pub(crate) fn new(omega: f64) -> Self {
        let (sine, cosine) = (0.5 * omega).sin_cos();
        Self {
            omega,
            sum: Complex::new(cosine, sine) / Complex::new(0.0, 2.0 * sine),
            trapezoid: Complex::new(0.0, -0.5 * cosine / sine),
            twice: 1.0 / 6.0 - 0.25 / (sine * sine),
        }
    }

    /// Returns the transform of an order's weights over `count` samples of the horizon, without dt^q: accurate for
    /// small `omega`·`count`.
    fn smooth(&self, order: usize, count: f64) -> Complex<f64> {
        let x = self.omega * count;
        let [one, two, three] = [1, 2, 3].map(|order| phi(order, x));
        let i = Complex::i();
        // (1 − (ω/2)cot(ω/2)) and 1/12 − ω²/240 …: the distance of sums from integrals, O(1/count²).
        let half = 0.5 * self.omega;
        let square = half * half;
        let defect = if half < 1e-2 { square / 3.0 + square * square / 45.0 } else { 1.0 - half / half.tan() };
        let excess =
            if half < 1e-2 { 1.0 / 12.0 - square / 60.0 } else { self.twice + 1.0 / (self.omega * self.omega) };
        let inner = match order {
            1 => i * x * one,
            2 => i * x * count * two + one * (defect * count),
            _ => i * x * count * count * three + (defect * count * count / x) / i + i * x * one * excess,
        };
        self.sum * inner
    }

    /// Returns the two parts of that transform: of the sum's begin, and of its end, whose delay is `count`.
    fn ends(&self, order: usize, count: f64) -> [Complex<f64>; 2] {
        let c = self.trapezoid;
        let [begin, end] = match order {
            1 => [Complex::from(1.0), Complex::from(-1.0)],
            2 => [count - c, c],
            _ => [0.5 * count * count - c * count + self.twice, Complex::from(-self.twice)],
        };
        [self.sum * begin, self.sum * end]
    }

    /// Writes the transform of all weights of an order, without dt^q, as a sum of at most three terms.
    pub(crate) fn terms(&self, order: usize, span: Span, smooth: Smooth, terms: &mut Vec<Term>) {
        terms.clear();
        let level = span.horizon.powi(order as i32) / factorial(order);
        let (align, horizon) = (span.align, span.horizon);
        // The alignment's own delay is part of the amplitudes as long as it is smooth.
        let (shift, behind) =
            if smooth.align { (Complex::cis(-self.omega * align), 0.0) } else { (Complex::from(1.0), align) };
        let [begin, end] =
            if smooth.horizon { [self.smooth(order, horizon), Complex::from(0.0)] } else { self.ends(order, horizon) };
        let [first, second] = if smooth.align {
            [Complex::from(0.0), -self.smooth(1, align) * (level / align)]
        } else {
            self.ends(1, align).map(|part| -part * (level / align))
        };
        if !smooth.align {
            terms.push(Term { amplitude: first, delay: 0.0 });
        }
        terms.push(Term { amplitude: begin * shift + second, delay: behind });
        if !smooth.horizon {
            terms.push(Term { amplitude: end * shift, delay: behind + horizon });
        }
    }
}

/// Returns |Σ w_k e^(−iωk)| of an order's weights, without dt^q, at `omega` in rad per sample; 0 at multiples of 2π.
pub(crate) fn gain(order: usize, span: Span, omega: f64) -> f64 {
    if omega <= 0.0 {
        return 0.0;
    }
    let mut terms = Vec::with_capacity(3);
    Angle::new(omega).terms(order, span, Smooth::up_to(omega, span), &mut terms);
    terms.iter().map(|term| term.amplitude * Complex::cis(-omega * term.delay)).sum::<Complex<f64>>().norm()
}

/// Returns Σ (−ix)^j/(j + order)!: the integral of (1 − s)^(order−1)/(order − 1)!·e^(−ixs) over 0…1, for x up to 3.
fn phi(order: usize, x: f64) -> Complex<f64> {
    let mut term = Complex::from(1.0 / factorial(order));
    let mut sum = term;
    for j in 1..30 {
        term *= Complex::new(0.0, -x / (j + order) as f64);
        sum += term;
    }
    sum
}

pub(crate) fn factorial(order: usize) -> f64 {
    (1..=order).map(|k| k as f64).product()
}

/// Integrates samples over alignment and horizon: Σ w_k x_k for every horizon at once, without dt^q.
#[derive(Debug, Clone)]
pub(crate) struct Strapdown {
    align: u64,
    seen: u64,
    first: f64,
    level: f64,
    /// The integrals of order 1, 2 and 3.
    state: [f64; ORDERS],
}

impl Strapdown {
    /// Creates the integrals after an alignment of `align` samples.
    pub(crate) fn new(align: u64) -> Self {
        Self { align, seen: 0, first: 0.0, level: 0.0, state: [0.0; ORDERS] }
    }

    /// Takes the next sample and returns the integrals up to its end.
    pub(crate) fn push(&mut self, value: f64) -> [f64; ORDERS] {
        // Relative to the first sample, so that a constant cancels exactly.
        if self.seen == 0 {
            self.first = value;
        }
        let own = value - self.first;
        self.seen += 1;
        if self.seen <= self.align {
            self.level += own / self.align as f64;
            return self.state;
        }
        let error = own - self.level;
        let [angle, once, twice] = self.state;
        self.state = [angle + error, once + angle + error / 2.0, twice + once + angle / 2.0 + error / 6.0];
        self.state
    }
}

/// Sums of squares and products of weights times variances: what white noise whose variance changes adds.
#[derive(Debug, Clone)]
pub(crate) struct Squares {
    align: u64,
    seen: u64,
    /// Σ variance/a² over the alignment.
    level: f64,
    /// Σ w_q w_r·variance over the horizon, for (q, r) = (1,1), (2,2), (3,3), (1,2), (2,3), (1,3).
    state: [f64; 6],
}

/// Σ w_q²·variance of each order, and the sums of the products of orders 1 and 2, 2 and 3, all without dt^q.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct WhiteSums {
    pub squares: [f64; ORDERS],
    pub products: [f64; 2],
}

impl Squares {
    /// Creates the sums after an alignment of `align` samples.
    pub(crate) fn new(align: u64) -> Self {
        Self { align, seen: 0, level: 0.0, state: [0.0; 6] }
    }

    /// Takes the variance of the next sample.
    pub(crate) fn push(&mut self, variance: f64) {
        self.seen += 1;
        if self.seen <= self.align {
            self.level += variance / (self.align as f64 * self.align as f64);
            return;
        }
        let [aa, bb, cc, ab, bc, ac] = self.state;
        // Covariance of (a, b + a, c + b + a/2), and the sample's own (1, 1/2, 1/6).
        self.state = [
            aa + variance,
            bb + 2.0 * ab + aa + variance / 4.0,
            cc + bb + aa / 4.0 + 2.0 * bc + ac + ab + variance / 36.0,
            ab + aa + variance / 2.0,
            bc + bb + ab / 2.0 + ac + ab + aa / 2.0 + variance / 12.0,
            ac + ab + aa / 2.0 + variance / 6.0,
        ];
    }

    /// Returns the sums over the alignment and the samples of the horizon so far.
    pub(crate) fn sums(&self) -> WhiteSums {
        let count = self.seen.saturating_sub(self.align) as f64;
        let level = [1, 2, 3].map(|order| count.powi(order as i32) / factorial(order));
        let [aa, bb, cc, ab, bc, _] = self.state;
        let all = |own: f64, q: usize, r: usize| own + level[q] * level[r] * self.level;
        WhiteSums { squares: [all(aa, 0, 0), all(bb, 1, 1), all(cc, 2, 2)], products: [all(ab, 0, 1), all(bc, 1, 2)] }
    }
}

/// Returns the weights of an order one by one, without dt^q: what the closed forms are tested with.
#[cfg(test)]
pub(crate) fn listed(order: usize, span: Span) -> Vec<f64> {
    let power = |m: f64| m.powi(order as i32) / factorial(order);
    let (align, count) = (span.align as usize, span.horizon as usize);
    let level = -power(span.horizon) / span.align;
    let of = |k: usize| power((count - k) as f64) - power((count - k) as f64 - 1.0);
    std::iter::repeat_n(level, align).chain((0..count).map(of)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforms_are_those_of_the_listed_weights() {
        for (align, horizon) in [(1.0, 1.0), (4.0, 7.0), (120.0, 40.0), (3.0, 300.0), (50.0, 1.0)] {
            let span = Span { align, horizon };
            for order in 1..=ORDERS {
                let weights = listed(order, span);
                let size: f64 = weights.iter().map(|weight| weight.abs()).sum();
                for omega in [1e-5, 1e-3, 0.006, 0.02, 0.049, 0.3, 1.0, 2.0, 3.0, std::f64::consts::PI] {
                    let direct = weights.iter().enumerate();
                    let direct: Complex<f64> = direct.map(|(k, w)| Complex::cis(-omega * k as f64) * *w).sum();
                    let found = gain(order, span, omega);
                    let off = (found - direct.norm()).abs();
                    assert!(off < 1e-11 * size, "{span:?} {order} {omega}: {found} {}", direct.norm());
                }
            }
        }
    }

    #[test]
    fn slow_waves_keep_their_relative_accuracy() {
        // To first order in the frequency, the gain is ω times the distance of the weights' centres.
        let span = Span { align: 1200.0, horizon: 144_000.0 };
        for order in 1..=ORDERS {
            let moment: f64 = listed(order, span).iter().enumerate().map(|(k, w)| k as f64 * w).sum();
            let omega = 1e-12;
            assert!((gain(order, span, omega) / (omega * moment) - 1.0).abs() < 1e-4, "{order}");
        }
    }

    #[test]
    fn integrals_are_sums_of_weighted_samples() {
        let span = Span { align: 5.0, horizon: 12.0 };
        let values: Vec<f64> = (0..17).map(|k| 3.0 + f64::from(k * k % 7)).collect();
        let mut strapdown = Strapdown::new(5);
        let found = values.iter().map(|value| strapdown.push(*value)).last().unwrap();
        let mut squares = Squares::new(5);
        values.iter().for_each(|value| squares.push(*value));
        let sums = squares.sums();
        for order in 1..=ORDERS {
            let weights = listed(order, span);
            let expected: f64 = weights.iter().zip(&values).map(|(weight, value)| weight * value).sum();
            assert!((found[order - 1] - expected).abs() < 1e-10, "{order}");
            let square: f64 = weights.iter().zip(&values).map(|(weight, value)| weight * weight * value).sum();
            assert!((sums.squares[order - 1] / square - 1.0).abs() < 1e-12, "{order}");
            if order < ORDERS {
                let both = weights.iter().zip(listed(order + 1, span)).zip(&values);
                let product: f64 = both.map(|((one, other), value)| one * other * value).sum();
                assert!((sums.products[order - 1] / product - 1.0).abs() < 1e-12, "{order}");
            }
        }
    }

    #[test]
    fn a_constant_has_no_effect() {
        let mut strapdown = Strapdown::new(1200);
        assert!((0..10_000).all(|_| strapdown.push(0.1) == [0.0; 3]));
    }
}
