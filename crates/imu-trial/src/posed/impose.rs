//! The imposed effects: what a sensor with additional effects would have shown of the same motion.
//!
//! A sensor shows P·x + b of what acts on its axes, with what the untouched part has: P from its scale factors and cross-axis
//! sensitivities, b its bias. The laws of [`crate::motion::impose`] act on x = P⁻¹·(values − b), smoothed over [`SMOOTHED_S`], and their
//! deviation is added to the values. So an imposed number is the change of the sensor's number, and the sensor's noise, which does not
//! come from the motion, is neither mixed nor scaled nor delayed. Where the sensor hardly moves, a latency changes nothing. At last the
//! values are rounded as the sensor rounds them, if its model has a resolution.

use super::part::{Numbers, Part};
use crate::motion::course::FINE;
use crate::motion::impose::{Imposed, shown};
use crate::motion::{Kind, TrueEffect};
use imu_core::sample::{Channel, Triad};
use imu_diagnosis::Recording;
use imu_model::simulator::{Motion, SensorModel};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

/// Time over which the motion is smoothed, s: short compared with the windows over which poses determine anything.
const SMOOTHED_S: f64 = 0.1;
/// Time on either side within which a sensor moves or not, s, and by how much it moves at least, rad/s and m/s².
const MOVES_S: f64 = 0.3;
const MOVES: [f64; 2] = [0.03, 0.15];

/// Returns the part with these effects.
pub fn impose(part: &Part, effects: &[TrueEffect]) -> Recording {
    let mut recording = part.recording.clone();
    let steps = steps(&part.model);
    for triad in [Triad::Gyro, Triad::Accel] {
        let own: Vec<Imposed> = effects
            .iter()
            .filter(|effect| effect.triad == triad.name())
            .map(|effect| Imposed { kind: effect.kind, triad, numbers: effect.numbers.clone() })
            .collect();
        let Some(numbers) = part.own.of(triad).filter(|_| !own.is_empty()) else { continue };
        let Some(values) = values_of(&recording, triad) else { continue };
        let changed = changed(triad, &values, numbers, recording.rate_hz, &own);
        for (channel, axis) in triad.channels().into_iter().zip(changed) {
            let step = steps.iter().find(|(own, _)| *own == channel).map(|(_, step)| *step);
            let column = recording.channels.iter_mut().find(|(own, _)| *own == channel);
            let rounded = axis.into_iter().map(|value| step.map_or(value, |step| (value / step).round() * step));
            if let Some((_, column)) = column {
                *column = rounded.collect();
            }
        }
    }
    let late_s = effects.iter().filter(|of| of.kind == Kind::Latency).filter_map(|of| of.numbers.first());
    let late = late_s.fold(0.0f64, |most, seconds| most.max(*seconds));
    without_support(&mut recording, late);
    recording
}

/// Returns the values of a triad.
fn values_of(recording: &Recording, triad: Triad) -> Option<Vec<Vector3<f64>>> {
    let [x, y, z] = triad.channels().map(|channel| recording.values(channel));
    let (x, y, z) = (x?, y?, z?);
    let mut last = Vector3::zeros();
    // A missing sample goes on with the last value: it shows nothing, but its neighbours are smoothed with it.
    let value = |place: usize| {
        let value = Vector3::new(x[place], y[place], z[place]);
        if !recording.is_missing(place) && value.iter().all(|of| of.is_finite()) {
            last = value;
        }
        last
    };
    Some((0..x.len()).map(value).collect())
}

fn changed(
    triad: Triad,
    values: &[Vector3<f64>],
    numbers: &Numbers,
    rate_hz: f64,
    effects: &[Imposed],
) -> [Vec<f64>; 3] {
    let known = |of: &[Option<super::Number>; 3]| of.map(|number| number.map_or(0.0, |number| number.value));
    let (scale, [xy, xz, yz], bias) =
        (known(&numbers.scale), known(&numbers.cross), Vector3::from(known(&numbers.bias)));
    let own = Matrix3::new(1.0 + scale[0], xy, xz, xy, 1.0 + scale[1], yz, xz, yz, 1.0 + scale[2]);
    let inverse = own.try_inverse().unwrap_or_else(Matrix3::identity);
    let felt: [Vec<f64>; 3] =
        std::array::from_fn(|axis| values.iter().map(|value| (inverse * (value - bias))[axis]).collect());
    let half = (0.5 * SMOOTHED_S * rate_hz).round().max(1.0) as usize;
    let motion = felt.each_ref().map(|values| smoothed(values, half));
    let others: Vec<Imposed> = effects.iter().filter(|effect| effect.kind != Kind::Latency).cloned().collect();
    let course = fine(triad, &motion);
    let late: Vec<Imposed> = effects.iter().filter(|effect| effect.kind == Kind::Latency).cloned().collect();
    let [still, delayed, with] =
        [&others[..], &late, effects].map(|effects| shown(triad, &course, rate_hz, effects, &[]));
    let moves = moves(&motion, (MOVES_S * rate_hz) as usize, MOVES[usize::from(triad == Triad::Accel)]);
    let at = |of: &[Vec<f64>; 3], place: usize| Vector3::from_fn(|axis, _| of[axis][place]);
    let mut axes: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(values.len()));
    for (place, is_moving) in moves.into_iter().enumerate().take(values.len()) {
        let (input, shown) = if is_moving { (&delayed, &with) } else { (&motion, &still) };
        let later = at(input, place) - at(&motion, place);
        let value = own * (at(&felt, place) + later) + bias + at(shown, place) - at(input, place);
        axes.iter_mut().zip(value.iter()).for_each(|(axis, value)| axis.push(*value));
    }
    axes
}

