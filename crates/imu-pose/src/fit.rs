//! Fit: Gauss-Newton steps over windows of time with bounded weights, and errors from parts of the record left out in turn.
//!
//! A fit to a sensor's own noise would find numbers that remove it (regression dilution). Windows may therefore have instruments:
//! the residuals are made orthogonal to what the reference alone gives.
//!
//! # Source
//! Instrumental variables: Söderström and Stoica 1983. Huber's weights (1964); the delete-one-block jackknife (Künsch 1989) with Student's quantile.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF as _, StudentsT};

/// A window's residual beyond this many standard deviations counts less.
const HUBER: f64 = 3.0;
const STEPS_MAX: usize = 25;
/// Parts of the record that are left out in turn.
const BLOCKS_MAX: usize = 24;
const BLOCKS_MIN: usize = 4;
/// Longer parts that are left out in turn as well: what changes slowly shows between them alone.
const LONG_BLOCKS: usize = 6;
/// Windows in a block.
const OF_A_BLOCK: usize = 8;

/// What one window of time has beyond the model, and how that changes with each number.
#[derive(Debug, Clone)]
pub(crate) struct Window {
    pub(crate) middle_s: f64,
    pub(crate) residual: DVector<f64>,
    /// A row for each residual, a column for each number.
    pub(crate) jacobian: DMatrix<f64>,
    /// The Jacobian as the reference's motion gives it, without the sensor's noise; `None` if that does not matter.
    pub(crate) instruments: Option<DMatrix<f64>>,
}

/// What is known of a number before the fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Prior {
    pub(crate) mean: f64,
    pub(crate) sd: f64,
}

/// A part of the record: what a sensor without deviations would leave there beyond the fit, and what numbers fitted to all other parts
/// explain of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Part {
    /// The beginning on the reference's clock, s.
    pub from_s: f64,
    /// The end, s.
    pub to_s: f64,
    /// The whole, nats.
    pub nats: f64,
    /// The explained part, nats.
    pub explained: f64,
}

/// How windows are assigned to parts of the record, and what is known of their residuals.
#[derive(Debug, Clone, Default)]
pub(crate) struct Design {
    /// The part of each window, from 0; empty: consecutive windows are a part.
    pub(crate) parts: Vec<usize>,
    /// The least standard deviation of a residual.
    pub(crate) least: f64,
    /// Whether no part is left out: each is needed.
    pub(crate) is_whole: bool,
}

impl Design {
    /// Returns the number of parts of `windows` windows.
    fn count(&self, windows: usize) -> usize {
        let consecutive = (windows / OF_A_BLOCK).clamp(BLOCKS_MIN, BLOCKS_MAX);
        self.parts.iter().max().map_or(consecutive, |last| last + 1)
    }

