//! Courses along a motion: what a sensor without noise does, by cause.
//!
//! A cause's own part is the mean of two numbers: the error that it makes alone, and what the error of all lacks without it. With
//! interactions of two causes each, such as that of a delay and a scale factor, these parts sum to the whole.

use super::path::{Errors, Path, USED, Values};
use crate::request::{CostError, Setting};
use imu_model::EffectKind;
use imu_model::effects::Stage;
use imu_model::simulator::{Sampling, SensorModel, Simulator};

/// Values differ if they do by more than this part of their size: less is rounding.
const ROUNDING: f64 = 1e-14;

/// What one cause on one channel does without noise.
#[derive(Debug)]
pub(super) struct CourseCause {
    /// The channel's place in [`USED`].
    pub channel: usize,
    pub name: &'static str,
    /// Its part of the mean, by horizon.
    pub own: Vec<Values>,
    /// The mean of the others without it, by horizon.
    pub without: Vec<Values>,
}

/// What a sensor without noise does.
#[derive(Debug)]
pub(super) struct Courses {
    /// The error at each horizon.
    pub mean: Vec<Values>,
    pub causes: Vec<CourseCause>,
    /// The least and the largest value that each channel would send without limits.
    pub range: [[f64; 2]; USED.len()],
}

/// A cause that acts without noise.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Part {
    Kind(EffectKind),
    Sampling,
}

impl Part {
    fn name(self) -> &'static str {
        match self {
            Self::Kind(kind) => kind.name(),
            Self::Sampling => "sampling",
        }
    }
}

/// Takes the mean of errors over the alignment and subtracts it from those that follow.
#[derive(Debug, Clone)]
pub(super) struct Aligned<const N: usize> {
    begin: u64,
    align: u64,
    seen: u64,
    first: [f64; N],
    level: [f64; N],
}

impl<const N: usize> Aligned<N> {
    pub(super) fn new(setting: &Setting<'_>) -> Self {
        Self { begin: setting.begin, align: setting.align, seen: 0, first: [0.0; N], level: [0.0; N] }
    }

    /// Takes the errors of the next sample from switch-on on; returns what is left of them after the alignment.
    pub(super) fn push(&mut self, errors: [f64; N]) -> Option<[f64; N]> {
        self.seen += 1;
        let taken = self.seen.checked_sub(self.begin).filter(|taken| *taken > 0)?;
        // Relative to the first sample, so that a constant cancels exactly.
        if taken == 1 {
            self.first = errors;
        }
        let own: [f64; N] = std::array::from_fn(|channel| errors[channel] - self.first[channel]);
        if taken <= self.align {
            self.level = std::array::from_fn(|channel| self.level[channel] + own[channel] / self.align as f64);
            return None;
        }
        Some(std::array::from_fn(|channel| own[channel] - self.level[channel]))
    }
}

/// Passes the number and the values of each sample of a simulation, from switch-on to the end of the longest horizon.
pub(super) fn each_sample(
    setting: &Setting<'_>,
    mut simulator: Simulator,
    mut take: impl FnMut(u64, [Option<f64>; USED.len()]),
) {
    let (mut sample, count) = (0, setting.begin + setting.samples());
    while sample < count {
        let Some(block) = simulator.next_block() else { return };
        let columns = USED.map(|channel| block.values(channel));
        for place in 0..block.len() {
            if sample == count {
                return;
            }
            take(sample, columns.map(|column| column.and_then(|values| values.get(place)).copied()));
            sample += 1;
        }
    }
}

/// Returns what each channel of a model without noise deviates from the truth after the alignment, sample by sample.
fn deviations(path: &Path, setting: &Setting<'_>, model: &SensorModel) -> Result<Vec<Errors>, CostError> {
    let rests = setting.begin + setting.align;
    let (mut aligned, mut sizes) = (Aligned::<{ USED.len() }>::new(setting), [0.0; USED.len()]);
    let mut found = Vec::new();
    each_sample(setting, path.simulator(setting, model, 0, true)?, |sample, values| {
        let truth = path.truth(sample, rests);
        let error = |channel: usize| values[channel].map_or(0.0, |value| value - truth[channel]);
        let size = |channel: usize| f64::max(sizes[channel], values[channel].unwrap_or(0.0).abs());
        sizes = std::array::from_fn(size);
        if let Some(errors) = aligned.push(std::array::from_fn(error)) {
            let kept = |channel: usize| errors[channel].abs() > ROUNDING * sizes[channel];
            found.push(std::array::from_fn(|channel| if kept(channel) { errors[channel] } else { 0.0 }));
        }
    });
    Ok(found)
}

