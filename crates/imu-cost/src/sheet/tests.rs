use super::*;
use crate::measured::tests::simulated;
use imu_core::sample::Channel;

const RATE_HZ: f64 = 20.0;

fn model(channels: &str) -> SensorModel {
    let text = format!(
        r#"{{"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": {RATE_HZ}, "channels": {{{channels}}}}}"#
    );
    SensorModel::from_json(&text, "t.json").unwrap()
}

const TRUE: &str = r#""gyro_y": {"N": 1e-4, "B": 2e-5}, "gyro_z": {"N": 1e-4, "K": 2e-6}, "accel_x": {"N": 1e-3}"#;
/// The model with `factor` times the true sizes, and intervals about them.
fn stated(factor: f64) -> SensorModel {
    let interval = |size: f64| match size > 0.0 {
        true => format!(r#"{{"ci95": [{}, {}]}}"#, 0.98 * factor * size, 1.02 * factor * size),
        false => r#"{"upper_limit95": 1e-9}"#.to_owned(),
    };
    let channel = |name: &str, [n, b, k]: [f64; 3]| {
        let sizes = format!(r#""N": {}, "B": {}, "K": {}"#, factor * n, factor * b, factor * k);
        let uncertainty = format!(r#""N": {}, "B": {}, "K": {}"#, interval(n), interval(b), interval(k));
        format!(r#""{name}": {{{sizes}, "uncertainty": {{{uncertainty}}}}}"#)
    };
    let channels = [
        channel("gyro_y", [1e-4, 2e-5, 0.0]),
        channel("gyro_z", [1e-4, 0.0, 2e-6]),
        channel("accel_x", [1e-3, 0.0, 0.0]),
    ];
    model(&channels.join(", "))
}

type Columns = Vec<(Channel, Vec<f64>)>;

fn evidence<'a>(name: &str, columns: &'a Columns) -> Evidence<'a> {
    let channels = columns.iter().map(|(channel, values)| (*channel, values.as_slice())).collect();
    Evidence {
        name: name.to_owned(),
        rest: Rest { rate_hz: RATE_HZ, channels, missing: &[] },
        begin_s: 0.0,
        temperature: None,
        temperature_c: None,
        unit: None,
        date: None,
        is_source: false,
    }
}

fn request(horizons_s: &[f64]) -> Request {
    Request { align_s: 10.0, horizons_s: horizons_s.to_vec(), ..Request::default() }
}

fn all(sheet: &Sheet) -> impl Iterator<Item = &Comparison> {
    sheet.quantities.values().flatten().flatten()
}

/// Every interval of a true model contains 0 as often as it states, from one recording and from several.
#[test]
fn a_true_model_is_validated_as_often_as_stated() {
    let (truth, stated) = (model(TRUE), stated(1.0));
    let (mut inside, mut count) = ([0_u32; 3], 0_u32);
    let mut validated = 0;
    for seed in 0..40 {
        let parts = 1 + seed % 4;
        let nights: Vec<Columns> =
            (0..parts).map(|part| simulated(&truth, 1000 + 10 * seed + part, 2400.0 / parts as f64)).collect();
        let evidence: Vec<Evidence> = nights.iter().map(|of| evidence("night", of)).collect();
        let found = sheet(&stated, "t", &evidence, &request(&[1.0, 10.0, 60.0])).unwrap();
        validated += u32::from(found.verdict == SheetVerdict::Validated);
        for of in all(&found) {
            count += 1;
            for (inside, error) in inside.iter_mut().zip([&of.rms, &of.bias, &of.scatter]) {
                *inside += u32::from(error.agrees());
                assert!((error.error - (error.predicted - error.measured)).abs() <= 1e-12 * error.measured.abs());
            }
            assert!(of.independent <= of.pieces as f64 && of.bias_proportion.unwrap() <= 1.0, "{of:?}");
            assert!(of.recordings_differ.is_none() || parts > 1, "{of:?}");
        }
    }
    // 470 comparisons of 40 nights resolve about 2 %.
    assert!(inside.iter().all(|inside| f64::from(*inside) >= 0.93 * f64::from(count)), "{inside:?} of {count}");
    assert!(validated >= 36, "{validated} of 40");
}

#[test]
fn a_wrong_model_is_not_valid() {
    let night = simulated(&model(TRUE), 5, 3600.0);
    for (factor, sign) in [(0.7, -1.0), (1.5, 1.0)] {
        let found = sheet(&stated(factor), "t", &[evidence("night", &night)], &request(&[1.0, 10.0])).unwrap();
        let of = found.quantities[&Quantity::Heading][0].as_ref().unwrap();
        assert!(of.rms.error * sign > 0.0 && !of.rms.agrees(), "{of:?}");
        // Its sizes are wrong, not its mean.
        assert!(of.bias.agrees() && of.bias_proportion.unwrap() < 0.2, "{of:?}");
        assert_eq!(found.verdict, SheetVerdict::NotValid, "{}", found.reason);
    }
}

/// One axis of six is wrong: the others do not outvote it.
#[test]
fn one_wrong_axis_is_enough() {
    let night = simulated(&model(TRUE), 5, 3600.0);
    let mut wrong = stated(1.0);
    let axis = wrong.channels.get_mut(&Channel::GyroZ).unwrap();
    (axis.n, axis.uncertainty) = (3e-4, None);
    let found = sheet(&wrong, "t", &[evidence("night", &night)], &request(&[1.0, 10.0, 60.0])).unwrap();
    assert_eq!(found.verdict, SheetVerdict::NotValid, "{}", found.reason);
}

/// A course that the model states twenty times too large is seen although all pieces have it in common.
#[test]
fn a_course_of_the_wrong_size_is_not_valid() {
    let with = |size: f64| {
        let ramp = format!(r#", "effects": [{{"effect": "rate_ramp", "R": {size:e}}}]"#);
        model(&format!(r#""gyro_z": {{"N": 1e-5{ramp}}}"#))
    };
    let night = simulated(&with(2e-6), 4, 3600.0);
    let of = |model: &SensorModel| sheet(model, "t", &[evidence("night", &night)], &request(&[60.0])).unwrap();
    assert_eq!(of(&with(4e-5)).verdict, SheetVerdict::NotValid);
    let right = of(&with(2e-6));
    let error = right.quantities[&Quantity::Heading][0].as_ref().unwrap().rms;
    assert!(right.verdict == SheetVerdict::Validated && error.u_val < 0.1 * error.measured, "{error:?}");
}

/// A slow process of the true model is a part that all pieces of a record have in common.
#[test]
fn a_slow_process_is_no_bias() {
    let slow = model(r#""gyro_z": {"N": 1e-5, "effects": [{"effect": "gauss_markov", "sigma": 1e-3, "tc_s": 20000}]}"#);
    let nights: Vec<Columns> = (0..20).map(|seed| simulated(&slow, 500 + seed, 1200.0)).collect();
    let is_valid = |night: &Columns| {
        let found = sheet(&slow, "t", &[evidence("night", night)], &request(&[10.0, 60.0])).unwrap();
        found.verdict == SheetVerdict::Validated
    };
    assert!(nights.iter().filter(|night| is_valid(night)).count() >= 18);
}

/// Sensors that differ are reported, and the error is about these recordings.
#[test]
fn recordings_that_differ_are_reported() {
    let loud = model(&TRUE.replace("1e-4", "3e-4").replace("1e-3", "3e-3"));
    let nights = [simulated(&model(TRUE), 1, 1800.0), simulated(&model(TRUE), 2, 1800.0), simulated(&loud, 3, 1800.0)];
    let all_of = |nights: &[Columns]| {
        let evidence: Vec<Evidence> = nights.iter().map(|of| evidence("night", of)).collect();
        sheet(&stated(1.0), "t", &evidence, &request(&[1.0])).unwrap()
    };
    let differing = all_of(&nights);
    let [least, most] = all(&differing).next().unwrap().recordings_differ.unwrap();
    assert!((0.7..1.3).contains(&least) && (2.4..3.6).contains(&most), "{least} {most}");
    assert!(differing.notes.iter().any(|note| note.contains("differ among themselves")), "{:?}", differing.notes);
    assert!(all(&all_of(&nights[..2])).all(|of| of.recordings_differ.is_none()));
}

/// A ramp that the model lacks turns all pieces alike.
#[test]
fn what_is_common_to_all_pieces_is_bias() {
    let ramp = r#", "effects": [{"effect": "rate_ramp", "R": 2e-6}]"#;
    let truth = model(&TRUE.replace(r#""K": 2e-6"#, &format!(r#""K": 2e-6{ramp}"#)));
    let nights: Vec<Columns> = (0..3).map(|seed| simulated(&truth, seed, 1800.0)).collect();
    let evidence: Vec<Evidence> = nights.iter().map(|of| evidence("night", of)).collect();
    let found = sheet(&stated(1.0), "t", &evidence, &request(&[60.0])).unwrap();
    let of = found.quantities[&Quantity::Heading][0].as_ref().unwrap();
    // ∫ r·t dt over the horizon, about the middle of the alignment.
    let expected = 2e-6 * (60.0 * 60.0 / 2.0 + 60.0 * 5.0);
    assert!((of.bias.error / -expected - 1.0).abs() < 0.3, "{of:?} {expected}");
    assert!(!of.bias.agrees() && of.bias_proportion.unwrap() > 0.6, "{of:?}");
    // The model that has it predicts it.
    let mut with_ramp = stated(1.0);
    let channel = with_ramp.channels.get_mut(&Channel::GyroZ).unwrap();
    channel.effects = truth.channels[&Channel::GyroZ].effects.clone();
    let found = sheet(&with_ramp, "t", &evidence, &request(&[60.0])).unwrap();
    let of = found.quantities[&Quantity::Heading][0].as_ref().unwrap();
    assert!((of.bias.predicted / expected - 1.0).abs() < 0.01 && of.bias.error.abs() < 0.3 * expected, "{of:?}");
}

#[test]
fn a_limit_is_met_missed_or_open() {
    let night = simulated(&model(TRUE), 9, 3600.0);
    let limits = |text: &str, factor: f64| {
        let request = Request { tolerances: crate::Tolerance::parse(text).unwrap(), ..request(&[1.0]) };
        let found = sheet(&stated(factor), "t", &[evidence("night", &night)], &request).unwrap();
        assert!(found.horizons_s.contains(&10.0));
        (found.limits.iter().map(|of| of.state).collect::<Vec<_>>(), found.verdict)
    };
    let (met, missed, open) = (LimitState::Met, LimitState::Missed, LimitState::Undecided);
    assert_eq!(limits("heading=1deg/10s", 1.0), (vec![met], SheetVerdict::Validated));
    assert_eq!(limits("heading=1deg/10s,heading=0.001deg/10s", 3.0), (vec![met, missed], SheetVerdict::NotValid));
    // Far below what an hour resolves, and a horizon for which there are too few pieces.
    assert_eq!(limits("heading=1e-9deg/10s", 1.0), (vec![open], SheetVerdict::Undecided));
    assert_eq!(limits("heading=1deg/10s,heading=9deg/1h", 1.0), (vec![met, open], SheetVerdict::Undecided));
}

#[test]
fn a_model_is_not_validated_with_what_it_was_fitted_to() {
    let night = simulated(&model(TRUE), 3, 3600.0);
    let source = Evidence { is_source: true, ..evidence("night", &night) };
    let found = sheet(&stated(1.0), "t", std::slice::from_ref(&source), &request(&[1.0])).unwrap();
    assert!(found.verdict == SheetVerdict::Undecided && found.reason.contains("fitted to night"), "{}", found.reason);
    let found = sheet(&stated(1.0), "t", &[evidence("another", &night)], &request(&[1.0])).unwrap();
    assert_eq!(found.verdict, SheetVerdict::Validated);
}

#[test]
fn what_the_model_states_without_an_interval_counts_as_exact() {
    let night = simulated(&model(TRUE), 3, 3600.0);
    let of = |model: &SensorModel| sheet(model, "t", &[evidence("night", &night)], &request(&[1.0])).unwrap();
    let (exact, with_intervals) = (of(&model(TRUE)), of(&stated(1.0)));
    let is_noted = |sheet: &Sheet| sheet.not_validated.iter().any(|of| of.contains("count as exact"));
    assert!(is_noted(&exact) && !is_noted(&with_intervals), "{:?}", exact.not_validated);
    for (one, other) in all(&exact).zip(all(&with_intervals)) {
        assert!(
            one.rms.u_val < other.rms.u_val && (one.rms.error - other.rms.error).abs() < 1e-12,
            "{one:?} {other:?}"
        );
    }
    assert_eq!(exact.verdict, SheetVerdict::Validated);
}

#[test]
fn the_sheet_states_what_the_recordings_do_not_cover() {
    let night = simulated(&model(TRUE), 3, 1200.0);
    let cold = Evidence {
        temperature_c: Some([21.0, 21.4]),
        unit: Some("0100012345".to_owned()),
        date: Some("2026-11-01".to_owned()),
        ..evidence("night", &night)
    };
    let effect = r#", "effects": [{"effect": "temperature_bias", "per_c": 1e-5, "reference_c": 25}]"#;
    let own = model(&format!(
        r#"{}, "mag_x": {{"N": 1e-3}}"#,
        TRUE.replace(r#""K": 2e-6"#, &format!(r#""K": 2e-6{effect}"#))
    ));
    let found = sheet(&own, "t", std::slice::from_ref(&cold), &request(&[1.0, 600.0])).unwrap();
    for expected in [
        "velocity_y: model or recordings lack its channels",
        "heading after 10 min: too few pieces",
        "horizons beyond 10 min",
        "mag_x: unaided integration",
        "temperatures other than 21.0 to 21.4 °C",
        "temperature_bias: the temperature moved by 0.40 K",
        "motion: the recordings are at rest",
        "other units: the recordings are of one",
        "other days: the recordings are of one",
        "times from switch-on other than 0 s to 20 min",
        "other poses: the recordings show one",
    ] {
        assert!(found.not_validated.iter().any(|of| of.contains(expected)), "{expected}: {:#?}", found.not_validated);
    }
    let envelope = &found.envelope;
    assert_eq!((envelope.total_s, envelope.recordings.len(), envelope.rate_hz), (1200.0, 1, RATE_HZ));
    assert_eq!(envelope.units.iter().collect::<Vec<_>>(), ["0100012345"]);
    assert!(envelope.largest[&Channel::GyroY] > 1e-4 && envelope.recordings[0].specific_force_m_s2.len() == 1);
    let other = Evidence { unit: Some("2".to_owned()), date: Some("2026-11-02".to_owned()), ..cold.clone() };
    let mut turned = night.clone();
    turned.iter_mut().filter(|(of, _)| *of == Channel::AccelX).flat_map(|(_, of)| of).for_each(|value| *value += 9.8);
    let other = Evidence { begin_s: 5.0, rest: evidence("", &turned).rest, ..other };
    let found = sheet(&own, "t", &[cold, other], &request(&[1.0])).unwrap();
    let others = ["other units", "other days", "other poses"];
    let is_other = |of: &String| others.iter().any(|other| of.starts_with(other));
    assert!(!found.not_validated.iter().any(is_other), "{:#?}", found.not_validated);
}

#[test]
fn recordings_that_cannot_be_compared_are_refused() {
    let night = simulated(&model(TRUE), 3, 100.0);
    let refusal = |evidence: &[Evidence<'_>], horizon_s: f64| {
        sheet(&stated(1.0), "t", evidence, &request(&[horizon_s])).unwrap_err().to_string()
    };
    assert!(refusal(&[evidence("night", &night)], 60.0).contains("1 disjoint pieces of 70 s"));
    let [one, two] = [evidence("one", &night), evidence("two", &night)];
    assert!(refusal(&[one, two], 60.0).contains("2 disjoint pieces of 70 s"));
    assert!(refusal(&[], 60.0).contains("0 disjoint pieces"));
    let mut fast = evidence("fast", &night);
    fast.rest.rate_hz = 100.0;
    assert!(refusal(std::slice::from_ref(&fast), 1.0).contains("expected the same rate"));
    let message = refusal(&[evidence("one", &night), fast], 1.0);
    assert!(message.contains("fast: ") && message.contains("expected the same rate"), "{message}");
    // A recording too short for a piece does not take the others' away.
    let warm = model(r#""gyro_z": {"N": 1e-4, "effects": [{"effect": "warm_up", "amplitude": 1e-4, "tau_s": 60}]}"#);
    let (long, short) = (simulated(&warm, 1, 1200.0), simulated(&warm, 2, 5.0));
    let hot = Evidence { temperature_c: Some([50.0, 51.0]), begin_s: 9e4, ..evidence("short", &short) };
    let found = sheet(&warm, "t", &[evidence("long", &long), hot], &request(&[1.0])).unwrap();
    assert!(found.envelope.recordings.len() == 1 && found.notes.iter().any(|of| of.contains("short has no piece")));
    assert_eq!((found.envelope.temperature_c, found.envelope.since_switch_on_s), (None, [0.0, 1200.0]));
}
