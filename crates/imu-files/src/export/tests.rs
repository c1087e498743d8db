//! Golden texts of every target, from parameters of round numbers.

use super::*;

fn axis(n: f64, b: f64, k: Known) -> Axis {
    Axis { n: Known::Value(n), b: Known::Value(b), k, gauss_markov: None, fixed: Fixed::default() }
}

fn noise() -> ImuNoise {
    let gyro = axis(1e-4, 2e-5, Known::Value(4e-7));
    ImuNoise {
        origin: "Capture night: 18000 s at 40 Hz".into(),
        caution: None,
        enlarged: None,
        behind: BTreeMap::new(),
        others: Vec::new(),
        rate_hz: 40.0,
        duration_s: 18000.0,
        accel: Some([
            axis(2e-3, 1e-4, Known::Value(1e-6)),
            axis(1.9e-3, 1e-4, Known::Below(3e-6)),
            axis(2.8e-3, 1e-4, Known::Nothing),
        ]),
        gyro: Some([gyro, gyro, Axis { gauss_markov: Some((1e-5, 200.0)), ..gyro }]),
        mag: None,
    }
}

#[test]
fn kalibr_has_the_worst_axis_in_continuous_time() {
    let text = Target::Kalibr.write(&noise());
    for line in [
        "accelerometer_noise_density: 2.800000e-3  # m/s^2/sqrt(Hz); 2.0000e-3, 1.9000e-3, 2.8000e-3\n",
        "accelerometer_random_walk: 3.000000e-6  # m/s^3/sqrt(Hz); 1.0000e-6, < 3.0000e-6, unknown\n",
        "gyroscope_noise_density: 1.000000e-4  # rad/s/sqrt(Hz); 1.0000e-4, 1.0000e-4, 1.0000e-4\n",
        "gyroscope_random_walk: 4.000000e-7  # rad/s^2/sqrt(Hz); 4.0000e-7, 4.0000e-7, 4.0000e-7\n",
        "update_rate: 40.0  # Hz\n",
    ] {
        assert!(text.contains(line), "{line}\nin\n{text}");
    }
    let nothing = ImuNoise { gyro: Some([Axis::UNKNOWN; 3]), ..noise() };
    assert!(Target::Kalibr.write(&nothing).contains("# gyroscope_noise_density: unknown"));
}

#[test]
fn ros_has_variances_of_one_sample() {
    let text = Target::Ros.write(&noise());
    assert!(
        text.contains(
            "angular_velocity_covariance: [4.000000e-7, 0.0, 0.0, 0.0, 4.000000e-7, 0.0, 0.0, 0.0, 4.000000e-7]"
        ),
        "{text}"
    );
    assert!(text.contains("linear_acceleration_covariance: [1.600000e-4,"), "{text}");
    let unknown = ImuNoise { mag: Some([Axis::UNKNOWN; 3]), ..noise() };
    assert!(Target::Ros.write(&unknown).contains("magnetic_field_covariance: [-1.0,"));
}

#[test]
fn gazebo_has_the_sample_deviation_and_a_walking_bias() {
    let text = Target::Gazebo.write(&noise());
    assert!(text.contains("<stddev>6.324555e-4</stddev>"), "{text}");
    assert!(
        text.contains(
            "<dynamic_bias_stddev>4.000000e-7</dynamic_bias_stddev><dynamic_bias_correlation_time>3600000.0<"
        ),
        "{text}"
    );
    // 1e-5 √(2/200)
    assert!(
        text.contains("<dynamic_bias_stddev>1.000000e-6</dynamic_bias_stddev><dynamic_bias_correlation_time>200.0<"),
        "{text}"
    );
    assert_eq!(text.matches("<noise").count(), text.matches("</noise>").count());
    assert_eq!(text.matches("dynamic_bias_stddev>").count(), 2 * 4, "limits are no bias");
}

