//! Stillness: the stretches of a capture in which the sensor was at rest, and those in which it moved, from gyroscope and
//! accelerometer.
//!
//! In: samples of the six inertial channels in order of time. Only their half-second means are kept ([`Stillness::push`]). Out:
//! the stretches in motion ([`Stillness::settle`]). All of these channels that the capture has are used.
//!
//! A sensor at rest shows its bias and one direction of gravity. A cause of motion (a hand, legs, a vehicle) changes
//! the *means* over half a second; vibration, knocks and noise hardly change them. The test therefore uses means, not
//! variances: a fan on the desk is not motion, though it makes samples ten times as noisy. A window departs if
//! - its mean rate differs from the bias by more than 6 of its standard deviations, at least 0.5 and at most 1 °/s; or
//! - its mean acceleration differs from the median over 3.5 s by more than 6 of its standard deviations, at least 0.1
//!   and at most 0.3 m/s²; or that median itself changes by as much within four seconds.
//!
//! Four departures among seven windows are motion: a knock of less than a second touches three. The standard deviation
//! is estimated from the record's quietest tenth, so that a record that moves for four fifths of its time is still
//! divided. The upper bounds apply if no part of a record is quiet. The bias is estimated from the steady windows and
//! followed at the rate at which electronics warm up.
//!
//! A slow tilt is motion if two independent quantities agree: the change of gravity's direction, and the integral of
//! the rate across it. Neither suffices alone: an accelerometer's bias creeps, and so does a gyroscope's.
//!
//! # Source
//! Detection by windows of mean and energy: Skog, Händel, Nilsson, Rantakokko, "Zero-velocity detection: an algorithm
//! evaluation", IEEE Trans. Biomed. Eng. 57 (2010) 2657–2666 (the test of angular rate energy, of the acceleration's
//! moving variance, and SHOE, which combines both). Bounds: at rest the means over half a second of the noisiest
//! sensors tried (ADIS16405, 0.04 °/s/√Hz; MPU-9150) scatter by 0.06 °/s and 0.01 m/s², a VN-100's (datasheet
//! PB-12-0002: 0.0035 °/s/√Hz, 0.14 mg/√Hz) by a twentieth of that rate; handling, walking and driving make 5 °/s and
//! 0.3 m/s² or more at the median. The bounds lie in between; the earth's 0.004 °/s is far below. A zero-rate offset is
//! up to 20 °/s (MPU-6050 datasheet): a steady rate beyond [`OFFSET_MAX`] is not a bias.
//!
//! # Validation
//! The tests below, and `docs/noise-model.md` for real recordings.

use imu_core::sample::Channel;
use std::ops::Range;

/// The channels that show motion, in the order of [`Stillness::push`].
pub const MOTION_CHANNELS: [Channel; 6] =
    [Channel::GyroX, Channel::GyroY, Channel::GyroZ, Channel::AccelX, Channel::AccelY, Channel::AccelZ];
