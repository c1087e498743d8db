//! Bursts: single wild samples, knocks and handling, detected in the samples less the mean of their neighbours.
//!
//! White noise of variance σ² leaves a variance of 1.5 σ², for any level, drift or walk. The mean square over short
//! windows is χ² distributed. Its degrees of freedom are estimated from the scatter of the windows, so that coloured
//! noise and the remaining vibration do not raise the alarm. Slow changes of the noise's size are detected in
//! [`super::dynamic`]: each window is compared with the windows around it.

use super::Part;
use super::event::{Event, Kind};
use super::scale::{centre_and_spread, median, spread_of_95};
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

/// Alarms expected by chance in a record of pure noise, per detector.
const BY_CHANCE: f64 = 2e-4;
/// Lengths of the windows, s; at least [`LEAST`] samples.
const WINDOWS_S: [f64; 2] = [0.25, 2.0];
const LEAST: usize = 8;
/// Number of surrounding windows with which a window is compared.
const AROUND: usize = 256;
/// Shaking that lasts longer is handling.
const HANDLING_S: f64 = 2.0;
/// Alarms closer together than this are one event.
const JOIN_S: f64 = 0.75;
/// More wild samples than this share are a property of the noise, not events.
const HEAVY_TAILS: f64 = 1e-3;

/// The findings.
#[derive(Debug, Default)]
pub(super) struct Bursts {
    pub(super) events: Vec<Event>,
    /// Wild samples, if there are too many to be events.
    pub(super) heavy_tails: Option<HeavyTails>,
}

/// Samples too far out for normal noise, and too many to be events.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeavyTails {
    /// Their share of all samples.
    pub share: f64,
    /// Standard deviation of the others over that of all.
    pub core: f64,
}

/// Returns each sample less the mean of its neighbours; 0 at the ends.
fn residuals(values: &[f64]) -> Vec<f64> {
    let mut residuals = vec![0.0; values.len()];
    for (residual, three) in residuals.iter_mut().skip(1).zip(values.windows(3)) {
        *residual = three[1] - 0.5 * (three[0] + three[2]);
    }
    residuals
}

struct Alarm {
    from_s: f64,
    to_s: f64,
    /// Largest residual over its standard deviation, and number of wild samples.
    peak: f64,
    wild: usize,
}

/// Finds bursts; the parts belong to one channel.
pub(super) fn find(parts: &[Part], rate_hz: f64) -> Bursts {
    let mut residuals: Vec<Vec<f64>> = parts.iter().map(|part| residuals(&part.values)).collect();
    let count: usize = residuals.iter().map(Vec::len).sum();
    let Some(sigma) = deviation(&residuals, count).filter(|sigma| *sigma > 0.0) else { return Bursts::default() };
    let of_all = (residuals.iter().flatten().map(|value| value * value).sum::<f64>() / count as f64).sqrt();
    let tail = BY_CHANCE / (2.0 * count.max(1) as f64);
    // Down to the smallest tail for which the quantile can be computed.
    let limit = -Normal::standard().inverse_cdf(tail.max(1e-15)) * sigma;
    let spikes = spikes(parts, &mut residuals, rate_hz, limit, sigma);
    let alone: usize = spikes.iter().map(|spike| spike.wild).sum();
    let share = alone as f64 / count as f64;
    let heavy_tails = (share > HEAVY_TAILS).then_some(HeavyTails { share, core: (sigma / of_all).min(1.0) });
    let mut shaking = Vec::new();
    for window_s in WINDOWS_S {
        let window = ((window_s * rate_hz).round() as usize).max(LEAST);
        let mut found = Vec::new();
        windows(parts, &residuals, rate_hz, window, &mut found);
        // Short windows place a knock; long ones only find knocks that short ones miss.
        found.retain(|alarm: &Alarm| {
            !shaking.iter().any(|known: &Alarm| known.from_s <= alarm.to_s + 1.0 && alarm.from_s <= known.to_s + 1.0)
        });
        shaking.extend(found);
    }
    let mut events: Vec<Event> = joined(shaking, rate_hz).iter().map(|alarm| shake(alarm, rate_hz)).collect();
    if heavy_tails.is_none() {
        let apart =
            |spike: &&Alarm| !events.iter().any(|event| event.from_s <= spike.to_s && spike.from_s <= event.to_s);
        let single: Vec<Event> = spikes.iter().filter(apart).map(|spike| lone(spike, rate_hz)).collect();
        events.extend(single);
    }
    events.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    Bursts { events, heavy_tails }
}