/// Returns a motion on the trial's fine grid: Catmull and Rom's cubic between the samples.
fn fine(triad: Triad, motion: &[Vec<f64>; 3]) -> Vec<Motion> {
    let last = motion[0].len().saturating_sub(1);
    let instant = |place: usize, t: f64| {
        let (t2, t3) = (t * t, t * t * t);
        let weights =
            [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2];
        let value: [f64; 3] = std::array::from_fn(|axis| {
            let at = |offset: usize| motion[axis][(place + offset).saturating_sub(1).min(last)];
            weights.iter().enumerate().map(|(offset, weight)| weight * at(offset)).sum()
        });
        match triad {
            Triad::Gyro => Motion { gyro_rad_s: value, ..Motion::default() },
            _ => Motion { accel_m_s2: value, ..Motion::default() },
        }
    };
    let steps = |place: usize| (0..FINE).map(move |step| (place, step as f64 / FINE as f64));
    (0..motion[0].len()).flat_map(steps).map(|(place, t)| instant(place, t)).collect()
}

/// Returns whether an axis moves by more than `least` within `reach` samples on either side.
fn moves(motion: &[Vec<f64>; 3], reach: usize, least: f64) -> Vec<bool> {
    let far = |values: &[f64]| {
        let ends = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), of| (l.min(*of), h.max(*of)));
        ends.1 - ends.0 > least
    };
    let count = motion[0].len();
    let within = |place: usize| place.saturating_sub(reach)..(place + reach + 1).min(count);
    (0..count).map(|place| motion.iter().any(|values| far(&values[within(place)]))).collect()
}

/// Returns the parabola through `half` values on either side, by least squares, at each value (Savitzky and Golay 1964); fewer at the ends.
fn smoothed(values: &[f64], half: usize) -> Vec<f64> {
    (0..values.len())
        .map(|place| {
            let reach = half.min(place).min(values.len() - 1 - place);
            if reach == 0 {
                return values[place];
            }
            let h = reach as f64;
            let all = (2.0 * h - 1.0) * (2.0 * h + 1.0) * (2.0 * h + 3.0) / 3.0;
            let sum: f64 = values[place - reach..=place + reach]
                .iter()
                .enumerate()
                .map(|(at, value)| (3.0 * h * h + 3.0 * h - 1.0 - 5.0 * (at as f64 - h).powi(2)) * value)
                .sum();
            sum / all
        })
        .collect()
}

/// Returns the steps to which a model's channels are rounded.
pub(super) fn steps(model: &SensorModel) -> Vec<(Channel, f64)> {
    let value = serde_json::to_value(model).unwrap_or_default();
    let step = |channel: &Channel| {
        let effects = value["channels"][channel.name()]["effects"].as_array()?;
        let resolution = effects.iter().find(|effect| effect["effect"] == "resolution")?;
        resolution["step"].as_f64().filter(|step| *step > 0.0).map(|step| (*channel, step))
    };
    model.channels.keys().filter_map(step).collect()
}

/// Marks as missing what a delay would take from a gap.
fn without_support(recording: &mut Recording, late_s: f64) {
    if late_s <= 0.0 {
        return;
    }
    let back = (late_s * recording.rate_hz).ceil() as usize + 2;
    let were: Vec<bool> = (0..recording.len()).map(|place| recording.is_missing(place)).collect();
    let mut since = usize::MAX - were.len();
    let missing: Vec<bool> = were
        .iter()
        .map(|gone| {
            since = if *gone { 0 } else { since + 1 };
            since <= back
        })
        .collect();
    if recording.time_s.len() != recording.len() && !recording.time_s.is_empty() {
        // A stamp for each sample that was present: those of samples that no longer are go.
        let present = (0..were.len()).filter(|place| !were[*place]);
        let stamps = present.zip(&recording.time_s).filter(|(place, _)| !missing[*place]);
        recording.time_s = stamps.map(|(_, stamp)| *stamp).collect();
    }
    recording.missing = if missing.contains(&true) { missing } else { Vec::new() };
}