#[test]
fn gnss_ins_sim_has_hours_and_degrees() {
    let text = Target::GnssInsSim.write(&noise());
    // 1e-4 rad/s/√Hz is 0.34377 deg/√h; K 4e-7 over Tc = 180000 s has sigma 1.2e-4 rad/s, 24.752 deg/h.
    assert!(text.contains("'gyro_arw': np.array([3.437747e-1, 3.437747e-1, 3.437747e-1]),  # deg/rt-hr"), "{text}");
    assert!(text.contains("'gyro_b_stability': np.array([2.475178e1, 2.475178e1, 2.062648e0]),  # deg/hr"), "{text}");
    assert!(text.contains("'gyro_b_corr': np.array([1.800000e5, 1.800000e5, 2.000000e2])"), "{text}");
    assert!(text.contains("'accel_vrw': np.array([1.200000e-1, 1.140000e-1, 1.680000e-1])"), "{text}");
}

#[test]
fn matlab_is_json_with_the_names_of_its_parameter_objects() {
    let value: serde_json::Value = serde_json::from_str(&Target::Matlab.write(&noise())).unwrap();
    let part = &value["IMU"];
    assert_eq!(part["Gyroscope"]["NoiseDensity"], serde_json::json!([1e-4, 1e-4, 1e-4]));
    assert_eq!(part["Accelerometer"]["RandomWalk"], serde_json::json!([1e-6, 0.0, 0.0]));
    assert_eq!(part["Accelerometer"]["NoiseType"], "single-sided");
    assert!(part.get("Magnetometer").is_none());
}

#[test]
fn every_target_is_found_by_its_name_and_survives_knowing_nothing() {
    let nothing = ImuNoise { accel: Some([Axis::UNKNOWN; 3]), gyro: Some([Axis::UNKNOWN; 3]), ..noise() };
    for target in Target::ALL {
        assert_eq!(Target::from_name(target.name()), Some(target));
        let text = target.write(&nothing);
        assert!(no_number(&text).is_none(), "{:?} in {text}", no_number(&text));
    }
    assert_eq!(Target::from_name("json"), None);
}

/// Returns the first word that is a float but not a finite number.
fn no_number(text: &str) -> Option<&str> {
    let mut words = text.split(|c: char| !c.is_ascii_alphanumeric());
    words.find(|word| ["nan", "inf", "infinity"].iter().any(|name| word.eq_ignore_ascii_case(name)))
}

#[test]
fn what_is_no_number_is_found_wherever_it_stands() {
    for text in ["[inf, 0.0]", "[0.0, inf]", "<a>-inf</a>", "x: NaN # x", "np.array([1e0, NaN])"] {
        assert!(no_number(text).is_some(), "{text}");
    }
    assert_eq!(no_number("information of 1.0e3 nanoseconds"), None);
}

#[test]
fn a_limit_of_n_is_not_written_as_if_it_were_measured() {
    let limited = |axis: Axis| Axis { n: Known::Below(1e-4), ..axis };
    let [x, y, z] = noise().gyro.unwrap();
    let mag = Some([x, limited(y), z]);
    let noise = ImuNoise { gyro: Some([limited(x), y, limited(z)]), mag, ..noise() };
    for (target, expected) in [
        (
            Target::Ros,
            &[
                "0.0, 4.000000e-7]  # (rad/s)^2; x, z: not identified, from the 95 % upper limit\n",
                "# tesla^2; y: not identified, from the 95 % upper limit\n",
                "# (m/s^2)^2\n",
            ][..],
        ),
        (
            Target::Gazebo,
            &[
                "<z><noise type=\"gaussian\">\n        <!-- N is not identified: stddev is that of its 95 % upper limit -->\n        \
                 <mean>0.0</mean><stddev>6.324555e-4</stddev>",
                "<y><noise type=\"gaussian\">\n        <mean>",
            ],
        ),
        (Target::GnssInsSim, &["# deg/rt-hr; x, z: not identified, from the 95 % upper limit\n", "# m/s/rt-hr\n"]),
        (Target::Kalibr, &["< 1.0000e-4, 1.0000e-4, < 1.0000e-4"]),
    ] {
        let text = target.write(&noise);
        for part in expected {
            assert!(text.contains(part), "{target:?}: {part}\nin\n{text}");
        }
    }
    assert_eq!(Target::Gazebo.write(&noise).matches("95 % upper limit").count(), 3);
}

