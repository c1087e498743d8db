//! The chain as a whole: its order, its sampling, the effects that channels share, and values that depend only on the
//! inputs.

use super::*;
use crate::effects::{
    BiasStep, Bursts, CommonMode, Effect, GaussMarkov, HeavyTails, HeldSamples, LowPass, Record, Resolution,
    Saturation, Spikes, TemperatureBias, Tone, TriadEffect, VarianceChange, WarmUp, triad,
};
use std::sync::Arc;

fn list(effects: Vec<Box<dyn Effect>>) -> Vec<Arc<dyn Effect>> {
    effects.into_iter().map(Arc::from).collect()
}

fn channel(n: f64, effects: Vec<Box<dyn Effect>>) -> ChannelModel {
    ChannelModel { n, effects: list(effects), ..ChannelModel::default() }
}

fn model(rate_hz: f64, channels: impl IntoIterator<Item = (Channel, ChannelModel)>) -> SensorModel {
    SensorModel { name: "test".to_owned(), rate_hz, channels: channels.into_iter().collect(), ..SensorModel::default() }
}

fn with_triad(mut model: SensorModel, triad: Triad, effects: Vec<Arc<dyn TriadEffect>>) -> SensorModel {
    model.triads.insert(triad, TriadModel { effects });
    model
}

fn simulate(model: &SensorModel, seed: u64, count: usize) -> Simulator {
    Simulator::new(model, seed, model.rate_hz, count as f64 / model.rate_hz).unwrap()
}

/// Returns `count` values of one channel.
fn values(model: &SensorModel, seed: u64, channel: Channel, count: usize) -> Vec<f64> {
    let mut simulator = simulate(model, seed, count);
    (0..count).map(|_| simulator.next_values()[channel as usize]).collect()
}

fn mean_square(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64
}

/// Returns a model with all kinds of content.
fn rich(rate_hz: f64, sampling: Option<Sampling>) -> SensorModel {
    let gyro = |sigma| ChannelModel {
        n: 1e-3,
        b: 1e-4,
        k: 1e-5,
        bias: Some(0.01),
        effects: list(vec![
            Box::new(Resolution { step: 1e-4 }),
            Box::new(Tone { frequency_hz: 3.0, amplitude: 1e-3 }),
            Box::new(Tone { frequency_hz: 4.0, amplitude: 1e-3 }),
            Box::new(HeavyTails { degrees_of_freedom: 6.0 }),
            Box::new(LowPass::new(12.0, 2)),
            Box::new(GaussMarkov { sigma: 1e-3, tc_s: 2.0 }),
            Box::new(TemperatureBias::linear(1e-4, 20.0)),
            Box::new(WarmUp { amplitude: 0.1, tau_s: 5.0 }),
            Box::new(CommonMode { sigma }),
            Box::new(HeldSamples { probability: 0.01 }),
            Box::new(Timing { jitter_s: 0.001, drop_probability: 0.02 }),
        ]),
        uncertainty: None,
    };
    let channels = [
        (Channel::GyroX, gyro(1e-3)),
        (Channel::GyroY, gyro(2e-3)),
        (Channel::AccelZ, channel(0.01, vec![Box::new(Spikes::new(1.0, 1.0))])),
        (Channel::Temperature, ChannelModel { n: 0.01, bias: Some(30.0), ..ChannelModel::default() }),
    ];
    let effects: Vec<Arc<dyn TriadEffect>> = vec![
        Arc::new(triad::Misalignment { rotation: [0.01, 0.02, 0.03] }),
        Arc::new(triad::Latency { seconds: 0.01 }),
        Arc::new(triad::GSensitivity { m: [[1e-3; 3]; 3] }),
    ];
    SensorModel { sampling, ..with_triad(model(rate_hz, channels), Triad::Gyro, effects) }
}

/// Returns a motion of `count` samples at `rate_hz`.
fn turning(rate_hz: f64, count: usize) -> impl Iterator<Item = Motion> + Send + 'static {
    (0..count).map(move |index| {
        let time_s = index as f64 / rate_hz;
        Motion {
            gyro_rad_s: [time_s.sin(), (0.7 * time_s).cos(), 0.3],
            accel_m_s2: [0.0, time_s.cos(), -9.8],
            temperature_c: Some(25.0 + 0.1 * time_s),
        }
    })
}

