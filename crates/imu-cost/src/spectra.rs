//! Spectra: the densities of all sources as they are sent, on panels on which each is smooth.
//!
//! A density passes the filters behind its source, the boxcar, and folds when samples are chosen; what is added to the
//! sent samples stays as it is. Panels are halved until the polynomial through their points describes every density
//! that matters there ([`crate::quadrature`]).
//!
//! Held samples. If each sample is with probability p the one before it again, a sent sample has the age j with
//! probability (1 − p)p^j. Its mean given the input is the input behind H = (1 − p)/(1 − pz). The rest has the
//! autocovariance p^k(R(0) − R_H(0)), with R_H that of the filtered input: noise of variance ∫(1 − |H|²)S df with the
//! spectrum of a first-order process of pole p. It is uncorrelated with the mean.

use crate::quadrature::{NODES, Panel, Rule, envelope, octaves, scale, variances};
use crate::request::Setting;
use crate::sources::{ChannelSources, Source};
use crate::weights::{ORDERS, Span, gain};
use imu_model::effects::moving_average::boxcar_gain;
use imu_model::effects::{Frequencies, HeldSamples, Line};
use std::f64::consts::TAU;

/// A panel is halved while the polynomial may be off by more than this part of the source's variance.
const ROUGH: f64 = 1e-6;
/// The most panels: enough for a moving average with hundreds of zeros below half the rate.
const PANELS_MAX: usize = 4000;

/// The densities of all spectral sources at the nodes of all panels, with the weights that make variances of them.
#[derive(Debug)]
pub(crate) struct Spectra {
    /// The stretches on which every density is smooth.
    pub panels: Vec<Panel>,
    /// Hz.
    nodes: Vec<f64>,
    /// Hz per node.
    plain: Vec<f64>,
    /// By source: channel by channel, in order, spectral sources alone.
    densities: Vec<Vec<f64>>,
    /// By horizon and order; empty if only the densities were asked for.
    weights: Vec<[Vec<f64>; ORDERS]>,
    rate_hz: f64,
}

impl Spectra {
    /// Computes the spectra of all channels' spectral sources, and the weights that make variances of them.
    pub(crate) fn new(setting: &Setting<'_>, channels: &[ChannelSources]) -> Self {
        let rule = Rule::new();
        let all = Self::unweighted(setting, channels, &rule);
        Self { weights: variances(&rule, &all.panels, setting.rate_hz, &setting.spans()), ..all }
    }

    /// Computes the spectra of all channels' spectral sources, on panels that suit the setting's horizons.
    pub(crate) fn unweighted(setting: &Setting<'_>, channels: &[ChannelSources], rule: &Rule) -> Self {
        let rate_hz = setting.rate_hz;
        let fold = |hz: f64| {
            let within = hz.rem_euclid(rate_hz);
            within.min(rate_hz - within)
        };
        let cuts: Vec<f64> = channels.iter().flat_map(ChannelSources::features).map(fold).collect();
        let panels = octaves(rate_hz, setting.samples() as f64, &cuts);
        let evaluate = |panel: Panel| (panel, densities(setting, channels, &rule.nodes(panel)));
        let evaluated = refined(panels.into_iter().map(evaluate).collect(), rule, setting, evaluate);
        let panels: Vec<Panel> = evaluated.iter().map(|(panel, _)| *panel).collect();
        let sources = evaluated.first().map_or(0, |(_, values)| values.len());
        let of = |source: usize| evaluated.iter().flat_map(|(_, values)| values[source]).collect();
        Self {
            nodes: panels.iter().flat_map(|panel| rule.nodes(*panel)).collect(),
            plain: panels.iter().flat_map(|panel| rule.plain(*panel)).collect(),
            densities: (0..sources).map(of).collect(),
            weights: Vec::new(),
            panels,
            rate_hz,
        }
    }

    /// Returns the variance of an integral of order 1 to 3 over the horizon at `place`, of the spectral source at
    /// `index`, as it is sent by a sensor that repeats samples with probability `held`.
    pub(crate) fn variance(&self, index: usize, held: f64, place: usize, order: usize) -> f64 {
        let weights = &self.weights[place][order - 1];
        let sum = |gain: &dyn Fn(f64) -> f64| {
            let nodes = self.nodes.iter().zip(weights).zip(&self.densities[index]);
            nodes.map(|((hz, weight), density)| weight * density * gain(*hz)).sum::<f64>()
        };
        let all = if held == 0.0 { sum(&|_| 1.0) } else { sum(&|hz| kept(held, hz, self.rate_hz)) };
        all.max(0.0)
    }

