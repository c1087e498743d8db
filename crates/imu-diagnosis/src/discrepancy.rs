//! Discrepancy: the size of the gap, before and after, on the half of the record from which no number was fitted.

use super::averages::quantile;
use super::found::{Attribution, Findings, Found};
use super::holdout::BLOCKS;
use super::report::Discrepancy;
use imu_model::effects::{EffectKind, Stream, StreamId};

/// Returns the explained part, on the half from which no number was fitted.
pub(super) fn discrepancy(found: &Found, attributions: &[Attribution], p_value_after: f64) -> Discrepancy {
    const DRAWS: usize = 1000;
    let channels = found.channels.len().max(1) as f64;
    let samples = found.channels.first().map_or(1, |of| of.scores.samples) as f64;
    let blocks = |which: fn(&Findings) -> &Vec<f64>| -> Vec<f64> {
        (0..BLOCKS).map(|block| found.channels.iter().map(|of| which(of)[block]).sum::<f64>()).collect()
    };
    let common = attributions.iter().any(|of| of.effect.kind() == EffectKind::CommonMode);
    // The gain from correlation is the same in every block.
    let shared: f64 = found.shared.iter().filter(|_| common).map(|shared| shared.gain).sum();
    let more = 0.5 * shared / BLOCKS as f64;
    let declared = blocks(|of| &of.scores.declared);
    let parameters = blocks(|of| &of.scores.parameters);
    let effects: Vec<f64> = blocks(|of| &of.scores.effects).into_iter().map(|sum| sum + more).collect();
    let ceiling: Vec<f64> = blocks(|of| &of.scores.ceiling).into_iter().map(|sum| sum + more).collect();
    let floor_nats: f64 = found.channels.iter().map(|of| 0.5 * of.scores.numbers as f64).sum();
    let per_sample = |nats: f64| nats / (samples * channels);
    let gap = |of: &[f64], weights: &dyn Fn(usize) -> f64| -> f64 {
        of.iter().zip(&ceiling).enumerate().map(|(block, (own, best))| weights(block) * (best - own)).sum()
    };
    let one = |_: usize| 1.0;
    // `lost`: nats that the first half's numbers lose on the second half because they are not exact.
    let ratio = |weights: &dyn Fn(usize) -> f64, lost: f64| {
        let (before, after) = (gap(&parameters, weights), gap(&effects, weights));
        (before - after + lost) / (before - floor_nats)
    };
    let before = gap(&parameters, &one);
    let something = !attributions.is_empty() && before > 3.0 * floor_nats + 5.0;
    let closed = something.then(|| ratio(&one, 0.0)).filter(|value| value.is_finite());
    let closed_ci95 = closed.map(|_| {
        let mut stream = Stream::new(BLOCKS as u64, StreamId { owner: 0, effect: 2, instance: 0 });
        let numbers: usize = found.channels.iter().map(|of| of.scores.numbers).sum();
        let draw = |_| {
            let mut weights = [0.0; BLOCKS];
            for _ in 0..BLOCKS {
                let block = ((stream.uniform() * BLOCKS as f64) as usize).min(BLOCKS - 1);
                weights[block] += 1.0;
            }
            // Half a χ² of as many degrees of freedom (Wilks 1938, Ann. Math. Stat. 9).
            let lost: f64 = (0..numbers).map(|_| 0.5 * stream.normal().powi(2)).sum();
            [0.0, lost].map(|lost| ratio(&|block| weights[block], lost))
        };
        let (low, high): (Vec<f64>, Vec<f64>) = (0..DRAWS).map(draw).map(|[low, high]| (low, high)).unzip();
        let end = |draws: Vec<f64>, share: f64| {
            quantile(draws.into_iter().filter(|value| value.is_finite()).collect(), share).unwrap_or(0.0)
        };
        [end(low, 0.025), end(high, 0.975)]
    });
    Discrepancy {
        unit: "nats/sample".into(),
        before: per_sample(gap(&declared, &one)),
        after_parameters: per_sample(before),
        after: per_sample(gap(&effects, &one)),
        floor: per_sample(floor_nats),
        p_value_after,
        closed,
        closed_ci95,
        measured_on: "second half, with the levels of the first; places and shapes are of the whole record".to_owned(),
        cost: None,
    }
}
