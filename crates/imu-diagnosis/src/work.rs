//! Schedules the work on the channels, and keeps its results for a diagnosis that continues after an interruption.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::{Mutex, PoisonError};

/// The scheduler of the work: several channels may be examined at a time.
pub trait Workers: Sync {
    /// Calls `work` once with each number below `count`. If it leaves some numbers out, the diagnosis is cancelled.
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync));

    /// Returns what [`Self::keep`] received for this part of the work on a number, during the same call of
    /// [`Self::each`] of an earlier diagnosis with the same inputs, by the same version of the program.
    fn kept(&self, _number: usize, _part: usize) -> Option<Vec<u8>> {
        None
    }

    /// Receives the result of a part of the work on a number, from which a diagnosis that is interrupted can continue.
    /// Part 0 is the whole work on the number, and replaces all other parts.
    fn keep(&self, _number: usize, _part: usize, _result: Vec<u8>) {}
}

/// Does all work sequentially.
#[derive(Debug, Clone, Copy, Default)]
pub struct Alone;

impl Workers for Alone {
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
        (0..count).for_each(work);
    }
}

/// Returns the results of `work` for all numbers below `count`, in order; `None` if the workers left some out.
pub(super) fn gathered<T: Send>(
    workers: &dyn Workers,
    count: usize,
    work: impl Fn(usize) -> T + Sync,
) -> Option<Vec<T>> {
    let places: Vec<Mutex<Option<T>>> = (0..count).map(|_| Mutex::new(None)).collect();
    workers.each(count, &|index| {
        let done = work(index);
        *places[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(done);
    });
    places.into_iter().map(|place| place.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

/// The work on one number, in parts whose results are kept.
pub(super) struct Parts<'a> {
    workers: &'a dyn Workers,
    number: usize,
    /// Number of the last part that was begun.
    begun: usize,
}

impl<'a> Parts<'a> {
    /// Returns the result of the whole work on a number.
    pub(super) fn whole<T: Serialize + DeserializeOwned>(
        workers: &'a dyn Workers,
        number: usize,
        work: impl FnOnce(&mut Self) -> T,
    ) -> T {
        let mut parts = Self { workers, number, begun: 0 };
        parts.kept(0, work)
    }

    /// Returns the result of the next part. The part must not change anything else, because it may be left out.
    pub(super) fn next<T: Serialize + DeserializeOwned>(&mut self, work: impl FnOnce() -> T) -> T {
        self.begun += 1;
        self.kept(self.begun, |_| work())
    }

    /// Returns the result that was kept, or a new one, which is kept. Both are equal, bit for bit.
    fn kept<T: Serialize + DeserializeOwned>(&mut self, part: usize, work: impl FnOnce(&mut Self) -> T) -> T {
        let kept = self.workers.kept(self.number, part);
        if let Some(result) = kept.as_ref().and_then(|kept| rmp_serde::from_slice(kept).ok()) {
            return result;
        }
        let result = work(self);
        // A result that cannot be written or read is found again after each interruption.
        if let (None, Ok(new)) = (kept, rmp_serde::to_vec(&result)) {
            self.workers.keep(self.number, part, new);
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::round_trip::{CHANNELS, RATE_HZ, recording};
    use crate::{Options, diagnose};
    use imu_model::simulator::SensorModel;
    use serde_json::{Value, json};
    use std::collections::BTreeMap;

    /// The parts that were kept, by the call of `each`, number and part.
    type Kept = BTreeMap<(u32, usize, usize), Vec<u8>>;

    /// Stops the work once it has kept this many new parts.
    struct Killed {
        kept: Mutex<Kept>,
        each: Mutex<u32>,
        left: Mutex<usize>,
    }

    impl Workers for Killed {
        fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
            *self.each.lock().unwrap() += 1;
            (0..count).take_while(|_| *self.left.lock().unwrap() > 0).for_each(work);
        }

        fn kept(&self, number: usize, part: usize) -> Option<Vec<u8>> {
            let each = *self.each.lock().unwrap();
            self.kept.lock().unwrap().get(&(each, number, part)).cloned()
        }

        fn keep(&self, number: usize, part: usize, result: Vec<u8>) {
            let mut left = self.left.lock().unwrap();
            if *left > 0 {
                *left -= 1;
                let each = *self.each.lock().unwrap();
                assert_eq!(self.kept.lock().unwrap().insert((each, number, part), result), None);
            }
        }
    }

    fn model(effects: [&Value; 3]) -> SensorModel {
        let channel = |effects: &Value| json!({"N": 2e-3, "B": 4e-4, "K": 2e-5, "effects": effects});
        let channels: BTreeMap<&str, Value> =
            CHANNELS.iter().zip(effects).map(|(of, effects)| (of.name(), channel(effects))).collect();
        let model = json!({"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": RATE_HZ, "channels": channels});
        SensorModel::from_json(&model.to_string(), "test").unwrap()
    }

    #[test]
    fn a_diagnosis_that_is_killed_after_any_part_comes_to_the_same_report() {
        let steps = json!([{"effect": "bias_step", "at_s": 200.0, "size": 0.05},
            {"effect": "tone", "frequency_hz": 7.0, "amplitude": 0.004},
            {"effect": "low_pass", "cutoff_hz": 11.0, "order": 2}]);
        let samples = json!([{"effect": "heavy_tails", "degrees_of_freedom": 4.0},
            {"effect": "spikes", "rate_hz": 0.06, "amplitude": 0.3},
            {"effect": "variance_change", "from_s": 100.0, "to_s": 200.0, "factor": 2.0}]);
        let none = json!([]);
        let mut sensor = model([&steps, &samples, &none]);
        sensor.channels.values_mut().last().unwrap().k *= 100.0;
        let real = recording(&sensor, 7, 36_000);
        // The last channel's model has an effect that the record lacks, and its K is far off.
        let sim = model([
            &none,
            &none,
            &json!([{"effect": "resonance", "frequency_hz": 5.0, "bandwidth_hz": 0.4, "sigma": 0.01}]),
        ]);
        let report = |kept: Kept, left: usize| {
            let workers = Killed { kept: Mutex::new(kept), each: Mutex::new(0), left: Mutex::new(left) };
            // A new process has no plans.
            let options = Options { workers: &workers, ..Options::default() };
            let done = std::thread::scope(|scope| scope.spawn(|| diagnose(&real, &sim, &options)).join().unwrap());
            let text = |done: crate::Outcome| {
                format!("{}\n{:?}", serde_json::to_string(&done.diagnosis).unwrap(), done.augmented)
            };
            (done.map(text), workers.kept.into_inner().unwrap())
        };
        let (whole, parts) = report(Kept::new(), usize::MAX);
        let whole = whole.unwrap();
        assert!(whole.contains("\"bias_step\"") && whole.contains("\"low_pass\""), "{whole}");
        let count =
            |name: &str| parts.values().filter(|of| of.windows(name.len()).any(|of| of == name.as_bytes())).count();
        assert!(
            count("Adopt") > 5 && count("FreeLevels") > 0 && count("End") >= CHANNELS.len(),
            "{} {} {}",
            count("Adopt"),
            count("FreeLevels"),
            count("End")
        );
        let mut kept = Kept::new();
        for kills in 1..parts.len() {
            let (_, more) = report(kept, 1);
            assert_eq!(more.len(), kills);
            kept = more;
        }
        // All but the last part are kept.
        let (done, kept) = report(kept, usize::MAX);
        assert!(done.unwrap() == whole);
        assert!(kept == parts);
    }
}
