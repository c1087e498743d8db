//! Shared noise: the noise that several channels have in common.

use super::series::Series;
use nalgebra::DMatrix;

/// The white part of a channel's whitened coefficients, and how much of its spectrum is white.
#[derive(Debug, Clone)]
pub struct Whitened {
    /// Coefficients over the root of the spectrum.
    pub coefficients: Vec<f64>,
    /// White noise's share of the root of the spectrum at each coefficient.
    pub white: Vec<f32>,
    /// The residual in time.
    pub residual: Vec<f64>,
    /// The samples that were replaced by draws of any size, in order.
    pub replaced: Vec<usize>,
}

impl Whitened {
    /// Whitens a series.
    pub fn of(series: &Series<'_>) -> Self {
        // Behind different filters the same noise has different phases.
        let coefficients = if series.is_filtered() {
            let mut values = series.innovations().to_vec();
            series.transform.clone().forward(&mut values);
            values
        } else {
            series.whitened.clone()
        };
        Self {
            coefficients,
            white: series.white_shares(),
            residual: series.scores().into_owned(),
            replaced: series.replaced(),
        }
    }
}

/// Noise that channels share.
#[derive(Debug, Clone, PartialEq)]
pub struct Shared {
    /// The channels' parts.
    pub parts: Vec<Part>,
    /// Nats gained.
    pub gain: f64,
}

/// The shared part of a channel's white noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Index of the channel.
    pub index: usize,
    /// Part of the standard deviation, with its sign.
    pub size: f64,
    /// Standard error of the part.
    pub error: f64,
    /// 95 % interval of the part without its sign.
    pub ci95: [f64; 2],
}

/// Returns the noise that channels share, if it is worth `price` nats per pair: one source for each group of channels
/// that are linked.
///
/// Two channels' correlation r of white parts gives −n/2·ln(1 − r²), n the coefficients that are white in both. One
/// shared source makes r_ij = a_i·a_j; the a are fitted to the pairs, and give −n/2·ln det(1 + aaᵀ − diag a²) in total.
pub fn shared(channels: &[Whitened], price: f64) -> Vec<Shared> {
    let count = channels.len();
    let mut correlation = DMatrix::zeros(count, count);
    let mut white = 0.0f64;
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
            // Draws have nothing in common, but they scatter like samples.
            let there = 1.0 - in_either(&a.replaced, &b.replaced) as f64 / a.residual.len().max(1) as f64;
            let r = (product / (there * square).max(1.0)).clamp(-0.999, 0.999);
            square *= there * there;
            if -0.5 * square * (-r * r).ln_1p() > price {
                correlation[(i, j)] = r;
                correlation[(j, i)] = r;
                white = white.max(square);
            }
        }
    }
    let mut group: Vec<usize> = (0..count).collect();
    for i in 0..count {
        for j in 0..i {
            if correlation[(i, j)] != 0.0 && group[i] != group[j] {
                let (from, to) = (group[i], group[j]);
                group.iter_mut().filter(|own| **own == from).for_each(|own| *own = to);
            }
        }
    }
    let mut groups: Vec<usize> = group.clone();
    groups.sort_unstable();
    groups.dedup();
    let members = |of: usize| -> Vec<usize> { (0..count).filter(|index| group[*index] == of).collect() };
    let sources = groups.into_iter().map(members).filter(|of| of.len() > 1);
    sources.map(|of| with_part(source(&of, &correlation, white))).filter(|of| of.parts.len() > 1).collect()
}

/// Returns how many numbers are in one of two ordered lists, or in both.
fn in_either(a: &[usize], b: &[usize]) -> usize {
    let both = a.iter().filter(|of| b.binary_search(of).is_ok()).count();
    a.len() + b.len() - both
}

