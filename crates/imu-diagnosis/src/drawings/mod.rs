//! Drawings: the data for the pictures on the page of a diagnosis, beside its report.

mod simulated;
mod spectra;
mod timeline;

pub use spectra::ChannelSpectra;
pub use timeline::{ChannelTimeline, Stretches};

use super::motion::Residuals;
use super::{Diagnosis, Outcome, Recording};
use imu_core::sample::Channel;
use imu_model::simulator::SensorModel;
use serde::{Deserialize, Serialize};
use simulated::simulated;
use spectra::Bins;

/// The data for the pictures, as `page::diagnosis` of `vn100d` takes it. Results of earlier versions have less of it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Drawings {
    /// The spectra of every channel that was compared.
    pub spectra: Vec<ChannelSpectra>,
    /// The timelines of channels with findings, in a record at rest.
    pub timelines: Vec<ChannelTimeline>,
    /// The residuals of a record of a motion.
    pub residuals: Vec<Residuals>,
}

impl Drawings {
    /// Returns drawings of a record that was compared with `sim`, and of the result. The record begins `from_s` after
    /// the origin of its times. Of a record with a motion that has no residuals, the longest rest is drawn. The channels are simulated one after the other, so that memory is that of three
    /// channels.
    pub fn new(real: &Recording, from_s: f64, sim: &SensorModel, outcome: &Outcome) -> Self {
        let within = outcome.rest.clone().unwrap_or(0..real.len());
        if within.is_empty() {
            return Self::default();
        }
        let rest = outcome.rest.as_ref().map(|within| real.part(within.clone()));
        let (real, from_s) = (rest.as_ref().unwrap_or(real), from_s + within.start as f64 / real.rate_hz);
        let residuals = outcome.residuals.clone();
        // If the record has a motion, a simulation without the motion does not show the record's course.
        let at_rest = residuals.is_empty();
        let found = found(&outcome.diagnosis);
        let mut bins = Bins::new(real);
        let (mut spectra, mut timelines) = (Vec::new(), Vec::new());
        for (channel, values) in real.channels.iter().filter(|(channel, _)| sim.channels.contains_key(channel)) {
            let (channel, models) = (*channel, [sim, &outcome.augmented]);
            let drawn = found.contains(&channel);
            let known = models.map(|model| bins.of_model(model, channel));
            let simulations = [0, 1].map(|index| {
                let wanted = at_rest && (drawn || known[index].is_none());
                if wanted { simulated(real, models[index], channel) } else { None }
            });
            spectra.push(ChannelSpectra::new(&mut bins, (channel, values), known, &simulations));
            if at_rest && drawn {
                timelines.extend(ChannelTimeline::new(real, from_s, (channel, values), &simulations));
            }
        }
        Self { spectra, timelines, residuals }
    }
}

/// Returns the channels with findings.
fn found(report: &Diagnosis) -> Vec<Channel> {
    let places = report.r#where.iter().map(|of| &of.channel);
    let parameters = report.parameters.iter().map(|of| &of.channel);
    let causes = report.causes.iter().flat_map(|of| &of.channels);
    let names: Vec<&String> = places.chain(parameters).chain(causes).collect();
    Channel::ALL.into_iter().filter(|channel| names.iter().any(|name| *name == channel.name())).collect()
}