/// Larger values are not measurements: rad/s, m/s².
const MEASURED_MAX: [f64; 6] = [100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0];
/// Minimum length of a window, s.
const WINDOW_S: f64 = 0.5;
/// Minimum number of samples in a window: at rates below 16 Hz a window is longer.
const WINDOW_SAMPLES: u64 = 8;
/// Maximum number of windows of a capture without gaps: 36 h of half seconds; longer captures have longer windows. Each
/// takes 56 bytes. With gaps there are at most four times as many, because every kept window is at least a quarter
/// full.
const WINDOWS_MAX: u64 = 1 << 18;
/// A window departs beyond this many standard deviations of its mean, within the bounds below.
const DEVIATIONS: f64 = 6.0;
/// Lower and upper bound of the departure of the mean rate, rad/s: 0.5 and 1 °/s.
const RATE: [f64; 2] = [0.0087, 0.0175];
/// Lower and upper bound of the departure of the mean acceleration, m/s².
const ACCELERATION: [f64; 2] = [0.1, 0.3];
/// With a gyroscope, an acceleration counts only beside a rate of at least this share of the rate that counts alone.
const STIR: f64 = 0.5;
/// Number of windows in a neighbourhood, and how many of them have to depart.
const NEIGHBOURS: usize = 7;
const DEPARTING: usize = 4;
/// No zero-rate offset is larger than this, rad/s: 25 °/s.
const OFFSET_MAX: f64 = 0.44;
/// A bias follows this share of each window's difference,
const FOLLOW: f64 = 0.05;
/// but at most this fast, rad/s per s: 0.34 °/s per minute.
const FOLLOW_MAX: f64 = 1e-4;
/// The largest change of a bias while the sensor moves, rad/s per s, and in total.
const UNSEEN: [f64; 2] = [1e-5, 0.0087];
/// Number of windows left out before and after motion.
const GUARD: usize = 2;
/// A shorter rest between two motions does not count, windows.
const REST_MIN: usize = 10;
/// Number of windows per block in the search for slow tilts.
const BLOCK: usize = 8;
/// Smallest tilt, rad: 0.17°.
const TILT_MIN: f64 = 3e-3;

/// Means of a window.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Window {
    /// Place of the window's first sample over the window's length.
    index: u64,
    /// Means of gyro x, y, z in rad/s and accel x, y, z in m/s²; NaN if there is none.
    means: [f32; 6],
}

/// The present window.
#[derive(Debug, Clone, Copy, Default)]
struct Open {
    index: u64,
    sums: [f64; 6],
    counts: [u64; 6],
}

/// Gathers a capture's means; [`Self::settle`] separates motion from rest.
#[derive(Debug, Clone)]
pub struct Stillness {
    rate_hz: f64,
    /// Samples per window.
    length: u64,
    windows: Vec<Window>,
    open: Open,
    /// Number of values beyond any measurement, and number of all values.
    beyond: [(u64, u64); 6],
}

impl Stillness {
    /// Creates the means for a capture with that many received samples. Missing samples take no window, so that a clock
    /// that jumps makes no window longer.
    pub fn new(rate_hz: f64, samples: u64) -> Self {
        let length = ((WINDOW_S * rate_hz).ceil() as u64).max(WINDOW_SAMPLES).max(samples.div_ceil(WINDOWS_MAX));
        Self { rate_hz, length, windows: Vec::new(), open: Open::default(), beyond: [(0, 0); 6] }
    }

    /// Takes consecutive samples of [`MOTION_CHANNELS`] from `place` on (counted from the capture's first sample,
    /// missing ones included): gyro x, y, z in rad/s, accel x, y, z in m/s². Places increase from call to call. NaN
    /// marks a missing value. A value beyond any measurement (100 rad/s, 1000 m/s²) counts as missing.
    pub fn push(&mut self, place: u64, columns: [&[f64]; 6]) {
        let rows = columns.iter().map(|column| column.len()).max().unwrap_or(0);
        let mut from = 0;
        while from < rows {
            let at = place + from as u64;
            let index = at / self.length;
            if index != self.open.index {
                self.close();
                self.open.index = index;
            }
            let left = usize::try_from((index + 1) * self.length - at).unwrap_or(rows);
            let to = rows.min(from + left);
            for (axis, column) in columns.iter().enumerate() {
                let values = column.get(from..to).unwrap_or_default();
                let most = MEASURED_MAX[axis];
                let (mut sum, mut count, mut beyond) = (0.0, 0u64, 0u64);
                for value in values {
                    let there = value.abs() <= most;
                    sum += if there { *value } else { 0.0 };
                    count += u64::from(there);
                    beyond += u64::from(value.abs() > most);
                }
                self.beyond[axis].0 += beyond;
                self.beyond[axis].1 += beyond + count;
                self.open.sums[axis] += sum;
                self.open.counts[axis] += count;
            }
            from = to;
        }
    }