    /// Returns the part of a window.
    fn part(&self, place: usize, windows: usize) -> usize {
        self.parts.get(place).copied().unwrap_or_else(|| place * self.count(windows) / windows)
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Solution {
    pub(crate) numbers: DVector<f64>,
    /// The numbers without each part of the record in turn.
    pub(crate) without: Vec<DVector<f64>>,
    /// The same with few, longer parts; empty if the parts are given.
    without_long: Vec<DVector<f64>>,
    /// The covariance that independent residuals would give.
    pub(crate) formal: DMatrix<f64>,
    pub(crate) windows: Vec<Window>,
    /// The standard deviation of each component of the residual, from its median deviation.
    pub(crate) scales: Vec<f64>,
    /// Residuals less numbers.
    freedom: f64,
    design: Design,
    priors: Vec<Prior>,
    /// How the numbers change with one standard deviation of each independent thing that the fit takes as known.
    pub(crate) borrowed: Vec<DVector<f64>>,
}

impl Solution {
    /// Takes an estimated bias out of the numbers. It counts as an error that may remain.
    pub(crate) fn less(&mut self, bias: &DVector<f64>) {
        let all = self.without.iter_mut().chain(&mut self.without_long);
        all.chain(std::iter::once(&mut self.numbers)).for_each(|numbers| *numbers -= bias);
        self.borrowed.push(bias.clone());
    }
}

/// Fits numbers to windows. `make` returns the windows at these numbers. `None` without windows.
pub(crate) fn solve(make: &dyn Fn(&DVector<f64>) -> Vec<Window>, priors: &[Prior]) -> Option<Solution> {
    solve_by(make, priors, Design::default())
}

/// Fits numbers to windows as [`solve`] does, with parts of the record that are given.
pub(crate) fn solve_by(
    make: &dyn Fn(&DVector<f64>) -> Vec<Window>,
    priors: &[Prior],
    design: Design,
) -> Option<Solution> {
    let mut numbers = DVector::from_iterator(priors.len(), priors.iter().map(|prior| prior.mean));
    let mut windows = make(&numbers);
    for _ in 0..STEPS_MAX {
        let scales = scales(&windows, priors.len(), design.least)?;
        let sums = sums(&windows, &scales, priors, &numbers, &design);
        let inverse = sums.normal.try_inverse()?;
        let formal = &inverse * sums.noise * inverse.transpose();
        let step = -(&inverse * sums.slope);
        numbers += &step;
        windows = make(&numbers);
        let settled = (0..priors.len()).all(|at| step[at].abs() < 1e-3 * formal[(at, at)].abs().sqrt());
        if settled {
            break;
        }
    }
    let scales = scales(&windows, priors.len(), design.least)?;
    let sums = sums(&windows, &scales, priors, &numbers, &design);
    let inverse = sums.normal.clone().try_inverse()?;
    let formal = &inverse * &sums.noise * inverse.transpose();
    let parts = sums.parts.iter().filter(|_| !design.is_whole);
    let left_out =
        |(own, slope): &(DMatrix<f64>, DVector<f64>)| Some(&numbers + (&sums.normal - own).lu().solve(slope)?);
    let without = parts.filter_map(left_out).collect();
    let is_given = design.is_whole || !design.parts.is_empty() || sums.parts.len() < 2 * LONG_BLOCKS;
    let long = sums.parts.chunks(sums.parts.len().div_ceil(LONG_BLOCKS)).map(|of| {
        let add = |(normal, slope): (DMatrix<f64>, DVector<f64>), of: &(DMatrix<f64>, DVector<f64>)| {
            (normal + &of.0, slope + &of.1)
        };
        of[1..].iter().fold(of[0].clone(), add)
    });
    let without_long = long.filter(|_| !is_given).filter_map(|of| left_out(&of)).collect();
    let freedom = freedom(&windows, priors.len());
    Some(Solution {
        numbers,
        without,
        without_long,
        formal,
        windows,
        scales,
        freedom,
        design,
        priors: priors.to_vec(),
        borrowed: Vec::new(),
    })
}

/// Returns the number of residuals less that of the numbers, at least 1.
fn freedom(windows: &[Window], numbers: usize) -> f64 {
    let residuals: usize = windows.iter().map(|window| window.residual.len()).sum();
    residuals.saturating_sub(numbers).max(1) as f64
}

/// Returns the 97.5 % point of Student's distribution.
pub(crate) fn student(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom).map_or(12.7, |student| student.inverse_cdf(0.975))
}

/// Returns 1.48 times the median deviation of each component, widened by the numbers that were fitted to few residuals.
fn scales(windows: &[Window], numbers: usize, least: f64) -> Option<Vec<f64>> {
    let count = windows.first()?.residual.len();
    let widened = ((count * windows.len()) as f64 / freedom(windows, numbers)).sqrt();
    let scale = |component: usize| {
        let mut sizes: Vec<f64> = windows.iter().map(|window| window.residual[component].abs()).collect();
        let middle = sizes.len() / 2;
        (1.4826 * widened * *sizes.select_nth_unstable_by(middle, f64::total_cmp).1).max(least.max(1e-12))
    };
    Some((0..count).map(scale).collect())
}

/// Returns a window's weight, and its distance in standard deviations.
pub(crate) fn weight(window: &Window, scales: &[f64]) -> (f64, f64) {
    let squares: f64 = window.residual.iter().zip(scales).map(|(value, scale)| (value / scale).powi(2)).sum();
    let distance = (squares / scales.len() as f64).sqrt();
    ((HUBER / distance).min(1.0), distance)
}

/// Sums over windows of what the instruments meet.
struct Sums {
    /// Instruments times Jacobian, and the priors' weights.
    normal: DMatrix<f64>,
    /// Instruments times residuals, and the priors'.
    slope: DVector<f64>,
    /// Instruments times instruments, and the priors' weights.
    noise: DMatrix<f64>,
    /// The first two of each part of the record.
    parts: Vec<(DMatrix<f64>, DVector<f64>)>,
}

fn sums(windows: &[Window], scales: &[f64], priors: &[Prior], numbers: &DVector<f64>, design: &Design) -> Sums {
    let count = priors.len();
    let mut parts = vec![(DMatrix::zeros(count, count), DVector::zeros(count)); design.count(windows.len())];
    let mut noise = DMatrix::zeros(count, count);
    for (place, window) in windows.iter().enumerate() {
        let (weight, _) = weight(window, scales);
        let (normal, slope) = &mut parts[design.part(place, windows.len())];
        let instruments = window.instruments.as_ref().unwrap_or(&window.jacobian);
        for (row, scale) in scales.iter().enumerate() {
            let [by, of] = [instruments, &window.jacobian].map(|of| of.row(row).transpose());
            let factor = weight / (scale * scale);
            normal.ger(factor, &by, &of, 1.0);
            noise.ger(factor, &by, &by, 1.0);
            slope.axpy(factor * window.residual[row], &by, 1.0);
        }
    }
    let mut normal = DMatrix::zeros(count, count);
    let mut slope = DVector::zeros(count);
    for (own, of) in &parts {
        normal += own;
        slope += of;
    }
    for (at, prior) in priors.iter().enumerate() {
        let weight = prior.sd.powi(-2);
        normal[(at, at)] += weight;
        noise[(at, at)] += weight;
        slope[at] += weight * (numbers[at] - prior.mean);
    }
    Sums { normal, slope, noise, parts }
}

impl Solution {
    /// Returns the standard deviation of a function of the numbers, and the factor of its 95 % interval. The widest of three intervals
    /// counts: by the scatter without each part of the record in turn, without each of few long parts, and by independent residuals.
    pub(crate) fn spread(&self, of: &dyn Fn(&DVector<f64>) -> f64) -> (f64, f64) {
        let middle = of(&self.numbers);
        let slopes = DVector::from_iterator(
            self.numbers.len(),
            (0..self.numbers.len()).map(|at| {
                let step = 0.1 * self.formal[(at, at)].sqrt();
                let mut moved = self.numbers.clone();
                moved[at] += step;
                (of(&moved) - middle) / step
            }),
        );
        let formal = (slopes.transpose() * &self.formal * slopes)[(0, 0)];
        let borrowed: f64 = self.borrowed.iter().map(|by| (of(&(&self.numbers + by)) - middle).powi(2)).sum();
        let by_parts = |without: &[DVector<f64>]| {
            let values: Vec<f64> = without.iter().map(of).collect();
            let count = values.len() as f64;
            let mean = values.iter().sum::<f64>() / count.max(1.0);
            let jackknife =
                values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() * (count - 1.0) / count.max(1.0);
            let freedom = if self.design.is_whole { self.freedom } else { (count - 1.0).min(self.freedom).max(1.0) };
            ((jackknife.max(formal) + borrowed).sqrt(), student(freedom))
        };
        let short = by_parts(&self.without);
        if self.without_long.is_empty() {
            return short;
        }
        let long = by_parts(&self.without_long);
        // With few parts, the factor is large: that of independent residuals does not take it.
        let is_wider = long.0 * long.1 > short.0 * short.1 && long.0 * long.0 > formal + borrowed;
        if is_wider { long } else { short }
    }

