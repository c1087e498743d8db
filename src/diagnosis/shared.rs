//! Shared noise: what several channels have in common.

use super::series::Series;

/// The white part of a channel's whitened coefficients, and how much of its spectrum is white.
#[derive(Debug, Clone)]
pub struct Whitened {
    /// Coefficients over the root of the spectrum.
    pub coefficients: Vec<f64>,
    /// Share of the spectrum's root that white noise has, at each.
    pub white: Vec<f32>,
}

impl Whitened {
    /// Of a series.
    #[must_use]
    pub fn of(series: &Series<'_>) -> Self {
        let white = series.white().powi(2);
        let share = |s: &f64| if s.is_finite() { (white / s).sqrt().min(1.0) as f32 } else { 0.0 };
        Self { coefficients: series.whitened.clone(), white: series.spectrum.iter().map(share).collect() }
    }
}

/// Noise that channels share.
#[derive(Debug, Clone, PartialEq)]
pub struct Shared {
    /// Index of each channel and the part of its white noise's standard deviation that is shared, with its sign.
    pub parts: Vec<(usize, f64)>,
    /// Nats.
    pub gain: f64,
}

/// What channels share, where it is worth `price` nats a pair.
///
/// Two channels' correlation r of white parts gives −n/2·ln(1 − r²), n the coefficients that are white in both. One shared
/// source makes r_ij = a_i·a_j; the a are fitted to the pairs.
#[must_use]
pub fn shared(channels: &[Whitened], price: f64) -> Option<Shared> {
    let count = channels.len();
    let mut correlation = vec![0.0; count * count];
    let mut linked = vec![false; count];
    let mut gain = 0.0;
    for i in 0..count {
        for j in 0..i {
            let (mut product, mut square) = (0.0, 0.0);
            let (a, b) = (&channels[i], &channels[j]);
            let pairs = a.coefficients.iter().zip(&b.coefficients).zip(a.white.iter().zip(&b.white));
            for ((x, y), (u, v)) in pairs.skip(1) {
                let weight = f64::from(u * v);
                product += x * y * weight;
                square += weight * weight;
            }
            let r = (product / square.max(1.0)).clamp(-0.999, 0.999);
            let nats = -0.5 * square * (-r * r).ln_1p();
            if nats > price {
                correlation[i * count + j] = r;
                correlation[j * count + i] = r;
                (linked[i], linked[j]) = (true, true);
                gain += nats;
            }
        }
    }
    let members: Vec<usize> = (0..count).filter(|index| linked[*index]).collect();
    if members.len() < 2 {
        return None;
    }
    let mut parts = vec![0.0f64; count];
    // From the strongest pair's signs, then each in turn given the others.
    for i in &members {
        let strongest = members.iter().map(|j| correlation[i * count + j].abs()).fold(0.0, f64::max);
        parts[*i] = strongest.sqrt();
    }
    let first = members[0];
    for i in members.iter().skip(1) {
        if correlation[first * count + i] < 0.0 {
            parts[*i] = -parts[*i];
        }
    }
    for _ in 0..200 {
        for i in &members {
            let (mut product, mut square) = (0.0, 0.0);
            for j in members.iter().filter(|j| *j != i) {
                product += correlation[i * count + j] * parts[*j];
                square += parts[*j] * parts[*j];
            }
            // Two channels alone tell their product only: equal shares.
            let next = if square > 0.0 { (product / square).clamp(-0.999, 0.999) } else { 0.0 };
            parts[*i] = if members.len() > 2 { 0.5 * (parts[*i] + next) } else { parts[*i] };
        }
    }
    Some(Shared { parts: members.into_iter().map(|index| (index, parts[index])).collect(), gain })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Stream, StreamId};

    #[test]
    fn shares_are_found_and_independent_channels_are_left_alone() {
        let n = 20_000;
        let noise = |effect: u16| {
            let mut stream = Stream::new(3, StreamId { owner: 1, effect, instance: 0 });
            (0..n).map(|_| stream.normal()).collect::<Vec<f64>>()
        };
        let source = noise(9);
        let of = |effect: u16, share: f64| Whitened {
            coefficients: noise(effect)
                .iter()
                .zip(&source)
                .map(|(own, all)| (1.0 - share * share).sqrt() * own + share * all)
                .collect(),
            white: vec![1.0; n],
        };
        let channels = [of(0, 0.5), of(1, 0.0), of(2, -0.3), of(3, 0.4)];
        let found = shared(&channels, 10.0).unwrap();
        assert_eq!(found.parts.iter().map(|(index, _)| *index).collect::<Vec<_>>(), [0, 2, 3]);
        for ((_, part), truth) in found.parts.iter().zip([0.5, -0.3, 0.4]) {
            assert!((part - truth).abs() < 0.03, "{found:?}");
        }
        assert_eq!(shared(&channels[1..2], 10.0), None);
        assert_eq!(shared(&[of(5, 0.0), of(6, 0.0)], 10.0), None);
    }
}
