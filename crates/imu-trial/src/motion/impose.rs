//! The response of a device to a motion, with effects of every kind. The code is separate from the simulator's.
//!
//! In the order of docs/formats.md: latency, mixing of axes, scale factor, level; then noise, bandwidth and limit. Each
//! stage acts on the output of the one before.

use super::course::FINE;
use super::kind::Kind;
use imu_core::sample::Triad;
use imu_model::simulator::Motion;

/// Full scale to which nonlinearities refer: ±2000 °/s and ±16 g.
pub const FULL_SCALE: [f64; 2] = [34.906_585, 156.906_4];
/// Half width of a play, as a part of the largest input.
const PLAY: f64 = 0.15;
/// Time constant of a creep, s.
const CREEP_S: f64 = 4.0;
/// Time over which the mean square of a vibration is taken, s.
const VIBRATION_S: f64 = 1.0;
/// Half width of a dead band over the effect's number.
const BAND: f64 = 1.0;

/// Returns the full scale of a triad.
pub fn full_scale(triad: Triad) -> f64 {
    FULL_SCALE[usize::from(triad == Triad::Accel)]
}

/// An effect on a triad with its numbers: x, y, z; xy, xz, yz; rows of a matrix; seconds; a range; a cutoff.
#[derive(Debug, Clone, PartialEq)]
pub struct Imposed {
    /// The kind.
    pub kind: Kind,
    /// The triad.
    pub triad: Triad,
    /// The numbers of the effect.
    pub numbers: Vec<f64>,
}

impl Imposed {
    fn number(&self, place: usize) -> f64 {
        self.numbers.get(place).copied().unwrap_or_default()
    }
}

/// Returns the input of a triad at an instant of the fine grid, `back` instants earlier, along the cubic between them.
fn felt(course: &[Motion], instant: usize, back: f64) -> Motion {
    let last = course.len() - 1;
    let place = (instant as f64 - back).clamp(0.0, last as f64);
    let (whole, share) = (place.floor() as usize, place.fract());
    if share == 0.0 {
        return course[whole];
    }
    // Catmull and Rom's cubic, which differs from the library's.
    let at = |offset: i64| &course[(whole as i64 + offset).clamp(0, last as i64) as usize];
    let (t, t2, t3) = (share, share * share, share * share * share);
    let weights =
        [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2];
    let mut sum = Motion::default();
    for (weight, motion) in weights.into_iter().zip([at(-1), at(0), at(1), at(2)]) {
        for axis in 0..3 {
            sum.gyro_rad_s[axis] += weight * motion.gyro_rad_s[axis];
            sum.accel_m_s2[axis] += weight * motion.accel_m_s2[axis];
        }
    }
    sum
}