    /// Returns, for each channel, the number of values beyond any measurement, and the number of all values.
    pub fn beyond(&self) -> [(u64, u64); 6] {
        self.beyond
    }

    fn close(&mut self) {
        let open = std::mem::take(&mut self.open);
        // A window of few samples counts as a window without samples.
        let enough = self.length.div_ceil(4);
        let mut means = [f32::NAN; 6];
        for ((mean, sum), count) in means.iter_mut().zip(open.sums).zip(open.counts) {
            if count >= enough {
                *mean = (sum / count as f64) as f32;
            }
        }
        if means.iter().any(|mean| mean.is_finite()) {
            self.windows.push(Window { index: open.index, means });
        }
    }

    /// Returns the stretches in motion: places from–to in order, disjoint; windows that are too sparse follow their
    /// neighbours. `None` if there is no window.
    pub fn settle(mut self) -> Option<Vec<Range<u64>>> {
        self.close();
        if self.windows.is_empty() {
            return None;
        }
        let window_s = self.length as f64 / self.rate_hz;
        let means: Vec<Means> = self.windows.iter().map(Means::of).collect();
        let mut moving = departures(&means, window_s);
        for tilt in tilts(&means, &moving, window_s * BLOCK as f64) {
            moving[tilt].fill(true);
        }
        let mut found: Vec<Range<u64>> = Vec::new();
        for run in widened(&moving) {
            let first = self.windows.get(run.start).map_or(0, |window| window.index * self.length);
            // Up to the next window; the last stretch extends to the end of the capture.
            let end = self.windows.get(run.end).map_or(u64::MAX, |next| next.index * self.length);
            found.push(if run.start == 0 { 0..end } else { first..end });
        }
        Some(found)
    }
}

/// A window's means. A triad that lacks an axis entirely has zeros, which never depart.
#[derive(Debug, Clone, Copy)]
struct Means {
    gyro: [f64; 3],
    accel: [f64; 3],
}

impl Means {
    fn of(window: &Window) -> Self {
        let axis = |at: usize| window.means.get(at).map_or(f64::NAN, |mean| f64::from(*mean));
        Self { gyro: [axis(0), axis(1), axis(2)], accel: [axis(3), axis(4), axis(5)] }
    }
}

/// Returns the Euclidean distance over the axes that both have.
fn distance(one: [f64; 3], other: [f64; 3]) -> f64 {
    one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).filter(|square| square.is_finite()).sum::<f64>().sqrt()
}

/// Returns the standard deviation per axis of a window's mean, from the lowest tenth of the differences of neighbours
/// over `axes` axes.
fn learned(values: impl Iterator<Item = [f64; 3]>, bounds: [f64; 2]) -> f64 {
    let values: Vec<[f64; 3]> = values.collect();
    let axes = (0..3).filter(|axis| values.iter().any(|value| value[*axis].is_finite())).count();
    let mut steps: Vec<f64> =
        values.windows(2).map(|pair| distance(pair[0], pair[1])).filter(|step| *step > 0.0).collect();
    let at = steps.len() / 10;
    if steps.is_empty() {
        return bounds[0];
    }
    let (_, tenth, _) = steps.select_nth_unstable_by(at, f64::total_cmp);
    // The tenth percentile of χ with 1, 2, 3 degrees of freedom.
    let chi = [0.126, 0.459, 0.764][axes.clamp(1, 3) - 1];
    (DEVIATIONS * *tenth / chi / std::f64::consts::SQRT_2).clamp(bounds[0], bounds[1])
}

/// Returns the medians of the axes over windows.
fn median(windows: &[Means], of: impl Fn(&Means) -> [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let mut values: Vec<f64> = windows.iter().map(|window| of(window)[axis]).filter(|v| v.is_finite()).collect();
        if values.is_empty() {
            return f64::NAN;
        }
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    })
}