/// Returns a model of the used channels without noise: courses, filters, limits and the triads' effects.
fn quiet(model: &SensorModel) -> SensorModel {
    let mut quiet = model.clone();
    for own in quiet.channels.values_mut() {
        (own.n, own.b, own.k) = (0.0, 0.0, 0.0);
        let effects = own.effects.iter().filter_map(|effect| match effect.stage() {
            Stage::Bias | Stage::Saturation => Some(effect.clone()),
            _ => effect.noiseless(),
        });
        own.effects = effects.collect();
    }
    quiet
}

/// Returns the causes in a model without noise. A constant bias is none.
fn parts(quiet: &SensorModel) -> Vec<Part> {
    let own = quiet.channels.values().flat_map(|channel| channel.effects.iter().map(|effect| effect.kind()));
    let shared = quiet.triads.values().flat_map(|triad| triad.effects.iter().map(|effect| effect.kind()));
    let mut parts: Vec<Part> = Vec::new();
    for kind in own.chain(shared).filter(|kind| *kind != EffectKind::Bias) {
        if !parts.contains(&Part::Kind(kind)) {
            parts.push(Part::Kind(kind));
        }
    }
    parts.extend(quiet.sampling.is_some_and(|sampling| sampling.filter_window > 1).then_some(Part::Sampling));
    parts
}

/// Returns a model with only those causes that `keep` chooses.
fn chosen(quiet: &SensorModel, keep: impl Fn(Part) -> bool) -> SensorModel {
    let mut model = quiet.clone();
    for own in model.channels.values_mut() {
        own.effects.retain(|effect| keep(Part::Kind(effect.kind())));
    }
    for own in model.triads.values_mut() {
        own.effects.retain(|effect| effect.kind() == EffectKind::Bias || keep(Part::Kind(effect.kind())));
    }
    if !keep(Part::Sampling) {
        model.sampling = model.sampling.map(|sampling| Sampling { filter_window: 1, ..sampling });
    }
    model
}

/// Returns what a model does without noise. It has the used channels alone, each with all effects that act on it.
///
/// # Errors
/// [`CostError::Model`] if the model cannot be simulated.
pub(super) fn courses(path: &Path, setting: &Setting<'_>, model: &SensorModel) -> Result<Courses, CostError> {
    let quiet = quiet(model);
    let full = deviations(path, setting, &quiet)?;
    let mean = path.navigate(|sample| full[sample]);
    let mut causes = Vec::new();
    for part in parts(&quiet) {
        let alone = deviations(path, setting, &chosen(&quiet, |other| other == part))?;
        let rest = deviations(path, setting, &chosen(&quiet, |other| other != part))?;
        for channel in 0..USED.len() {
            let acts = alone.iter().any(|errors| errors[channel] != 0.0)
                || rest.iter().zip(&full).any(|(rest, full)| rest[channel] != full[channel]);
            if !acts {
                continue;
            }
            let by_itself = path.navigate(|sample| {
                let mut errors = [0.0; USED.len()];
                errors[channel] = alone[sample][channel];
                errors
            });
            let without = path.navigate(|sample| {
                let mut errors = full[sample];
                errors[channel] = rest[sample][channel];
                errors
            });
            let own = by_itself.iter().zip(&mean).zip(&without).map(|((alone, mean), without)| {
                std::array::from_fn(|place| 0.5 * (alone[place] + mean[place] - without[place]))
            });
            causes.push(CourseCause { channel, name: part.name(), own: own.collect(), without });
        }
    }
    settle(&mean, &mut causes);
    Ok(Courses { range: range(path, setting, &quiet)?, mean, causes })
}

/// Spreads what the parts lack of the mean, interactions of three causes or more, over them by their size.
fn settle(mean: &[Values], causes: &mut [CourseCause]) {
    for (horizon, mean) in mean.iter().enumerate() {
        for (place, mean) in mean.iter().enumerate() {
            let sizes: f64 = causes.iter().map(|cause| cause.own[horizon][place].abs()).sum();
            let lacks = mean - causes.iter().map(|cause| cause.own[horizon][place]).sum::<f64>();
            for cause in causes.iter_mut().filter(|_| sizes > 0.0) {
                let own = &mut cause.own[horizon][place];
                *own += lacks * own.abs() / sizes;
            }
        }
    }
}

/// Returns the least and the largest value of each channel without limits.
fn range(path: &Path, setting: &Setting<'_>, quiet: &SensorModel) -> Result<[[f64; 2]; USED.len()], CostError> {
    let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; USED.len()];
    let limitless = chosen(quiet, |part| part != Part::Kind(EffectKind::Saturation));
    each_sample(setting, path.simulator(setting, &limitless, 0, true)?, |_, values| {
        for (range, value) in range.iter_mut().zip(values) {
            let value = value.unwrap_or(0.0);
            *range = [range[0].min(value), range[1].max(value)];
        }
    });
    Ok(range)
}
