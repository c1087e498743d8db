//! Hints: differences whose size has a meaning (a unit, the root of the rate, a sign, exchanged axes), and differing
//! means.

use super::found::Found;
use super::report::{Hint, HintKind, Offset, Parameter};
use imu_core::sample::{Channel, Triad};
use imu_model::simulator::SensorModel;

/// Maximum distance of a ratio from a meaningful one, ln: a model is rarely nearer to its sensor than that.
const NEAR: f64 = 0.12;

/// Returns the meanings of a ratio of the capture's N over the model's on a triad.
fn meanings(triad: Triad, rate_hz: f64) -> Vec<(f64, HintKind, String)> {
    /// Standard gravity, m/s² (CGPM 1901).
    const G: f64 = 9.806_65;
    let degree = std::f64::consts::PI / 180.0;
    let root = rate_hz.sqrt();
    let by_rate = [
        (1.0 / root, "the model's value looks like the standard deviation of a sample: divide it by √rate"),
        (root, "the model's value looks like a density that was divided by √rate: multiply it by √rate"),
    ];
    let units = match triad {
        Triad::Accel => vec![
            (G, "the model's value looks like one in g/√Hz"),
            (1e-3 * G, "the model's value looks like one in mg/√Hz"),
            (1e-6 * G, "the model's value looks like one in µg/√Hz"),
            (1.0 / G, "the recording's values look like ones in g"),
            (1e3 / G, "the recording's values look like ones in mg"),
        ],
        Triad::Gyro => vec![
            (degree, "the model's value looks like one in °/s/√Hz"),
            (degree / 60.0, "the model's value looks like one in °/√h"),
            (degree / 3600.0, "the model's value looks like one in °/h/√Hz"),
            (1.0 / degree, "the recording's values look like ones in °/s"),
        ],
        Triad::Mag => vec![
            (1e4, "the model's value looks like one in T/√Hz"),
            (1e-2, "the model's value looks like one in µT/√Hz"),
            (1e-4, "the recording's values look like ones in T"),
            (1e2, "the recording's values look like ones in µT"),
        ],
        _ => Vec::new(),
    };
    let scales = [(1e3, "1000"), (1e-3, "1/1000"), (60.0, "60"), (1.0 / 60.0, "1/60")];
    let is_far = root.ln().abs() > 2.0 * NEAR;
    let by_rate =
        by_rate.into_iter().filter(|_| is_far).map(|(ratio, text)| (ratio, HintKind::SqrtRate, text.to_owned()));
    let units = units.into_iter().map(|(ratio, text)| (ratio, HintKind::Unit, text.to_owned()));
    let scales = scales.into_iter().map(|(ratio, name)| {
        (ratio, HintKind::Scale, format!("the recording's value is {name} times the model's: a prefix or a minute"))
    });
    by_rate.chain(units).chain(scales).collect()
}

/// Returns the possible meanings of the sizes of the differences.
pub(super) fn hints(found: &Found, sim: &SensorModel, parameters: &[Parameter], offsets: &[Offset]) -> Vec<Hint> {
    let mut hints = Vec::new();
    let triads = [Triad::Accel, Triad::Gyro, Triad::Mag];
    for triad in triads {
        hints.extend(of_ratios(triad, found, sim, parameters));
        hints.extend(of_axes(triad, found, sim, parameters));
        hints.extend(of_signs(triad, offsets));
    }
    hints
}

/// Returns hints for N of a triad's axes that are all off by the same meaningful ratio.
fn of_ratios(triad: Triad, found: &Found, sim: &SensorModel, parameters: &[Parameter]) -> Option<Hint> {
    let compared = || found.channels.iter().map(|of| of.prepared.channel).filter(|of| of.triad() == Some(triad));
    let ratio = |channel: Channel| {
        let own = parameters.iter().find(|of| of.parameter == "N" && of.channel == channel.name())?;
        own.ratio.filter(|ratio| *ratio > 0.0)
    };
    let logarithms: Option<Vec<f64>> = compared().map(|channel| Some(ratio(channel)?.ln())).collect();
    let logarithms = logarithms.filter(|of| !of.is_empty())?;
    let is = |(ratio, ..): &(f64, HintKind, String)| logarithms.iter().all(|of| (of - ratio.ln()).abs() < NEAR);
    let likely: Vec<(f64, HintKind, String)> = meanings(triad, sim.rate_hz).into_iter().filter(is).collect();
    let channels: Vec<&str> = compared().map(Channel::name).collect();
    let texts: Vec<&str> = likely.iter().map(|(.., text)| text.as_str()).collect();
    Some(Hint { about: format!("{} N", channels.join(", ")), kind: likely.first()?.1, text: texts.join("; or ") })
}