    /// Returns the variance of an integral of white noise of variance 1 per sample that repeats as samples do.
    pub(crate) fn repeated(&self, held: f64, place: usize, order: usize) -> f64 {
        let law = HeldSamples { probability: held };
        let nodes = self.nodes.iter().zip(&self.weights[place][order - 1]);
        nodes.map(|(hz, weight)| weight * law.white_gain(*hz, self.rate_hz) / self.rate_hz).sum::<f64>().max(0.0)
    }

    /// Returns the frequencies, Hz, of the nodes of all panels, one panel after the other.
    pub(crate) fn nodes(&self) -> &[f64] {
        &self.nodes
    }

    /// Returns the two-sided density, U²/Hz, of the spectral source at `index`, by node.
    pub(crate) fn density(&self, index: usize) -> &[f64] {
        &self.densities[index]
    }

    /// Returns the mean square, in U², of a source times a gain of the frequency.
    pub(crate) fn mean_square(&self, index: usize, gain: impl Fn(f64) -> f64) -> f64 {
        let nodes = self.nodes.iter().zip(&self.plain).zip(&self.densities[index]);
        nodes.map(|((hz, width), density)| 2.0 * width * density * gain(*hz)).sum()
    }

    /// Returns the part of a source's mean square that held samples turn into noise, U².
    pub(crate) fn unsettled(&self, index: usize, held: f64) -> f64 {
        if held == 0.0 {
            return 0.0;
        }
        self.mean_square(index, |hz| 1.0 - kept(held, hz, self.rate_hz))
    }

    /// Returns half the mean square, U², of the difference from one sent sample to the next.
    pub(crate) fn local(&self, index: usize) -> f64 {
        self.mean_square(index, |hz| 1.0 - (TAU * hz / self.rate_hz).cos())
    }
}

/// Returns |H|² of the mean of a sample that is with probability `held` the one before it again.
pub(crate) fn kept(held: f64, hz: f64, rate_hz: f64) -> f64 {
    (1.0 - held).powi(2) / (1.0 + held * held - 2.0 * held * (TAU * hz / rate_hz).cos())
}

/// Halves panels until all densities are smooth on them, as far as that matters to a variance.
fn refined(
    mut panels: Vec<(Panel, Vec<[f64; NODES]>)>,
    rule: &Rule,
    setting: &Setting<'_>,
    evaluate: impl Fn(Panel) -> (Panel, Vec<[f64; NODES]>),
) -> Vec<(Panel, Vec<[f64; NODES]>)> {
    let ends = [setting.horizons.first(), setting.horizons.last()].map(|of| of.copied().unwrap_or(1) as f64);
    let sources = panels.first().map_or(0, |(_, values)| values.len());
    // The part of each source's variance that a panel holds, for the shortest and the longest horizon.
    let held = |(panel, values): &(Panel, Vec<[f64; NODES]>)| -> Vec<[f64; 2]> {
        let (nodes, plain) = (rule.nodes(*panel), rule.plain(*panel));
        let sum = |values: &[f64; NODES], horizon: f64| -> f64 {
            let parts = values.iter().zip(&plain).zip(&nodes);
            parts.map(|((value, width), hz)| value * width * envelope(*hz, setting.rate_hz, horizon)).sum()
        };
        values.iter().map(|values| ends.map(|horizon| sum(values, horizon))).collect()
    };
    loop {
        let parts: Vec<Vec<[f64; 2]>> = panels.iter().map(held).collect();
        let total = |source: usize, end: usize| parts.iter().map(|of| of[source][end]).sum::<f64>();
        let totals: Vec<[f64; 2]> = (0..sources).map(|source| [total(source, 0), total(source, 1)]).collect();
        let is_rough = |values: &[[f64; NODES]], parts: &[[f64; 2]]| {
            (0..sources).any(|source| {
                let share = |end: usize| parts[source][end] / totals[source][end].max(f64::MIN_POSITIVE);
                let largest = share(0).max(share(1));
                largest > ROUGH && largest * rule.roughness(&values[source]) > ROUGH
            })
        };
        let before = panels.len();
        let mut next = Vec::with_capacity(before);
        for (own, parts) in panels.into_iter().zip(&parts) {
            if before < PANELS_MAX && is_rough(&own.1, parts) {
                next.extend(own.0.halves().map(&evaluate));
            } else {
                next.push(own);
            }
        }
        panels = next;
        if panels.len() == before {
            return panels;
        }
    }
}

