//! Along a motion: the errors of unaided integration while the sensor moves, with what acts on a motion (scale factors,
//! misalignment, latency, g-sensitivity, limits).
//!
//! In: a model, a request with a motion. Out: mean, standard deviation and band of each quantity at each horizon, by cause. The
//! sensor is at rest at the motion's first attitude over the alignment, then the motion begins. The mean is that of a sensor
//! without noise (`courses`), integrated by the full strapdown (`path`). The noise of each cause is simulated and its errors are
//! summed to first order about the truth (`noise`). If an effect acts on the sum of noise and motion, the whole sensor is
//! simulated and integrated by the full strapdown.

mod courses;
mod noise;
mod path;
#[cfg(test)]
mod tests;

use crate::band::empirical;
use crate::compose::{Composed, moments};
use crate::document::{Cause, Growth, Method};
use crate::request::{Along, CostError, MOTION_ROWS_MAX, MotionRefusal, Quantity, Request, Setting};
use crate::sources::restricted;
use courses::Courses;
use imu_core::sample::Channel;
use imu_model::motion::file::samples_per_row;
use imu_model::motion::gravity;
use imu_model::simulator::{Motion, SensorModel};
use path::{Path, USED, Values, is_at_rest, place_of};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// The most samples of one channel in all runs: about ten minutes.
const WORK_MAX: f64 = 1e10;

/// Returns how many of the sensor's own samples a row stands for, and the number of samples that the motion has.
fn samples_of(along: &Along, model: &SensorModel) -> Result<(u32, u64), MotionRefusal> {
    let (name, found) = (along.name.clone(), along.rows.len());
    if !(2..=MOTION_ROWS_MAX).contains(&found) {
        return Err(MotionRefusal::Rows { name, found });
    }
    let values = |row: &Motion| [row.gyro_rad_s, row.accel_m_s2].concat().into_iter().chain(row.temperature_c);
    if let Some(row) = along.rows.iter().position(|row| !values(row).all(f64::is_finite)) {
        return Err(MotionRefusal::Value { name, row: row + 1 });
    }
    let internal_hz = model.internal_rate_hz(model.rate_hz);
    let every = samples_per_row(&name, along.rate_hz, model.rate_hz, internal_hz)
        .map_err(|error| MotionRefusal::Rate(error.to_string()))?;
    let ratio = (internal_hz / model.rate_hz).round().max(1.0) as u64;
    Ok((every, found as u64 * u64::from(every) / ratio))
}

/// Returns the request with the horizons that are within its motion, and a note on those that are left out.
///
/// # Errors
/// [`MotionRefusal`] for a motion that cannot be used, and if no horizon or not every limit is within it.
pub(crate) fn within<'a>(
    request: &'a Request,
    model: &SensorModel,
) -> Result<(Cow<'a, Request>, Option<String>), MotionRefusal> {
    let Some(along) = &request.motion else { return Ok((Cow::Borrowed(request), None)) };
    let (_, samples) = samples_of(along, model)?;
    let length_s = samples as f64 / model.rate_hz;
    let ends_before = |time_s: &f64| (time_s * model.rate_hz).round() > samples as f64;
    let short = |found_s| MotionRefusal::Short { name: along.name.clone(), length_s, found_s };
    if let Some(found_s) = request.tolerances.iter().map(|limit| limit.horizon_s).find(ends_before) {
        return Err(short(found_s));
    }
    let (beyond, horizons_s): (Vec<f64>, Vec<f64>) = request.horizons_s.iter().partition(|time_s| ends_before(time_s));
    match beyond.first() {
        None => Ok((Cow::Borrowed(request), None)),
        Some(found_s) if horizons_s.is_empty() => Err(short(*found_s)),
        Some(_) => {
            let list = beyond.iter().map(|time_s| format!("{time_s} s")).collect::<Vec<_>>().join(", ");
            let note = format!("the motion ends after {length_s} s: no horizon of {list}");
            Ok((Cow::Owned(Request { horizons_s, ..request.clone() }), Some(note)))
        }
    }
}

/// Returns what a reader has to know about the motion's begin and about channels that the model lacks.
pub(crate) fn notes(along: &Along, model: &SensorModel, quantities: &[Quantity]) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some(begin) = along.rows.first().filter(|begin| !is_at_rest(begin)) {
        let [x, y, z] = begin.gyro_rad_s.map(crate::number);
        notes.push(format!(
            "the motion begins with a turn of ({x}, {y}, {z}) rad/s: the alignment is at rest at its first attitude all the same"
        ));
    }
    let has = |channel: &Channel| model.channels.contains_key(channel);
    let attitude_only = !has(&Channel::AccelX) && !has(&Channel::AccelY);
    let concerned = if attitude_only { &USED[..3] } else { &USED[..] };
    if attitude_only {
        notes.push("the model has no horizontal accelerometer: attitude only".to_owned());
    }
    let list = |names: Vec<String>| names.join(", ");
    let missing = list(concerned.iter().filter(|channel| !has(channel)).map(ToString::to_string).collect());
    if !missing.is_empty() {
        let is_left_out = |of: &&Quantity| !quantities.contains(of) && (of.unit() == "rad" || !attitude_only);
        let left_out = list(Quantity::all().iter().filter(is_left_out).map(ToString::to_string).collect());
        let without = if left_out.is_empty() { String::new() } else { format!("; no {left_out}") };
        notes.push(format!("the model has no {missing}, which counts as free of error{without}"));
    }
    notes
}