/// Returns the names of an effect's parameters in a diagnosis.
pub(super) fn names(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::CrossAxisSensitivity => &["xy", "xz", "yz"],
        Kind::Latency => &["seconds"],
        _ => &["x", "y", "z"],
    }
}

/// Returns the ends of a parameter's interval, if the cause has one.
pub(super) fn ends(cause: &Value, triad: &str, name: &str) -> Option<[f64; 2]> {
    let of = &cause["uncertainty"][triad][name];
    Some([of[0].as_f64()?, of[1].as_f64()?])
}

#[cfg(test)]
mod tests {
    use super::super::{Number, Own};
    use super::*;

    /// Returns a part of a sensor with scale, cross-axis sensitivity and bias, and what acts on it.
    fn part(rate_hz: f64, later_s: f64) -> (Part, Matrix3<f64>, Vector3<f64>) {
        let own = Matrix3::new(1.01, 0.003, -0.002, 0.003, 0.99, 0.001, -0.002, 0.001, 1.02);
        let bias = Vector3::new(0.02, -0.01, 0.03);
        let number = |value| Some(Number { value, half: 1e-4 });
        let numbers = Numbers {
            scale: [number(0.01), number(-0.01), number(0.02)],
            cross: [number(0.003), number(-0.002), number(0.001)],
            bias: [number(0.02), number(-0.01), number(0.03)],
            latency: number(later_s),
        };
        let values: Vec<Vector3<f64>> =
            (0..400).map(|place| own * rate(place as f64 / rate_hz - later_s) + bias).collect();
        let channels = Triad::Gyro.channels().into_iter().enumerate();
        let channels = channels.map(|(axis, channel)| (channel, values.iter().map(|of| of[axis]).collect())).collect();
        let recording = Recording { rate_hz, channels, ..Recording::default() };
        let own_numbers = Own { gyro: numbers, ..Own::default() };
        (Part { recording, model: SensorModel::default(), own: own_numbers }, own, bias)
    }

    fn rate(t: f64) -> Vector3<f64> {
        Vector3::new((3.0 * t).sin(), 0.7 * (5.0 * t).cos(), 0.4 * (4.0 * t).sin())
    }

    fn effect(kind: Kind, numbers: &[f64]) -> TrueEffect {
        TrueEffect { kind, triad: "gyro".to_owned(), over_limit: 1.0, numbers: numbers.to_vec(), limit: 1.0 }
    }

    #[test]
    fn an_imposed_number_is_the_change_of_the_sensors_number() {
        let (part, own, bias) = part(100.0, 0.004);
        // A scale factor acts on what the axes mixed before.
        let scale = Matrix3::from_diagonal(&Vector3::new(0.05, -0.03, 0.0));
        let cross = Matrix3::new(0.0, 0.01, 0.0, 0.01, 0.0, 0.02, 0.0, 0.02, 0.0);
        let more = scale + cross + scale * cross;
        let late = [effect(Kind::Latency, &[0.0137])];
        let found = values_of(&impose(&part, &late), Triad::Gyro).unwrap();
        for (place, shown) in found.iter().enumerate().take(360).skip(40) {
            let off = shown - (own * rate(place as f64 / 100.0 - 0.0177) + bias);
            assert!(off.norm() < 1e-4, "{place} {off}");
        }
        let effects = [
            effect(Kind::ScaleFactor, &[0.05, -0.03, 0.0]),
            effect(Kind::CrossAxisSensitivity, &[0.01, 0.0, 0.02]),
            effect(Kind::Bias, &[0.1, 0.0, -0.2]),
            effect(Kind::Latency, &[0.0137]),
        ];
        let found = values_of(&impose(&part, &effects), Triad::Gyro).unwrap();
        let expected = |t: f64| (own + more) * rate(t - 0.004 - 0.0137) + bias + Vector3::new(0.1, 0.0, -0.2);
        for (place, shown) in found.iter().enumerate().take(380).skip(20) {
            let off = shown - expected(place as f64 / 100.0);
            assert!(off.norm() < 2e-4, "{place} {off}");
        }
    }

    #[test]
    fn what_a_delay_would_take_from_a_gap_is_missing_with_its_stamp() {
        let (mut part, ..) = part(100.0, 0.0);
        part.recording.missing = (0..400).map(|place| place == 200).collect();
        part.recording.time_s = (0..400).filter(|place| *place != 200).map(|place| place as f64 / 100.0).collect();
        let found = impose(&part, &[effect(Kind::Latency, &[0.02])]);
        let missing: Vec<usize> = (0..400).filter(|place| found.is_missing(*place)).collect();
        assert_eq!(missing, [200, 201, 202, 203, 204]);
        assert_eq!(found.time_s.len(), 395);
        assert_eq!(found.time_s[200], 2.05);
        assert_eq!(impose(&part, &[]), part.recording);
    }
}