/// Returns the output of a triad for a course at each sample, before noise; `warmth_c` is the temperature about its
/// mean.
pub fn shown(triad: Triad, course: &[Motion], rate_hz: f64, effects: &[Imposed], warmth_c: &[f64]) -> [Vec<f64>; 3] {
    let own: Vec<&Imposed> = effects.iter().filter(|effect| effect.triad == triad).collect();
    let of = |kind: Kind| own.iter().copied().filter(move |effect| effect.kind == kind);
    let late_s: f64 = of(Kind::Latency).map(|effect| effect.number(0)).sum();
    let samples = course.len() / FINE;
    let motions: Vec<Motion> = (0..samples).map(|t| felt(course, FINE * t, late_s * rate_hz * FINE as f64)).collect();
    let input = |motion: &Motion| if triad == Triad::Gyro { motion.gyro_rad_s } else { motion.accel_m_s2 };
    let largest = motions.iter().flat_map(&input).fold(0.0f64, |most, value| most.max(value.abs()));
    let mut dragged = motions.first().map_or([0.0; 3], input);
    let mut follows = dragged;
    let share = 1.0 - (-1.0 / (CREEP_S * rate_hz)).exp();
    let mut last = motions.first().map_or([0.0; 3], |motion| motion.gyro_rad_s);
    let shaken = shaken(&motions, rate_hz);
    let mut axes: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(samples));
    for (t, motion) in motions.iter().enumerate() {
        let (truth, force) = (input(motion), motion.accel_m_s2);
        let mut mixed = truth;
        for effect in of(Kind::Misalignment) {
            let [x, y, z] = [0, 1, 2].map(|place| effect.number(place));
            mixed[0] += y * truth[2] - z * truth[1];
            mixed[1] += z * truth[0] - x * truth[2];
            mixed[2] += x * truth[1] - y * truth[0];
        }
        for effect in of(Kind::CrossAxisSensitivity) {
            let [xy, xz, yz] = [0, 1, 2].map(|place| effect.number(place));
            mixed[0] += xy * truth[1] + xz * truth[2];
            mixed[1] += xy * truth[0] + yz * truth[2];
            mixed[2] += xz * truth[0] + yz * truth[1];
        }
        for effect in of(Kind::LeverArm) {
            let arm = [0, 1, 2].map(|place| effect.number(place));
            let spin: [f64; 3] = std::array::from_fn(|axis| (motion.gyro_rad_s[axis] - last[axis]) * rate_hz);
            let inward = cross(motion.gyro_rad_s, cross(motion.gyro_rad_s, arm));
            let across = cross(spin, arm);
            (0..3).for_each(|axis| mixed[axis] += inward[axis] + across[axis]);
        }
        last = motion.gyro_rad_s;
        for axis in 0..3 {
            let value = mixed[axis];
            dragged[axis] = dragged[axis].clamp(truth[axis] - PLAY * largest, truth[axis] + PLAY * largest);
            follows[axis] += share * (truth[axis] - follows[axis]);
            let mut scaled = value;
            for effect in &own {
                let number = effect.number(axis);
                scaled += match effect.kind {
                    Kind::ScaleFactor => number * value,
                    Kind::UnsignedNonlinearity => number * value * value / full_scale(triad),
                    Kind::SignedNonlinearity => number * value * value.abs() / full_scale(triad),
                    Kind::TemperatureScale => number * value * warmth_c.get(t).copied().unwrap_or_default(),
                    Kind::Hysteresis => number * (dragged[axis] - truth[axis]),
                    Kind::Creep => number * (follows[axis] - truth[axis]),
                    Kind::DeadBand => -value.clamp(-BAND * number.abs(), BAND * number.abs()),
                    _ => 0.0,
                };
            }
            for effect in &own {
                scaled += match effect.kind {
                    Kind::Bias => effect.number(axis),
                    Kind::Rectification => effect.number(axis) * shaken[t][axis],
                    Kind::TemperatureBias => effect.number(axis) * warmth_c.get(t).copied().unwrap_or_default(),
                    Kind::GSensitivity => (0..3).map(|of| effect.number(3 * axis + of) * force[of]).sum(),
                    _ => 0.0,
                };
            }
            axes[axis].push(scaled);
        }
    }
    axes
}

/// Returns the mean square of the vibration along each axis: exponentially weighted, of the force less its weighted mean.
fn shaken(motions: &[Motion], rate_hz: f64) -> Vec<[f64; 3]> {
    let kept = (-1.0 / (VIBRATION_S * rate_hz)).exp();
    let mut mean = motions.first().map_or([0.0; 3], |motion| motion.accel_m_s2);
    let mut square = [0.0; 3];
    // Of each interval, what is halfway between its ends.
    let (mut force_before, mut beyond_before) = (mean, [0.0; 3]);
    motions
        .iter()
        .map(|motion| {
            for axis in 0..3 {
                let force = motion.accel_m_s2[axis];
                mean[axis] = kept * mean[axis] + (1.0 - kept) * 0.5 * (force_before[axis] + force);
                let beyond = (force - mean[axis]).powi(2);
                square[axis] = kept * square[axis] + (1.0 - kept) * 0.5 * (beyond_before[axis] + beyond);
                (force_before[axis], beyond_before[axis]) = (force, beyond);
            }
            square
        })
        .collect()
}

/// Applies bandwidth and limit to the output with its noise.
pub fn behind(values: &mut [f64], triad: Triad, rate_hz: f64, effects: &[Imposed]) {
    for effect in effects.iter().filter(|effect| effect.triad == triad) {
        match effect.kind {
            Kind::LowPass => low_pass(values, effect.number(0), rate_hz),
            Kind::Saturation => {
                let range = effect.number(0);
                values.iter_mut().for_each(|value| *value = value.clamp(-range, range));
            }
            _ => {}
        }
    }
}

