//! Calibration: records of a model's noise alone, of a record's own length, and the chance findings of a diagnosis in them.

use super::error::DiagnosisError;
use super::evidence::{self, Kind};
use super::explanation::Explanation;
use super::omnibus::{self, Statistic};
use super::prepare;
use super::prices::{Tail, Tails};
use super::recording::Recording;
use super::series::Series;
use super::work::{Workers, gathered};
use imu_core::sample::Channel;
use imu_model::effects::{Effect, Flicker, RandomWalk, Stream, StreamId, White};
use imu_model::simulator::{ChannelModel, SensorModel};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

/// Records in a calibration.
pub const RECORDS: usize = 300;

/// The model that is imitated.
#[derive(Debug, Clone, PartialEq)]
pub struct Nulls {
    /// Samples.
    pub samples: usize,
    /// Samples per second.
    pub rate_hz: f64,
    /// N, B and K of each channel, in its unit.
    pub levels: Vec<[f64; 3]>,
    /// The temperature at each sample, °C, if it is measured.
    pub temperature_c: Option<Vec<f64>>,
    /// The seed of the first record.
    pub seed: u64,
}

/// The chance findings on one pair of channels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Chance {
    /// Gains, nats.
    pub kinds: Vec<(Kind, f64)>,
    /// Statistics.
    pub statistics: Vec<(Statistic, f64)>,
}

impl Nulls {
    /// Returns the nulls for a recording and the model that it is compared with.
    pub fn of(real: &Recording, sim: &SensorModel) -> Self {
        let levels = sim.channels.iter().filter(|(channel, _)| **channel != Channel::Temperature);
        Self {
            samples: real.len(),
            rate_hz: sim.rate_hz,
            levels: levels.map(|(_, model)| [model.n, model.b, model.k]).filter(|of| of[0] > 0.0).collect(),
            temperature_c: real.temperature_c.clone(),
            seed: 1,
        }
    }

    /// Returns the `index`th record of two channels, and a model whose N, B and K are off by up to 5, 25 and 40 %, as
    /// models are.
    fn record(&self, index: usize) -> (Recording, SensorModel) {
        let mut model = SensorModel { rate_hz: self.rate_hz, ..SensorModel::default() };
        let mut real = Recording {
            rate_hz: self.rate_hz,
            temperature_c: self.temperature_c.clone().filter(|values| values.len() == self.samples),
            ..Recording::default()
        };
        for (place, channel) in [Channel::GyroX, Channel::GyroY].into_iter().enumerate() {
            let [n, b, k] = self.levels[(2 * index + place) % self.levels.len()];
            let stream = |effect| {
                let id = StreamId { owner: place as u32, effect, instance: 0 };
                Stream::new(self.seed.wrapping_add(index as u64), id)
            };
            let mut values = vec![0.0; self.samples];
            let noise: [&dyn Effect; 3] = [&White { n }, &Flicker { b }, &RandomWalk { k }];
            for (effect, number) in noise.into_iter().zip(0..) {
                let length_s = self.samples as f64 / self.rate_hz;
                effect.sampler(self.rate_hz, length_s, stream(number)).apply(&mut values);
            }
            let mut off = stream(9);
            let mut wrong = |value: f64, share: f64| value * (1.0 + share * (2.0 * off.uniform() - 1.0));
            let declared =
                ChannelModel { n: wrong(n, 0.05), b: wrong(b, 0.25), k: wrong(k, 0.4), ..ChannelModel::default() };
            model.channels.insert(channel, declared);
            real.channels.push((channel, values));
        }
        (real, model)
    }

