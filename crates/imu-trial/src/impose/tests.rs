//! Imposed effects have the stated properties: statistics of the changes to samples.

use super::*;
use crate::class::Sense;
use crate::columns::Column;
use crate::ground::TemperatureCourse;
use crate::setting::Part;
use std::f64::consts::TAU;

const RATE: f64 = 53.7;
const SAMPLES: usize = 70_001;

fn setting() -> Setting {
    let part = |channel| Part {
        channel,
        level: 0.3,
        true_nbk: [2.0 / RATE.sqrt(), 0.01, 1e-3],
        declared_nbk: [2.0 / RATE.sqrt(), 0.01, 1e-3],
        declared_bias: None,
    };
    Setting {
        rate_hz: RATE,
        samples: SAMPLES,
        parts: [Channel::AccelX, Channel::AccelY, Channel::GyroZ].map(part).to_vec(),
        temperature: Some(TemperatureCourse { start_c: 20.0, rise_c: 8.0, settles: 0.2, wander_c: 1.0 }),
        stamps: Some(crate::stamps::Stamps::exact(7.0)),
        own: Default::default(),
    }
}

/// Returns white noise of standard deviation 2 about 0.3.
fn white() -> Columns {
    let mut draw = Draw::capture(1, 1, 1, "white");
    let column = |part: &Part| {
        let mut draw = draw.split();
        let white: Vec<f64> = (0..SAMPLES).map(|_| 2.0 * draw.normal()).collect();
        Column { channel: part.channel, values: white.iter().map(|one| 0.3 + one).collect(), white, scale: 2.0 }
    };
    let setting = setting();
    let columns = setting.parts.iter().map(column).collect();
    let temperature_c = setting.temperature.unwrap().samples(SAMPLES, &mut draw);
    let time_s = (0..SAMPLES).map(|i| 7.0 + i as f64 / RATE).collect();
    Columns { rate_hz: RATE, columns, temperature_c, missing: Vec::new(), time_s }
}

/// Returns the effect, the columns with it, and the change on its first channel.
fn imposed(kind: Kind, seed: u64) -> (Effect, Columns, Vec<f64>) {
    let before = white();
    let draws = |purpose| Draw::device(seed, 5, purpose);
    let effect = Effect::draw(kind, &setting(), Role::ALONE, draws("device"), draws("events")).unwrap();
    let mut after = before.clone();
    effect.impose(&mut after, &mut draws("noise"));
    let place = before.columns.iter().position(|column| column.channel == effect.channels[0]).unwrap();
    let change = |(now, then): (&f64, &f64)| now - then;
    let changed = after.columns[place].values.iter().zip(&before.columns[place].values).map(change).collect();
    (effect, after, changed)
}

