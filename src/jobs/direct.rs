//! Direct: computes the results of jobs at once, for a caller that waits: no queue, no checkpoints.

use super::curves::Curves;
use super::distribution::Distribution;
use super::examine::InOneGo;
use super::motion::{AtRest, at_rest};
use super::pass::Pass;
use super::report;
use super::source::{CHUNK, Extent};
use super::spectra::Spectra;
use super::sums::Summation;
use super::{AnalysisRequest, Documents, JobError, JobKind, JobParameters, Plan, SampleSource, StatisticsReport};
use crate::store::{CaptureRow, JobState, Reader, chunks};
use imu_core::sample::{Channel, StatedSampling};
use imu_noise::NoiseReport;
use imu_noise::allan::{AllanReport, Estimator};

/// Returns the noise parameters of a plan's samples, computed on two threads; memory is bounded as a job's is.
///
/// # Errors
/// The error that `source` reports.
pub fn noise(source: &dyn SampleSource, plan: Plan) -> Result<NoiseReport, JobError> {
    noise_at_rest(source, at_rest(source, plan, true, || Ok(()))?)
}

/// As [`noise`], for a plan whose motion is known.
pub(super) fn noise_at_rest(source: &dyn SampleSource, at_rest: AtRest) -> Result<NoiseReport, JobError> {
    let mut spectra = Spectra::of(at_rest);
    take_all(source, &mut spectra)?;
    let (plan, sums, held) = spectra.finish();
    report::noise(source, &plan, &sums, held, &mut InOneGo)
}

/// Returns the deviation curves of a plan's samples. An estimator other than `oadev` holds all of them in memory.
///
/// # Errors
/// [`JobError::Allan`] if there are too few samples for a curve, or the error that `source` reports.
pub fn allan(source: &dyn SampleSource, plan: Plan, parameters: &JobParameters) -> Result<AllanReport, JobError> {
    let AtRest { plan, .. } = at_rest(source, plan, false, || Ok(()))?;
    if parameters.estimator == Estimator::Oadev {
        let mut summation = Summation::new(plan, parameters)?;
        take_all(source, &mut summation)?;
        let (plan, sums) = summation.finish();
        return Ok(report::allan(&plan, &sums, &Extent::of_plan(source, &plan)?));
    }
    let mut curves = Curves::new(plan, parameters)?;
    take_all(source, &mut curves)?;
    let (plan, estimator, curves) = curves.finish();
    Ok(report::curves(&plan, estimator, curves, &Extent::of_plan(source, &plan)?))
}

/// Returns moments, histogram and a test for normality of every channel of a capture.
///
/// # Errors
/// The error that the database reports.
pub fn statistics(reader: &Reader, capture_id: i64) -> Result<StatisticsReport, JobError> {
    let row = reader.capture(capture_id)?;
    let mut distribution = Distribution::new(row.channels);
    let channels = distribution.read_channels().to_vec();
    for chunk in chunks(0..row.samples, CHUNK, |seq, limit| reader.read_chunk(capture_id, seq, limit, &channels)) {
        distribution.take(&chunk?);
    }
    Ok(report::statistics(distribution.statistics(), Extent::read(reader, capture_id, row.samples)?))
}

/// Returns the result of a job of one of the usual kinds, over the samples in `capture`'s row. It is the stored result
/// if this version of the program has finished such a job, else it is computed at once and not stored. `stated` is the
/// user's statement about the sampling; queued jobs have none.
///
/// # Errors
/// [`JobError::InsufficientData`], [`JobError::Parameters`] for a diagnosis, which is never usual, or the error that
/// the database reports.
pub fn document(
    reader: &Reader,
    capture: &CaptureRow,
    kind: JobKind,
    stated: Option<StatedSampling>,
) -> Result<Documents, JobError> {
    let request = AnalysisRequest::usual(kind)?;
    if !capture.state.is_open() && stated.is_none() {
        let usual = request.text()?;
        let jobs = reader.jobs_over(capture.id, kind, capture.samples)?;
        let finished = jobs.into_iter().find(|job| job.state == JobState::Done && !job.stale && job.params == usual);
        let result = finished.and_then(|job| job.result_id).map(|id| reader.result(id)).transpose()?.flatten();
        if let Some(result) = result {
            return Ok(Documents::read(kind, &result.body)?);
        }
    }
    let plan = || {
        let mut plan = Plan::read(reader, capture.id, capture.samples, &Channel::ANALYSED)?;
        stated.map_or(Ok(()), |stated| plan.sampled(stated))?;
        Ok::<_, JobError>(plan)
    };
    let mut own = Documents::default();
    match request {
        AnalysisRequest::Noise(_) => own.noise = Some(noise(reader, plan()?)?),
        AnalysisRequest::Allan(parameters) => own.allan = Some(allan(reader, plan()?, &parameters)?),
        AnalysisRequest::Statistics(_) => own.statistics = Some(statistics(reader, capture.id)?),
    }
    Ok(own)
}

/// Passes all samples to `pass`, pass by pass.
fn take_all(source: &dyn SampleSource, pass: &mut dyn Pass) -> Result<(), JobError> {
    loop {
        let mut next_seq = 0;
        while let Some(plan) = pass.plan().filter(|plan| next_seq < plan.end_seq) {
            let limit = CHUNK.min(usize::try_from(plan.end_seq - next_seq).unwrap_or(CHUNK));
            let chunk = match pass.held_chunk(next_seq, limit) {
                Some(chunk) => chunk,
                None => plan.read_chunk(source, next_seq, limit, pass.read_channels())?,
            };
            pass.take(&chunk);
            next_seq = chunk.next_seq();
        }
        while pass.work() {}
        if !pass.end_pass() {
            return Ok(());
        }
    }
}