    /// Returns the chance findings for the `index`th record.
    ///
    /// # Errors
    /// [`DiagnosisError`] for a length or for levels that the diagnosis cannot handle.
    pub fn chance(&self, index: usize) -> Result<Chance, DiagnosisError> {
        if self.levels.is_empty() {
            return Err(DiagnosisError::Model("no channel has an N, so that there is no noise to simulate".to_owned()));
        }
        let (real, model) = self.record(index);
        let ready = prepare::prepare(&real, &model)?;
        let mut found = Chance::default();
        let mut residuals: Vec<Vec<f64>> = Vec::new();
        for prepared in &ready.channels {
            let base =
                |grid: &super::grid::Grid, without: &BTreeSet<usize>| prepare::base_of(&model, prepared, grid, without);
            let setting = ready.setting(prepared, &base);
            let start = Explanation::noise(prepared.declared.clone());
            let mut series = Series::new(&setting, ready.transform.clone(), prepared.samples.clone(), start);
            // The gain of a kind that is not examined is 0.
            let mut gains: BTreeMap<Kind, f64> = Kind::ALL.into_iter().map(|kind| (kind, 0.0)).collect();
            for candidate in evidence::all_and_conditional(&mut series) {
                gains.insert(candidate.kind, candidate.gain);
            }
            // A loud stretch is a burst or an interval of another variance.
            let loud = gains[&Kind::Bursts].max(gains[&Kind::VarianceInterval]);
            gains.insert(Kind::Bursts, loud);
            gains.insert(Kind::VarianceInterval, loud);
            found.kinds.extend(gains);
            residuals.push(series.residual.clone());
            let parts = omnibus::component::parts(&mut series);
            found.statistics.extend(omnibus::statistics(&mut series, prepared.facts.atom, &parts));
        }
        let crosstalk = omnibus::crosstalk::greatest(residuals, &|_, _| false);
        found.statistics.extend(crosstalk.first().map(|value| (Statistic::Crosstalk, *value)));
        Ok(found)
    }

    /// Returns the tails of this many records, as [`Nulls::chances`] does.
    ///
    /// # Errors
    /// As [`Nulls::chances`].
    pub fn tails(
        &self,
        records: usize,
        workers: &dyn Workers,
        each: &(dyn Fn(usize) -> bool + Sync),
    ) -> Result<Option<Tails>, DiagnosisError> {
        Ok(self.chances(records, workers, each)?.map(|all| tails(&all, self.samples)))
    }

    /// Returns the tails of chance in this many records. `each` receives the number of finished records and returns
    /// whether to continue.
    ///
    /// # Errors
    /// [`DiagnosisError`] of a record; `Ok(None)` if the calibration was stopped.
    pub fn chances(
        &self,
        records: usize,
        workers: &dyn Workers,
        each: &(dyn Fn(usize) -> bool + Sync),
    ) -> Result<Option<Vec<Chance>>, DiagnosisError> {
        let done = Mutex::new((0, true));
        let all = gathered(workers, records, |index| {
            if !done.lock().unwrap_or_else(PoisonError::into_inner).1 {
                return None;
            }
            let found = self.chance(index);
            let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
            done.0 += 1;
            done.1 &= each(done.0);
            Some(found)
        });
        if !done.into_inner().unwrap_or_else(PoisonError::into_inner).1 {
            return Ok(None);
        }
        all.map(|all| all.into_iter().flatten().collect()).transpose()
    }
}

/// Returns the tails of the chance values. A statistic without information (its value is always 0) takes its tail from
/// the shipped table.
pub fn tails(all: &[Chance], samples: usize) -> Tails {
    let mut tails = Tails::shipped(samples);
    let again = |tail: &mut Tail, values: Vec<f64>| {
        if values.iter().any(|value| *value > 0.0) {
            *tail = Tail::of(&values).unwrap_or(*tail);
        }
    };
    for (kind, tail) in &mut tails.kinds {
        let of = all.iter().flat_map(|of| &of.kinds).filter(|(own, _)| own == kind);
        again(tail, of.map(|(_, value)| *value).collect());
    }
    for (statistic, tail) in &mut tails.statistics {
        let of = all.iter().flat_map(|of| &of.statistics).filter(|(own, _)| own == statistic);
        again(tail, of.map(|(_, value)| *value).collect());
    }
    tails
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Alone;

    #[test]
    fn the_same_seed_has_the_same_tails_and_it_can_be_stopped() {
        let nulls = Nulls {
            samples: 2001,
            rate_hz: 40.0,
            levels: vec![[0.01, 0.002, 1e-4]],
            temperature_c: Some((0..2001).map(|t| 25.0 + f64::from(t) * 0.002).collect()),
            seed: 5,
        };
        let tails = |records| nulls.tails(records, &Alone, &|_| true).unwrap().unwrap();
        let found = tails(24);
        assert_eq!(found, tails(24));
        assert_ne!(found.kinds[&Kind::Tone], Tails::shipped(2001).kinds[&Kind::Tone]);
        let shipped = Tails::shipped(2001);
        for kind in [Kind::Tone, Kind::BiasStep, Kind::RateRamp, Kind::TemperatureCurve] {
            let (own, other) = (found.kinds[&kind].beyond(1e-3), shipped.kinds[&kind].beyond(1e-3));
            assert!((own - other).abs() < 6.0, "{kind:?}: {own} {other}");
        }
        assert_eq!(nulls.tails(24, &Alone, &|done| done < 3).unwrap(), None);
    }
}