/// Returns hints for N of three axes that are those of the model in another order.
fn of_axes(triad: Triad, found: &Found, sim: &SensorModel, parameters: &[Parameter]) -> Option<Hint> {
    /// Maximum distance of the capture's N from the model's, ln; an exchanged axis is farther off by itself.
    const SAME: f64 = 0.05;
    const ORDERS: [[usize; 3]; 5] = [[1, 0, 2], [2, 1, 0], [0, 2, 1], [1, 2, 0], [2, 0, 1]];
    let channels = triad.channels();
    let of = |channel: Channel| found.channels.iter().find(|of| of.prepared.channel == channel);
    channels.into_iter().all(|channel| of(channel).is_some()).then_some(())?;
    let model = channels.map(|channel| sim.channels.get(&channel).map_or(0.0, |own| own.n));
    let capture: [f64; 3] = std::array::from_fn(|axis| {
        let own = parameters.iter().find(|of| of.parameter == "N" && of.channel == channels[axis].name());
        own.map_or(model[axis], |own| own.capture)
    });
    let apart = |axis: usize, other: usize| (capture[axis] / model[other]).ln().abs();
    let off = (0..3).filter(|axis| apart(*axis, *axis) > 3.0 * SAME).count();
    let order = ORDERS.into_iter().find(|order| (0..3).all(|axis| apart(axis, order[axis]) < SAME))?;
    (off >= 2).then_some(())?;
    let pairs = (0..3).filter(|axis| order[*axis] != *axis);
    let texts: Vec<String> =
        pairs.map(|axis| format!("{} is the model's {}", channels[axis], channels[order[axis]])).collect();
    Some(Hint { about: format!("{} N", triad.name()), kind: HintKind::Axes, text: texts.join(", ") })
}

/// Returns hints for means that are the model's with the other sign, or those of another axis.
fn of_signs(triad: Triad, offsets: &[Offset]) -> Vec<Hint> {
    /// Maximum deviation, as a part of a mean.
    const MISS: f64 = 0.1;
    let own: Vec<&Offset> =
        offsets.iter().filter(|of| triad.channels().iter().any(|channel| channel.name() == of.channel)).collect();
    let near = |one: f64, other: f64| (one - other).abs() < MISS * one.abs().max(other.abs());
    let mut hints = Vec::new();
    for of in &own {
        if near(of.capture, -of.model) {
            let text = "the recording's mean is the model's with the other sign".to_owned();
            hints.push(Hint { about: format!("{} mean", of.channel), kind: HintKind::Sign, text });
            continue;
        }
        let other = own.iter().find(|other| other.channel != of.channel && near(other.capture.abs(), of.model.abs()));
        if let Some(other) = other.filter(|_| of.model.abs() > of.explained) {
            let text = format!("the mean that the model has on {} is on {}", of.channel, other.channel);
            hints.push(Hint { about: format!("{} mean", of.channel), kind: HintKind::Axes, text });
        }
    }
    hints
}

/// Returns means that differ from the model's by more than turn-on bias and, for an accelerometer or a magnetometer,
/// the pose explain.
pub(super) fn offsets(found: &Found, sim: &SensorModel) -> Vec<Offset> {
    /// The possible bias of a sensor after it is switched on: 1 °/s and 30 mg, more than the data sheets of industrial sensors
    /// have (VN-100: 5°/h and 0.04 mg in run; BMI088: 1 °/s and 20 mg), and 0.1 gauss for iron beside it.
    const TURN_ON: [(Triad, f64); 3] = [(Triad::Gyro, 0.0175), (Triad::Accel, 0.3), (Triad::Mag, 0.1)];
    let mut offsets = Vec::new();
    for (triad, explained) in TURN_ON {
        let stated: Vec<Offset> = found
            .channels
            .iter()
            .filter(|of| of.prepared.channel.triad() == Some(triad))
            .filter_map(|of| {
                let model = sim.channels.get(&of.prepared.channel)?.bias?;
                let channel = of.prepared.channel.name().to_owned();
                Some(Offset { channel, model, capture: of.level, explained })
            })
            .collect();
        let length = |of: fn(&Offset) -> f64| stated.iter().map(|one| of(one).powi(2)).sum::<f64>().sqrt();
        let is_whole = stated.len() == 3;
        let lengths = [length(|of| of.model), length(|of| of.capture)];
        let is_as_long = (lengths[0] - lengths[1]).abs() <= explained.max(0.05 * lengths[0]);
        // A table is a little out of level, and north may lie in any direction. One axis shows at most the whole of
        // gravity.
        let is_posed = |of: &Offset| match triad {
            Triad::Accel if is_whole => is_as_long && !turned(&stated),
            Triad::Accel => of.capture.abs().max(of.model.abs()) <= 9.806_65 + explained,
            Triad::Mag => is_as_long || !is_whole,
            _ => false,
        };
        let differs = |of: &&Offset| (of.capture - of.model).abs() > explained && !is_posed(of);
        offsets.extend(stated.iter().filter(differs).cloned());
    }
    offsets
}