    /// Returns what one step of the fit adds to the numbers if the residuals change to these, window by window.
    pub(crate) fn step(&self, windows: &[Window]) -> Option<DVector<f64>> {
        let count = self.numbers.len();
        let (mut normal, mut slope) = (DMatrix::zeros(count, count), DVector::zeros(count));
        for (own, other) in self.windows.iter().zip(windows) {
            let (weight, _) = weight(own, &self.scales);
            for (row, scale) in self.scales.iter().enumerate() {
                let by = own.jacobian.row(row).transpose();
                let factor = weight / (scale * scale);
                normal.ger(factor, &by, &by, 1.0);
                slope.axpy(factor * (other.residual[row] - own.residual[row]), &by, 1.0);
            }
        }
        (0..count).for_each(|at| normal[(at, at)] += self.priors[at].sd.powi(-2));
        normal.lu().solve(&slope).map(|step| -step)
    }

    /// Returns vectors whose squares sum to the covariance of the numbers.
    pub(crate) fn deviations(&self) -> Vec<DVector<f64>> {
        let count = self.without.len() as f64;
        let zero = DVector::zeros(self.numbers.len());
        let mean = self.without.iter().fold(zero, |sum, of| sum + of) / count.max(1.0);
        let jackknife = self.without.iter().fold(DMatrix::zeros(self.numbers.len(), self.numbers.len()), |sum, of| {
            let off = of - &mean;
            sum + &off * off.transpose() * ((count - 1.0) / count)
        });
        let larger = if jackknife.trace() > self.formal.trace() { jackknife } else { self.formal.clone() };
        let of = larger.symmetric_eigen();
        let root = |(at, value): (usize, &f64)| of.eigenvectors.column(at) * value.max(0.0).sqrt();
        of.eigenvalues.iter().enumerate().map(root).collect()
    }