/// Returns which windows are in motion according to their departures.
fn departures(means: &[Means], window_s: f64) -> Vec<bool> {
    let rate = learned(means.iter().map(|window| window.gyro), RATE);
    let acceleration = learned(means.iter().map(|window| window.accel), ACCELERATION);
    let has_gyro = means.iter().any(|window| window.gyro.iter().any(|axis| axis.is_finite()));
    let half = NEIGHBOURS / 2;
    let levels: Vec<[f64; 3]> = (0..means.len())
        .map(|at| median(&means[at.saturating_sub(half)..(at + half + 1).min(means.len())], |window| window.accel))
        .collect();
    let far = |at: usize| distance(means[at].accel, levels[at]) > acceleration;
    let steady = |at: usize| {
        let near = |other: usize| distance(means[at].gyro, means[other].gyro) <= rate && !far(other);
        near(at.saturating_sub(1)) && near((at + 1).min(means.len() - 1)) && near(at)
    };
    let steady: Vec<usize> = (0..means.len()).filter(|at| steady(*at)).collect();
    let bias = followed(means, &steady, rate, window_s);
    let turning = |at: usize| bias[at].is_none_or(|bias| distance(means[at].gyro, bias) > rate);
    // A push also turns the sensor, however little; a line folded to a low frequency only shakes the accelerometer.
    let turns = |at: usize| !has_gyro || bias[at].is_none_or(|bias| distance(means[at].gyro, bias) > STIR * rate);
    let departs: Vec<bool> = (0..means.len()).map(|at| turning(at) || far(at) && turns(at)).collect();
    let mut moving = vec![false; means.len()];
    for from in 0..means.len() {
        let group = from..(from + NEIGHBOURS).min(means.len());
        let departing: Vec<usize> = group.filter(|at| departs[*at]).collect();
        if let (DEPARTING.., Some(first), Some(last)) = (departing.len(), departing.first(), departing.last()) {
            moving[*first..=*last].fill(true);
        }
    }
    // The poses before and after: medians that share no window.
    let turned = |at: usize| {
        if at < 4 || at + 4 >= levels.len() {
            return false;
        }
        let (before, after) = (levels[at - 4], levels[at + 4]);
        let apart = distance(before, after);
        // The direction that follows from the rate: a direction fixed in the world turns relative to the sensor, du/dt
        // = −ω × u.
        let turn = (at - 4..at + 4).filter_map(|at| {
            let bias = bias[at]?;
            let rate: [f64; 3] = std::array::from_fn(|axis| means[at].gyro[axis] - bias[axis]);
            Some(cross(levels[at], rate).map(|axis| axis * window_s))
        });
        let predicted = turn.fold(before, |sum, change| std::array::from_fn(|axis| sum[axis] + change[axis]));
        // If an axis is absent, the quantities neither agree nor disagree.
        let agree = predicted.iter().any(|axis| axis.is_nan()) || distance(predicted, after) < 0.5 * apart;
        apart > acceleration && (!has_gyro || agree)
    };
    let turned: Vec<bool> = (0..means.len()).map(turned).collect();
    for run in runs(&turned) {
        // An instantaneous change shows in eight windows.
        let middle = usize::midpoint(run.start, run.end);
        moving[(run.start + 4).min(middle)..run.end.saturating_sub(4).max(middle + 1)].fill(true);
    }
    moving
}

