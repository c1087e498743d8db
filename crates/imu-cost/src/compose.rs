//! Composition: from the channels' contributions to quantities, causes and verdicts.

use crate::band::{Distribution, Spiky, empirical};
use crate::channel::{ChannelErrors, Contribution, Shape};
use crate::courses::squares;
use crate::document::{Cause, Growth, Method};
use crate::monte_carlo;
use crate::quadrature::scale;
use crate::request::{CostError, Quantity, Setting, Share};
use crate::weights::{Span, WhiteSums, factorial};
use imu_core::sample::Channel;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// A quantity's growth and its causes, for the horizons of a setting.
#[derive(Debug)]
pub(crate) struct Composed {
    pub growth: Growth,
    pub causes: Vec<Cause>,
}

/// A contribution to a quantity.
#[derive(Debug, Clone, Copy)]
struct Piece<'a> {
    share: Share,
    of: &'a Contribution,
}

impl Piece<'_> {
    fn mean(&self, place: usize) -> f64 {
        self.share.factor * self.of.mean[place][self.share.order - 1]
    }

    fn variance(&self, place: usize) -> f64 {
        self.share.factor.powi(2) * self.of.variance[place][self.share.order - 1]
    }

    /// Adds the parts that are not normal to a distribution.
    fn shape(&self, setting: &Setting<'_>, place: usize, distribution: &mut Distribution) {
        let variance = self.variance(place);
        let Some(horizon) = setting.horizons.get(place).map(|samples| *samples as f64) else { return };
        if variance <= 0.0 {
            return;
        }
        match self.of.shape {
            Shape::Plain => {
                let peaks = self.of.sines[place][self.share.order - 1].iter();
                distribution.sines.extend(peaks.map(|peak| peak * self.share.factor.abs()).filter(|peak| *peak > 0.0));
            }
            Shape::Spikes { begins, goes_on, amplitude, averaged } => distribution.spikes.push(Spiky {
                begins,
                goes_on,
                amplitude: amplitude * self.share.factor.abs() * scale(self.share.order, setting.rate_hz),
                averaged,
                span: Span { align: setting.align as f64, horizon },
                order: self.share.order,
                variance,
            }),
            Shape::Wanders { .. } => distribution.sines.extend(self.wandering(setting, horizon, variance)),
        }
    }

    /// Returns the peaks of the sines that a wandering line is, over a horizon in samples; the rest of its variance is normal.
    fn wandering(&self, setting: &Setting<'_>, horizon: f64, variance: f64) -> Vec<f64> {
        let Shape::Wanders { sent_hz, power, steady, beta, tc_s } = self.of.shape else { return Vec::new() };
        let (horizon_s, align_s) = (horizon / setting.rate_hz, setting.align as f64 / setting.rate_hz);
        let x = horizon_s.min(align_s) / tc_s;
        let kept = (-2.0 * beta * (x + (-x).exp_m1())).exp();
        let order = self.share.order;
        if order == 1 || kept > 0.5 || sent_hz * horizon_s < 1.0 {
            return vec![(2.0 * steady * kept * variance).sqrt()];
        }
        // A line that is fast compared with the horizon counts where the weights jump: at the alignment's begin and at its
        // end. At each it is a sine of its own phase, whatever it does in between.
        let level = horizon_s.powi(order as i32) / factorial(order) / align_s;
        let begins = horizon_s.powi(order as i32 - 1) / factorial(order - 1);
        let turn = 2.0 * setting.rate_hz * (PI * sent_hz / setting.rate_hz).sin();
        let peaks = [level, level + begins].map(|jump| (2.0 * power).sqrt() * jump / turn * self.share.factor.abs());
        let all: f64 = peaks.iter().map(|peak| 0.5 * peak * peak).sum();
        let scale = (steady * (variance / all).min(1.0)).sqrt();
        peaks.iter().map(|peak| scale * peak).filter(|peak| *peak > 0.0).collect()
    }
}

