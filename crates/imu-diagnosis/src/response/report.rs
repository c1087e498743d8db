//! The report: a solution as values, intervals and sentences.

use super::clipping::Bridges;
use super::confounding::{Motions, latency_or_offset};
use super::design::{Design, Slot, State};
use super::solution::{Search, Solution};
use super::{AXES, Candidate, Clipping, Clock, Confounding, Estimate, Fit, Fitted, Openness, Record, Request};
use imu_model::effects::EffectKind;

/// Returns the complete report of a solution.
pub(super) fn report(
    record: &Record<'_>,
    request: &Request<'_>,
    known: &State,
    search: &mut Search<'_, '_>,
    solution: &Solution,
    clipping: Option<Clipping>,
) -> Fit {
    let design = search.design;
    let inverse = solution.normal.inverse();
    let left_out = search.whitening.bridges.each_ref().map(Bridges::count);
    let covariance = if left_out == [0; 3] {
        inverse
    } else {
        let gradient = search.whitening.gradient_covariance(&solution.columns) + search.known();
        &inverse * gradient * &inverse
    };
    let open: Vec<usize> =
        solution.normal.unseen().into_iter().chain(solution.normal.open_groups().into_iter().flatten()).collect();
    let estimates: Vec<Estimate> = design
        .slots
        .iter()
        .enumerate()
        .map(|(place, slot)| {
            let (effect, parameter) = label(design, request, *slot);
            // A clock's offset comes in addition to the known latency.
            let own = *slot == Slot::Delay && request.clock == Clock::Separate;
            let before = if own { 0.0 } else { known.value(*slot) };
            let value = solution.state.value(*slot) - if own { known.delay_s } else { 0.0 };
            let error = covariance[(place, place)].max(0.0).sqrt();
            let standard_error = (!open.contains(&place)).then_some(error);
            Estimate { effect, parameter, value, known: before, standard_error }
        })
        .collect();
    let n = record.reference.len() as f64;
    let squares = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    Fit {
        fitted: fitted(request, design, &solution.state, clipping),
        // A bridge leaves almost no signal.
        misfit: std::array::from_fn(|axis| squares(&solution.residual[axis]) / (n - left_out[axis] as f64)),
        confounded: statements(record, request, design, solution, &estimates),
        estimates,
        response: solution.response.clone(),
        clipping,
        stretches: search.whitening.bridges.each_ref().map(Bridges::stretches),
    }
}

fn label(design: &Design<'_>, request: &Request<'_>, slot: Slot) -> (Option<EffectKind>, String) {
    match slot {
        Slot::Coefficient(candidate, place) => {
            let candidate = design.candidates[candidate];
            (Some(candidate.kind()), candidate.parameters()[place].clone())
        }
        Slot::Delay if request.clock == Clock::Separate => (None, "offset_s".to_owned()),
        Slot::Delay => (Some(EffectKind::Latency), "seconds".to_owned()),
        Slot::RateError => (None, "rate_error".to_owned()),
        Slot::Temperature(axis) => (Some(EffectKind::TemperatureBias), format!("{} per_c", AXES[axis])),
        Slot::Cutoff(axis) => (Some(EffectKind::LowPass), format!("{} ln_cutoff", AXES[axis])),
    }
}

fn fitted(request: &Request<'_>, design: &Design<'_>, state: &State, clipping: Option<Clipping>) -> Vec<Fitted> {
    let mut linear = 0;
    let mut all = Vec::new();
    for candidate in request.candidates {
        let first = |wanted: Slot| design.slots.iter().position(|slot| *slot == wanted).unwrap_or(0);
        let (effect, places) = match candidate {
            Candidate::Saturation => {
                let Some(clipping) = clipping else { continue };
                (candidate.make(&[clipping.limit]), 0..0)
            }
            Candidate::Latency if request.clock == Clock::Separate => continue,
            Candidate::Latency => {
                let place = first(Slot::Delay);
                (candidate.make(&[state.delay_s]), place..place + 1)
            }
            _ => {
                let place = first(Slot::Coefficient(linear, 0));
                let coefficients = &state.coefficients[linear];
                linear += 1;
                (candidate.make(coefficients), place..place + coefficients.len())
            }
        };
        all.push(Fitted { effect, places });
    }
    all
}

fn statements(
    record: &Record<'_>,
    request: &Request<'_>,
    design: &Design<'_>,
    solution: &Solution,
    estimates: &[Estimate],
) -> Vec<Confounding> {
    let motions = Motions::of(record);
    let (mut unseen, normal) = (solution.normal.unseen(), &solution.normal);
    let mut groups: Vec<(Openness, Vec<usize>)> = Vec::new();
    while let Some(first) = unseen.first().copied() {
        // One sentence for each effect and clock.
        let (same, rest) = unseen.iter().partition(|place| estimates[**place].effect == estimates[first].effect);
        groups.push((Openness::Unseen, same));
        unseen = rest;
    }
    groups.extend(normal.open_groups().into_iter().map(|group| (Openness::Confounded, group)));
    groups.extend(normal.faint_groups().into_iter().map(|group| (Openness::Faint, group)));
    let state = |(openness, group): (Openness, Vec<usize>)| {
        motions.state(openness, &group, &design.slots, &design.candidates, estimates)
    };
    let mut all: Vec<Confounding> = groups.into_iter().map(state).collect();
    if request.clock == Clock::Separate && request.candidates.contains(&Candidate::Latency) {
        all.push(latency_or_offset());
    }
    all
}
