//! Modulated: found bands whose level changes with time.

use super::law::Shape;
use super::omnibus::component::Part;
use super::series::Series;
use imu_model::effects::profile::mean_power_of;
use std::f64::consts::TAU;

/// A band whose level changes: the place of its term in the law, and the middles of stretches of the record in samples, each with
/// the factor on the band's amplitude there. The mean square of the level is 1.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Levels {
    pub(super) term: usize,
    pub(super) points: Vec<(f64, f64)>,
}

/// Returns the bands of the law whose levels change clearly.
///
/// The mean square of a normal process of bandwidth w (full width at half power) over a time T is about that of 2π·w·T
/// squares of normal values: its square has the autocovariance σ⁴·exp(−2πw|t|). Levels in stretches gain ν/2·(r − 1 −
/// ln r) each.
pub(super) fn levels(series: &Series<'_>, parts: &[Part]) -> Vec<Levels> {
    /// Minimum number of independent values in a stretch.
    const LEAST: f64 = 24.0;
    const FEWEST: usize = 4;
    const MOST: usize = 48;
    /// Nats that levels have to gain per stretch and in total, beyond the gain of chance.
    const EACH: f64 = 2.0;
    const ALL: f64 = 20.0;
    /// Levels below this part of the average count as silence.
    const SILENT: f64 = 0.01;
    let (n, rate_hz) = (series.len(), series.setting().rate_hz);
    // White noise of changing variance shows in every band.
    if !series.variance.is_empty() {
        return Vec::new();
    }
    let mut found = Vec::new();
    for Part { place, term: own, course, .. } in parts {
        let width_hz = own.numbers.get(2).map(|width| width.exp()).filter(|_| own.shape == Shape::Resonance);
        let Some(width_hz) = width_hz else { continue };
        let free = TAU * width_hz * n as f64 / rate_hz;
        let count = ((free / LEAST) as usize).min(MOST);
        if count < FEWEST {
            continue;
        }
        let size = n / count;
        let squares: Vec<f64> =
            course.chunks_exact(size).map(|of| of.iter().map(|x| x * x).sum::<f64>() / size as f64).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        let ratios: Vec<f64> = squares.iter().map(|square| (square / mean).max(SILENT)).collect();
        let each = 0.5 * free / count as f64;
        let nats: f64 = ratios.iter().map(|ratio| each * (ratio - 1.0 - ratio.ln())).sum();
        if nats > ALL + EACH * ratios.len() as f64 {
            let middle = |at: usize| (at as f64 + 0.5) * size as f64;
            let mut points: Vec<(f64, f64)> =
                ratios.iter().enumerate().map(|(at, ratio)| (middle(at), ratio.sqrt())).collect();
            // The level is interpolated linearly between the middles of stretches.
            let square = mean_power_of(&points, n as f64, 2);
            points.iter_mut().for_each(|point| point.1 /= square.sqrt());
            found.push(Levels { term: *place, points });
        }
    }
    found
}