const FACTORY: Sampling = Sampling { internal_rate_hz: 800.0, filter_window: 4 };

#[test]
fn values_depend_neither_on_threads_nor_on_how_they_are_taken() {
    for sampling in [None, Some(FACTORY)] {
        let model = rich(40.0, sampling);
        let count = 3000;
        let start = || {
            let simulator = simulate(&model, 7, count);
            let internal_hz = simulator.internal_rate_hz();
            simulator.with_motion(turning(internal_hz, (count as f64 * internal_hz / 40.0) as usize))
        };
        let mut one_by_one = start();
        let reference: Vec<SimulatedSample> = std::iter::from_fn(|| one_by_one.next_sample()).collect();
        assert_eq!(reference.len(), count);
        for threads in [1, 2, 5] {
            let mut simulator = start().with_threads(threads);
            let mut taken = Vec::new();
            for _ in 0..3 {
                taken.extend(simulator.next_sample());
            }
            while let Some(block) = simulator.next_block() {
                assert_eq!(block.first_index, taken.len() as u64);
                for place in 0..block.len() {
                    let mut values = [0.0; Channel::COUNT];
                    for channel in model.channels.keys() {
                        values[*channel as usize] = block.values(*channel).unwrap()[place];
                    }
                    let (time_s, lost) = (block.time_s[place], block.lost[place]);
                    taken.push(SimulatedSample { index: block.first_index + place as u64, time_s, lost, values });
                }
            }
            assert_eq!(taken, reference, "{threads} threads");
            assert_eq!(simulator.next_sample(), None);
        }
    }
}

#[test]
fn the_order_of_the_files_list_does_not_matter() {
    let model = rich(40.0, None);
    let mut turned = model.clone();
    let gyro = turned.channels.get_mut(&Channel::GyroX).unwrap();
    gyro.effects.reverse();
    // The two tones draw their phases in the list's order.
    let tones: Vec<usize> = (0..gyro.effects.len()).filter(|index| gyro.effects[*index].name() == "tone").collect();
    gyro.effects.swap(tones[0], tones[1]);
    assert_eq!(values(&turned, 3, Channel::GyroX, 2000), values(&model, 3, Channel::GyroX, 2000));
}

#[test]
fn an_effect_more_leaves_the_other_values_as_they_were() {
    let plain = model(40.0, [(Channel::GyroX, channel(1.0, vec![]))]);
    let step = || Box::new(BiasStep { at_s: 10.0, size: 100.0 });
    let tone = || Box::new(Tone { frequency_hz: 3.0, amplitude: 1.0 });
    let more = model(40.0, [(Channel::GyroX, channel(1.0, vec![step(), tone()]))]);
    let alone = model(40.0, [(Channel::GyroX, channel(0.0, vec![tone()]))]);
    let of = |model: &SensorModel| values(model, 1, Channel::GyroX, 1000);
    for (index, ((more, plain), tone)) in of(&more).iter().zip(of(&plain)).zip(of(&alone)).enumerate() {
        let step = if index >= 400 { 100.0 } else { 0.0 };
        assert!((more - plain - tone - step).abs() < 1e-12);
    }
}

#[test]
fn noise_is_clipped_then_averaged_then_rounded() {
    let effects: Vec<Box<dyn Effect>> =
        vec![Box::new(Resolution { step: 0.5 }), Box::new(Saturation { low: -10.0, high: 1.0 })];
    let mut clipped = model(40.0, [(Channel::GyroX, channel(1.0, effects))]);
    let found = values(&clipped, 1, Channel::GyroX, 4000);
    // The noise of deviation √40 is clipped, and the rest is rounded: never above the limit, often exactly at it.
    assert!(found.iter().all(|value| (-10.0..=1.0).contains(value) && (value / 0.5).fract() == 0.0));
    let at_limit = found.iter().filter(|value| **value == 1.0).count();
    // P(z > 0.75/√40), the values that round to the limit included, is 45.3 %.
    assert!((at_limit as f64 / 4000.0 - 0.453).abs() < 5.0 * 0.0079, "{at_limit}");
    clipped.sampling = Some(Sampling { internal_rate_hz: 800.0, filter_window: 20 });
    let sampled = values(&clipped, 1, Channel::GyroX, 4000);
    // Means of twenty clipped values lie between the limits, on the output's grid: rounding follows averaging.
    assert!(sampled.iter().all(|value| (value / 0.5).fract() == 0.0));
    let at_limit = sampled.iter().filter(|value| **value == 1.0).count();
    assert!(at_limit < 40, "{at_limit}");
}

