//! Requests for filter parameters: range of horizons, alignment, record; checked and turned into a grid of samples.
//!
//! Refused with one sentence that names what was found and what is allowed ([`FilterError`]): ranges that are empty,
//! reversed, shorter than a sample or too long, and models without gyroscope and accelerometer.

use crate::request::{CostError, Request, Setting};
use imu_core::sample::Channel;
use imu_core::units::parse_duration;
use imu_model::motion::Temperatures;
use imu_model::simulator::SensorModel;
use std::collections::BTreeMap;

/// The range that is taken if none is given, s.
const USUAL_S: [f64; 2] = [0.1, 100.0];
/// The record that is taken if neither the request nor the model states one, s.
const USUAL_RECORD_S: f64 = 3600.0;
/// Horizons per decade whose errors are fitted jointly, and at which the covering pair is checked.
const JOINT_PER_DECADE: f64 = 5.0;
const FINE_PER_DECADE: f64 = 80.0;
/// The largest ratio of the ends of a range: beyond it the joint covariance is singular in floating-point numbers.
const WIDEST: f64 = 1e6;
/// Two parameters need more than two different horizons.
const LEAST_HORIZONS: usize = 3;

/// A range of horizons.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Over {
    /// The shortest horizon, s.
    pub from_s: f64,
    /// The longest horizon, s.
    pub to_s: f64,
}

impl Over {
    /// Reads `FROM..TO`, such as `0.1s..100s`.
    ///
    /// # Errors
    /// [`FilterError::Range`] with the text and what is allowed.
    pub fn parse(text: &str) -> Result<Self, FilterError> {
        let refuse = |expected: String| FilterError::Range { found: text.trim().to_owned(), expected };
        let form = "FROM..TO, such as 0.1s..100s".to_owned();
        let (from, to) = text.split_once("..").ok_or_else(|| refuse(form))?;
        let units = || refuse("two numbers with a unit, such as 0.1s..100s".to_owned());
        let time = |text: &str| parse_duration(text).map(|time| time.as_secs_f64()).map_err(|_| units());
        let own = Self { from_s: time(from)?, to_s: time(to)? };
        own.check().map_err(|_| refuse("a first time above 0 and a longer second one".to_owned()))?;
        Ok(own)
    }

    /// Checks that the range is positive and not empty.
    fn check(self) -> Result<(), FilterError> {
        let Self { from_s, to_s } = self;
        if from_s.is_finite() && to_s.is_finite() && 0.0 < from_s && from_s < to_s {
            return Ok(());
        }
        let found = format!("{from_s}s..{to_s}s");
        Err(FilterError::Range { found, expected: "a first time above 0 and a longer second one".to_owned() })
    }
}

/// The reason why filter parameters were refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FilterError {
    /// A range cannot be read, is empty, or is reversed.
    #[error("the range `{found}`: expected {expected}")]
    Range {
        /// The given text.
        found: String,
        /// What is allowed.
        expected: String,
    },
    /// A range begins before the first sample.
    #[error(
        "a range from {found_s} s is shorter than a sample at {rate_hz} Hz: expected one from {least_s} s or later"
    )]
    Short {
        /// The begin of the range, s.
        found_s: f64,
        /// The model's rate, Hz.
        rate_hz: f64,
        /// The shortest begin, s.
        least_s: f64,
    },
    /// A range has too few different horizons.
    #[error(
        "a range from {from_s} s to {to_s} s at {rate_hz} Hz has too few different horizons ({found} of {LEAST_HORIZONS}): expected an \
         end of {least_s} s or later"
    )]
    Narrow {
        /// The begin of the range, s.
        from_s: f64,
        /// The end of the range, s.
        to_s: f64,
        /// The number of different horizons.
        found: usize,
        /// The model's rate, Hz.
        rate_hz: f64,
        /// The shortest end, s.
        least_s: f64,
    },
    /// A range spans too many decades for floating-point numbers.
    #[error("a range from {from_s} s to {to_s} s: expected an end of at most {most_s} s, {WIDEST:e} times its begin")]
    Wide {
        /// The begin of the range, s.
        from_s: f64,
        /// The end of the range, s.
        to_s: f64,
        /// The longest end, s.
        most_s: f64,
    },
    /// The record is not a time above 0.
    #[error("a record of {found_s} s: expected a time above 0, such as 5h")]
    Record {
        /// The given time, s.
        found_s: f64,
    },
    /// The model has neither gyroscope nor accelerometer.
    #[error("the model has no channel that a filter integrates: expected some of {expected}")]
    NoChannel {
        /// The channels.
        expected: String,
    },
    /// Alignment, length or model are refused as for a cost.
    #[error(transparent)]
    Cost(#[from] CostError),
}

/// A request for filter parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct FilterRequest {
    /// The range of horizons; without it 0.1 s to 100 s, from the first sample on if that comes later.
    pub over: Option<Over>,
    /// Time over which the bias is taken as a mean, s; it ends where a horizon begins.
    pub align_s: f64,
    /// The record over which what changes with time is averaged, s; without it the one that the model was fitted to, else
    /// an hour.
    pub record_s: Option<f64>,
    /// The sensor's temperature from the record's begin on; without it, a constant one.
    pub temperature: Option<Temperatures>,
    /// The seed of what has to be simulated.
    pub seed: u64,
    /// N and K from the Allan deviation, which the inflation is stated over: U/√Hz and U/√s, by channel.
    pub allan: BTreeMap<Channel, [Option<f64>; 2]>,
}

impl Default for FilterRequest {
    fn default() -> Self {
        Self { over: None, align_s: 30.0, record_s: None, temperature: None, seed: 1, allan: BTreeMap::new() }
    }
}