/// Returns the standard deviation of the residuals without the wild ones. Excluding values beyond four deviations
/// hardly changes that of normal values, and coarse steps do not narrow it as they narrow a quantile.
fn deviation(residuals: &[Vec<f64>], count: usize) -> Option<f64> {
    let thin = count.div_ceil(1 << 18).max(1);
    let some: Vec<f64> = residuals.iter().flat_map(|part| part.iter().step_by(thin)).copied().collect();
    let rough = spread_of_95(some.iter().copied())?;
    let calm = some.iter().filter(|value| value.abs() <= 4.0 * rough);
    let (number, squares) = calm.fold((0u64, 0.0), |(number, squares), value| (number + 1, squares + value * value));
    (number > 0).then(|| (squares / number as f64).sqrt())
}

/// Finds wild samples that are alone or in twos and threes. They are removed from the residuals, so that the rest shows
/// shaking.
fn spikes(parts: &[Part], residuals: &mut [Vec<f64>], rate_hz: f64, limit: f64, sigma: f64) -> Vec<Alarm> {
    /// Maximum number of successive wild samples that are not shaking.
    const FEW: usize = 3;
    let mut alarms = Vec::new();
    for (part, residuals) in parts.iter().zip(residuals) {
        // A wild sample leaves half of itself with each neighbour; its place is that of the largest residual.
        let peaks: Vec<usize> = (0..residuals.len())
            .filter(|index| {
                let size = residuals[*index].abs();
                let near = &residuals[index.saturating_sub(1)..(index + 2).min(residuals.len())];
                size > limit && near.iter().all(|other| other.abs() <= size)
            })
            .collect();
        let reach = (JOIN_S * rate_hz).ceil() as usize;
        for group in peaks.chunk_by(|one, next| next - one <= reach) {
            let (Some(first), Some(last)) = (group.first(), group.last()) else { continue };
            if group.len() > FEW || last - first > FEW {
                continue;
            }
            let peak = group.iter().map(|index| residuals[*index].abs() / sigma).fold(0.0, f64::max);
            let (from_s, to_s) = (part.time_s(*first, rate_hz), part.time_s(*last, rate_hz));
            alarms.push(Alarm { from_s, to_s, peak, wild: group.len() });
            for index in group {
                let end = (index + 2).min(residuals.len());
                residuals[index.saturating_sub(1)..end].fill(0.0);
            }
        }
    }
    alarms
}

/// Finds half-overlapping windows whose power is beyond chance.
fn windows(parts: &[Part], residuals: &[Vec<f64>], rate_hz: f64, window: usize, alarms: &mut Vec<Alarm>) {
    let hop = (window / 2).max(1);
    let powers: Vec<Vec<f64>> = residuals
        .iter()
        .map(|part| {
            let squares: Vec<f64> =
                part.chunks_exact(hop).map(|chunk| chunk.iter().map(|value| value * value).sum()).collect();
            squares.windows(2).map(|pair| pair[0] + pair[1]).collect()
        })
        .collect();
    // Divided by the median around it, to the power 1/3: nearly normal (Wilson and Hilferty).
    let scores: Vec<Vec<f64>> = powers.iter().map(|powers| over_median(powers)).collect();
    let all: Vec<f64> = scores.iter().flatten().copied().collect();
    let count = all.len();
    let Some((centre, spread)) = centre_and_spread(all.into_iter()).filter(|(_, spread)| *spread > 0.0) else { return };
    // cbrt(χ²_ν/ν) has standard deviation √(2/9ν) about 1 − 2/9ν. A window has fewer independent values than samples.
    let degrees = (2.0 / (9.0 * (spread / centre).powi(2))).clamp(1.0, window as f64);
    let Ok(chi_squared) = ChiSquared::new(degrees) else { return };
    let limit =
        chi_squared.inverse_cdf(1.0 - (BY_CHANCE / count.max(1) as f64).max(1e-15)) / chi_squared.inverse_cdf(0.5);
    for (part, scores) in parts.iter().zip(&scores) {
        for (index, score) in scores.iter().enumerate().filter(|(_, score)| score.powi(3) > limit) {
            alarms.push(Alarm {
                from_s: part.time_s(index * hop, rate_hz),
                to_s: part.time_s(index * hop + 2 * hop - 1, rate_hz),
                peak: score.powf(1.5),
                wild: 0,
            });
        }
    }
}