#[test]
fn a_bandwidth_filters_noise_and_a_limit_comes_behind_it() {
    let filter = || Box::new(LowPass::new(2.0, 1));
    let clip = Box::new(Saturation { low: -0.1, high: 0.1 });
    let plain = values(&model(40.0, [(Channel::GyroX, channel(1.0, vec![]))]), 1, Channel::GyroX, 20_000);
    let filtered = values(&model(40.0, [(Channel::GyroX, channel(1.0, vec![filter()]))]), 1, Channel::GyroX, 20_000);
    let both = values(&model(40.0, [(Channel::GyroX, channel(1.0, vec![clip, filter()]))]), 1, Channel::GyroX, 20_000);
    // One pole at tan(π/20): the variance falls to tan/(1 + tan).
    let tangent = (std::f64::consts::PI / 20.0).tan();
    let ratio = mean_square(&filtered) / mean_square(&plain);
    assert!((ratio / (tangent / (1.0 + tangent)) - 1.0).abs() < 0.08, "{ratio}");
    let clipped: Vec<f64> = filtered.iter().map(|value| value.clamp(-0.1, 0.1)).collect();
    assert_eq!(both, clipped);
}

#[test]
fn heavy_tails_and_changes_of_variance_act_on_the_white_part_alone() {
    let shapes: Vec<Box<dyn Effect>> = vec![
        Box::new(HeavyTails { degrees_of_freedom: 5.0 }),
        Box::new(VarianceChange::Interval { from_s: 0.0, to_s: 1e9, factor: 2.0 }),
        Box::new(GaussMarkov { sigma: 1.0, tc_s: 10.0 }),
    ];
    let other = || -> Vec<Box<dyn Effect>> { vec![Box::new(GaussMarkov { sigma: 1.0, tc_s: 10.0 })] };
    let of = |n, effects| values(&model(40.0, [(Channel::GyroX, channel(n, effects))]), 1, Channel::GyroX, 40_000);
    let (shaped, rest) = (of(0.1, shapes), of(0.0, other()));
    let white: Vec<f64> = shaped.iter().zip(&rest).map(|(shaped, rest)| shaped - rest).collect();
    // N² · 40 Hz · 2²; the scatter follows from the kurtosis of 9 of t with five degrees of freedom.
    let expected = 0.01 * 40.0 * 4.0;
    assert!((mean_square(&white) / expected - 1.0).abs() < 5.0 * (8.0_f64 / 40_000.0).sqrt());
}

#[test]
fn white_noise_behind_the_boxcar_has_the_density_that_the_datasheet_room_predicts() {
    use imu_noise::datasheet::{FilterWindows, Sampling as Predicted};
    for window in [1, 4, 20, 32] {
        let mut model = model(40.0, [(Channel::GyroX, channel(0.01, vec![]))]);
        model.sampling = Some(Sampling { internal_rate_hz: 800.0, filter_window: u64::from(window) });
        let windows = FilterWindows { mag: 0, accel: window, gyro: window };
        let factor = Predicted::new(40.0, Some(windows)).density_factor(Triad::Gyro);
        let count = 100_000;
        let spectrum = Spectrum::new(&model, Channel::GyroX, Record { rate_hz: 40.0, samples: count });
        // Low frequencies: means of a hundred values.
        let means: Vec<f64> = values(&model, 3, Channel::GyroX, count as usize)
            .chunks_exact(100)
            .map(|values| values.iter().sum::<f64>() / 100.0)
            .collect();
        let density = mean_square(&means) * 100.0 / 40.0;
        let predicted = 1e-4 * factor * factor;
        assert!((density / predicted - 1.0).abs() < 5.0 * (2.0 / 1000.0_f64).sqrt(), "{window}: {density} {predicted}");
        assert!((spectrum.psd(1e-6).unwrap() / predicted - 1.0).abs() < 1e-6, "{window}");
    }
}