/// A quantity's pieces and the correlations of noise that its channels share.
#[derive(Debug)]
struct Sum<'a> {
    setting: &'a Setting<'a>,
    pieces: Vec<Piece<'a>>,
    white: Option<&'a [WhiteSums]>,
}

impl Sum<'_> {
    /// Returns the covariance of two different pieces.
    fn covariance(&self, one: &Piece<'_>, other: &Piece<'_>, place: usize) -> f64 {
        let (Some((instance, sign)), Some((same, opposite)), Some(white)) =
            (one.of.common, other.of.common, self.white)
        else {
            return 0.0;
        };
        if instance != same || one.share.channel == other.share.channel {
            return 0.0;
        }
        let orders = [one.share.order - 1, other.share.order - 1];
        let sums = &white[place];
        let correlation =
            sums.products[orders[0].min(orders[1])] / (sums.squares[orders[0]] * sums.squares[orders[1]]).sqrt();
        let sign = sign * opposite * (one.share.factor * other.share.factor).signum();
        sign * correlation * (one.variance(place) * other.variance(place)).sqrt()
    }

    /// Returns the distribution of the sum of the pieces that `keep` chooses.
    fn distribution(&self, place: usize, keep: impl Fn(&Piece<'_>) -> bool) -> Distribution {
        let kept: Vec<&Piece<'_>> = self.pieces.iter().filter(|piece| keep(piece)).collect();
        let mut all = Distribution::default();
        let mut variance = 0.0;
        for (index, piece) in kept.iter().enumerate() {
            all.mean += piece.mean(place);
            variance += piece.variance(place);
            variance += kept[..index].iter().map(|other| 2.0 * self.covariance(piece, other, place)).sum::<f64>();
            piece.shape(self.setting, place, &mut all);
        }
        all.normal = (variance - all.variance()).max(0.0);
        all
    }

    /// Returns the part of the mean square error that a channel's cause has, not yet divided by the whole.
    fn part(&self, place: usize, mean: f64, is_own: impl Fn(&Piece<'_>) -> bool) -> f64 {
        let own = self.pieces.iter().filter(|piece| is_own(piece));
        let one = |piece: &Piece<'_>| {
            let others = self.pieces.iter().map(|other| self.covariance(piece, other, place));
            piece.mean(place) * mean + piece.variance(place) + others.sum::<f64>()
        };
        own.map(one).sum()
    }
}

/// Composes all quantities that the channels allow.
///
/// # Errors
/// [`CostError::Model`] if the model cannot be simulated.
pub(crate) fn compose(
    setting: &Setting<'_>,
    errors: &[ChannelErrors],
    quantities: &[Quantity],
) -> Result<BTreeMap<Quantity, Composed>, CostError> {
    let is_shared = |of: &ChannelErrors| of.contributions.iter().any(|one| one.common.is_some());
    let white = (errors.iter().filter(|of| is_shared(of)).count() > 1).then(|| squares(setting, || 1.0));
    let find = |channel: Channel| errors.iter().find(|of| of.channel == channel);
    let nonlinear = |quantity: &Quantity| -> Vec<(Channel, &'static str)> {
        let own = quantity.shares().into_iter().filter_map(|share| find(share.channel));
        own.flat_map(|of| of.nonlinear.iter().map(|name| (of.channel, *name))).collect()
    };
    let whole: Vec<Quantity> = quantities.iter().copied().filter(|quantity| !nonlinear(quantity).is_empty()).collect();
    let mut runs = if whole.is_empty() { Vec::new() } else { monte_carlo::quantities(setting, &whole)? }.into_iter();
    let mut all = BTreeMap::new();
    for quantity in quantities {
        let nonlinear = nonlinear(quantity);
        let pieces = quantity.shares().into_iter().flat_map(|share| {
            let of = find(share.channel).map(|of| of.contributions.as_slice()).unwrap_or_default();
            of.iter().map(move |of| Piece { share, of })
        });
        let pieces = pieces.filter(|piece| !nonlinear.contains(&(piece.share.channel, piece.of.cause))).collect();
        let sum = Sum { setting, pieces, white: white.as_deref() };
        let values = if nonlinear.is_empty() { None } else { runs.next() };
        all.insert(*quantity, composed(*quantity, &sum, &nonlinear, values.as_deref()));
    }
    Ok(all)
}