/// Computes the quantities along the request's motion.
///
/// # Errors
/// [`CostError`] for a motion that does not begin with gravity, and a model that cannot be simulated.
pub(crate) fn composed(
    request: &Request,
    along: &Along,
    model: &SensorModel,
    quantities: &[Quantity],
) -> Result<BTreeMap<Quantity, Composed>, CostError> {
    let (every, _) = samples_of(along, model)?;
    let mut model = restricted(model, &USED);
    // A motion brings gravity. In a bias it would be there twice, which matters to limits.
    gravity::take_out(&mut model, imu_core::units::STANDARD_GRAVITY_M_S2);
    let setting = Setting::new(request, &model)?;
    let path = Path::new(&setting, along, every, request.temperature.is_none())?;
    let courses = courses::courses(&path, &setting, &model)?;
    let noises = noise::noises(&path, &setting, &model, &courses)?;
    let causes = noises.all.len() + usize::from(!noises.nonlinear.is_empty());
    let samples = (setting.begin + setting.samples()) as f64 * setting.ratio() as f64;
    let work = samples * (setting.runs * causes) as f64;
    if work > WORK_MAX {
        let found_s = setting.record_s();
        let most_s = (found_s * WORK_MAX / work).floor();
        return Err(MotionRefusal::Work { runs: setting.runs, causes, found_s, most_s }.into());
    }
    let mut parts = Parts { nonlinear: noises.nonlinear, ..Parts::of(courses) };
    for noise in &noises.all {
        parts.add(noise.channel, noise.name, noise.runs(&path, &setting)?);
    }
    if !parts.nonlinear.is_empty() {
        parts.whole = Some(noise::whole(&path, &setting, &model)?);
    }
    let one = |quantity: &Quantity| Ok((*quantity, parts.composed(&setting, *quantity)?));
    quantities.iter().map(one).collect()
}

/// One cause on one channel.
#[derive(Debug)]
struct Part {
    channel: usize,
    name: &'static str,
    /// Its part of the mean, and the mean without it, by horizon; none if it does nothing without noise.
    course: Option<[Vec<Values>; 2]>,
    /// Its noise by run and horizon; none if it has none.
    runs: Vec<Vec<Values>>,
}

/// All causes, and the whole sensor if it had to be simulated.
#[derive(Debug)]
struct Parts {
    mean: Vec<Values>,
    all: Vec<Part>,
    nonlinear: Vec<(Channel, &'static str)>,
    whole: Option<Vec<Vec<Values>>>,
}

impl Parts {
    fn of(courses: Courses) -> Self {
        let part = |of: courses::CourseCause| Part {
            channel: of.channel,
            name: of.name,
            course: Some([of.own, of.without]),
            runs: Vec::new(),
        };
        let all = courses.causes.into_iter().map(part).collect();
        Self { mean: courses.mean, all, nonlinear: Vec::new(), whole: None }
    }

    /// Adds the noise of a cause, which may have a course as well.
    fn add(&mut self, channel: usize, name: &'static str, runs: Vec<Vec<Values>>) {
        match self.all.iter_mut().find(|part| part.channel == channel && part.name == name) {
            Some(part) => part.runs = runs,
            None => self.all.push(Part { channel, name, course: None, runs }),
        }
    }

