//! The report: a solution as values, intervals and sentences.

use super::clipping::Bridges;
use super::confounding::Motions;
use super::design::{Design, Slot, State};
use super::solution::{Search, Solution};
use super::{Candidate, Clipping, Confounding, Estimate, Fit, Fitted, NORMAL_95, Openness, Record, Request, clock};
use imu_model::effects::EffectKind;
use nalgebra::{DMatrix, DVector};

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
            let own = *slot == Slot::Delay && request.clock.offset_unknown;
            let before = if own { 0.0 } else { known.value(*slot) };
            let value = solution.state.value(*slot) - if own { known.delay_s } else { 0.0 };
            let error = covariance[(place, place)].max(0.0).sqrt();
            let standard_error = (!open.contains(&place)).then_some(error);
            let ci95 = standard_error.map(|error| [value - NORMAL_95 * error, value + NORMAL_95 * error]);
            Estimate { effect, parameter, value, known: before, standard_error, ci95 }
        })
        .collect();
    let (_, before) = search.residual(known);
    let n = record.reference.len() as f64;
    let squares = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    let gain = |axis: usize| {
        let share = 1.0 - left_out[axis] as f64 / n;
        0.5 * share * (squares(&before[axis]) - squares(&solution.residual[axis]))
    };
    let rows: Vec<Vec<f64>> = covariance
        .row_iter()
        .enumerate()
        .map(|(row, of)| {
            let seen = |column: &usize| !open.contains(&row) && !open.contains(column);
            (0..of.len()).map(|column| if seen(&column) { of[column] } else { 0.0 }).collect()
        })
        .collect();
    Fit {
        fitted: fitted(request, design, &solution.state, &estimates, &rows, clipping),
        gain_nats: (0..3).map(gain).sum(),
        // A bridge leaves almost no signal.
        misfit: std::array::from_fn(|axis| squares(&solution.residual[axis]) / (n - left_out[axis] as f64)),
        residual: std::array::from_fn(|axis| {
            let pairs = record.samples[axis].iter().zip(&solution.response[axis]);
            let mut values: Vec<f64> = pairs.map(|(shown, response)| shown - response).collect();
            search.whitening.bridges[axis].fill(&mut values);
            values
        }),
        confounded: statements(record, request, design, solution, &estimates),
        singular_values: solution.normal.singular_values(),
        covariance: rows,
        estimates,
        response: solution.response.clone(),
        clipping,
        left_out,
        stretches: search.whitening.bridges.each_ref().map(Bridges::stretches),
        converged: solution.converged,
        steps: solution.steps,
    }
}

fn label(design: &Design<'_>, request: &Request<'_>, slot: Slot) -> (Option<EffectKind>, String) {
    match slot {
        Slot::Coefficient(candidate, place) => {
            let candidate = design.candidates[candidate];
            (Some(candidate.kind()), candidate.parameters()[place].clone())
        }
        Slot::Delay if request.clock.offset_unknown => (None, "offset_s".to_owned()),
        Slot::Delay => (Some(EffectKind::Latency), "seconds".to_owned()),
        Slot::RateError => (None, "rate_error".to_owned()),
        Slot::Temperature(axis) => (Some(EffectKind::TemperatureBias), format!("{} per_c", ["x", "y", "z"][axis])),
        Slot::Cutoff(axis) => (Some(EffectKind::LowPass), format!("{} ln_cutoff", ["x", "y", "z"][axis])),
    }
}

fn fitted(
    request: &Request<'_>,
    design: &Design<'_>,
    state: &State,
    estimates: &[Estimate],
    covariance: &[Vec<f64>],
    clipping: Option<Clipping>,
) -> Vec<Fitted> {
    let mut linear = 0;
    let mut all = Vec::new();
    for candidate in request.candidates {
        let first = |wanted: Slot| design.slots.iter().position(|slot| *slot == wanted).unwrap_or(0);
        let (effect, places) = match candidate {
            Candidate::Saturation => {
                let Some(clipping) = clipping else { continue };
                (candidate.make(&[clipping.limit]), 0..0)
            }
            Candidate::Latency if request.clock.offset_unknown => continue,
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
        let gain_nats = loss(places.clone(), estimates, covariance);
        all.push(Fitted { effect, places, gain_nats });
    }
    all
}

/// Returns ½ (β − known)ᵀ C⁻¹ (β − known) over the parameters of these places that are not left open.
fn loss(places: std::ops::Range<usize>, estimates: &[Estimate], covariance: &[Vec<f64>]) -> f64 {
    let seen: Vec<usize> = places.filter(|place| estimates[*place].standard_error.is_some_and(|e| e > 0.0)).collect();
    let errors: Vec<f64> = seen.iter().map(|place| covariance[*place][*place].sqrt()).collect();
    let correlation = DMatrix::from_fn(seen.len(), seen.len(), |row, column| {
        covariance[seen[row]][seen[column]] / (errors[row] * errors[column])
    });
    let moved = seen.iter().zip(&errors).map(|(place, error)| {
        let estimate = &estimates[*place];
        (estimate.value - estimate.known) / error
    });
    let moved = DVector::from_iterator(seen.len(), moved);
    correlation.cholesky().map_or(0.0, |root| 0.5 * moved.dot(&root.solve(&moved)))
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
    if request.clock.offset_unknown && request.candidates.contains(&Candidate::Latency) {
        let place = design.slots.iter().position(|slot| *slot == Slot::Delay).unwrap_or(0);
        all.push(clock::latency_or_offset(place));
    }
    all
}
