//! Filter parameters against known laws, a search on a grid, and runs of the simulator.

use super::fit::{Family, Variances};
use super::moments::{Windows, of_densities, of_line};
use super::real::errors;
use super::request::{Asked, Grid};
use super::{ChannelParameters, FilterError, FilterParameters, FilterRequest, Over, RecordFrom, filter_parameters};
use crate::quadrature::{Rule, octaves};
use crate::sources::ChannelSources;
use imu_core::sample::Channel;
use imu_model::effects::Line;
use imu_model::simulator::{SensorModel, Simulator};
use std::f64::consts::{PI, TAU};

const N: f64 = 1e-4;
const K: f64 = 2e-6;

fn model_at(rate_hz: f64, gyro_z: &str) -> SensorModel {
    let text = format!(
        r#"{{"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": {rate_hz}, "channels": {{"gyro_z": {gyro_z}}}}}"#
    );
    SensorModel::from_json(&text, "t.json").unwrap()
}

fn with(effects: &str) -> SensorModel {
    model_at(40.0, &format!(r#"{{"N": {N}, "K": {K}, "effects": [{effects}]}}"#))
}

fn request() -> FilterRequest {
    FilterRequest { allan: [(Channel::GyroZ, [Some(N), Some(K)])].into(), ..FilterRequest::default() }
}

fn parameters(model: &SensorModel) -> ChannelParameters {
    found(model, &request()).channels[&Channel::GyroZ].clone()
}

fn found(model: &SensorModel, request: &FilterRequest) -> FilterParameters {
    filter_parameters(model, "t", request).unwrap()
}

fn is_close(found: f64, expected: f64, share: f64) {
    assert!((found / expected - 1.0).abs() < share, "{found}, expected {expected}");
}

const TONE: &str = r#"{"effect": "tone", "frequency_hz": 13.38, "amplitude": 2e-3}"#;
const WARM_UP: &str = r#"{"effect": "warm_up", "amplitude": 2e-3, "tau_s": 600}"#;
const PROCESS: &str = r#"{"effect": "gauss_markov", "sigma": 3e-5, "tc_s": 20}"#;
const RESONANCE: &str = r#"{"effect": "resonance", "frequency_hz": 7.3, "bandwidth_hz": 0.4, "sigma": 1e-3}"#;

#[test]
fn white_noise_and_a_walk_are_found_again() {
    let of = parameters(&with(""));
    for own in [&of.white_and_walk.fit, &of.white_and_walk.cover, of.allan.as_ref().unwrap()] {
        is_close(own.n, N, 1e-6);
        is_close(own.k.unwrap(), K, 1e-6);
        is_close(own.inflation.n.unwrap(), 1.0, 1e-6);
        is_close(own.inflation.k.unwrap(), 1.0, 1e-6);
        is_close(own.worst_ratio.unwrap(), 1.0, 1e-6);
        assert!(own.divergence.unwrap() < 1e-9, "{own:?}");
    }
    assert_eq!((of.summary.as_str(), of.causes.len()), ("N × 1.0; K × 1.0", 0));
    // Var x = N²(τ + τ²/T) + K²(τ³/3 + τ²T/3).
    let (all, t) = (found(&with(""), &request()), 30.0);
    for (h, sd) in all.horizons_s.iter().zip(&of.real_sd) {
        let variance = N * N * (h + h * h / t) + K * K * (h.powi(3) + h * h * t) / 3.0;
        is_close(*sd, variance.sqrt(), 1e-4);
    }
}

#[test]
fn one_kind_of_noise_alone_is_found_as_such() {
    let white = parameters(&model_at(40.0, r#"{"N": 1e-4}"#)).white_and_walk;
    is_close(white.fit.n, N, 1e-6);
    assert_eq!((white.fit.k, white.cover.k), (Some(0.0), Some(0.0)));
    let walk = parameters(&model_at(40.0, r#"{"K": 2e-6}"#)).white_and_walk;
    is_close(walk.fit.k.unwrap(), K, 1e-6);
    assert!(walk.fit.n < 1e-4 * K && walk.cover.n < 1e-4 * K, "{walk:?}");
    let none = parameters(&model_at(40.0, r#"{"bias": 0.2}"#));
    assert_eq!((none.white_and_walk.fit.n, none.white_and_walk.cover.k), (0.0, Some(0.0)));
    assert!(none.white_and_walk.fit.divergence.is_none() && none.gauss_markov.fit.tc_s.is_none());
    serde_json::to_string(&none).unwrap();
}

#[test]
fn a_gauss_markov_process_is_found_again_by_its_own_family() {
    let of = parameters(&model_at(40.0, &format!(r#"{{"N": 1e-4, "effects": [{PROCESS}]}}"#)));
    for own in [&of.gauss_markov.fit, &of.gauss_markov.cover] {
        is_close(own.n, N, 1e-4);
        is_close(own.sigma.unwrap(), 3e-5, 1e-3);
        is_close(own.tc_s.unwrap(), 20.0, 1e-3);
        assert!(own.divergence.unwrap() < 1e-6 && own.tc_at_end == Some(false), "{own:?}");
    }
    assert!(of.white_and_walk.fit.divergence.unwrap() > 0.01);
    assert!(of.summary.ends_with(": gauss_markov"), "{}", of.summary);
}

/// A walk is a process of a correlation time beyond the range.
#[test]
fn a_walk_is_a_process_without_an_end() {
    let of = parameters(&with("")).gauss_markov.fit;
    assert_eq!(of.tc_at_end, Some(true));
    is_close(of.sigma.unwrap() * (2.0 / of.tc_s.unwrap()).sqrt(), K, 0.05);
}

#[test]
fn a_constant_bias_and_other_sensors_change_nothing() {
    let plain = found(&with(TONE), &request());
    let moved = with(TONE);
    let mut moved = SensorModel { name: "other".to_owned(), ..moved };
    moved.channels.get_mut(&Channel::GyroZ).unwrap().bias = Some(0.37);
    moved.channels.insert(Channel::MagX, moved.channels[&Channel::GyroZ].clone());
    moved.channels.insert(Channel::Pressure, moved.channels[&Channel::GyroZ].clone());
    assert_eq!(plain, found(&moved, &request()));
}

#[test]
fn each_effect_raises_the_parameter_that_it_acts_on_and_is_named() {
    let of = |effects: &str| parameters(&with(effects));
    let tone = of(TONE);
    assert!(tone.white_and_walk.fit.n > 1.1 * N && tone.summary.contains(": tone at 13.38 Hz;"), "{}", tone.summary);
    let flicker = parameters(&model_at(40.0, r#"{"N": 1e-4, "K": 2e-6, "B": 2.6e-5}"#));
    assert!(flicker.white_and_walk.fit.k.unwrap() > 1.2 * K && flicker.summary.ends_with(": B"), "{}", flicker.summary);
    let warm = of(WARM_UP);
    assert!(warm.white_and_walk.fit.k.unwrap() > 1.05 * K && warm.summary.ends_with("warm_up"), "{}", warm.summary);
    let both = of(&format!("{TONE}, {WARM_UP}"));
    assert!(
        both.summary.contains(": tone at 13.38 Hz; K × ") && both.summary.ends_with(": warm_up"),
        "{}",
        both.summary
    );
    // Two equal causes: each alone suffices, and neither is necessary.
    let twice = of(&format!("{PROCESS}, {RESONANCE}"));
    assert_eq!(twice.causes.len(), 2);
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(24))]

    /// Whatever the sizes of white noise and walk: the pair is found again, and larger noise has a larger pair.
    #[test]
    fn pairs_follow_the_sizes_of_the_noise(
        n in 1e-6_f64..1e-2,
        ratio in 1e-3_f64..3.0,
        flicker in 0.0_f64..30.0,
        rate_hz in 20.0_f64..400.0,
        align_s in 1.0_f64..300.0,
        to_s in 5.0_f64..300.0,
    ) {
        let k = n * ratio;
        let over = Some(Over { from_s: 0.1, to_s });
        let request = FilterRequest { over, align_s, ..FilterRequest::default() };
        let pair = |scale: f64, b: f64| {
            let (n, k) = (scale * n, scale * k);
            let model = model_at(rate_hz, &format!(r#"{{"N": {n:e}, "K": {k:e}, "B": {b:e}}}"#));
            found(&model, &request).channels[&Channel::GyroZ].white_and_walk.clone()
        };
        let plain = pair(1.0, 0.0).fit;
        is_close(plain.n, n, 1e-5);
        is_close(plain.k.unwrap(), k, 1e-5);
        let (one, twice) = (pair(1.0, flicker * k), pair(2.0, 2.0 * flicker * k));
        for (one, twice) in [(&one.fit, &twice.fit), (&one.cover, &twice.cover)] {
            is_close(twice.n, 2.0 * one.n, 1e-4);
            is_close(twice.k.unwrap(), 2.0 * one.k.unwrap(), 1e-4);
        }
        proptest::prop_assert!(one.fit.k.unwrap() >= k * (1.0 - 1e-6));
        proptest::prop_assert!(one.cover.worst_ratio.unwrap() < 1.0 + 1e-6);
    }
}

/// The horizons of a grid ten times as fine, and every sample at the short end.
fn between(over: Over, rate_hz: f64) -> Vec<f64> {
    let (from, to) = ((over.from_s * rate_hz).round(), (over.to_s * rate_hz).round());
    let steps = (50.0 * (to / from).log10()).ceil();
    let spread = (0..=steps as usize).map(|k| (from * (to / from).powf((k as f64 + 0.37) / (steps + 1.0))).round());
    let mut all: Vec<f64> = spread.chain((from as u64..=(to as u64).min(from as u64 + 60)).map(|k| k as f64)).collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    all.iter().map(|samples| samples / rate_hz).collect()
}

/// The real root mean square at the given horizons, by the closed forms of the cost, which have grids of their own.
fn by_cost(model: &SensorModel, horizons_s: Vec<f64>) -> Vec<f64> {
    let request = crate::Request { horizons_s, ..crate::Request::default() };
    crate::cost(model, "t", &request).unwrap().quantities[&crate::Quantity::Heading].sd.clone()
}

fn predicted(n: f64, k: f64, horizons_s: Vec<f64>) -> Vec<f64> {
    by_cost(&model_at(40.0, &format!(r#"{{"N": {n}, "K": {k}}}"#)), horizons_s)
}

#[test]
fn the_covering_pair_covers_at_every_horizon() {
    let over = Over { from_s: 0.1, to_s: 100.0 };
    for effects in [
        TONE,
        RESONANCE,
        PROCESS,
        r#"{"effect": "tone", "frequency_hz": 0.31, "amplitude": 2e-3}"#,
        r#"{"effect": "tone", "frequency_hz": 13.38, "amplitude": 0.2}"#,
        r#"{"effect": "quantization_noise", "Q": 1e-5}"#,
        r#"{"effect": "power_law", "alpha": 1.4, "at_hz": 1, "density": 1e-8}"#,
    ] {
        let model = with(effects);
        let of = parameters(&model).white_and_walk;
        let horizons_s = between(over, 40.0);
        let real = by_cost(&model, horizons_s.clone());
        let cover = predicted(of.cover.n, of.cover.k.unwrap(), horizons_s.clone());
        let fit = predicted(of.fit.n, of.fit.k.unwrap(), horizons_s.clone());
        let ratio = |predicted: &[f64]| {
            real.iter().zip(predicted).map(|(real, predicted)| real / predicted).fold(0.0, f64::max)
        };
        assert!(ratio(&cover) <= 1.0 + 1e-5, "{effects}: {}", ratio(&cover));
        assert!(ratio(&fit) <= of.fit.worst_ratio.unwrap() + 1e-3, "{effects}: {}", ratio(&fit));
        assert!(of.cover.divergence.unwrap() >= of.fit.divergence.unwrap());
    }
}

/// A family and a real covariance of 13 horizons.
fn seen(effects: &str) -> (Grid, Vec<f64>, Family) {
    let (model, request) = (with(effects), FilterRequest::default());
    let asked = Asked::new(&request, &model).unwrap();
    let grid = Grid::new(asked.over, 40.0, |_| Vec::new()).unwrap();
    let sources = vec![ChannelSources::new(&model, Channel::GyroZ).unwrap()];
    let (known, real) = errors(&asked, &grid, &sources).unwrap();
    let family = Family::new(&grid, &known.white, &known.walk).unwrap();
    (grid, real[0].without(None), family)
}

#[test]
fn the_closest_pair_is_the_closest_on_a_grid() {
    for effects in [TONE, WARM_UP, PROCESS, RESONANCE] {
        let (grid, real, family) = seen(effects);
        let seen = family.seen(&grid, &real);
        let closest = family.closest(&seen);
        let cover = family.covering(closest, &seen);
        let best = family.distance(closest, &seen);
        let mut covering = f64::INFINITY;
        for i in -200..=200 {
            for j in -200..=200 {
                let of = |centre: f64, k: i32| centre * (f64::from(k) * 0.02).exp();
                let near = Variances { white: of(closest.white, i), second: of(closest.second, j) };
                assert!(family.distance(near, &seen) >= best - 1e-9, "{effects}: {near:?} {closest:?}");
                let near = Variances { white: of(cover.white, i), second: of(cover.second, j) };
                if family.shortfall(near, &seen).0 <= 1.0 {
                    covering = covering.min(family.distance(near, &seen));
                }
            }
        }
        let own = family.distance(cover, &seen);
        assert!(own <= covering + 1e-2, "{effects}: {own} {covering} {cover:?}");
        assert!(family.shortfall(cover, &seen).0 <= 1.0 + 1e-6, "{effects}");
    }
}

#[test]
fn joint_moments_are_those_of_the_listed_weights() {
    let (rate_hz, align) = (10.0, 50_u64);
    let grid = Grid::new(Over { from_s: 0.2, to_s: 20.0 }, rate_hz, |_| Vec::new()).unwrap();
    let (rule, panels) = (Rule::new(), octaves(rate_hz, 250.0, &[]));
    let nodes: Vec<f64> = panels.iter().flat_map(|panel| rule.nodes(*panel)).collect();
    let walk: Vec<f64> = nodes.iter().map(|hz| (2.0 * rate_hz * (PI * hz / rate_hz).sin()).powi(-2)).collect();
    let found = of_densities(&rule, &panels, rate_hz, align, &grid, &[vec![1.0; nodes.len()], walk]);
    let line = of_line(Line { frequency_hz: 1.7, power: 0.5 }, rate_hz, align, &grid);
    let weights = |place: usize| -> Vec<f64> {
        let horizon = grid.horizons[place] as usize;
        let level = -(horizon as f64) / align as f64;
        let after = (0..grid.horizons[grid.horizons.len() - 1] as usize).map(|k| f64::from(u8::from(k < horizon)));
        std::iter::repeat_n(level, align as usize).chain(after).collect()
    };
    for (index, [one, other]) in grid.pairs.iter().enumerate() {
        let (one, other) = (weights(*one), weights(*other));
        let dot = |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(one, other)| one * other).sum::<f64>();
        let later = |of: &[f64]| -> Vec<f64> {
            let mut sum = 0.0;
            of.iter()
                .rev()
                .map(|weight| {
                    sum += weight;
                    sum
                })
                .collect()
        };
        let white = dot(&one, &other) / rate_hz;
        assert!((found[0][index] - white).abs() < 1e-7 * (dot(&one, &one) * dot(&other, &other)).sqrt() / rate_hz);
        let (one_sum, other_sum) = (later(&one), later(&other));
        let walked = dot(&one_sum, &other_sum) / rate_hz.powi(3);
        let size = (dot(&one_sum, &one_sum) * dot(&other_sum, &other_sum)).sqrt() / rate_hz.powi(3);
        assert!((found[1][index] - walked).abs() < 1e-7 * size, "{} {walked}", found[1][index]);
        let wave = |of: &[f64], wave: fn(f64) -> f64| -> f64 {
            of.iter().enumerate().map(|(k, weight)| weight * wave(TAU * 1.7 * k as f64 / rate_hz)).sum()
        };
        let product = wave(&one, f64::cos) * wave(&other, f64::cos) + wave(&one, f64::sin) * wave(&other, f64::sin);
        let expected = 0.5 * product / (rate_hz * rate_hz);
        if index < grid.joint_pairs() {
            assert!((line[index] - expected).abs() < 1e-9, "{} {expected}", line[index]);
        } else {
            assert!(line[index] >= expected - 1e-9, "{} {expected}", line[index]);
        }
    }
}

#[test]
fn a_record_has_the_moments_of_its_windows() {
    let grid = Grid::new(Over { from_s: 1.0, to_s: 8.0 }, 1.0, |_| Vec::new()).unwrap();
    let windows = Windows::new(40, 4, &grid);
    let value = |k: u64| 0.3 + 1e-2 * (k * k % 11) as f64;
    let mut taken = 0;
    let found = windows.moments(1.0, &grid, || {
        taken += 1;
        value(taken - 1)
    });
    for (moment, [one, other]) in found.iter().zip(&grid.pairs) {
        let integral = |start: u64, place: usize| {
            let horizon = grid.horizons[place];
            let level = (start..start + 4).map(value).sum::<f64>() / 4.0;
            (start + 4..start + 4 + horizon).map(|k| value(k) - level).sum::<f64>()
        };
        let mean = (0..=28).map(|start| integral(start, *one) * integral(start, *other)).sum::<f64>() / 29.0;
        assert!((moment - mean).abs() < 1e-12, "{moment} {mean}");
    }
}

/// A line of a third of a second in eight hours has the same part wherever it lies. White noise that covers it alone has an N of
/// 4.6e-4, by sums over all windows (numpy).
#[test]
fn a_short_line_has_the_same_part_wherever_it_lies() {
    let covers = [10_000.0, 10_003.0, 10_005.0].map(|from: f64| {
        let to = from + 0.3;
        let gated = format!(
            r#"{{"effect": "intermittent", "of": {{"effect": "tone", "frequency_hz": 5.3, "amplitude": 1.0}}, "intervals": [[{from}, {to}]]}}"#
        );
        let sensor = model_at(40.0, &format!(r#"{{"N": 1e-4, "K": 1e-6, "effects": [{gated}]}}"#));
        let of = found(&sensor, &FilterRequest { record_s: Some(28_800.0), ..request() }).channels[&Channel::GyroZ].clone();
        of.white.cover.n
    });
    for n in covers {
        assert!((n / covers[0] - 1.0).abs() < 0.02 && (n / 4.61e-4 - 1.0).abs() < 0.03, "{covers:?}");
    }
}

/// Memory does not grow with the record's length.
#[test]
fn a_record_of_months_gets_windows_that_are_apart_and_a_note() {
    let gated = r#"{"effect": "intermittent", "of": {"effect": "tone", "frequency_hz": 0.4, "amplitude": 1e-3}, "intervals": [[100, 5000]]}"#;
    let of = |record_s: f64| {
        let over = Some(Over { from_s: 1.0, to_s: 10.0 });
        found(
            &model_at(40.0, &format!(r#"{{"N": {N}, "effects": [{gated}]}}"#)),
            &FilterRequest { record_s: Some(record_s), over, ..request() },
        )
    };
    assert!(of(86_400.0).notes.is_empty());
    let notes = of(600_000.0).notes;
    assert!(notes.iter().any(|note| note.contains("gyro_z") && note.contains("150 s")), "{notes:?}");
}

/// The root mean square of windows at any time of simulated records, at fourteen horizons. The figures of docs/filters.md:
/// `cargo test -p imu-cost -- --nocapture real_errors_are`.
#[test]
fn real_errors_are_those_of_the_simulator() {
    println!("| beside N and K | runs | largest deviation |\n|---|---|---|");
    let gated = r#"{"effect": "intermittent", "of": {"effect": "tone", "frequency_hz": 0.4, "amplitude": 1e-3}"#;
    for (name, effects, seeds) in [
        ("tone", TONE.to_owned(), 6),
        ("warm_up", WARM_UP.to_owned(), 6),
        ("gauss_markov", PROCESS.to_owned(), 30),
        ("bursts", r#"{"effect": "bursts", "intervals": [[100, 160], [400, 410]], "sigma": 2e-2}"#.to_owned(), 300),
        ("tone inside intervals", format!(r#"{gated}, "intervals": [[100, 400]]}}"#), 20),
        ("tone at random times (simulated)", format!(r#"{gated}, "on_s": 20, "off_s": 40}}"#), 30),
    ] {
        let request = FilterRequest {
            over: Some(Over { from_s: 0.1, to_s: 30.0 }),
            align_s: 10.0,
            record_s: Some(900.0),
            ..request()
        };
        let model = with(&effects);
        let all = found(&model, &request);
        let of = &all.channels[&Channel::GyroZ];
        let mut sums = vec![0.0; all.horizons_s.len()];
        let mut count = 0.0;
        for seed in 0..seeds {
            let mut simulator = Simulator::new(&model, 1000 + seed, 40.0, 900.0).unwrap();
            let mut values = Vec::new();
            while let Some(block) = simulator.next_block().filter(|_| values.len() < 36_000) {
                values.extend_from_slice(block.values(Channel::GyroZ).unwrap());
            }
            let mut sum = vec![0.0];
            values.iter().for_each(|value| sum.push(sum[sum.len() - 1] + value / 40.0));
            for start in (0..values.len() - 1600).step_by(80) {
                let level = (sum[start + 400] - sum[start]) / 10.0;
                count += 1.0;
                for (square, horizon_s) in sums.iter_mut().zip(&all.horizons_s) {
                    let error =
                        sum[start + 400 + (horizon_s * 40.0).round() as usize] - sum[start + 400] - level * horizon_s;
                    *square += error * error;
                }
            }
        }
        let mut largest = 0.0_f64;
        for ((square, horizon_s), sd) in sums.iter().zip(&all.horizons_s).zip(&of.real_sd) {
            let simulated = f64::sqrt(square / count);
            largest = largest.max((simulated / sd - 1.0).abs());
            assert!((simulated / sd - 1.0).abs() < 0.1, "{effects} at {horizon_s} s: {sd}, simulated {simulated}");
        }
        println!("| {name} | {seeds} | {:.1} % |", 100.0 * largest);
    }
}

#[test]
fn senseless_ranges_are_refused_with_what_is_allowed() {
    let refusal = |text: &str| Over::parse(text).unwrap_err().to_string();
    for text in ["100s..0.1s", "1s..1s", "0s..10s", "-1s..10s", "..", "1s", "1..10", "1s..", "a..b"] {
        let words = refusal(text);
        assert!(words.contains(&format!("the range `{text}`: expected")), "{words}");
    }
    assert_eq!(Over::parse("0.1s..100s").unwrap(), Over { from_s: 0.1, to_s: 100.0 });
    let plain = with("");
    let asked = |from_s: f64, to_s: f64| {
        filter_parameters(&plain, "t", &FilterRequest { over: Some(Over { from_s, to_s }), ..request() })
    };
    assert!(matches!(asked(f64::NAN, 1.0), Err(FilterError::Range { .. })));
    assert!(matches!(asked(1.0, f64::INFINITY), Err(FilterError::Range { .. })));
    assert!(matches!(asked(0.001, 1.0), Err(FilterError::Short { .. })));
    assert!(matches!(asked(1.0, 1.01), Err(FilterError::Narrow { .. })));
    assert!(matches!(asked(1.0, 1e9), Err(FilterError::Cost(_))));
    let wide = asked(0.1, 1e6).unwrap_err().to_string();
    assert!(wide.contains("at most 100000 s, 1e6 times its begin"), "{wide}");
    let narrow = asked(0.1, 0.12).unwrap_err().to_string();
    assert!(narrow.contains("(2 of 3): expected an end of 0.15 s or later") && asked(0.1, 0.15).is_ok(), "{narrow}");
    let record = FilterRequest { record_s: Some(0.0), ..request() };
    assert!(matches!(filter_parameters(&plain, "t", &record), Err(FilterError::Record { .. })));
    let align = FilterRequest { align_s: -1.0, ..request() };
    assert!(matches!(filter_parameters(&plain, "t", &align), Err(FilterError::Cost(_))));
    let mag = SensorModel { channels: [(Channel::MagX, plain.channels[&Channel::GyroZ].clone())].into(), ..plain };
    let error = filter_parameters(&mag, "t", &request()).unwrap_err().to_string();
    assert!(error.contains("gyro_x, gyro_y, gyro_z, accel_x"), "{error}");
}

#[test]
fn a_range_beyond_the_record_is_an_extrapolation() {
    let mut model = with(WARM_UP);
    let plain = found(&model, &request());
    assert_eq!((plain.record_from, plain.record_s, plain.extrapolated), (RecordFrom::Assumed, 3600.0, false));
    model.provenance = Some([("duration_s".to_owned(), 60.0.into())].into_iter().collect());
    let short = found(&model, &request());
    assert_eq!((short.record_from, short.record_s, short.extrapolated), (RecordFrom::Model, 130.0, true));
    assert!(short.notes[0].contains("extrapolation"), "{:?}", short.notes);
    let stated = found(&model, &FilterRequest { record_s: Some(7200.0), ..request() });
    assert_eq!((stated.record_from, stated.extrapolated), (RecordFrom::Request, false));
}

/// Rates, ranges and sizes at the ends of what users have.
#[test]
fn odd_sensors_and_ranges_have_finite_answers() {
    let strong = r#"{"effect": "tone", "frequency_hz": 0.41, "amplitude": 2}"#;
    for (rate_hz, channel) in [
        (1.0, r#"{"N": 1e-4, "K": 1e-6}"#.to_owned()),
        (800.0, format!(r#"{{"N": 1e-4, "effects": [{TONE}]}}"#)),
        (40.0, format!(r#"{{"N": 1e-4, "effects": [{strong}]}}"#)),
        (40.0, format!(r#"{{"effects": [{strong}]}}"#)),
        (40.0, format!(r#"{{"effects": [{WARM_UP}]}}"#)),
        (40.0, format!(r#"{{"effects": [{WARM_UP}, {{"effect": "bias_step", "at_s": 100, "size": 1}}]}}"#)),
        (40.0, r#"{"N": 1e-4, "effects": [{"effect": "saturation", "low": -1e-3, "high": 2e-4}]}"#.to_owned()),
        (40.0, r#"{"N": 1e-4, "effects": [{"effect": "held_samples", "probability": 0.4}]}"#.to_owned()),
        (40.0, r#"{"N": 1e-4, "effects": [{"effect": "moving_average", "window": 8}]}"#.to_owned()),
        (40.0, r#"{"B": 1e-5}"#.to_owned()),
    ] {
        let of = parameters(&model_at(rate_hz, &channel));
        let cover = &of.white_and_walk.cover;
        assert!(cover.worst_ratio.unwrap() < 1.0 + 1e-4, "{channel}: {cover:?}");
        assert!(of.gauss_markov.cover.worst_ratio.unwrap() < 1.0 + 1e-4, "{channel}: {:?}", of.gauss_markov.cover);
        assert!(of.white.cover.worst_ratio.unwrap() < 1.0 + 1e-4, "{channel}: {:?}", of.white);
        let text = serde_json::to_string(&of).unwrap();
        assert!(!text.contains("NaN"), "{text}");
    }
    for to_s in [7200.0, 25_000.0] {
        let long = FilterRequest { over: Some(Over { from_s: 0.025, to_s }), ..request() };
        let of = found(&with(""), &long).channels[&Channel::GyroZ].white_and_walk.fit.clone();
        is_close(of.n, N, 1e-4);
        is_close(of.k.unwrap(), K, 1e-4);
    }
}