#[test]
fn a_model_is_exported_with_what_no_target_can_hold_in_words() {
    let model = imu_model::simulator::SensorModel::from_json(
        r#"{"format":"vn100d-sensor-model-1","name":"unit <7>","rate_hz":40,
            "channels":{"gyro_x":{"N":1e-4,"B":2e-5,"K":0,"bias":0.01,"uncertainty":{"K":{"upper_limit95":3e-7}},
                "effects":[{"effect":"gauss_markov","sigma":1e-5,"tc_s":200},{"effect":"tone","frequency_hz":7,"amplitude":1e-3}]}},
            "triads":{"gyro":{"effects":[{"effect":"scale_factor","x":0.002,"y":0,"z":0}]}},
            "sampling":{"internal_rate_hz":800,"filter_window":4}}"#,
        "m.json",
    )
    .unwrap();
    let noise = ImuNoise::of_model(&model);
    let [x, y, _] = noise.gyro.unwrap();
    assert_eq!((x.k, x.gauss_markov), (Known::Below(3e-7), Some((1e-5, 200.0))));
    // Means of four of 800 samples, sent at 40 Hz: a density √5 times as high.
    let Known::Value(n) = x.n else { panic!("{:?}", x.n) };
    assert!((n / (1e-4 * 5f64.sqrt()) - 1.0).abs() < 1e-9, "{n}");
    assert_eq!(y, Axis::UNKNOWN);
    for target in Target::ALL {
        let text = target.write(&noise);
        for words in ["unit _7_", "tone of gyro_x", "scale_factor of gyro", "800 Hz"] {
            assert!(text.contains(words), "{}: {words:?} is not in\n{text}", target.name());
        }
    }
}

#[test]
fn what_a_temperature_bias_is_beyond_its_slope_is_named_where_the_slope_goes() {
    let with = |further: &str| {
        let text = format!(
            r#"{{"format":"vn100d-sensor-model-1","name":"t","rate_hz":40,"channels":{{"gyro_x":{{"N":1e-4,
                "effects":[{{"effect":"temperature_bias","per_c":1e-4,"reference_c":25{further}}}]}}}}}}"#
        );
        let model = imu_model::simulator::SensorModel::from_json(&text, "m.json").unwrap();
        Target::Matlab.write(&ImuNoise::of_model(&model))
    };
    assert!(with(r#","play_c":2"#).contains("temperature_bias beyond its slope of gyro_x"));
    assert!(!with("").contains("beyond its slope"));
}

#[test]
fn what_is_no_noise_goes_where_a_target_has_a_place_for_it() {
    let model = imu_model::simulator::SensorModel::from_json(
        r#"{"format":"vn100d-sensor-model-1","name":"t","rate_hz":40,"channels":{
            "gyro_x":{"N":1e-4,"bias":0.01,"effects":[{"effect":"resolution","step":1e-3},
                {"effect":"temperature_bias","per_c":1e-4,"reference_c":15}]},
            "gyro_y":{"N":1e-4,"effects":[{"effect":"resolution","step":2e-3}]}, "gyro_z":{"N":1e-4},
            "mag_x":{"N":1e-4,"bias":0.2},"mag_y":{"N":1e-4},"mag_z":{"N":1e-4}},
            "triads":{"gyro":{"effects":[{"effect":"bias","x":0.002,"y":-0.003,"z":0},{"effect":"saturation","range":35},
                {"effect":"g_sensitivity","m":[[1e-5,0,0],[0,2e-5,0],[0,0,3e-5]]},
                {"effect":"g_sensitivity","m":[[0,1e-5,0],[0,0,0],[0,0,0]]}]},
                "mag":{"effects":[{"effect":"bias","x":0.01,"y":0,"z":0}]}}}"#,
        "m.json",
    )
    .unwrap();
    let noise = ImuNoise::of_model(&model);
    assert_eq!(noise.gyro.unwrap().map(|axis| axis.fixed.bias), [Some(0.012), Some(-0.003), None]);
    let matlab: Value = serde_json::from_str(&Target::Matlab.write(&noise)).unwrap();
    let gyro = &matlab["IMU"]["Gyroscope"];
    let numbers = |value: &Value| value.as_array().unwrap().iter().map(|of| of.as_f64().unwrap()).collect::<Vec<_>>();
    // The slope counts from 25 °C there: ten degrees of it are bias.
    for (found, expected) in numbers(&gyro["ConstantBias"]).iter().zip([0.013, -0.003, 0.0]) {
        assert!((found - expected).abs() < 1e-12, "{gyro}");
    }
    assert_eq!(numbers(&gyro["TemperatureBias"]), [1e-4, 0.0, 0.0]);
    assert_eq!(numbers(&gyro["AccelerationBias"]), [1e-5, 2e-5, 3e-5]);
    assert_eq!((gyro["Resolution"].as_f64(), gyro["MeasurementRange"].as_f64()), (Some(1e-3), Some(35.0)));
    assert_eq!(matlab["IMU"]["Magnetometer"]["ConstantBias"][0], 1.0);
    let gazebo = Target::Gazebo.write(&noise);
    for part in [
        "<x><noise type=\"gaussian_quantized\">\n        <mean>1.200000e-2</mean><stddev>6.324555e-4</stddev>\n        \
         <precision>1.000000e-3</precision>",
        "<z><noise type=\"gaussian\">\n        <mean>0.0</mean>",
        "<mean>1.000000e-6</mean>",
    ] {
        assert!(gazebo.contains(part), "{part}\nin\n{gazebo}");
    }
    assert!(Target::GnssInsSim.write(&noise).contains("'gyro_b': np.array([2.475178e3, -6.187944e2, 0.000000e0])"));
    for (target, left) in [
        (
            Target::Kalibr,
            "bias of gyro_x gyro_y mag_x, resolution of gyro_x gyro_y, temperature_bias of gyro_x, saturation of",
        ),
        (
            Target::GnssInsSim,
            "resolution of gyro_x gyro_y, temperature_bias of gyro_x, saturation of gyro_x gyro_y gyro_z",
        ),
        (Target::Gazebo, "temperature_bias of gyro_x, saturation of gyro_x gyro_y gyro_z, g_sensitivity of"),
        (Target::Matlab, "Left out here: field in the bias of mag_x, g_sensitivity of gyro. Part"),
    ] {
        let text = target.write(&noise).split(['#', '\n']).map(str::trim).collect::<Vec<_>>().join(" ");
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(text.contains(left), "{target:?}: {left}\nin\n{text}");
    }
}