/// Composes one quantity, from its pieces, or from the values of each run if an effect is nonlinear.
fn composed(
    quantity: Quantity,
    sum: &Sum<'_>,
    nonlinear: &[(Channel, &'static str)],
    values: Option<&[Vec<f64>]>,
) -> Composed {
    let count = sum.setting.horizons.len();
    let mut simulated: Vec<String> = nonlinear.iter().map(|(channel, name)| format!("{name} on {channel}")).collect();
    let alone = sum.pieces.iter().filter(|piece| piece.of.is_simulated);
    simulated.extend(alone.map(|piece| format!("{} on {}", piece.of.cause, piece.share.channel)));
    simulated.dedup();
    let mut growth = Growth {
        unit: quantity.unit(),
        mean: Vec::with_capacity(count),
        sd: Vec::with_capacity(count),
        band95: Vec::with_capacity(count),
        band95_upper: None,
        method: if simulated.is_empty() { Method::ClosedForm } else { Method::MonteCarlo },
        runs: (!simulated.is_empty()).then_some(sum.setting.runs),
        simulated,
    };
    let mut causes = blank(quantity, sum, nonlinear);
    for place in 0..count {
        let all = sum.distribution(place, |_| true);
        let linear_band = all.band95();
        let (mean, sd, band) = match values.and_then(|values| values.get(place)) {
            Some(values) => moments(values),
            None => (all.mean, all.variance().sqrt(), linear_band),
        };
        let square = mean * mean + sd * sd;
        let share = |part: f64| if square > 0.0 { part / square } else { 0.0 };
        let less = |without: f64| if band > 0.0 { 1.0 - without / band } else { 0.0 };
        let mut explained = 0.0;
        for cause in causes.iter_mut().skip(nonlinear.len()) {
            let is_own = |piece: &Piece<'_>| piece.share.channel == cause.channel && piece.of.cause == cause.cause;
            let own = share(sum.part(place, mean, is_own));
            explained += own;
            let without = sum.distribution(place, |piece| !is_own(piece)).band95();
            cause.share.push(own);
            cause.share_band95.push(less(without));
            cause.band95_without.push(without);
        }
        for cause in causes.iter_mut().take(nonlinear.len()) {
            cause.share.push(if square > 0.0 { (1.0 - explained) / nonlinear.len() as f64 } else { 0.0 });
        }
        growth.mean.push(mean);
        growth.sd.push(sd);
        growth.band95.push(band);
    }
    if !nonlinear.is_empty() {
        // What is left without another cause would have to be simulated for each.
        for cause in &mut causes {
            (cause.share_band95, cause.band95_without) = (Vec::new(), Vec::new());
        }
    }
    Composed { growth, causes }
}

/// Returns the causes of a quantity without numbers: nonlinear effects first, then every cause of every channel.
fn blank(quantity: Quantity, sum: &Sum<'_>, nonlinear: &[(Channel, &'static str)]) -> Vec<Cause> {
    let mut names: Vec<(Channel, &'static str)> = Vec::new();
    for piece in &sum.pieces {
        let name = (piece.share.channel, piece.of.cause);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let one = |(channel, cause): &(Channel, &'static str)| Cause {
        cause: (*cause).to_owned(),
        channel: *channel,
        quantity,
        share: Vec::new(),
        share_band95: Vec::new(),
        band95_without: Vec::new(),
    };
    nonlinear.iter().chain(&names).map(one).collect()
}

/// Returns mean, standard deviation and 95 % band of values.
pub(crate) fn moments(values: &[f64]) -> (f64, f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    (mean, square.sqrt(), empirical(values))
}
