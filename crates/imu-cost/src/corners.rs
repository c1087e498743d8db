//! Corners: the costs of a model at the ends of the 95 % intervals that it states.
//!
//! In: a model with its `uncertainty`, and a request. Out: the smallest and the largest error that the intervals allow, and the
//! sizes that have none. Pure.

use crate::cost;
use crate::document::{Cost, Growth};
use crate::request::{CostError, Quantity, Request};
use imu_model::simulator::SensorModel;
use serde_json::{Value, json};

/// Costs at the corners of a model's intervals.
#[derive(Debug, Clone)]
pub struct Corners {
    /// None if a corner is no model.
    costs: Option<Vec<Cost>>,
    /// Causes and channels whose size has no interval.
    unknown: Vec<(String, String)>,
}

impl Corners {
    /// Computes the costs at four corners of a model's 95 % intervals: N, B, K and the sizes of its effects all at their lower or all
    /// at their upper ends, and the effects' other numbers at theirs. What the model `exact` states alike has no error.
    pub fn new(model: &SensorModel, exact: Option<&SensorModel>, request: &Request) -> Self {
        let (models, unknown) = models(model, exact);
        let request = Request { tolerances: Vec::new(), ..request.clone() };
        let of = |model: &SensorModel| cost(model, &model.name, &request);
        let costs = models.and_then(|models| models.iter().map(of).collect::<Result<_, CostError>>().ok());
        Self { costs, unknown }
    }

    /// Returns the least and the largest of a number of a quantity, one pair per horizon, among the corners and the model itself, whose
    /// cost is `central`. `number` takes it from the growth at a horizon's index. `None` if a size that makes more than `matters` of the mean square error has no interval, or if a corner has
    /// no cost.
    pub fn ends(
        &self,
        central: &Cost,
        quantity: Quantity,
        matters: f64,
        number: impl Fn(&Growth, usize) -> f64,
    ) -> Option<Vec<[f64; 2]>> {
        let is_unknown = |cause: &&crate::Cause| {
            let is_it = |(name, channel): &(String, String)| *name == cause.cause && channel == cause.channel.name();
            cause.quantity == quantity
                && self.unknown.iter().any(is_it)
                && cause.share.iter().any(|of| of.abs() > matters)
        };
        if central.causes.iter().any(|cause| is_unknown(&cause)) {
            return None;
        }
        let own = central.quantities.get(&quantity)?;
        let mut ends: Vec<[f64; 2]> = (0..own.band95.len()).map(|at| [number(own, at); 2]).collect();
        for cost in self.costs.as_ref()? {
            let corner = cost.quantities.get(&quantity)?;
            for (at, [low, high]) in ends.iter_mut().enumerate() {
                let value = number(corner, at);
                (*low, *high) = (low.min(value), high.max(value));
            }
        }
        Some(ends).filter(|ends| ends.iter().flatten().all(|end| end.is_finite()))
    }
}

/// Returns a model at four corners of its 95 % intervals: N, B, K and the sizes of its effects at their lower or upper ends, and the
/// effects' other numbers at theirs; and the causes and channels whose size has no interval. What `exact` states itself has no
/// error. Time constant and size of a course are correlated, so that both have to move.
fn models(model: &SensorModel, exact: Option<&SensorModel>) -> (Option<Vec<SensorModel>>, Vec<(String, String)>) {
    let mut unknown = Vec::new();
    let Ok(value) = serde_json::to_value(model) else { return (None, unknown) };
    let mut all = vec![value; 4];
    for (channel, own) in &model.channels {
        let declared = exact.and_then(|of| of.channels.get(channel));
        // Bit 0 of a corner's number is the end of sizes, bit 1 that of other numbers.
        let mut set = |place: &str, name: &str, bit: usize, ends: [f64; 2]| {
            for (corner, value) in all.iter_mut().enumerate() {
                let at = value.pointer_mut(&format!("/channels/{}{place}", channel.name()));
                if let Some(Value::Object(at)) = at {
                    at.insert(name.to_owned(), json!(ends[(corner >> bit) & 1]));
                }
            }
        };
        let of_sim = declared.map(|of| [of.n, of.b, of.k]);
        for (place, (name, size)) in [("N", own.n), ("B", own.b), ("K", own.k)].into_iter().enumerate() {
            let limit = own.upper_limit(name).map(|limit| [0.0, limit.max(size)]);
            match own.interval(name).or(limit) {
                Some(ends) => set("", name, 0, ends),
                None if of_sim.is_some_and(|of| of[place] == size) => {}
                None => unknown.push((name.to_owned(), channel.name().to_owned())),
            }
        }
        let found = |effect| declared.is_none_or(|of| !of.effects.contains(effect));
        for (index, effect) in own.effects.iter().enumerate().filter(|(_, effect)| found(effect)) {
            for parameter in effect.spec().parameters {
                let is_size = parameter.unit.starts_with('U');
                let Some(size) = effect.number(parameter.name) else {
                    // A list or another effect: its sizes have no interval here.
                    let is_given = effect.parameters().iter().any(|(name, _)| *name == parameter.name);
                    if is_given && (is_size || parameter.name == "of") {
                        unknown.push((effect.name().to_owned(), channel.name().to_owned()));
                    }
                    continue;
                };
                let place = format!("/effects/{index}");
                match own.effect_interval(index, parameter.name) {
                    Some([low, high]) if low * high > 0.0 => {
                        let ends = if low.abs() < high.abs() { [low, high] } else { [high, low] };
                        set(&place, parameter.name, usize::from(!is_size), ends);
                    }
                    _ if size == 0.0 || !is_size => {}
                    _ => unknown.push((effect.name().to_owned(), channel.name().to_owned())),
                }
            }
        }
    }
    let models = all.iter().map(|value| SensorModel::from_value(value, "the corrected model").ok()).collect();
    (models, unknown)
}