/// Applies a first-order low pass: the bilinear transform with its cutoff at the requested frequency.
fn low_pass(values: &mut [f64], cutoff_hz: f64, rate_hz: f64) {
    let warped = (std::f64::consts::PI * cutoff_hz / rate_hz).tan();
    let (gain, back) = (warped / (1.0 + warped), (1.0 - warped) / (1.0 + warped));
    let Some(first) = values.first().copied() else { return };
    let (mut before, mut out) = (first, first);
    for value in values.iter_mut() {
        out = gain * (*value + before) + back * out;
        before = *value;
        *value = out;
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::triad::{Bias, CrossAxisSensitivity, GSensitivity, Misalignment, ScaleFactor};
    use imu_model::effects::triad::{Drive, Rectification, ScaleFactorNonlinearity, TemperatureScale, Vibration};
    use imu_model::effects::{LowPass, Stream, StreamId, TriadEffect};

    fn effects_with_memory_or_temperature_are_the_documented_ones() {
        let at = |t: usize| Motion {
            gyro_rad_s: [(0.02 * t as f64).sin(), 0.5, -1.0],
            accel_m_s2: [4.0 * (1.9 * t as f64).sin(), 0.3 * (0.05 * t as f64).cos(), -9.8],
            temperature_c: None,
        };
        let course: Vec<Motion> = (0..300 * FINE).map(|instant| at(instant / FINE)).collect();
        let warmth_c: Vec<f64> = (0..300).map(|t| 0.1 * f64::from(t)).collect();
        let numbers = vec![1e-3, -2e-3, 3e-3];
        let axes = [1e-3, -2e-3, 3e-3];
        let pairs: [(Kind, Box<dyn TriadEffect>); 2] = [
            (Kind::Rectification, Box::new(Rectification { axes })),
            (Kind::TemperatureScale, Box::new(TemperatureScale { axes, reference_c: 20.0 })),
        ];
        for (kind, effect) in pairs {
            let imposed = Imposed { kind, triad: Triad::Gyro, numbers: numbers.clone() };
            let found = shown(Triad::Gyro, &course, 40.0, &[imposed], &warmth_c);
            let mut vibration = Vibration::new(40.0);
            for t in 0..300 {
                let motion = at(t);
                let more = effect.deviation(Drive {
                    input: motion.gyro_rad_s,
                    accel_m_s2: motion.accel_m_s2,
                    vibration_m2_s4: vibration.next(motion.accel_m_s2),
                    temperature_c: Some(20.0 + warmth_c[t]),
                });
                for axis in 0..3 {
                    assert!((found[axis][t] - motion.gyro_rad_s[axis] - more[axis]).abs() < 1e-12, "{kind} {t}");
                }
            }
        }
    }

    /// This code and the library's are independent and must describe the same physics.
    #[test]
    fn effects_are_the_documented_ones() {
        let motion = Motion { gyro_rad_s: [1.0, -2.0, 0.5], accel_m_s2: [3.0, 1.0, -9.0], temperature_c: None };
        let course = vec![motion; 8 * FINE];
        let numbers = |kind: Kind| -> Vec<f64> {
            (0..kind.numbers().unwrap_or(1)).map(|place| 1e-3 * (place as f64 - 1.3)).collect()
        };
        let axes = |kind: Kind| [0, 1, 2].map(|place| numbers(kind)[place]);
        let m = numbers(Kind::GSensitivity);
        let [xy, xz, yz] = axes(Kind::CrossAxisSensitivity);
        let nonlinear = |signed| ScaleFactorNonlinearity {
            axes: axes(Kind::SignedNonlinearity),
            full_scale: full_scale(Triad::Gyro),
            signed,
        };
        let pairs: [(Kind, Box<dyn TriadEffect>); 7] = [
            (Kind::Bias, Box::new(Bias { axes: axes(Kind::Bias) })),
            (Kind::ScaleFactor, Box::new(ScaleFactor { axes: axes(Kind::ScaleFactor) })),
            (Kind::Misalignment, Box::new(Misalignment { rotation: axes(Kind::Misalignment) })),
            (Kind::CrossAxisSensitivity, Box::new(CrossAxisSensitivity { xy, xz, yz })),
            (Kind::SignedNonlinearity, Box::new(nonlinear(true))),
            (Kind::UnsignedNonlinearity, Box::new(nonlinear(false))),
            (
                Kind::GSensitivity,
                Box::new(GSensitivity { m: [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]] }),
            ),
        ];
        for (kind, effect) in pairs {
            let imposed = Imposed { kind, triad: Triad::Gyro, numbers: numbers(kind) };
            let found = shown(Triad::Gyro, &course, 40.0, &[imposed], &[]);
            let more =
                effect.deviation(Drive { input: motion.gyro_rad_s, accel_m_s2: motion.accel_m_s2, ..Drive::default() });
            for axis in 0..3 {
                assert!((found[axis][5] - motion.gyro_rad_s[axis] - more[axis]).abs() < 1e-12, "{kind}");
            }
        }
        effects_with_memory_or_temperature_are_the_documented_ones();
        let mut values: Vec<f64> = (0..200).map(|t| (0.1 * f64::from(t)).sin()).collect();
        let mut other = values.clone();
        low_pass(&mut values, 5.0, 40.0);
        let stream = Stream::new(0, StreamId { owner: 0, effect: 0, instance: 0 });
        imu_model::effects::Effect::sampler(&LowPass::new(5.0, 1), 40.0, 5.0, stream).apply(&mut other);
        assert!(values.iter().zip(&other).all(|(one, other)| (one - other).abs() < 1e-12));
    }
}