/// Returns the two-sided densities, U²/Hz, of all spectral sources at sent frequencies.
fn densities(setting: &Setting<'_>, channels: &[ChannelSources], nodes: &[f64; NODES]) -> Vec<[f64; NODES]> {
    let (rate_hz, internal_hz) = (setting.rate_hz, setting.internal_hz);
    let sources = channels.iter().map(|of| of.sources.iter().filter(|source| source.is_spectral()).count());
    let mut all = vec![[0.0; NODES]; sources.sum()];
    let sent = Frequencies::new(nodes.to_vec(), rate_hz);
    for image in 0..setting.ratio() {
        // Beyond half the internal rate, a spectrum is its own mirror image.
        let own = nodes.iter().map(|hz| {
            let at = hz + image as f64 * rate_hz;
            at.min(internal_hz - at).abs()
        });
        let internal = Frequencies::new(own.collect(), internal_hz);
        let averaged: Vec<f64> =
            internal.hz().iter().map(|hz| boxcar_gain(setting.window(), hz / internal_hz)).collect();
        let mut rows = all.iter_mut();
        for channel in channels {
            let gains = gains(channel, &internal, &averaged);
            for (source, row) in channel.sources.iter().filter(|source| source.is_spectral()).zip(&mut rows) {
                if !source.is_sent() {
                    let densities = source.effect.densities(&internal);
                    for ((value, density), gain) in row.iter_mut().zip(densities).zip(&gains[source.behind]) {
                        *value += density * gain;
                    }
                } else if image == 0 {
                    row.iter_mut().zip(source.effect.densities(&sent)).for_each(|(value, density)| *value = density);
                }
            }
        }
    }
    all
}

/// Returns the power gain from behind each number of filters to the sent samples.
fn gains(channel: &ChannelSources, internal: &Frequencies, averaged: &[f64]) -> Vec<Vec<f64>> {
    let mut gains = vec![averaged.to_vec()];
    for filter in channel.filters.iter().rev() {
        let last = gains.last().map_or(averaged, Vec::as_slice);
        gains.push(filter.power_gains(internal).iter().zip(last).map(|(own, after)| own * after).collect());
    }
    gains.reverse();
    gains
}

/// Returns a source's lines as they are sent: folded, with every filter's gain.
pub(crate) fn lines(setting: &Setting<'_>, channel: &ChannelSources, source: &Source) -> Vec<Line> {
    let (rate_hz, internal_hz) = (setting.rate_hz, setting.internal_hz);
    let sent = |line: Line| {
        let filtered: f64 = channel.filters.iter().map(|of| of.power_gain(line.frequency_hz, internal_hz)).product();
        let within = line.frequency_hz.rem_euclid(rate_hz);
        Line {
            frequency_hz: within.min(rate_hz - within),
            power: line.power * filtered * boxcar_gain(setting.window(), line.frequency_hz / internal_hz),
        }
    };
    source.effect.lines().into_iter().map(sent).collect()
}

/// Returns the peaks that sent lines have in an integral over the horizon at `place`, in the integral's unit.
pub(crate) fn peaks(setting: &Setting<'_>, lines: &[Line], held: f64, place: usize, order: usize) -> Vec<f64> {
    let rate_hz = setting.rate_hz;
    let Some(horizon) = setting.horizons.get(place) else { return Vec::new() };
    let span = Span { align: setting.align as f64, horizon: *horizon as f64 };
    let peak = |line: &Line| {
        let size = gain(order, span, TAU * line.frequency_hz / rate_hz) * scale(order, rate_hz);
        (2.0 * line.power * kept(held, line.frequency_hz, rate_hz)).sqrt() * size
    };
    lines.iter().map(peak).collect()
}

/// Returns the part of sent lines' mean square that held samples turn into noise, U².
pub(crate) fn unsettled_lines(setting: &Setting<'_>, lines: &[Line], held: f64) -> f64 {
    lines.iter().map(|line| line.power * (1.0 - kept(held, line.frequency_hz, setting.rate_hz))).sum()
}

/// Returns half the mean square, U², of sent lines' difference from one sample to the next.
pub(crate) fn local_lines(setting: &Setting<'_>, lines: &[Line]) -> f64 {
    lines.iter().map(|line| line.power * (1.0 - (TAU * line.frequency_hz / setting.rate_hz).cos())).sum()
}
