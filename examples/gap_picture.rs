//! Draws spectra of one channel in several recordings into one picture: a sensor's, its model's, its corrected model's.
//!
//! ```text
//! cargo run --release --example gap_picture -- accel_y 40 real=desk.txt.gz "N, B, K=plain.csv" corrected=better.csv > docs/gap-desk.svg
//! ```

mod axes;

use axes::{Axes, BOTTOM, COLOURS, HEIGHT, LEFT, RIGHT, TOP, WIDTH, ends};
use imu_core::sample::Channel;
use imu_files::recording::{Options, load_columns};
use realfft::RealFftPlanner;
use std::fmt::Write as _;
use std::path::Path;

/// Number of samples of a transform.
const LENGTH: usize = 8192;
/// Number of points of a curve.
const POINTS: usize = 220;

/// Returns frequencies and two-sided densities, by Hann windows that overlap by half (Welch 1967, IEEE Trans. Audio
/// 15).
fn spectrum(values: &[f64], rate_hz: f64) -> Vec<(f64, f64)> {
    let mut planner = RealFftPlanner::<f64>::new();
    let transform = planner.plan_fft_forward(LENGTH);
    let window: Vec<f64> =
        (0..LENGTH).map(|i| (std::f64::consts::PI * (i as f64 + 0.5) / LENGTH as f64).sin().powi(2)).collect();
    let power: f64 = window.iter().map(|w| w * w).sum();
    let (mut sums, mut count) = (vec![0.0; LENGTH / 2 + 1], 0.0);
    let mut output = transform.make_output_vec();
    for start in (0..=values.len().saturating_sub(LENGTH)).step_by(LENGTH / 2) {
        let part = &values[start..start + LENGTH];
        let mean = part.iter().sum::<f64>() / LENGTH as f64;
        let mut input: Vec<f64> = part.iter().zip(&window).map(|(value, w)| (value - mean) * w).collect();
        transform.process(&mut input, &mut output).unwrap_or_else(|error| panic!("{error}"));
        sums.iter_mut().zip(&output).for_each(|(sum, of)| *sum += of.norm_sqr() / (power * rate_hz));
        count += 1.0;
    }
    let step_hz = rate_hz / LENGTH as f64;
    // Below the third line the window shows the removed mean.
    sums.iter().enumerate().skip(3).map(|(k, sum)| (k as f64 * step_hz, sum / count)).collect()
}

/// Returns means over steps of even ratio; the greatest density instead if a step has a line.
fn thinned(of: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let (Some(first), Some(last)) = (of.first(), of.last()) else { return Vec::new() };
    let ratio = (last.0 / first.0).powf(1.0 / POINTS as f64);
    let mut points = Vec::new();
    let mut at = 0;
    while at < of.len() {
        let until = of.partition_point(|(f, _)| *f < of[at].0 * ratio).max(at + 1);
        let part = &of[at..until];
        let n = part.len() as f64;
        let (mean, most) = part.iter().fold((0.0, (0.0, 0.0)), |(mean, most): (f64, (f64, f64)), one| {
            (mean + one.1 / n, if one.1 > most.1 { *one } else { most })
        });
        points.push(if most.1 > 4.0 * mean { most } else { (part[part.len() / 2].0, mean) });
        at = until;
    }
    points
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [channel, rate_hz, curves @ ..] = arguments.as_slice() else {
        panic!("usage: gap_picture CHANNEL RATE_HZ LABEL=RECORDING…");
    };
    let channel = Channel::from_name(channel).unwrap_or_else(|| panic!("{channel} is no channel"));
    let rate_hz: f64 = rate_hz.parse().unwrap_or_else(|error| panic!("{rate_hz}: {error}"));
    let curves: Vec<(&str, Vec<(f64, f64)>)> = curves
        .iter()
        .map(|curve| {
            let (label, file) = curve.split_once('=').unwrap_or_else(|| panic!("{curve} is not LABEL=RECORDING"));
            let options = Options { rate_hz: Some(rate_hz), ..Options::default() };
            let loaded = load_columns(Path::new(file), options).unwrap_or_else(|error| panic!("{file}: {error}"));
            let column = loaded.column(channel).unwrap_or_else(|| panic!("{file} has no {channel}"));
            (label, thinned(&spectrum(&column.values, rate_hz)))
        })
        .collect();
    let all = || curves.iter().flat_map(|(_, points)| points.iter());
    let density = ends(all().map(|point| point.1.sqrt()));
    let axes = Axes { x: ends(all().map(|point| point.0)), y: (density.0 / 1.5, density.1 * 1.5) };
    let mut svg = axes.begin(&format!("Spectra of {channel}"));
    for (row, ((label, points), colour)) in curves.iter().zip(COLOURS).enumerate() {
        let line = axes.line(points.iter().map(|(hz, of)| (*hz, of.sqrt())));
        let at = LEFT + 20.0 + 170.0 * row as f64;
        let _ = write!(
            svg,
            r##"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="1.2"/><path d="M{at} {}h22" stroke="{colour}" stroke-width="3"/><text x="{}" y="{}">{label}</text>"##,
            line,
            TOP + 10.0,
            at + 28.0,
            TOP + 14.0
        );
    }
    let _ = write!(
        svg,
        r##"<text x="{LEFT}" y="24" font-size="14">{channel}: square root of the spectral density</text><text x="{}" y="{}" text-anchor="middle">frequency in Hz</text><text transform="translate(18 {}) rotate(-90)" text-anchor="middle">{}/√Hz</text></svg>"##,
        (WIDTH + LEFT - RIGHT) / 2.0,
        HEIGHT - 18.0,
        (HEIGHT + TOP - BOTTOM) / 2.0,
        channel.unit()
    );
    println!("{svg}");
}
