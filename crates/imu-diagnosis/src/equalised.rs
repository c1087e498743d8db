//! Equalised: makes the white noise of a series even if its variance changes with time.

use super::equaliser::Equaliser;
use super::filling::stream;
use super::phase;
use super::series::Series;

/// The random stream of the draws.
const DRAWN: u16 = 7;

impl Series<'_> {
    /// Returns whether the law is about as high as the record where the record is white. Draws would separate a filter
    /// that is not known yet from the white noise, until no white noise is left.
    fn law_is_even(&self) -> bool {
        const BANDS: usize = 8;
        /// Range of the ratio of the record's power to the law's.
        const ABOUT: std::ops::Range<f64> = 0.6..1.6;
        /// Deviations of a band's mean up to this many standard errors are chance.
        const ERRORS: f64 = 3.0;
        let high = self.len() / 2;
        let places = self.coefficients[high..].iter().zip(&self.spectrum[high..]);
        let ratios: Vec<f64> = places.map(|(c, s)| c * c / s).collect();
        let size = ratios.len().div_ceil(BANDS).max(1);
        let mut means: Vec<f64> =
            ratios.chunks(size).map(|band| band.iter().sum::<f64>() / band.len() as f64).collect();
        // One of the bands may hold a line that is not known yet.
        means.sort_unstable_by(f64::total_cmp);
        // An uneven variance leaves this many of a band's coefficients independent.
        let variance = self.variances();
        let (sum, square) = variance.iter().fold((0.0, 0.0), |(sum, square), v| (sum + v, square + v * v));
        let count = size as f64 * sum * sum / (square * variance.len().max(1) as f64);
        let slack = if count > 0.0 { ERRORS * (2.0 / count).sqrt() } else { 0.0 };
        let about = ABOUT.start - slack..ABOUT.end + slack;
        means.iter().take(BANDS - 2).all(|mean| about.contains(mean))
    }

    /// Makes the white noise of the rest even if its variance is known to change and the law is even.
    pub(super) fn equalise(&mut self) {
        /// Variances that differ by at least this ratio are uneven.
        const UNEVEN: f64 = 2.0;
        /// The largest ratio behind filters, where conjugate gradients take about its root as many rounds.
        const UNEVEN_BEHIND: f64 = 1000.0;
        let n = self.len();
        let before = self.equaliser.take();
        let variance = self.variances();
        let (least, most) = variance.iter().fold((f64::MAX, 0.0f64), |(l, m), v| (l.min(*v), m.max(*v)));
        let is_uneven = most > UNEVEN * least && least > 0.0 && most.is_finite();
        if !is_uneven || self.is_unsolved || self.spectrum.len() != n || !self.censored.is_empty() {
            return;
        }
        let mut squares = self.filters().unwrap_or_default();
        if !self.law_is_even() || (!squares.is_empty() && most > UNEVEN_BEHIND * least) {
            return;
        }
        let white = self.white();
        let mut deviation: Vec<f64> = variance.iter().map(|v| white * v.sqrt()).collect();
        // Excluded samples carry no information. Behind filters, draws from the law that agree with the samples about them
        // take their place.
        if squares.is_empty() {
            for place in self.excluded() {
                deviation[place] = Equaliser::UNKNOWN * white * most.sqrt();
            }
        } else {
            self.interpolate();
        }
        // The gain of a constant is not known.
        if let [first, second, ..] = squares.as_mut_slice() {
            *first = *second;
        }
        // A constant is not noise and is not divided.
        let weights = deviation.iter().map(|own| 1.0 / (own * own));
        let (sum, all) = self.rest.iter().zip(weights).fold((0.0, 0.0), |(sum, all), (x, w)| (sum + w * x, all + w));
        let mean = sum / all;
        self.mean += mean;
        self.rest.iter_mut().for_each(|value| *value -= mean);
        let passed = |at: usize| squares.get(at).copied().unwrap_or(1.0);
        let other = |(at, s): (usize, &f64)| (s - white * white * passed(at)).max(0.0);
        let mut rest: Vec<f64> = self.spectrum.iter().enumerate().map(other).collect();
        // The mean is unknown.
        rest[0] = rest[1];
        let gain: Vec<f64> = squares.iter().map(|square| square.sqrt()).collect();
        let mut equaliser = Equaliser { deviation, white, rest, gain, squares, solution: Vec::new() };
        let mut stream = stream(n, self.setting().owner, DRAWN);
        let mut slow: Vec<f64> = equaliser.rest.iter().map(|s| s.sqrt() * stream.normal()).collect();
        slow[0] = 0.0;
        self.transform.backward(&mut slow);
        let fast: Vec<f64> = (0..n).map(|_| stream.normal()).collect();
        let own = fast.iter().zip(&equaliser.deviation).map(|(fast, own)| own * fast).collect();
        let mut drawn = equaliser.behind(&mut self.transform, own);
        drawn.iter_mut().zip(&slow).for_each(|(drawn, slow)| *drawn += slow);
        phase::redo(&mut drawn, &equaliser.squares);
        let mut difference: Vec<f64> = self.rest.iter().zip(drawn).map(|(x, drawn)| x - drawn).collect();
        phase::undo(&mut difference, &equaliser.squares);
        let near = before.as_ref().map(|before| before.solution.as_slice());
        let Some(solution) = equaliser.solve(&mut self.transform, &difference, near) else {
            self.is_unsolved = true;
            return;
        };
        let known = equaliser.even(&mut self.transform, &difference, &solution);
        let fast = equaliser.behind(&mut self.transform, fast.iter().map(|fast| white * fast).collect());
        self.rest = known.iter().zip(&slow).zip(&fast).map(|((known, slow), fast)| known + slow + fast).collect();
        phase::redo(&mut self.rest, &equaliser.squares);
        equaliser.solution = solution;
        self.equaliser = Some(equaliser);
    }
}