/// Returns a report of gyroscope x alone, white noise of 4000 samples.
fn report() -> NoiseReport {
    use imu_noise::robust::{All, Part, spectral_sums};
    let values = (0..4000u64).map(|i| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f64 * 1e-10).collect();
    let sums =
        spectral_sums(&[Part { start_s: 0.0, values }], imu_noise::allan::FixedPoint::for_channel(Channel::GyroX));
    let parameters = All::of(Channel::GyroX, 40.0, &sums, None).parameters;
    serde_json::from_value(serde_json::json!({
        "format": NoiseReport::FORMAT, "capture": "night", "rate_hz": 40.0, "duration_s": 100.0, "samples": 4000, "missing": 0,
        "complete": true, "channels": { "gyro_x": parameters }, "datasheet": null }))
    .unwrap()
}

/// Returns a report with all axes, a walk that only z has, and a limit for the others.
fn of_six_axes() -> NoiseReport {
    use imu_noise::fit::{Estimate, Term};
    let mut report = report();
    let of_x = report.channels[&Channel::GyroX].clone();
    for (scale, channel) in [Triad::Gyro, Triad::Accel].into_iter().flat_map(Triad::channels).enumerate() {
        let mut own = of_x.clone();
        let n = 1e-4 * (scale + 1) as f64;
        own.n = Estimate::identified(channel, Term::N, n, [0.9 * n, 1.1 * n]);
        own.k = Estimate::unidentified(channel, Term::K, Some(1e-6));
        if channel == Channel::GyroZ {
            own.k = Estimate::identified(channel, Term::K, 2e-6, [1e-6, 3e-6]);
        }
        report.channels.insert(channel, own);
    }
    report
}

#[test]
fn what_contradicts_its_record_is_refused_or_written_below_a_comment() {
    let mut report = report();
    report.channels.get_mut(&Channel::GyroX).unwrap().refuse("the fitted noise predicts another deviation".to_owned());
    let why = "gyro_x: the fitted noise predicts another deviation";
    for target in Target::ALL {
        assert_eq!(target.refusal(&report).as_deref(), Some(why));
        let text = target.write_report(&report);
        let caution = text.find("NOT USABLE").unwrap();
        // Covariances are of all three axes or not given.
        assert!(text.find("e-").is_none_or(|number| caution < number), "{text}");
    }
    // An unusable magnetometer is no reason to withhold formats without a magnetometer.
    let gyro = report.channels.get_mut(&Channel::GyroX).unwrap();
    let mag = gyro.clone();
    gyro.usable = true;
    report.channels.insert(Channel::MagX, mag);
    for target in Target::ALL {
        let refused = target.refusal(&report).is_some();
        let text = target.write_report(&report);
        assert_eq!((refused, text.contains("NOT USABLE")), (target.holds(Channel::MagX), refused), "{target:?}");
    }
    assert!(report.refusal(|_| true).is_some());
}

