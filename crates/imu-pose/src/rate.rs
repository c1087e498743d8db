//! Rates: a gyroscope about one axis compared with an encoder or a rate table about that axis.
//!
//! Both are integrated over windows, so that the noise of the reference's rate is in what remains.

use crate::fit::{Prior, Solution, Window, solve};
use crate::reference::Rates;
use crate::track::Track;
use nalgebra::{DMatrix, DVector, Vector3};

/// A window's length, s: short beside turns that swing, long beside the noise of one sample.
const WINDOW_S: f64 = 0.2;
const LAG_SD_S: f64 = 0.1;

/// Places of the numbers: the factor of the inverse, its constant, the lag.
pub(crate) const LAG: usize = 2;

/// Returns all windows at these numbers.
pub(crate) fn windows(track: &Track, rates: &Rates, numbers: &DVector<f64>) -> Vec<Window> {
    let mut reference = Track { time_s: rates.time_s.clone(), ..Track::default() };
    reference.gyro = rates.rate_rad_s.iter().map(|rate| Vector3::new(*rate, 0.0, 0.0)).collect();
    let reference = reference.refined();
    let (Some(first), Some(last)) = (rates.time_s.first(), rates.time_s.last()) else { return Vec::new() };
    let count = ((last - first) / WINDOW_S) as usize;
    let longest = [track.longest_step_s(), reference.longest_step_s()];
    let (factor, constant, lag_s) = (numbers[0], numbers[1], numbers[LAG]);
    let window = |place: usize| {
        let from_s = first + place as f64 * WINDOW_S;
        let (begin_s, end_s) = (from_s + lag_s, from_s + WINDOW_S + lag_s);
        let own = track.parts(&track.gyro, begin_s, end_s, longest[0])?;
        let known = reference.parts(&reference.gyro, from_s, from_s + WINDOW_S, longest[1])?;
        let turned: f64 = own.iter().map(|part| part.value[rates.axis] * part.seconds).sum();
        let angle: f64 = known.iter().map(|part| part.value.x * part.seconds).sum();
        let ends = own.last()?.value[rates.axis] - own.first()?.value[rates.axis];
        Some(Window {
            middle_s: from_s + 0.5 * WINDOW_S,
            residual: DVector::from_element(1, factor * turned + constant * WINDOW_S - angle),
            jacobian: DMatrix::from_row_slice(1, 3, &[turned, WINDOW_S, factor * ends]),
            instruments: None,
        })
    };
    (0..count).filter_map(window).collect()
}

/// Fits factor, constant and lag: `factor · gyro + constant` is the reference's rate. `None` without windows.
pub(crate) fn fit(track: &Track, rates: &Rates, factor: f64, lag_s: f64) -> Option<Solution> {
    let priors =
        [Prior { mean: factor, sd: factor.abs() }, Prior { mean: 0.0, sd: 1.0 }, Prior { mean: lag_s, sd: LAG_SD_S }];
    solve(&|numbers| windows(track, rates, numbers), &priors)
}