fn parameter(effect: &Effect, name: &str) -> f64 {
    effect.parameters[effect.channels[0].name()][name].as_f64().unwrap()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// Returns the amplitude of a line at a frequency.
fn amplitude(values: &[f64], frequency_hz: f64) -> f64 {
    let at = |i: usize| TAU * (frequency_hz / RATE * i as f64).fract();
    let (mut re, mut im) = (0.0, 0.0);
    for (i, value) in values.iter().enumerate() {
        re += value * at(i).cos();
        im += value * at(i).sin();
    }
    2.0 * re.hypot(im) / values.len() as f64
}

#[test]
fn every_kind_changes_its_channels_and_no_other_and_gives_numbers() {
    let before = white();
    for kind in Kind::all() {
        for seed in 0..6 {
            let (effect, after, _) = imposed(kind, seed);
            for (then, now) in before.columns.iter().zip(&after.columns) {
                let named = effect.channels.contains(&then.channel);
                assert!(now.values.iter().all(|value| value.is_finite()), "{kind} on {}", then.channel);
                let changed = now.values != then.values || after.time_s != before.time_s;
                assert_eq!(changed, named, "{kind} with seed {seed} on {}", then.channel);
            }
            assert_eq!(effect.parameters.len(), effect.channels.len(), "{kind}");
            let most = if kind == Kind::BiasStep { 3_000.0 } else { 101.0 };
            assert!((0.1..most).contains(&effect.over_limit), "{kind} {}", effect.over_limit);
        }
    }
}

#[test]
fn what_is_stated_of_an_effect_is_read_by_the_library() {
    use imu_model::effects::CHANNEL;
    for kind in Kind::LIBRARY.iter().copied() {
        // A saturation's limits follow from the samples.
        if kind == Kind::Saturation {
            continue;
        }
        let (effect, ..) = imposed(kind, 3);
        for stated in effect.parameters.values() {
            for one in stated.as_array().cloned().unwrap_or_else(|| vec![stated.clone()]) {
                let found = CHANNEL.iter().find(|of| Some(of.spec.kind) == kind.effect()).unwrap();
                let read = found.read(one.as_object().unwrap()).unwrap();
                assert_eq!(read.check(RATE), Ok(()), "{kind}");
            }
        }
    }
}

#[test]
fn a_size_is_drawn_between_half_and_a_hundred_times_the_limit() {
    let over: Vec<f64> = (0..200).map(|seed| imposed_size(seed).over_limit).collect();
    assert!(over.iter().all(|over| (0.5..100.0).contains(over)));
    let below = over.iter().filter(|over| **over < 50.0_f64.sqrt()).count();
    assert!((80..120).contains(&below), "{below} of 200 below the middle");
}

fn imposed_size(seed: u64) -> Effect {
    let draws = |purpose| Draw::device(seed, 5, purpose);
    Effect::draw(Kind::RateRamp, &setting(), Role::ALONE, draws("device"), draws("events")).unwrap()
}

#[test]
fn courses_of_the_level_are_as_stated() {
    let (effect, _, changed) = imposed(Kind::RateRamp, 1);
    let slope = (changed[SAMPLES - 1] - changed[0]) / (SAMPLES - 1) as f64 * RATE;
    assert!((slope / parameter(&effect, "R") - 1.0).abs() < 1e-9);

    let (effect, after, changed) = imposed(Kind::TemperatureBias, 1);
    for i in [0, 9_999, SAMPLES - 1] {
        let expected = parameter(&effect, "per_c") * (after.temperature_c[i] - parameter(&effect, "reference_c"));
        assert!((changed[i] - expected).abs() < 1e-9);
    }

    let (effect, _, changed) = imposed(Kind::WarmUp, 1);
    let tau = (parameter(&effect, "tau_s") * RATE) as usize;
    assert!((changed[0] / parameter(&effect, "amplitude") - 1.0).abs() < 1e-9);
    assert!((changed[tau] / changed[0] - (-1.0_f64).exp()).abs() < 1e-3);

    let (effect, _, changed) = imposed(Kind::BiasStep, 1);
    let steps = effect.parameters[effect.channels[0].name()].as_array().unwrap().clone();
    let sum: f64 = steps.iter().map(|step| step["size"].as_f64().unwrap()).sum();
    assert!((changed[SAMPLES - 1] - sum).abs() < 1e-9 && changed[0] == 0.0);
}

#[test]
fn lines_stand_where_stated() {
    let (effect, _, changed) = imposed(Kind::Tone, 1);
    let found = amplitude(&changed, parameter(&effect, "frequency_hz"));
    assert!((found / parameter(&effect, "amplitude") - 1.0).abs() < 0.02, "{found}");
    let bins = parameter(&effect, "frequency_hz") / RATE * SAMPLES as f64;
    assert!((bins - bins.round()).abs() > 1e-4, "a line on a bin");

    let (effect, _, changed) = imposed(Kind::Comb, 1);
    let entry = &effect.parameters[effect.channels[0].name()];
    let fundamental = entry["fundamental_hz"].as_f64().unwrap();
    for (harmonic, expected) in (1..).zip(entry["amplitudes"].as_array().unwrap()) {
        let found = amplitude(&changed, f64::from(harmonic) * fundamental);
        assert!((found / expected.as_f64().unwrap() - 1.0).abs() < 0.03, "harmonic {harmonic}: {found}");
    }
}

#[test]
fn noise_has_its_size_and_time_constant() {
    let (effect, _, changed) = imposed(Kind::QuantizationNoise, 1);
    let expected = parameter(&effect, "Q") * RATE * 2.0_f64.sqrt();
    assert!((rms(&changed) / expected - 1.0).abs() < 0.02);

    let sizes = |kind: Kind| {
        let ratio = |seed| {
            let (effect, _, changed) = imposed(kind, seed);
            (rms(&changed) / parameter(&effect, "sigma")).powi(2)
        };
        (0..30).map(ratio).sum::<f64>() / 30.0
    };
    assert!((sizes(Kind::Resonance) - 1.0).abs() < 0.05);
    assert!((sizes(Kind::GaussMarkov) - 1.0).abs() < 0.15);

    let (effect, _, changed) = imposed(Kind::GaussMarkov, 2);
    let lag = (parameter(&effect, "tc_s") * RATE).round() as usize;
    let product: f64 = changed.iter().zip(&changed[lag..]).map(|(one, other)| one * other).sum();
    let correlation = product / (SAMPLES - lag) as f64 / rms(&changed).powi(2);
    assert!((correlation - (-1.0_f64).exp()).abs() < 0.15, "{correlation}");
}

#[test]
fn a_resonance_is_as_wide_as_stated() {
    // Density by lines: at half the bandwidth from the middle it is half of that in the middle.
    let mut power = [0.0, 0.0];
    for seed in 0..60 {
        let (effect, _, changed) = imposed(Kind::Resonance, seed);
        let (middle, width) = (parameter(&effect, "frequency_hz"), parameter(&effect, "bandwidth_hz"));
        for chunk in changed.chunks_exact(10_000) {
            power[0] += (amplitude(chunk, middle) / parameter(&effect, "sigma")).powi(2) * width;
            let side =
                0.5 * (amplitude(chunk, middle - 0.5 * width).powi(2) + amplitude(chunk, middle + 0.5 * width).powi(2));
            power[1] += side / parameter(&effect, "sigma").powi(2) * width;
        }
    }
    let ratio = power[1] / power[0];
    assert!((ratio - 0.5).abs() < 0.12, "{ratio}");
}

#[test]
fn filters_leave_half_the_power_at_their_corner() {
    for order in [1, 2] {
        let setting = Setting { parts: setting().parts[..1].to_vec(), ..setting() };
        let find = |seed: u64| {
            let draws = |purpose| Draw::device(seed, 9, purpose);
            Effect::draw(Kind::LowPass, &setting, Role::ALONE, draws("device"), draws("events")).unwrap()
        };
        let effect = (0..).map(find).find(|effect| parameter(effect, "order") == f64::from(order)).unwrap();
        let corner = parameter(&effect, "cutoff_hz");
        let mut columns = white();
        for (i, value) in columns.columns[0].values.iter_mut().enumerate() {
            *value = 1e3 * (TAU * corner / RATE * i as f64).cos();
        }
        effect.impose(&mut columns, &mut Draw::device(1, 1, "noise"));
        let gain = (amplitude(&columns.columns[0].values, corner) / 1e3).powi(2);
        assert!((gain - 0.5).abs() < 0.01, "order {order}: {gain}");
    }
}

#[test]
fn events_come_as_often_and_where_stated() {
    let (effect, _, changed) = imposed(Kind::Spikes, 4);
    let expected = parameter(&effect, "rate_hz") / RATE * SAMPLES as f64;
    let count = changed.iter().filter(|change| **change != 0.0).count() as f64;
    assert!((count - expected).abs() < 4.0 * expected.sqrt() + 1.0, "{count} for {expected}");
    let size = parameter(&effect, "amplitude");
    assert!(
        changed.iter().filter(|change| **change != 0.0).all(|change| (0.59..1.41).contains(&(change.abs() / size)))
    );

    let (effect, _, changed) = imposed(Kind::Bursts, 1);
    let intervals = effect.parameters[effect.channels[0].name()]["intervals"].as_array().unwrap().clone();
    let within = |i: usize| {
        let time = i as f64 / RATE;
        intervals.iter().any(|one| (one[0].as_f64().unwrap()..one[1].as_f64().unwrap() + 1e-9).contains(&time))
    };
    assert!((0..SAMPLES).all(|i| changed[i] == 0.0 || within(i)));
    let inside: Vec<f64> = (0..SAMPLES).filter(|i| within(*i)).map(|i| changed[i]).collect();
    let ratio = rms(&inside) / parameter(&effect, "sigma");
    assert!((0.75..1.05).contains(&ratio), "{ratio}");
}

/// Returns the effects of a kind in a role, for many devices.
fn drawn(kind: Kind, role: Role) -> impl Iterator<Item = Effect> {
    (0..60).map(move |seed| {
        let draws = |purpose| Draw::device(seed, 5, purpose);
        Effect::draw(kind, &setting(), role, draws("device"), draws("events")).unwrap()
    })
}

#[test]
fn what_comes_after_other_effects_does_not_erase_them() {
    let beside = Role { sense: Sense::Missing, of: 2 };
    assert!(drawn(Kind::LowPass, beside).all(|effect| parameter(&effect, "cutoff_hz") >= 0.1 * RATE));
    assert!(drawn(Kind::MovingAverage, beside).all(|effect| parameter(&effect, "window") <= 9.0));
    assert!(drawn(Kind::Resolution, beside).all(|effect| parameter(&effect, "step") <= 1.5 * 2.0));
    assert!(!Kind::Spikes.goes_with(Kind::Saturation) && Kind::Spikes.goes_with(Kind::Tone));
}

#[test]
fn bursts_and_louder_intervals_leave_half_of_the_record_or_most_of_it() {
    let length_s = SAMPLES as f64 / RATE;
    let mut to_the_end = 0;
    for effect in drawn(Kind::Bursts, Role::ALONE) {
        let intervals = effect.parameters[effect.channels[0].name()]["intervals"].as_array().unwrap().clone();
        for one in &intervals {
            let (from, to) = (one[0].as_f64().unwrap(), one[1].as_f64().unwrap());
            if (to - length_s).abs() < 1e-9 {
                to_the_end += 1;
                assert!(from > 0.5 * length_s - 1.0);
            }
        }
    }
    assert!((1..30).contains(&to_the_end), "{to_the_end}");
    assert!(
        drawn(Kind::VarianceInterval, Role::ALONE)
            .all(|of| parameter(&of, "to_s") - parameter(&of, "from_s") < 0.61 * length_s)
    );
}

#[test]
fn spikes_that_the_sensor_lacks_are_expected_often() {
    let superfluous = Role { sense: Sense::Superfluous, of: 1 };
    let expected = |effect: Effect| parameter(&effect, "rate_hz") * SAMPLES as f64 / RATE;
    assert!(drawn(Kind::Spikes, superfluous).map(expected).all(|events| events >= 11.9));
}

#[test]
fn the_white_parts_law_and_size_change_as_stated() {
    let variance = |columns: &Columns, place: usize, from: usize, to: usize| {
        rms(&columns.columns[place].white[from..to]).powi(2) / 4.0
    };
    let place = |effect: &Effect, columns: &Columns| {
        columns.columns.iter().position(|column| column.channel == effect.channels[0]).unwrap()
    };
    let (effect, after, _) = imposed(Kind::VarianceInterval, 2);
    let index = |name| (parameter(&effect, name) * RATE) as usize;
    let found = variance(&after, place(&effect, &after), index("from_s"), index("to_s"));
    let expected = parameter(&effect, "factor").powi(2);
    assert!((found / expected - 1.0).abs() < 0.1, "{found} for {expected}");

    for (kind, within) in [(Kind::HeavyTails, 0.05), (Kind::SkewedNoise, 0.05)] {
        let (effect, after, _) = imposed(kind, 2);
        let found = variance(&after, place(&effect, &after), 0, SAMPLES);
        assert!((found - 1.0).abs() < within, "{kind}: {found}");
    }
    let (effect, after, _) = imposed(Kind::SkewedNoise, 3);
    let white = &after.columns[place(&effect, &after)].white;
    let skewness = white.iter().map(|value| value.powi(3)).sum::<f64>() / SAMPLES as f64 / rms(white).powi(3);
    let part = parameter(&effect, "square");
    let expected = (6.0 * part + 8.0 * part.powi(3)) / (1.0 + 2.0 * part * part).powf(1.5);
    assert!((skewness - expected).abs() < 0.08, "{skewness} for {expected}");
}

#[test]
fn what_is_sent_is_rounded_clipped_repeated_and_lost_as_stated() {
    let (effect, after, _) = imposed(Kind::Resolution, 2);
    let column = after.columns.iter().find(|column| column.channel == effect.channels[0]).unwrap();
    let step = parameter(&effect, "step");
    assert!(column.values.iter().all(|value| ((value / step).round() - value / step).abs() < 1e-9));

    let (effect, after, _) = imposed(Kind::Saturation, 2);
    let column = after.columns.iter().find(|column| column.channel == effect.channels[0]).unwrap();
    let entry = &effect.parameters[effect.channels[0].name()];
    let of = |value: f64| column.values.iter().filter(|one| **one == value).count() as f64 / SAMPLES as f64;
    let (high, low) =
        column.values.iter().fold((f64::MIN, f64::MAX), |(high, low), one| (high.max(*one), low.min(*one)));
    for (side, limit) in [("above", high), ("below", low)] {
        if entry[side] == true {
            assert!((of(limit) / parameter(&effect, "share") - 1.0).abs() < 0.2, "{}", of(limit));
        }
    }

    let (effect, after, _) = imposed(Kind::HeldSamples, 2);
    let column = after.columns.iter().find(|column| column.channel == effect.channels[0]).unwrap();
    let repeats = column.values.windows(2).filter(|two| two[0] == two[1]).count() as f64;
    let expected = parameter(&effect, "probability") * SAMPLES as f64;
    assert!((repeats - expected).abs() < 4.0 * expected.sqrt() + 1.0, "{repeats} for {expected}");

    let lossy = (0..20)
        .map(|seed| imposed(Kind::Timing, seed))
        .find(|(effect, ..)| parameter(effect, "drop_probability") > 3e-4);
    let (effect, after, _) = lossy.unwrap();
    let steps: Vec<f64> = after.time_s.windows(2).map(|two| two[1] - two[0] - 1.0 / RATE).collect();
    assert!((rms(&steps) / 2.0_f64.sqrt() / parameter(&effect, "jitter_s") - 1.0).abs() < 0.03);
    let lost = after.missing.iter().filter(|missing| **missing).count() as f64;
    let expected = parameter(&effect, "drop_probability") * SAMPLES as f64;
    assert!((lost - expected).abs() < 4.0 * expected.sqrt(), "{lost} for {expected}");
}

#[test]
fn common_noise_is_common() {
    let (effect, after, changed) = imposed(Kind::CommonMode, 2);
    let before = white();
    let other = after.columns.iter().position(|column| column.channel == effect.channels[1]).unwrap();
    let second: Vec<f64> =
        after.columns[other].values.iter().zip(&before.columns[other].values).map(|(now, then)| now - then).collect();
    let product: f64 = changed.iter().zip(&second).map(|(one, other)| one * other).sum::<f64>() / SAMPLES as f64;
    assert!(((product / rms(&changed) / rms(&second)).abs() - 1.0).abs() < 1e-6);
    assert!((rms(&changed) / parameter(&effect, "sigma") - 1.0).abs() < 0.02);
}