#[test]
fn a_tone_beyond_half_the_output_rate_appears_folded_with_the_boxcars_gain() {
    let tone = Tone { frequency_hz: 131.0, amplitude: 1.0 };
    let mut model = model(40.0, [(Channel::GyroX, channel(0.0, vec![Box::new(tone)]))]);
    assert!(matches!(Simulator::new(&model, 1, 40.0, 10.0), Err(SimulatorError::Model { .. })));
    model.sampling = Some(FACTORY);
    let count = 4000;
    let found = values(&model, 1, Channel::GyroX, count);
    // 131 − 3·40 = 11 Hz, times sin(4x)/(4 sin x) at x = π·131/800.
    let x = std::f64::consts::PI * 131.0 / 800.0;
    let gain = (4.0 * x).sin() / (4.0 * x.sin());
    let at = |frequency_hz: f64| {
        let (mut real, mut imaginary) = (0.0, 0.0);
        for (index, value) in found.iter().enumerate() {
            let (sine, cosine) = (2.0 * std::f64::consts::PI * frequency_hz * index as f64 / 40.0).sin_cos();
            real += value * cosine;
            imaginary += value * sine;
        }
        2.0 * f64::hypot(real, imaginary) / count as f64
    };
    assert!((at(11.0) / gain.abs() - 1.0).abs() < 1e-2, "{} {gain}", at(11.0));
    let line = Spectrum::new(&model, Channel::GyroX, Record { rate_hz: 40.0, samples: 4000 }).lines()[0];
    assert!((line.frequency_hz - 11.0).abs() < 1e-9 && (line.power / (gain * gain / 2.0) - 1.0).abs() < 1e-9);
    let rest = mean_square(&found) - at(11.0).powi(2) / 2.0;
    // The first sample is not yet a mean of four.
    assert!(rest.abs() < 1e-2 * line.power, "{rest} {}", line.power);
}

/// Compares the mean spectrum over octaves of the simulated chain with the chain's closed form.
fn chain_has_its_spectrum(model: &SensorModel) {
    const COUNT: usize = 1 << 13;
    const SEEDS: u64 = 60;
    let record = Record { rate_hz: model.rate_hz, samples: COUNT as u64 };
    let spectrum = Spectrum::new(model, Channel::GyroX, record);
    let fft = realfft::RealFftPlanner::<f64>::new().plan_fft_forward(COUNT);
    let bands: Vec<(usize, usize)> = (5..12).map(|octave| (1 << octave, 1 << (octave + 1))).collect();
    let mut found = vec![Vec::new(); bands.len()];
    for seed in 0..SEEDS {
        let window = |i: usize| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * i as f64 / COUNT as f64).cos();
        let mut tapered = values(model, seed, Channel::GyroX, COUNT);
        let mean = tapered.iter().sum::<f64>() / COUNT as f64;
        tapered.iter_mut().enumerate().for_each(|(index, value)| *value = (*value - mean) * window(index));
        let mut transform = fft.make_output_vec();
        fft.process(&mut tapered, &mut transform).unwrap();
        for (found, (from, to)) in found.iter_mut().zip(&bands) {
            let sum: f64 = transform[*from..*to].iter().map(realfft::num_complex::Complex::norm_sqr).sum();
            found.push(sum / ((to - from) as f64 * 0.375 * COUNT as f64 * model.rate_hz));
        }
    }
    for (found, (from, to)) in found.iter().zip(bands) {
        let at = |bin: usize| spectrum.psd(bin as f64 * model.rate_hz / COUNT as f64).unwrap();
        let expected = (from..to).map(at).sum::<f64>() / (to - from) as f64;
        let mean = found.iter().sum::<f64>() / SEEDS as f64;
        let variance = found.iter().map(|power| (power - mean).powi(2)).sum::<f64>() / (SEEDS - 1) as f64;
        let allowed = 5.0 * (variance / SEEDS as f64).sqrt() + 0.012 * expected;
        assert!((mean - expected).abs() < allowed, "bins {from}–{to}: {mean:e}, expected {expected:e} ± {allowed:e}");
    }
}