    /// Composes one quantity.
    fn composed(&self, setting: &Setting<'_>, quantity: Quantity) -> Result<Composed, MotionRefusal> {
        let own = place_of(quantity);
        // The attitude does not depend on the accelerometer.
        let acts = |channel: usize| quantity.unit() != "rad" || channel < 3;
        let channel_of = |channel: &Channel| USED.iter().position(|used| used == channel).unwrap_or(0);
        let nonlinear: Vec<(Channel, &'static str)> =
            self.nonlinear.iter().filter(|(channel, _)| acts(channel_of(channel))).copied().collect();
        let parts: Vec<&Part> = self.all.iter().filter(|part| acts(part.channel)).collect();
        let mut causes: Vec<Cause> = Vec::new();
        let mut names: Vec<(Channel, &'static str)> =
            parts.iter().map(|part| (USED[part.channel], part.name)).collect();
        names.extend(nonlinear.iter().filter(|name| !parts.iter().any(|part| part.is(name))));
        causes.extend(names.iter().map(|(channel, name)| blank(quantity, *channel, name)));
        let is_random = !nonlinear.is_empty() || parts.iter().any(|part| !part.runs.is_empty());
        let mut simulated: Vec<String> =
            nonlinear.iter().map(|(channel, name)| format!("{name} on {channel}")).collect();
        if is_random && simulated.is_empty() {
            simulated.push("the motion".to_owned());
        }
        let mut growth = Growth {
            unit: quantity.unit(),
            mean: Vec::new(),
            sd: Vec::new(),
            band95: Vec::new(),
            band95_upper: None,
            method: if is_random { Method::MonteCarlo } else { Method::ClosedForm },
            runs: is_random.then_some(setting.runs),
            simulated,
        };
        for horizon in 0..setting.horizons.len() {
            let at = At { parts: &parts, own, horizon, runs: if is_random { setting.runs } else { 1 } };
            let sum = at.sum(|_| true);
            let course = self.mean[horizon][own];
            let all = match self.whole.as_ref().filter(|_| !nonlinear.is_empty()) {
                Some(whole) => whole.iter().map(|values| values[horizon][own]).collect(),
                None => sum.iter().map(|value| course + value).collect::<Vec<f64>>(),
            };
            let (mut mean, sd, band) = moments(&all);
            if nonlinear.is_empty() {
                // The mean of noise is 0, and that of its runs has the error of chance.
                mean = course;
            }
            if ![mean, sd, band].into_iter().all(f64::is_finite) {
                return Err(MotionRefusal::Infinite { quantity });
            }
            growth.mean.push(mean);
            growth.sd.push(sd);
            growth.band95.push(band);
            let square = mean * mean + sd * sd;
            at.share(&mut causes, [mean, square], &all, &nonlinear);
            if nonlinear.is_empty() {
                at.without(&mut causes, [course, band], &sum);
            }
        }
        Ok(Composed { growth, causes })
    }
}

impl Part {
    fn is(&self, (channel, name): &(Channel, &'static str)) -> bool {
        USED[self.channel] == *channel && self.name == *name
    }
}

fn blank(quantity: Quantity, channel: Channel, name: &str) -> Cause {
    let (share, share_band95, band95_without) = (Vec::new(), Vec::new(), Vec::new());
    Cause { cause: name.to_owned(), channel, quantity, share, share_band95, band95_without }
}

/// The parts of a quantity at a horizon.
struct At<'a> {
    parts: &'a [&'a Part],
    own: usize,
    horizon: usize,
    runs: usize,
}

impl At<'_> {
    /// Returns the noise of a part in each run.
    fn noise(&self, part: &Part) -> Vec<f64> {
        part.runs.iter().map(|values| values[self.horizon][self.own]).collect()
    }

    /// Returns the sum of the noise of chosen parts in each run.
    fn sum(&self, keep: impl Fn(&Part) -> bool) -> Vec<f64> {
        let mut sum = vec![0.0; self.runs];
        for part in self.parts.iter().filter(|part| keep(part)) {
            sum.iter_mut().zip(self.noise(part)).for_each(|(sum, value)| *sum += value);
        }
        sum
    }

    /// Adds each cause's share of the mean square error; nonlinear causes have what the others leave.
    fn share(&self, causes: &mut [Cause], [mean, square]: [f64; 2], all: &[f64], nonlinear: &[(Channel, &str)]) {
        let is_nonlinear =
            |cause: &Cause| nonlinear.iter().any(|(of, name)| cause.channel == *of && cause.cause == *name);
        let mut explained = 0.0;
        for (part, cause) in self.parts.iter().zip(causes.iter_mut()) {
            let course = part.course.as_ref().map_or(0.0, |[own, _]| own[self.horizon][self.own]);
            let own = course * mean + covariance(&self.noise(part), all);
            let share = if square > 0.0 && !is_nonlinear(cause) { own / square } else { 0.0 };
            explained += share;
            cause.share.push(share);
        }
        let others: Vec<&mut Cause> = causes.iter_mut().filter(|cause| is_nonlinear(cause)).collect();
        let count = others.len() as f64;
        for cause in others {
            cause.share.truncate(self.horizon);
            cause.share.push(if square > 0.0 { (1.0 - explained) / count } else { 0.0 });
        }
    }

    /// Adds the band without each cause.
    fn without(&self, causes: &mut [Cause], [course, band]: [f64; 2], sum: &[f64]) {
        for (part, cause) in self.parts.iter().zip(causes) {
            let course = part.course.as_ref().map_or(course, |[_, without]| without[self.horizon][self.own]);
            let mut left: Vec<f64> = sum.iter().map(|value| course + value).collect();
            left.iter_mut().zip(self.noise(part)).for_each(|(left, value)| *left -= value);
            let without = empirical(&left);
            cause.band95_without.push(without);
            cause.share_band95.push(if band > 0.0 { 1.0 - without / band } else { 0.0 });
        }
    }
}

/// Returns the covariance of values with others; 0 if there are none.
fn covariance(values: &[f64], others: &[f64]) -> f64 {
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
    let (own, other) = (mean(values), mean(others));
    let sum: f64 = values.iter().zip(others).map(|(value, with)| (value - own) * (with - other)).sum();
    sum / (values.len() as f64 - 1.0).max(1.0)
}
