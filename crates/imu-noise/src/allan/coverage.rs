//! Noise types and 68.3 % intervals compared with the truth: synthetic power laws with many seeds.

use super::identify::{Lag1, noise_of_phases};
use super::*;
use imu_model::effects::{Effect as _, Flicker, Stream, StreamId};
use std::collections::BTreeMap;

const SAMPLES: usize = 2048;

/// Returns rate samples of a power law, of no particular size.
fn power_law(noise: NoiseType, count: usize, seed: u64) -> Vec<f64> {
    let mut stream = Stream::new(seed, StreamId { owner: 0, effect: 0, instance: 0 });
    let flicker = |count: usize, stream: Stream| {
        let mut values = vec![0.0; count];
        Flicker { b: 1.0 }.sampler(1.0, count as f64, stream).apply(&mut values);
        values
    };
    let steps = |values: Vec<f64>| values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    match noise {
        NoiseType::WhiteAngle => steps((0..=count).map(|_| stream.normal()).collect()),
        NoiseType::FlickerAngle => steps(flicker(count + 1, stream)),
        NoiseType::WhiteRate => (0..count).map(|_| stream.normal()).collect(),
        NoiseType::FlickerRate => flicker(count, stream),
        NoiseType::RandomWalkRate => {
            let mut level = 0.0;
            let mut step = || {
                level += stream.normal();
                level
            };
            (0..count).map(|_| step()).collect()
        }
    }
}

/// Returns in how many of a hundred records each kind is identified at each averaging factor.
fn named_right(factors: &[usize], kinds: impl Fn(&Phases) -> Vec<Option<NoiseType>>) -> Vec<(NoiseType, Vec<f64>)> {
    const SEEDS: u64 = 200;
    let of = |noise| {
        let mut right = vec![0.0; factors.len()];
        for seed in 0..SEEDS {
            let phases = Phases::integrate(&power_law(noise, SAMPLES, seed)).unwrap();
            for (share, found) in right.iter_mut().zip(kinds(&phases)) {
                *share += f64::from(u8::from(found == Some(noise))) * 100.0 / SEEDS as f64;
            }
        }
        (noise, right)
    };
    NoiseType::ALL.into_iter().map(of).collect()
}

#[test]
fn every_power_law_is_identified_wherever_thirty_points_are_left() {
    let factors = [1, 2, 4, 8, 16, 32, 64];
    let shares = named_right(&factors, |phases| {
        noise_of_phases(std::slice::from_ref(phases), &factors).into_iter().map(Some).collect()
    });
    for (noise, right) in shares {
        println!("{noise:?} {right:?} % at {factors:?}");
        assert!(right.iter().all(|share| *share >= 95.0), "{noise:?} {right:?}");
    }
}

/// Why the published rule is not sufficient: it uses one phase in m, and the thresholds of noise that was never
/// averaged.
#[test]
fn lag_1_alone_mistakes_both_flickers() {
    let factors = [1, 2, 4, 8, 16, 32, 64];
    let alone = |phases: &Phases| {
        let of = |m: &usize| {
            let alpha = Lag1::of([phases.picked(*m)])?.alpha.round();
            NoiseType::ALL.into_iter().find(|noise| f64::from(noise.alpha()) == alpha.clamp(-2.0, 2.0))
        };
        factors.iter().map(of).collect()
    };
    for (noise, right) in named_right(&factors, alone) {
        println!("lag 1 alone: {noise:?} {right:?} % at {factors:?}");
        let least = if matches!(noise, NoiseType::FlickerAngle | NoiseType::FlickerRate) { 0.0 } else { 90.0 };
        assert!(right[..5].iter().all(|share| *share >= least), "{noise:?} {right:?}");
        assert!(least > 0.0 || right[4] < 90.0, "{noise:?} {right:?}");
    }
}

#[test]
fn intervals_hold_the_truth_as_often_as_they_state() {
    const SEEDS: u64 = 300;
    let factors = [1, 8, 64, 128, 256, 512];
    let grid = TauGrid::custom(factors).unwrap();
    let mut checked = 0;
    for noise in [NoiseType::WhiteRate, NoiseType::FlickerRate, NoiseType::RandomWalkRate] {
        let mut curves: BTreeMap<&str, Vec<AllanCurve>> = BTreeMap::new();
        for seed in 0..SEEDS {
            let phases = [Phases::integrate(&power_law(noise, SAMPLES, 7000 + seed)).unwrap()];
            for estimator in Estimator::ALL {
                let curve = AllanCurve::from_phases(&phases, estimator, &grid, 1.0, "");
                curves.entry(estimator.name()).or_default().push(curve);
            }
        }
        let truth = |name: &str, index: usize| {
            // A total deviation estimates the Allan deviation.
            let name = if name == "totdev" { "oadev" } else { name };
            let squares: f64 = curves[name].iter().map(|curve| curve.deviation[index].powi(2)).sum();
            (squares / SEEDS as f64).sqrt()
        };
        for (name, curves) in &curves {
            for (index, m) in factors.iter().enumerate() {
                let truth = truth(name, index);
                let inside = |curve: &&AllanCurve| curve.ci68_low[index] <= truth && truth <= curve.ci68_high[index];
                let share = curves.iter().filter(inside).count() as f64 / SEEDS as f64;
                println!("{noise:?} {name} m = {m}: {share:.3}");
                // Four standard deviations of a share of 0.683 in 300. At m = 1 the degrees are those of a walk that
                // continues between the samples: fewer than those of a stepping walk.
                let stepping = *m == 1 && noise == NoiseType::RandomWalkRate;
                let most = if stepping { 0.85 } else { 0.79 };
                assert!((0.575..=most).contains(&share), "{noise:?} {name} m = {m}: {share}");
                checked += 1;
            }
        }
    }
    assert_eq!(checked, 3 * 6 * 6);
}