#[test]
fn the_whole_chain_has_the_spectrum_of_its_closed_form() {
    let effects = || -> Vec<Box<dyn Effect>> {
        vec![
            Box::new(GaussMarkov { sigma: 2e-3, tc_s: 0.2 }),
            Box::new(LowPass::new(15.0, 2)),
            Box::new(HeavyTails { degrees_of_freedom: 8.0 }),
            Box::new(Resolution { step: 2e-3 }),
        ]
    };
    let gyro = || ChannelModel { b: 1e-3, k: 3e-4, ..channel(1e-3, effects()) };
    let plain = model(40.0, [(Channel::GyroX, gyro())]);
    chain_has_its_spectrum(&plain);
    chain_has_its_spectrum(&SensorModel { sampling: Some(FACTORY), ..plain });
}

#[test]
fn all_channels_of_a_triad_hold_together_even_if_one_names_it() {
    let held = channel(1.0, vec![Box::new(HeldSamples { probability: 0.2 })]);
    let plain = channel(1.0, vec![]);
    let channels = [
        (Channel::GyroX, plain.clone()),
        (Channel::GyroY, held.clone()),
        (Channel::GyroZ, held),
        (Channel::AccelX, plain),
    ];
    let model = model(40.0, channels);
    let repeats =
        |channel| -> Vec<bool> { values(&model, 2, channel, 2000).windows(2).map(|pair| pair[0] == pair[1]).collect() };
    assert_eq!(repeats(Channel::GyroX), repeats(Channel::GyroY));
    assert_eq!(repeats(Channel::GyroX), repeats(Channel::GyroZ));
    assert!(repeats(Channel::AccelX).iter().all(|repeat| !repeat));
    let count = repeats(Channel::GyroX).iter().filter(|repeat| **repeat).count();
    assert!((count as f64 - 400.0).abs() < 5.0 * 17.9, "{count}");
}

#[test]
fn common_mode_is_the_same_on_all_channels_times_their_share() {
    let shared = |sigma| channel(0.0, vec![Box::new(CommonMode { sigma }) as Box<dyn Effect>]);
    let model =
        model(40.0, [(Channel::GyroX, shared(1.0)), (Channel::GyroY, shared(-2.0)), (Channel::AccelX, shared(0.5))]);
    let of = |channel| values(&model, 5, channel, 1000);
    for ((x, y), a) in of(Channel::GyroX).iter().zip(of(Channel::GyroY)).zip(of(Channel::AccelX)) {
        assert_eq!((y, a), (-2.0 * x, 0.5 * x));
    }
}

#[test]
fn stamps_scatter_and_samples_get_lost_as_the_parameters_state() {
    let timing = Timing { jitter_s: 0.002, drop_probability: 0.05 };
    let model = model(40.0, [(Channel::GyroX, channel(1.0, vec![Box::new(timing)]))]);
    let plain = values(&self::model(40.0, [(Channel::GyroX, channel(1.0, vec![]))]), 1, Channel::GyroX, 20_000);
    let mut simulator = simulate(&model, 1, 20_000);
    let samples: Vec<_> = (0..20_000).map(|_| simulator.next_sample().unwrap()).collect();
    let deviations: Vec<f64> = samples.iter().map(|sample| sample.time_s - sample.index as f64 / 40.0).collect();
    assert!((mean_square(&deviations).sqrt() / 0.002 - 1.0).abs() < 5.0 * 0.005);
    assert!(samples.windows(2).all(|pair| pair[0].time_s < pair[1].time_s));
    let lost = samples.iter().filter(|sample| sample.lost).count();
    assert!((lost as f64 - 1000.0).abs() < 5.0 * 30.8, "{lost}");
    for (sample, plain) in samples.iter().zip(plain) {
        assert_eq!(sample.values[Channel::GyroX as usize], plain);
    }
}