/// Drops the channels that are linked to others but have almost none of the source.
fn with_part(mut of: Shared) -> Shared {
    /// The smallest part that counts, and the same in standard errors.
    const LEAST: f64 = 0.02;
    const ERRORS: f64 = 4.0;
    of.parts.retain(|part| part.size.abs() > LEAST.max(ERRORS * part.error));
    of
}

/// Returns one source of linked channels, each linked to at least one other; n is the number of informative
/// coefficients.
fn source(members: &[usize], correlation: &DMatrix<f64>, n: f64) -> Shared {
    const ROUNDS: usize = 300;
    let count = members.len();
    let r = |i: usize, j: usize| correlation[(members[i], members[j])];
    // Signs follow the strongest links, starting from the first member.
    let mut parts = vec![0.0f64; count];
    let strongest = |i: usize| (0..count).filter(|j| *j != i).map(|j| r(i, j).abs()).fold(0.0, f64::max).sqrt();
    parts[0] = strongest(0);
    for _ in 1..count {
        let links = (0..count)
            .filter(|i| parts[*i] == 0.0)
            .flat_map(|i| (0..count).filter(|j| parts[*j] != 0.0).map(|j| (i, j)).collect::<Vec<_>>());
        let Some((i, j)) = links.max_by(|a, b| r(a.0, a.1).abs().total_cmp(&r(b.0, b.1).abs())) else { break };
        parts[i] = strongest(i) * (r(i, j) * parts[j]).signum();
    }
    // Two channels alone determine only the product of the parts; equal shares are assumed.
    for _ in 0..if count > 2 { ROUNDS } else { 0 } {
        for i in 0..count {
            let others = (0..count).filter(|j| *j != i);
            let (product, square) =
                others.fold((0.0, 0.0), |(p, s), j| (p + r(i, j) * parts[j], s + parts[j] * parts[j]));
            let next = if square > 0.0 { (product / square).clamp(-0.999, 0.999) } else { 0.0 };
            parts[i] = 0.5 * (parts[i] + next);
        }
    }
    let model = DMatrix::from_fn(count, count, |i, j| if i == j { 1.0 } else { parts[i] * parts[j] });
    let gain = -0.5 * n * model.determinant().max(1e-12).ln();
    // Each pair's correlation has an error of (1 − r²)/√n; two channels alone are assumed to have equal shares.
    let weight = |i: usize, j: usize| n / (1.0 - (parts[i] * parts[j]).powi(2)).powi(2);
    let normal = DMatrix::from_fn(count, count, |i, j| {
        if i == j {
            (0..count).filter(|other| *other != i).map(|other| weight(i, other) * parts[other].powi(2)).sum()
        } else {
            weight(i, j) * parts[i] * parts[j]
        }
    });
    let errors: Vec<f64> = match (count, normal.try_inverse()) {
        (2, _) => {
            let r = parts[0] * parts[1];
            parts.iter().map(|part| (1.0 - r * r) / n.sqrt() / (2.0 * part.abs())).collect()
        }
        (_, Some(inverse)) => (0..count).map(|at| inverse[(at, at)].max(0.0).sqrt()).collect(),
        (_, None) => vec![1.0; count],
    };
    let parts = members.iter().zip(parts.into_iter().zip(errors)).map(|(index, (size, error))| Part {
        index: *index,
        size,
        error,
        ci95: interval(size, error, count, n),
    });
    Shared { parts: parts.collect(), gain }
}