fn over_median(powers: &[f64]) -> Vec<f64> {
    let mut scores = vec![0.0; powers.len()];
    for (block, chunk) in scores.chunks_mut(AROUND / 2).enumerate() {
        let from = (block * AROUND / 2).saturating_sub(AROUND / 4);
        let to = (block * AROUND / 2 + 3 * AROUND / 4).min(powers.len());
        // Near the end, the windows before are used instead.
        let from = from.min(to.saturating_sub(AROUND));
        let level = median(powers[from..to].iter().copied()).unwrap_or(0.0);
        for (score, power) in chunk.iter_mut().zip(&powers[block * AROUND / 2..]) {
            *score = if level > 0.0 { (power / level).cbrt() } else { 1.0 };
        }
    }
    scores
}

fn joined(mut alarms: Vec<Alarm>, rate_hz: f64) -> Vec<Alarm> {
    alarms.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    let mut joined: Vec<Alarm> = Vec::new();
    for alarm in alarms {
        match joined.last_mut() {
            Some(last) if alarm.from_s <= last.to_s + JOIN_S.max(2.0 / rate_hz) => {
                last.to_s = last.to_s.max(alarm.to_s);
                last.peak = last.peak.max(alarm.peak);
            }
            _ => joined.push(alarm),
        }
    }
    joined
}

fn shake(alarm: &Alarm, rate_hz: f64) -> Event {
    let lasts = alarm.to_s - alarm.from_s;
    let kind = if lasts > HANDLING_S + WINDOWS_S[0] { Kind::Handling } else { Kind::Knock };
    let pad_s = WINDOWS_S[0].max(2.0 / rate_hz);
    let note = format!("shaking up to {:.1} times the usual noise for {lasts:.1} s", alarm.peak);
    Event { kind, from_s: (alarm.from_s - pad_s).max(0.0), to_s: alarm.to_s + pad_s, note }
}

fn lone(alarm: &Alarm, rate_hz: f64) -> Event {
    let pad_s = 2.0 / rate_hz;
    let note = format!("{:.1} standard deviations from its neighbours", alarm.peak);
    Event { kind: Kind::Spike, from_s: (alarm.from_s - pad_s).max(0.0), to_s: alarm.to_s + pad_s, note }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Noise;
    use super::*;

    fn of(values: Vec<f64>) -> Bursts {
        find(&[Part { start_s: 0.0, values }], 40.0)
    }

    #[test]
    fn spikes_knocks_and_handling_are_distinguished_and_placed() {
        let mut noise = Noise::new(21);
        let mut values = noise.sensor(60_000, 40.0, 2e-3, 1e-3, 1e-4);
        let sigma = 2e-3 * 40f64.sqrt();
        values[8000] += 12.0 * sigma;
        for value in &mut values[20_000..20_016] {
            *value += 6.0 * sigma * noise.normal();
        }
        for value in &mut values[40_000..40_200] {
            *value += 4.0 * sigma * noise.normal();
        }
        let found = of(values).events;
        let kinds: Vec<Kind> = found.iter().map(|event| event.kind).collect();
        assert_eq!(kinds, [Kind::Spike, Kind::Knock, Kind::Handling], "{found:?}");
        for (event, (from, to)) in found.iter().zip([(200.0, 200.0), (500.0, 500.4), (1000.0, 1005.0)]) {
            assert!(event.from_s <= from && event.to_s >= to, "{event:?}");
            assert!(event.from_s > from - 2.5 && event.to_s < to + 2.5, "{event:?}");
        }
    }

    #[test]
    fn heavy_tails_are_no_events() {
        let mut noise = Noise::new(22);
        // Student's t of three degrees.
        let values: Vec<f64> = (0..100_000)
            .map(|_| {
                let chi: f64 = (0..3).map(|_| noise.normal().powi(2)).sum();
                noise.normal() / (chi / 3.0).sqrt()
            })
            .collect();
        let found = of(values);
        assert!(
            found.heavy_tails.is_some_and(|tails| tails.share < 0.02 && tails.core < 1.0),
            "{:?}",
            found.heavy_tails
        );
        assert!(found.events.iter().all(|event| event.kind != Kind::Spike), "{:?}", found.events.len());
    }

    #[test]
    fn constant_and_coarse_data_raise_no_alarm() {
        assert!(of(vec![9.8; 5000]).events.is_empty());
        let coarse: Vec<f64> = Noise::new(23).white(50_000, 0.4).iter().map(|value| value.round()).collect();
        assert!(of(coarse).events.is_empty());
    }
}