/// Where the length of a record comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordFrom {
    /// The request states it.
    Request,
    /// The model was fitted to a record of this length.
    Model,
    /// Neither states one.
    Assumed,
}

/// The horizons of a range, in samples, and the pairs of them whose moments are computed.
#[derive(Debug, Clone)]
pub(crate) struct Grid {
    /// The horizons at which the covering pair is checked, increasing.
    pub horizons: Vec<u64>,
    /// The places among them of those that are fitted jointly.
    pub joint: Vec<usize>,
    /// Places of both horizons of each pair: those of `joint` with each other, row by row, then every horizon with itself.
    pub pairs: Vec<[usize; 2]>,
}

impl Grid {
    /// Creates the grid of a range. `phases` returns further horizons at which to check one.
    pub(crate) fn new(over: Over, rate_hz: f64, phases: impl Fn(u64) -> Vec<u64>) -> Result<Self, FilterError> {
        let (from, to) = ((over.from_s * rate_hz).round(), (over.to_s * rate_hz).round());
        if from < 1.0 {
            return Err(FilterError::Short { found_s: over.from_s, rate_hz, least_s: 1.0 / rate_hz });
        }
        if to > WIDEST * from {
            let Over { from_s, to_s } = over;
            return Err(FilterError::Wide { from_s, to_s, most_s: WIDEST * from / rate_hz });
        }
        let spaced = |per_decade: f64| -> Vec<u64> {
            let steps = (per_decade * (to / from).log10()).ceil().max(1.0);
            let mut of: Vec<u64> =
                (0..=steps as u64).map(|k| (from * (to / from).powf(k as f64 / steps)).round() as u64).collect();
            of.dedup();
            of
        };
        let (joint, mut horizons) = (spaced(JOINT_PER_DECADE.max(3.0 / (to / from).log10())), spaced(FINE_PER_DECADE));
        if joint.len() < LEAST_HORIZONS {
            let least_s = (from + LEAST_HORIZONS as f64 - 1.0) / rate_hz;
            let Over { from_s, to_s } = over;
            return Err(FilterError::Narrow { from_s, to_s, found: joint.len(), rate_hz, least_s });
        }
        let inside = |horizon: &u64| (from as u64..=to as u64).contains(horizon);
        horizons.extend(joint.iter().flat_map(|horizon| phases(*horizon)).filter(inside));
        horizons.extend(&joint);
        horizons.sort_unstable();
        horizons.dedup();
        let joint: Vec<usize> = joint.iter().filter_map(|own| horizons.binary_search(own).ok()).collect();
        let mut pairs = Vec::new();
        for (row, one) in joint.iter().enumerate() {
            pairs.extend(joint[..=row].iter().map(|other| [*one, *other]));
        }
        pairs.extend((0..horizons.len()).map(|place| [place, place]));
        Ok(Self { horizons, joint, pairs })
    }

    /// Returns the number of pairs of jointly fitted horizons, which come first.
    pub(crate) fn joint_pairs(&self) -> usize {
        self.pairs.len() - self.horizons.len()
    }
}

/// A checked request.
#[derive(Debug)]
pub(crate) struct Asked<'a> {
    pub over: Over,
    /// Alignment and horizons of the spectra.
    pub setting: Setting<'a>,
    /// Alignment and the rest of the record, for what changes with time.
    pub record: Setting<'a>,
    pub record_s: f64,
    pub record_from: RecordFrom,
    /// Whether alignment and longest horizon exceed the record.
    pub extrapolated: bool,
}

impl<'a> Asked<'a> {
    /// Checks a request against the model.
    pub(crate) fn new(request: &FilterRequest, model: &'a SensorModel) -> Result<Self, FilterError> {
        let first_s = USUAL_S[0].max(1.0 / model.rate_hz);
        let over = request.over.unwrap_or(Over { from_s: first_s, to_s: USUAL_S[1].max(10.0 * first_s) });
        over.check()?;
        if over.to_s * model.rate_hz < 1.0 {
            let (rate_hz, least_s) = (model.rate_hz, 1.0 / model.rate_hz);
            return Err(FilterError::Short { found_s: over.from_s, rate_hz, least_s });
        }
        if let Some(found_s) = request.record_s.filter(|record_s| !(record_s.is_finite() && *record_s > 0.0)) {
            return Err(FilterError::Record { found_s });
        }
        let stated_s = crate::record_s(model);
        let (record_s, record_from) = match (request.record_s, stated_s) {
            (Some(given_s), _) => (given_s, RecordFrom::Request),
            (None, Some(stated_s)) => (stated_s, RecordFrom::Model),
            (None, None) => (USUAL_RECORD_S, RecordFrom::Assumed),
        };
        let period_s = 1.0 / model.rate_hz;
        let setting = |longest_s: f64| {
            let horizons_s = vec![longest_s];
            let (temperature, seed) = (request.temperature.clone(), request.seed);
            Setting::new(
                &Request { align_s: request.align_s, horizons_s, temperature, seed, ..Request::default() },
                model,
            )
        };
        let mut own = setting(over.to_s)?;
        let first = ((over.from_s * model.rate_hz).round() as u64).max(1);
        own.horizons.insert(0, first.min(own.horizons[0]));
        let needed_s = request.align_s + over.to_s;
        let record = setting((record_s.max(needed_s) - request.align_s).max(period_s))?;
        let limit_s = if record_from == RecordFrom::Assumed { f64::INFINITY } else { record_s };
        let record_s = record.record_s();
        Ok(Self { over, setting: own, record, record_s, record_from, extrapolated: needed_s > limit_s })
    }
}