    /// Returns the nats of each part of the record beyond the fit.
    pub(crate) fn gap(&self, plain: &[Window]) -> Vec<Part> {
        let blocks = self.without.len();
        let nothing = Part { from_s: f64::INFINITY, to_s: f64::NEG_INFINITY, nats: 0.0, explained: 0.0 };
        let mut found = vec![nothing; blocks];
        let nats = |residual: &DVector<f64>| {
            0.5 * residual.iter().zip(&self.scales).map(|(value, scale)| (value / scale).powi(2)).sum::<f64>()
        };
        let mut at = 0;
        for (place, window) in self.windows.iter().enumerate() {
            // With another lag, other windows have a gap.
            at += plain[at..].iter().take_while(|before| before.middle_s < window.middle_s).count();
            let Some(before) = plain.get(at).filter(|before| before.middle_s == window.middle_s) else { continue };
            let block = self.design.part(place, self.windows.len());
            let held_out = &window.residual + &window.jacobian * (&self.without[block] - &self.numbers);
            let (weight, _) = weight(window, &self.scales);
            let part = &mut found[block];
            part.nats += weight * (nats(&before.residual) - nats(&window.residual));
            part.explained += weight * (nats(&before.residual) - nats(&held_out));
            (part.from_s, part.to_s) = (part.from_s.min(window.middle_s), part.to_s.max(window.middle_s));
        }
        found
    }

    /// Returns the root of the mean square of the residuals over all components.
    pub(crate) fn rms(&self) -> f64 {
        let count = (self.windows.len() * self.scales.len()) as f64;
        let squares: f64 = self.windows.iter().map(|window| window.residual.norm_squared()).sum();
        (squares / count).sqrt()
    }
}