/// `--force` writes every number below a comment that states why it should not be there.
#[test]
fn every_text_that_is_forced_states_the_reason_above_its_first_number() {
    let mut report = of_six_axes();
    report.channels.get_mut(&Channel::GyroY).unwrap().refuse("it was not at rest".to_owned());
    for target in Target::ALL {
        let text = target.write_report(&report);
        let joined = text.replace(['#', '\n'], " ").split_whitespace().collect::<Vec<_>>().join(" ");
        let comment = "NOT USABLE, written because it was asked for: gyro_y: it was not at rest";
        assert!(joined.contains(comment), "{target:?}: {text}");
        let number = text.find("e-").unwrap();
        // JSON has no comments and no order.
        assert!(target == Target::Matlab || text.find("NOT").unwrap() < number, "{target:?}: {text}");
    }
}

/// The summary shows the numbers in the files.
#[test]
fn the_summary_has_the_numbers_of_the_files() {
    let report = of_six_axes();
    let paste = paste::Paste::of(&report);
    assert!(paste.note.contains("often ten times as large"));
    let names: Vec<&str> = paste.programs.iter().map(|program| program.format.as_str()).collect();
    assert_eq!(names, Target::ALL.map(Target::name));
    for program in &paste.programs {
        let text = Target::from_name(&program.format).unwrap().write_report(&report);
        let words = text.split(|c: char| !c.is_ascii_alphanumeric() && !".-+".contains(c));
        let mut found: Vec<f64> = words.filter_map(|word| word.parse().ok()).collect();
        if program.format == "isaac" {
            found.extend(found.clone().iter().map(|density| density * 40f64.sqrt()));
        }
        assert!(!program.source.is_empty() && !program.takes.is_empty(), "{program:?}");
        for number in &program.values {
            assert!(number.reason.is_none(), "{number:?}");
            let Some(value) = number.value else {
                // A simulator gets no walk that was not measured.
                assert!(number.noise == Noise::Walk && number.of != "gyro_z", "{program:?}");
                continue;
            };
            let there = found.iter().any(|found| (found / value - 1.0).abs() < 1e-5);
            assert!(there, "{}: {number:?} is not in\n{text}", program.format);
            assert!(text.contains(&number.name), "{}: {number:?} is not in\n{text}", program.format);
        }
    }
    let of = |format: &str, of: &str, noise: Noise| {
        let program = paste.programs.iter().find(|program| program.format == format).unwrap();
        program.values.iter().find(|number| number.of == of && number.noise == noise).cloned().unwrap()
    };
    let walk = of("kalibr", "accel", Noise::Walk);
    assert_eq!((walk.value, walk.limit, walk.unit.as_str()), (Some(1e-6), true, "m/s³/√Hz"));
    let walk = of("kalibr", "gyro", Noise::Walk);
    assert_eq!((walk.value, walk.limit, walk.name.as_str()), (Some(2e-6), false, "gyroscope_random_walk"));
    let variance = of("ros", "gyro_y", Noise::White);
    assert!((variance.value.unwrap() / (4e-8 * 40.0) - 1.0).abs() < 1e-12 && variance.unit == "(rad/s)²");
    let (header, rows) = paste.table(|value| format!("{value:.1e}"));
    assert_eq!((header.len(), rows.len()), (6, Target::ALL.len()));
    assert_eq!(rows[0][0], "kalibr");
    assert_eq!(rows[0][2..], ["3.0e-4 rad/s/√Hz", "2.0e-6 rad/s²/√Hz", "6.0e-4 m/s²/√Hz", "< 1.0e-6 m/s³/√Hz"]);
}