#[test]
fn a_motion_is_answered_in_the_chains_order() {
    let silent = |bias| ChannelModel { bias: Some(bias), ..ChannelModel::default() };
    let channels = [(Channel::GyroX, silent(0.5)), (Channel::GyroZ, silent(0.0)), (Channel::AccelY, silent(0.1))];
    let effects: Vec<Arc<dyn TriadEffect>> = vec![
        // In the wrong order on purpose.
        Arc::new(triad::Saturation { range: 100.0 }),
        Arc::new(triad::GSensitivity { m: [[0.0, 0.0, 0.01], [0.0; 3], [0.0; 3]] }),
        Arc::new(triad::ScaleFactorNonlinearity { axes: [0.1, 0.0, 0.0], full_scale: 10.0, signed: false }),
        Arc::new(triad::ScaleFactor { axes: [0.1, 0.0, 0.0] }),
        Arc::new(triad::CrossAxisSensitivity { xy: 0.2, xz: 0.0, yz: 0.0 }),
        Arc::new(triad::Misalignment { rotation: [0.0, 0.0, 0.1] }),
    ];
    let model = with_triad(model(40.0, channels), Triad::Gyro, effects);
    let motion = Motion { gyro_rad_s: [1.0, 2.0, 3.0], accel_m_s2: [4.0, 5.0, 6.0], temperature_c: None };
    let mut simulator = simulate(&model, 1, 100).with_motion(std::iter::repeat_n(motion, 10));
    let sample = simulator.next_sample().unwrap();
    // Cross-axis: x + 0.2·y − 0.1·y = 1.2; scale 1.2·1.1 + 0.1·1.44/10; g-sensitivity 0.06; bias 0.5.
    let expected = 1.2 * 1.1 + 0.0144 + 0.06 + 0.5;
    assert!((sample.values[Channel::GyroX as usize] - expected).abs() < 1e-12);
    assert_eq!(sample.values[Channel::GyroZ as usize], 3.0);
    assert_eq!(sample.values[Channel::AccelY as usize], 5.1);
    // The simulation ends with the motion; next_values repeats its last.
    assert_eq!(std::iter::from_fn(|| simulator.next_sample()).count(), 9);
    assert!((simulator.next_values()[Channel::GyroX as usize] - expected).abs() < 1e-12);
}

#[test]
fn a_triads_range_clips_bias_and_noise_as_well() {
    let noisy = ChannelModel { bias: Some(0.9), ..channel(1.0, vec![]) };
    let effects: Vec<Arc<dyn TriadEffect>> =
        vec![Arc::new(triad::Saturation { range: 1.0 }), Arc::new(triad::Bias { axes: [5.0, 0.0, 0.0] })];
    let model =
        with_triad(model(40.0, [(Channel::GyroX, noisy.clone()), (Channel::GyroY, noisy)]), Triad::Gyro, effects);
    let x = values(&model, 1, Channel::GyroX, 2000);
    let y = values(&model, 1, Channel::GyroY, 2000);
    let at_top = |values: &[f64]| values.iter().filter(|value| **value == 1.0).count();
    assert!(x.iter().chain(&y).all(|value| (-1.0..=1.0).contains(value)));
    // P(5.9 + √40·z > 1) = 78.1 %, P(0.9 + √40·z > 1) = 49.4 %.
    assert!(
        (at_top(&x) as f64 / 2000.0 - 0.781).abs() < 5.0 * 0.0093
            && (at_top(&y) as f64 / 2000.0 - 0.494).abs() < 5.0 * 0.0112
    );
}