/// Returns whether a triad's mean points elsewhere by more than a table may be out of level.
fn turned(stated: &[Offset]) -> bool {
    /// Cosine of 20°.
    const TABLE: f64 = 0.94;
    let product = |one: fn(&Offset) -> f64, other: fn(&Offset) -> f64| -> f64 {
        stated.iter().map(|of| one(of) * other(of)).sum()
    };
    let (model, capture) = (|of: &Offset| of.model, |of: &Offset| of.capture);
    let lengths = (product(model, model) * product(capture, capture)).sqrt();
    lengths > 0.0 && product(model, capture) < TABLE * lengths
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::round_trip::{CHANNELS, model, recording};
    use crate::{Diagnosis, Options, diagnose};

    fn with(change: impl Fn(usize, &mut imu_model::simulator::ChannelModel)) -> Diagnosis {
        let mut off = model(None);
        for (axis, channel) in CHANNELS.into_iter().enumerate() {
            off.channels.entry(channel).and_modify(|own| change(axis, own));
        }
        diagnose(&recording(&model(None), 3, 16_000), &off, &Options::default()).unwrap().diagnosis
    }

    #[test]
    fn ratios_that_mean_something_are_recognised() {
        for (factor, kind, text) in [
            (40f64.sqrt(), HintKind::SqrtRate, "standard deviation of a sample"),
            (1.0 / 40f64.sqrt(), HintKind::SqrtRate, "multiply it by √rate"),
            (1.0 / 9.806_65, HintKind::Unit, "in g/√Hz"),
            (1000.0 / 9.806_65, HintKind::Unit, "in mg/√Hz"),
            (9.806_65, HintKind::Unit, "ones in g"),
        ] {
            let found = with(|_, own| (own.n, own.b, own.k) = (own.n * factor * 1.03, own.b * factor, own.k * factor));
            let [hint] = &found.hints[..] else { panic!("{factor}: {:#?} {:#?}", found.hints, found.parameters) };
            assert_eq!((hint.kind, hint.about.as_str()), (kind, "accel_x, accel_y, accel_z N"));
            assert!(hint.text.contains(text) && found.summary.contains(text), "{factor}: {}", found.summary);
            assert!(found.summary.contains("accel_x, accel_y, accel_z N is"), "{}", found.summary);
        }
        let plain = with(|_, own| own.n *= 1.3);
        assert!(plain.hints.is_empty() && plain.parameters.len() == 3, "{plain:#?}");
    }

    #[test]
    fn axes_and_signs_that_are_exchanged_are_recognised() {
        // The model's axes have N in the ratio 1 : 2 : 3, the sensor's in the ratio 3 : 2 : 1.
        let mut sensor = model(None);
        let mut declared = model(None);
        for (axis, channel) in CHANNELS.into_iter().enumerate() {
            sensor.channels.entry(channel).and_modify(|own| own.n *= [3.0, 2.0, 1.0][axis]);
            declared.channels.entry(channel).and_modify(|own| own.n *= [1.0, 2.0, 3.0][axis]);
        }
        let found = diagnose(&recording(&sensor, 4, 16_000), &declared, &Options::default()).unwrap().diagnosis;
        let [hint] = &found.hints[..] else { panic!("{:#?}", found.hints) };
        assert_eq!(hint.kind, HintKind::Axes);
        assert_eq!(hint.text, "accel_x is the model's accel_z, accel_z is the model's accel_x");

        let turned = with(|axis, own| own.bias = Some([0.3, -0.1, 9.8][axis]));
        let [offset] = &turned.offsets[..] else { panic!("{:#?}", turned.offsets) };
        assert!(offset.channel == "accel_z" && (offset.capture + 9.8).abs() < 0.01 && offset.model == 9.8);
        assert_eq!(turned.hints.iter().map(|hint| hint.kind).collect::<Vec<_>>(), [HintKind::Sign]);
        assert!(turned.summary.starts_with("the mean of accel_z is -9.79"), "{}", turned.summary);

        let exchanged = with(|axis, own| own.bias = Some([-9.8, -0.1, 0.3][axis]));
        assert!(exchanged.hints.iter().any(|hint| hint.kind == HintKind::Axes), "{:#?}", exchanged.hints);
        // A difference that a table and a turn-on bias explain is not reported.
        let tilted = with(|axis, own| own.bias = Some([0.1, 0.2, -9.8][axis]));
        assert!(tilted.offsets.is_empty(), "{:#?}", tilted.offsets);
    }
}