/// A channel that is not usable has its reason in place of a number, and no other triad's.
#[test]
fn the_summary_withholds_what_is_not_usable() {
    let mut report = of_six_axes();
    report.channels.get_mut(&Channel::GyroY).unwrap().refuse("it was not at rest".to_owned());
    let paste = paste::Paste::of(&report);
    for number in paste.programs.iter().flat_map(|program| &program.values) {
        let withheld = matches!(number.of.as_str(), "gyro" | "gyro_y");
        assert_eq!(number.reason.as_deref(), withheld.then_some("gyro_y: it was not at rest"), "{number:?}");
        assert!(!withheld || number.value.is_none() && !number.limit, "{number:?}");
    }
    let (_, rows) = paste.table(|value| format!("{value:.1e}"));
    assert_eq!(rows[0][2..4], ["not usable", "not usable"]);
    assert_eq!(rows[0][4], "6.0e-4 m/s²/√Hz");
    // A record without information gives no number either.
    let mut nothing = of_six_axes();
    nothing.rate_hz = f64::NAN;
    let text = serde_json::to_string(&paste::Paste::of(&nothing)).unwrap();
    assert!(no_number(&text.replace("at NaN Hz", "")).is_none(), "{text}");
}

/// Behind a filter one sample deviates by less than N√rate: no text states it as that of one sample, and each names the
/// filter.
#[test]
fn what_lies_behind_a_filter_is_named_and_is_not_of_one_sample() {
    let mut report = of_six_axes();
    let at_rate = [Target::Ros, Target::RobotLocalization, Target::Gazebo, Target::Isaac];
    let joined = |target: Target, report: &NoiseReport| {
        let text = target.write_report(report).replace(['#', '\n'], " ");
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    for target in at_rate {
        let text = joined(target, &report);
        assert!(text.contains("of one sample at 40 Hz") && !text.contains("behind"), "{text}");
    }
    let bandwidth = serde_json::json!({ "kind": "moving_average", "value": 4.0, "unit": "samples", "ci95": null, "source": "fitted" });
    report.channels.get_mut(&Channel::GyroX).unwrap().bandwidth = serde_json::from_value(bandwidth).unwrap();
    for target in Target::ALL {
        let text = joined(target, &report);
        assert!(text.contains("gyro_x behind a moving average of 4 samples (fitted)"), "{target:?}: {text}");
        assert!(!text.contains("of one sample") || target == Target::GnssInsSim, "{target:?}: {text}");
        assert_eq!(text.contains("keeps the density, which is what integrates"), at_rate.contains(&target), "{text}");
    }
    // The filter of a sensor model is named too.
    let model = imu_model::simulator::SensorModel::from_json(
        r#"{"format":"vn100d-sensor-model-1","name":"m","rate_hz":40,
            "channels":{"gyro_x":{"N":1e-4,"effects":[{"effect":"moving_average","window":4}]}, "gyro_y":{"N":1e-4}, "gyro_z":{"N":1e-4}}}"#,
        "m.json",
    )
    .unwrap();
    let text = Target::Ros.write(&ImuNoise::of_model(&model));
    assert!(text.contains("gyro_x behind a moving average") && !text.contains("of one sample"), "{text}");
}

/// A report has no information about its sensor: no text names one.
#[test]
fn no_text_names_a_sensor_that_the_report_does_not_name() {
    for target in Target::ALL {
        let text = target.write_report(&of_six_axes()).to_lowercase();
        assert!(!text.contains("vn100") && !text.contains("vn-100"), "{target:?}: {text}");
    }
}