#[test]
fn latency_delays_the_motion_before_sampling() {
    let silent = ChannelModel::default;
    let mut model = model(40.0, [(Channel::GyroX, silent()), (Channel::AccelX, silent())]);
    model.sampling = Some(Sampling { internal_rate_hz: 800.0, filter_window: 1 });
    let model = with_triad(model, Triad::Gyro, vec![Arc::new(triad::Latency { seconds: 0.0131 })]);
    let motion = (0..80_000_u32).map(|index| Motion {
        gyro_rad_s: [(f64::from(index) / 800.0).sin(), 0.0, 0.0],
        accel_m_s2: [(f64::from(index) / 800.0).sin(), 0.0, 0.0],
        temperature_c: None,
    });
    let mut simulator = simulate(&model, 1, 4000).with_motion(motion);
    while let Some(sample) = simulator.next_sample() {
        assert!((sample.values[Channel::AccelX as usize] - sample.time_s.sin()).abs() < 1e-12);
        if sample.time_s > 0.1 {
            let late = (sample.time_s - 0.0131).sin();
            assert!((sample.values[Channel::GyroX as usize] - late).abs() < 1e-9);
        }
    }
}

#[test]
fn temperature_drives_what_depends_on_it_and_shows_on_its_channel() {
    let bias = TemperatureBias::linear(0.01, 20.0);
    let gyro = || channel(0.0, vec![Box::new(bias) as Box<dyn Effect>]);
    let thermometer = ChannelModel { bias: Some(35.0), ..ChannelModel::default() };
    let with = model(40.0, [(Channel::GyroX, gyro()), (Channel::Temperature, thermometer)]);
    let without = model(40.0, [(Channel::GyroX, gyro())]);
    let first = |simulator: &mut Simulator| {
        let values = simulator.next_values();
        (values[Channel::GyroX as usize], values[Channel::Temperature as usize])
    };
    let close = |found: (f64, f64), expected: (f64, f64)| {
        assert!((found.0 - expected.0).abs() < 1e-12 && (found.1 - expected.1).abs() < 1e-12, "{found:?} {expected:?}");
    };
    // Constant: the channel's bias, else 25 °C.
    close(first(&mut simulate(&with, 1, 100)), (0.15, 35.0));
    close(first(&mut simulate(&without, 1, 100)), (0.05, 0.0));
    // A course replaces it, and takes precedence over the motion's.
    let mut course =
        simulate(&with, 1, 100).with_temperature(|time_s: f64| 40.0 + time_s).with_motion(turning(40.0, 100));
    let samples: Vec<_> = (0..40).map(|_| first(&mut course)).collect();
    close((samples[20].0 - 0.5_f64.sin(), samples[20].1), (0.205, 40.5));
    let mut moved = simulate(&with, 1, 100).with_motion(turning(40.0, 100));
    let samples: Vec<_> = (0..40).map(|_| first(&mut moved)).collect();
    close((samples[20].0 - 0.5_f64.sin(), samples[20].1), (0.01 * 5.05, 25.05));
}

#[test]
fn a_model_that_makes_no_sense_at_the_rate_is_refused_with_the_place() {
    let model =
        model(40.0, [(Channel::GyroX, channel(1.0, vec![Box::new(Tone { frequency_hz: 11.0, amplitude: 1.0 })]))]);
    assert!(Simulator::new(&model, 1, 40.0, 10.0).is_ok());
    let refused = Simulator::new(&model, 1, 20.0, 10.0).unwrap_err().to_string();
    assert_eq!(
        refused,
        "cannot simulate `test` at 20 Hz: channels.gyro_x.effects[0].frequency_hz: found 11 Hz; expected a frequency below \
         10 Hz, half the rate at which it acts"
    );
    let negative = self::model(40.0, [(Channel::GyroX, ChannelModel { b: -1.0, ..ChannelModel::default() })]);
    assert!(Simulator::new(&negative, 1, 40.0, 10.0).unwrap_err().to_string().contains("channels.gyro_x.B: found -1"));
    let sampled = SensorModel { sampling: Some(FACTORY), ..model };
    assert!(Simulator::new(&sampled, 1, 30.0, 10.0).unwrap_err().to_string().contains("sampling.internal_rate_hz"));
}

#[test]
fn bursts_fall_on_the_samples_of_their_interval() {
    let bursts = Bursts { intervals: vec![(1.0, 2.0)], sigma: 1.0 };
    let found = values(&model(40.0, [(Channel::GyroX, channel(0.0, vec![Box::new(bursts)]))]), 1, Channel::GyroX, 120);
    assert!((0..120).all(|index| (found[index] != 0.0) == (40..80).contains(&index)));
}