/// Returns the bias at each window: estimated from the steady windows of smallest rate, and followed from there to both
/// ends. `None` if no window is steady; then every window is in motion.
fn followed(means: &[Means], steady: &[usize], rate: f64, window_s: f64) -> Vec<Option<[f64; 3]>> {
    if means.iter().all(|window| window.gyro.iter().all(|axis| axis.is_nan())) {
        return vec![Some([0.0; 3]); means.len()];
    }
    let norm = |at: &usize| distance(means[*at].gyro, [0.0; 3]);
    let mut still: Vec<usize> = steady.iter().copied().filter(|at| norm(at) <= OFFSET_MAX).collect();
    still.sort_by(|one, other| norm(one).total_cmp(&norm(other)));
    still.truncate(still.len().div_ceil(3));
    let least: Vec<Means> = still.iter().map(|at| means[*at]).collect();
    let bias = median(&least, |window| window.gyro);
    let from_bias = |at: &usize| distance(means[*at].gyro, bias);
    let Some(seed) = still.into_iter().min_by(|one, other| from_bias(one).total_cmp(&from_bias(other))) else {
        return vec![None; means.len()];
    };
    let mut all = vec![None; means.len()];
    let mut follow = |order: &mut dyn Iterator<Item = usize>| {
        let (mut bias, mut unseen_s) = (bias, 0.0);
        for at in order {
            let allowance = (UNSEEN[0] * unseen_s).min(UNSEEN[1]);
            let away = distance(means[at].gyro, bias);
            if away > rate && away <= rate + allowance {
                // The bias appears again after a long motion and has changed meanwhile.
                bias =
                    std::array::from_fn(|axis| bias[axis] + (means[at].gyro[axis] - bias[axis]) * (1.0 - rate / away));
            }
            if away <= rate + allowance {
                unseen_s = 0.0;
                let most = FOLLOW_MAX * window_s;
                bias = std::array::from_fn(|axis| {
                    let difference = means[at].gyro[axis] - bias[axis];
                    bias[axis] + if difference.is_finite() { (FOLLOW * difference).clamp(-most, most) } else { 0.0 }
                });
            } else {
                unseen_s += window_s;
            }
            all[at] = Some(bias);
        }
    };
    follow(&mut (seed..means.len()));
    follow(&mut (0..=seed).rev());
    all
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Returns slow tilts among windows at rest: windows in which gravity's direction turned and the rate shows the same
/// turn.
///
/// Both are computed as an episode's change less the mean change of equally long episodes before and after, so that a
/// bias and its linear drift cancel. Each is compared with its own median over the record.
fn tilts(means: &[Means], moving: &[bool], block_s: f64) -> Vec<Range<usize>> {
    let there = |window: &Means| window.gyro.iter().chain(&window.accel).all(|axis| axis.is_finite());
    let mut found = Vec::new();
    // Stretches at rest, with all six axes throughout.
    let usable: Vec<bool> = means.iter().zip(moving).map(|(window, moving)| there(window) && !moving).collect();
    for run in runs(&usable) {
        let blocks = run.len() / BLOCK;
        let (mut direction, mut turned) = (Vec::with_capacity(blocks), vec![[0.0; 3]]);
        for block in 0..blocks {
            let windows = &means[run.start + block * BLOCK..run.start + (block + 1) * BLOCK];
            // Medians, because a knock is not a tilt.
            let accel = median(windows, |window| window.accel);
            let gyro = median(windows, |window| window.gyro);
            let g = distance(accel, [0.0; 3]).max(1.0);
            let unit = accel.map(|axis| axis / g);
            // A direction fixed in the world turns relative to the sensor: du/dt = −ω × u.
            let change = cross(gyro, unit).map(|axis| -axis * block_s);
            let last: [f64; 3] = turned.last().copied().unwrap_or_default();
            turned.push(std::array::from_fn(|axis| last[axis] + change[axis]));
            direction.push(unit);
        }
        let mut length = 4;
        while 9 * length <= blocks {
            found.extend(
                tilts_of(&direction, &turned, length)
                    .into_iter()
                    .map(|tilt| run.start + tilt.start * BLOCK..run.start + tilt.end * BLOCK),
            );
            length *= 2;
        }
    }
    found
}

/// Returns tilts that last about `length` blocks.
fn tilts_of(direction: &[[f64; 3]], turned: &[[f64; 3]], length: usize) -> Vec<Range<usize>> {
    // Gravity's direction at the boundary before a block: the mean of the blocks around it.
    let around = (length / 3).clamp(1, 5);
    let mut sums = vec![[0.0; 3]];
    for unit in direction {
        let last: [f64; 3] = sums.last().copied().unwrap_or_default();
        sums.push(std::array::from_fn(|axis| last[axis] + unit[axis]));
    }
    let at = |boundary: usize| -> [f64; 3] {
        let (from, to) = (boundary.saturating_sub(around), (boundary + around).min(direction.len()));
        std::array::from_fn(|axis| (sums[to][axis] - sums[from][axis]) / (to - from) as f64)
    };
    let excess = |of: &dyn Fn(usize) -> [f64; 3], from: usize| -> [f64; 3] {
        let [a, b, c, d] = [from, from + length, from + 2 * length, from + 3 * length].map(of);
        std::array::from_fn(|axis| (c[axis] - b[axis]) - 0.5 * ((b[axis] - a[axis]) + (d[axis] - c[axis])))
    };
    let count = direction.len() + 1 - 3 * length;
    let seen: Vec<[f64; 3]> = (0..count).map(|from| excess(&at, from)).collect();
    let predicted: Vec<[f64; 3]> = (0..count).map(|from| excess(&|boundary| turned[boundary], from)).collect();
    let size = |of: &[[f64; 3]]| -> Vec<f64> { of.iter().map(|one| distance(*one, [0.0; 3])).collect() };
    let (seen_size, predicted_size) = (size(&seen), size(&predicted));
    let typical = |sizes: &[f64]| {
        let mut sorted = sizes.to_vec();
        let middle = sorted.len() / 2;
        // The median of a Rayleigh distribution is 1.18 standard deviations.
        *sorted.select_nth_unstable_by(middle, f64::total_cmp).1 / 1.18
    };
    let least = [typical(&seen_size), typical(&predicted_size)].map(|typical| (DEVIATIONS * typical).max(TILT_MIN));
    let mut found = Vec::new();
    for from in 0..count {
        let agree = distance(seen[from], predicted[from]) < 0.3 * seen_size[from];
        if !(agree && seen_size[from] > least[0] && predicted_size[from] > least[1]) {
            continue;
        }
        let near = from.saturating_sub(3 * length / 2)..(from + 3 * length / 2 + 1).min(count);
        if seen_size[near].iter().all(|other| *other <= seen_size[from]) {
            found.push(from + length..from + 2 * length);
        }
    }
    found
}

/// Returns the runs of `true`.
fn runs(of: &[bool]) -> Vec<Range<usize>> {
    let mut from = 0;
    let mut found = Vec::new();
    for run in of.chunk_by(|one, next| one == next) {
        if run.first() == Some(&true) {
            found.push(from..from + run.len());
        }
        from += run.len();
    }
    found
}

/// Returns motion with its guards, and with rests in between that are too short.
fn widened(moving: &[bool]) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = Vec::new();
    for run in runs(moving) {
        let mut run = run.start.saturating_sub(GUARD)..(run.end + GUARD).min(moving.len());
        if run.start < REST_MIN {
            run.start = 0;
        }
        if moving.len() - run.end < REST_MIN {
            run.end = moving.len();
        }
        match found.last_mut().filter(|last| run.start < last.end + REST_MIN) {
            Some(last) => last.end = last.end.max(run.end),
            None => found.push(run),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 40.0;

    /// Returns white noise of a VN-100 on a desk, with accel z at −g.
    fn at_rest(seconds: usize, seed: u64) -> [Vec<f64>; 6] {
        let mut state = seed;
        let mut uniform = || {
            state = 16_807 * state % 2_147_483_647;
            state as f64 / 2_147_483_647.0 - 0.5
        };
        let mut normal = || (0..12).map(|_| uniform()).sum::<f64>();
        std::array::from_fn(|axis| {
            let (sigma, level) = if axis < 3 { (7.6e-4, 2e-3) } else { (1.3e-2, 0.0) };
            let level = if axis == 5 { -9.8 } else { level };
            (0..seconds * 40).map(|_| level + sigma * normal()).collect()
        })
    }

    /// Returns the motion in s.
    fn moving(columns: &[Vec<f64>; 6]) -> Vec<(f64, f64)> {
        let samples = columns.iter().map(Vec::len).max().unwrap();
        let mut stillness = Stillness::new(RATE_HZ, samples as u64);
        // In pieces, as when reading.
        for from in (0..samples).step_by(777) {
            let to = samples.min(from + 777);
            stillness.push(from as u64, columns.each_ref().map(|column| column.get(from..to).unwrap_or_default()));
        }
        let s = |place: u64| place.min(samples as u64) as f64 / RATE_HZ;
        stillness.settle().unwrap().into_iter().map(|range| (s(range.start), s(range.end))).collect()
    }

    fn add(column: &mut [f64], change: impl Fn(f64) -> f64) {
        column.iter_mut().enumerate().for_each(|(i, value)| *value += change(i as f64 / RATE_HZ));
    }

    #[test]
    fn disturbances_of_a_sensor_at_rest_are_no_motion() {
        let tau = std::f64::consts::TAU;
        type Change = (&'static str, fn(f64) -> f64, f64);
        let changes: [Change; 5] = [
            ("nothing", |_| 0.0, 1.0),
            ("vibration", |t| (std::f64::consts::TAU * 13.38 * t).sin(), 20.0),
            ("a warm-up", |t| (-t / 300.0).exp(), 8.0),
            ("a step", |t| if t > 333.0 { 1.0 } else { 0.0 }, 1.0),
            ("knocks", |t| if t % 97.0 < 0.8 { 1.0 } else { 0.0 }, 500.0),
        ];
        for (name, change, size) in changes {
            let mut columns = at_rest(900, 7);
            for (axis, column) in columns.iter_mut().enumerate() {
                let unit = if axis < 3 { 1e-3 } else { 1e-2 };
                add(column, |t| size * unit * change(t));
            }
            assert_eq!(moving(&columns), [], "{name}");
        }
        let mut columns = at_rest(900, 8);
        columns.iter_mut().flatten().for_each(|value| *value = (*value / 0.02).round() * 0.02);
        add(&mut columns[0], |t| 2e-3 * (tau * 0.1 * t).sin());
        assert_eq!(moving(&columns), [], "coarse steps");
        columns[1].fill(0.0);
        columns[4].fill(f64::NAN);
        assert_eq!(moving(&columns), [], "dead and absent channels");
    }

    #[test]
    fn a_turn_is_found_with_its_guards_whichever_channels_there_are() {
        let turned = |t: f64| (t - 100.0).clamp(0.0, 3.0) * 0.035;
        for absent in [None, Some(0..3), Some(3..6)] {
            let mut columns = at_rest(300, 3);
            // Two degrees a second about x: gravity turns from z towards y.
            add(&mut columns[0], |t| if (100.0..103.0).contains(&t) { 0.035 } else { 0.0 });
            add(&mut columns[4], |t| -9.8 * turned(t).sin());
            add(&mut columns[5], |t| 9.8 * (1.0 - turned(t).cos()));
            for axis in absent.clone().into_iter().flatten() {
                columns[axis].fill(f64::NAN);
            }
            let found = moving(&columns);
            let [(from, to)] = found[..] else { panic!("{absent:?}: {found:?}") };
            assert!((97.0..=100.5).contains(&from) && (102.5..=106.0).contains(&to), "{absent:?}: {found:?}");
        }
        // A turn about the vertical does not change gravity's direction.
        let mut columns = at_rest(300, 4);
        add(&mut columns[2], |t| if (200.0..203.0).contains(&t) { -0.035 } else { 0.0 });
        assert_eq!(moving(&columns).len(), 1);
    }

    #[test]
    fn what_moves_for_most_of_its_time_is_divided_and_what_never_rests_moves_throughout() {
        let tau = std::f64::consts::TAU;
        let hand = |t: f64| 0.5 * (tau * 0.31 * t).sin() + 0.3 * (tau * 1.7 * t).cos();
        let moved = |rest: fn(f64) -> bool| {
            let mut columns = at_rest(300, 5);
            for (axis, column) in columns.iter_mut().enumerate() {
                let size = if axis < 3 { 0.5 } else { 2.0 };
                add(column, |t| if rest(t) { 0.0 } else { size * hand(t + axis as f64) });
            }
            moving(&columns)
        };
        let found = moved(|t| (120.0..180.0).contains(&t));
        let [(0.0, one), (two, 300.0)] = found[..] else { panic!("{found:?}") };
        assert!((one - 121.0).abs() < 2.0 && (two - 179.0).abs() < 2.0, "{found:?}");
        assert_eq!(moved(|_| false), [(0.0, 300.0)]);
    }

    /// A table that tilts by 3° within 200 s is motion if the rate shows the same turn; creep of the accelerometer is
    /// not.
    #[test]
    fn a_slow_tilt_counts_where_both_witnesses_agree() {
        let angle = |t: f64| 0.052 * ((t - 500.0) / 200.0).clamp(0.0, 1.0);
        let mut columns = at_rest(1800, 6);
        add(&mut columns[4], |t| -9.8 * angle(t).sin());
        assert_eq!(moving(&columns), [], "the accelerometer alone");
        add(&mut columns[0], |t| if (500.0..700.0).contains(&t) { 0.052 / 200.0 } else { 0.0 });
        let found = moving(&columns);
        let [(from, to)] = found[..] else { panic!("{found:?}") };
        assert!((440.0..560.0).contains(&from) && (640.0..760.0).contains(&to), "{found:?}");
    }

    /// If the clock jumps by four weeks, windows keep their length, and a turn of three seconds is found.
    #[test]
    fn a_clock_that_jumps_makes_no_window_longer() {
        let mut columns = at_rest(300, 10);
        add(&mut columns[2], |t| if (200.0..203.0).contains(&t) { 0.035 } else { 0.0 });
        let mut stillness = Stillness::new(RATE_HZ, 12_000);
        let jump = 4 * 7 * 86_400 * 40;
        for (range, place) in [(0..4000, 0), (4000..12_000, 4000 + jump)] {
            stillness.push(place, columns.each_ref().map(|column| &column[range.clone()]));
        }
        let found = stillness.settle().unwrap();
        assert_eq!(found.len(), 1, "{found:?}");
        let s = |place: u64| (place - jump) as f64 / RATE_HZ;
        assert!(
            (197.0..=200.5).contains(&s(found[0].start)) && (202.5..=206.0).contains(&s(found[0].end)),
            "{found:?}"
        );
    }

    #[test]
    fn values_beyond_any_measurement_are_counted() {
        let mut columns = at_rest(10, 11);
        columns[5].fill(16_384.0);
        columns[0][7] = f64::NAN;
        columns[0][8] = -1e9;
        let mut stillness = Stillness::new(RATE_HZ, 400);
        stillness.push(0, columns.each_ref().map(Vec::as_slice));
        assert_eq!(stillness.beyond(), [(1, 399), (0, 400), (0, 400), (0, 400), (0, 400), (400, 400)]);
    }

    #[test]
    fn an_empty_record_gets_no_verdict_and_a_record_in_gaps_is_judged_across_them() {
        assert_eq!(Stillness::new(40.0, 0).settle(), None);
        let columns = at_rest(200, 9);
        let mut stillness = Stillness::new(RATE_HZ, 8000);
        // Three samples of four, and a hole of a minute.
        for from in (0..8000).step_by(4).filter(|from| !(2000..4400).contains(from)) {
            stillness.push(from as u64, columns.each_ref().map(|column| &column[from..from + 3]));
        }
        assert_eq!(stillness.settle(), Some(Vec::new()));
    }
}