/// Returns the 95 % interval of a part's size among `count` channels. The white noise's own size is known to 1 in
/// √(2n). Two channels show only the product of their parts: each part may lie anywhere from that product to 1.
fn interval(part: f64, error: f64, count: usize, n: f64) -> [f64; 2] {
    const NORMAL_95: f64 = 1.959_964;
    let size = part.abs();
    let own = size / (2.0 * n).sqrt();
    let half = NORMAL_95 * error.hypot(own);
    match count {
        2 => [(size * size - 2.0 * half * size).max(0.0), 1.0 + NORMAL_95 / (2.0 * n).sqrt()],
        _ => [(size - half).max(0.0), size + half],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

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
            residual: Vec::new(),
            replaced: Vec::new(),
        };
        let channels = [of(0, 0.5), of(1, 0.0), of(2, -0.3), of(3, 0.4)];
        let all = shared(&channels, 10.0);
        let found = &all[0];
        assert_eq!(all.len(), 1);
        assert_eq!(found.parts.iter().map(|part| part.index).collect::<Vec<_>>(), [0, 2, 3]);
        for (part, truth) in found.parts.iter().zip([0.5, -0.3, 0.4]) {
            assert!((part.size - truth).abs() < 0.03, "{found:?}");
        }
        assert_eq!(shared(&channels[1..2], 10.0), []);
        assert_eq!(shared(&[of(5, 0.0), of(6, 0.0)], 10.0), []);
    }
    /// Draws in place of samples have nothing in common, but they scatter like samples.
    #[test]
    fn replaced_samples_make_no_shared_noise_and_do_not_hide_it() {
        const PRICE: f64 = 6.0;
        let n = 10_000;
        let noise = |effect: u16, seed: u64| {
            let mut stream = Stream::new(seed, StreamId { owner: 1, effect, instance: 0 });
            (0..n).map(|_| stream.normal()).collect::<Vec<f64>>()
        };
        let replaced: Vec<usize> = (0..n).filter(|t| t % 5 != 0).collect();
        let channel = |coefficients: Vec<f64>, replaced: &[usize]| Whitened {
            coefficients,
            white: vec![1.0; n],
            residual: vec![0.0; n],
            replaced: replaced.to_vec(),
        };
        let records = 200;
        let is_false = |seed: &u64| {
            let of = |effect| channel(noise(effect, *seed), &replaced);
            !shared(&[of(0), of(1)], PRICE).is_empty()
        };
        // The chance is that of a normal value beyond √12: 5e-4.
        let count = (0..records).filter(is_false).count();
        assert!(count <= 1, "{count} of {records}");
        // A fifth of the samples has a common part of 0.6.
        let source = noise(9, 1);
        let with = |effect| {
            let own = noise(effect, 2).into_iter().zip(&source);
            let mix = own.enumerate().map(|(t, (own, all))| if t % 5 == 0 { 0.8 * own + 0.6 * all } else { own });
            channel(mix.collect(), &replaced)
        };
        let found = shared(&[with(0), with(1), with(2)], PRICE);
        assert!(found[0].parts.iter().all(|part| part.ci95[0] < 0.6 && part.ci95[1] > 0.6), "{found:?}");
    }

    #[test]
    fn two_sources_are_two() {
        let n = 20_000;
        let noise = |effect: u16| {
            let mut stream = Stream::new(4, StreamId { owner: 1, effect, instance: 0 });
            (0..n).map(|_| stream.normal()).collect::<Vec<f64>>()
        };
        let of = |effect: u16, source: &[f64], share: f64| Whitened {
            coefficients: noise(effect)
                .iter()
                .zip(source)
                .map(|(own, all)| (1.0 - share * share).sqrt() * own + share * all)
                .collect(),
            white: vec![1.0; n],
            residual: Vec::new(),
            replaced: Vec::new(),
        };
        let (one, other) = (noise(8), noise(9));
        let found = shared(&[of(0, &one, 0.8), of(1, &one, 0.8), of(2, &other, 0.8), of(3, &other, -0.8)], 10.0);
        assert_eq!(found.len(), 2);
        for (of, signs) in found.iter().zip([[1.0, 1.0], [1.0, -1.0]]) {
            for (part, sign) in of.parts.iter().zip(signs) {
                assert!((part.size * sign - 0.8).abs() < 0.02, "{found:?}");
            }
            // −n/2·ln(1 − r²), r = 0.64.
            assert!((of.gain / (n as f64 * 0.2636) - 1.0).abs() < 0.05, "{found:?}");
        }
    }
}