/// Evaluates each program's numbers as its code does: a second of white noise N and of a walk K must give N² and K².
#[test]
fn every_filter_adds_the_variance_of_the_noise_in_a_second() {
    let axis = Axis { n: Known::Value(2e-3), k: Known::Value(3e-4), ..Axis::UNKNOWN };
    let only_gyro = ImuNoise { gyro: Some([axis; 3]), accel: None, ..noise() };
    let number = |target: Target, key: &str| -> f64 {
        let text = target.write(&only_gyro);
        let line = text.lines().find(|line| line.trim_start().trim_start_matches("param set ").starts_with(key));
        let line = line.unwrap_or_else(|| panic!("no {key} in\n{text}"));
        line.split([' ', ':']).rfind(|word| !word.is_empty()).unwrap().parse().unwrap()
    };
    type Adds = fn(f64) -> f64;
    const SAMPLE_S: f64 = 1.0 / 40.0;
    let continuous: Adds = |number| number * number;
    let per_sample: Adds = |number| (SAMPLE_S * number).powi(2) / SAMPLE_S;
    let variance: Adds = |number| SAMPLE_S * SAMPLE_S * number / SAMPLE_S;
    let ten_ms: Adds = |number| (0.01 * number).powi(2) / 0.01;
    let twelve_ms: Adds = |number| (0.012 * number).powi(2) / 0.012;
    for (target, white, walk, adds) in [
        (Target::Kalibr, "gyroscope_noise_density", "gyroscope_random_walk", continuous),
        (Target::Openvins, "gyroscope_noise_density", "gyroscope_random_walk", continuous),
        (Target::VinsFusion, "gyr_n", "gyr_w", per_sample),
        (Target::OrbSlam3, "IMU.NoiseGyro", "IMU.GyroWalk", continuous),
        (Target::LioSam, "imuGyrNoise", "imuGyrBiasN", continuous),
        (Target::FastLio, "gyr_cov", "b_gyr_cov", variance),
        (Target::Px4, "EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE", ten_ms),
        (Target::Ardupilot, "EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE", twelve_ms),
    ] {
        if target == Target::Kalibr {
            assert!(target.write(&only_gyro).contains("gyroscope_noise_density: 2.000000e-3  #"));
            continue;
        }
        for (key, density) in [(white, 2e-3f64), (walk, 3e-4)] {
            let found = adds(number(target, key));
            assert!((found / density.powi(2) - 1.0).abs() < 1e-5, "{target:?} {key}: {found}");
        }
    }
}

#[test]
fn no_text_speaks_of_a_triad_that_is_not_there() {
    let only_gyro = ImuNoise { accel: None, ..noise() };
    let only_accel = ImuNoise { gyro: None, ..noise() };
    let numbers = |text: &str| {
        let own = text.lines().filter(|line| !line.trim_start().starts_with('#') && !line.contains("Comment"));
        own.collect::<Vec<_>>().join("\n").to_lowercase()
    };
    for target in Target::ALL {
        let (gyro, accel) = (numbers(&target.write(&only_gyro)), numbers(&target.write(&only_accel)));
        for word in ["acc", "m/s"] {
            assert!(
                !gyro.contains(word) && (accel.contains(word) || word == "m/s"),
                "{target:?} {word}:\n{gyro}\n{accel}"
            );
        }
        for word in ["gyr", "ang", "rad/s"] {
            assert!(!accel.contains(word), "{target:?} {word}:\n{accel}");
        }
    }
}

#[test]
fn files_for_filters_have_units_limits_and_why_others_publish_more() {
    for target in
        [Target::Kalibr, Target::Openvins, Target::VinsFusion, Target::OrbSlam3, Target::LioSam, Target::FastLio]
    {
        let text = target.write(&noise());
        assert!(text.contains("# accelerometer, random walk, ") || target == Target::Kalibr, "{text}");
        assert!(text.contains(", < "), "{text}");
        assert!(text.contains("often ten times as") && text.contains("Capture night"), "{text}");
    }
    let vins = Target::VinsFusion.write(&noise());
    // The larger of 1e-6 and the limit of 3e-6, times √40; 2.8e-3 √40.
    assert!(vins.contains("\nacc_w: 1.897367e-5\n") && vins.contains("\nacc_n: 1.770875e-2\n"), "{vins}");
    let px4 = Target::Px4.write(&noise());
    assert!(px4.contains("\nparam set EKF2_ACC_NOISE 2.800000e-2\n") && px4.contains("EKF2_PREDICT_US"), "{px4}");
    let orb = Target::OrbSlam3.write(&noise());
    assert!(orb.contains("\nIMU.Frequency: 40.0\n") && orb.contains("\nIMU.NoiseAcc: 2.800000e-3\n"), "{orb}");
    let isaac = Target::Isaac.write(&noise());
    assert!(isaac.contains("RATE_HZ = 40.0 ") && isaac.contains("std=2.800000e-3 * math.sqrt(RATE_HZ))"), "{isaac}");
    let fusion = Target::RobotLocalization.write(&noise());
    assert!(fusion.contains("angular_velocity_covariance: [4.000000e-7,") && !fusion.contains("magnetic"), "{fusion}");
}
