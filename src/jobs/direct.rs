//! Direct: what jobs compute, at once, for whoever waits for it: no queue, no checkpoints.

use super::curves::Curves;
use super::distribution::Distribution;
use super::fold::Pass;
use super::report::{self, Extent};
use super::runner::CHUNK;
use super::spectra::Spectra;
use super::sums::Summation;
use super::{JobError, JobParameters, Plan, SampleSource, StatisticsReport};
use crate::noise::NoiseReport;
use crate::noise::allan::{AllanReport, Estimator};
use crate::store::Reader;

/// The noise parameters of a plan's samples, on two threads; memory is bounded as a job's is.
///
/// # Errors
/// What `source` says.
pub fn noise(source: &dyn SampleSource, plan: Plan) -> Result<NoiseReport, JobError> {
    let mut spectra = Spectra::new(plan);
    take_all(source, &mut spectra)?;
    let (plan, sums, held) = spectra.finish();
    report::noise(source, &plan, &sums, held, |_| Ok(()))
}

/// The deviation curves of a plan's samples. An estimator other than `oadev` holds them in memory, however many they are.
///
/// # Errors
/// [`JobError::Allan`] where there are too few samples for a curve; what `source` says.
pub fn allan(source: &dyn SampleSource, plan: Plan, parameters: &JobParameters) -> Result<AllanReport, JobError> {
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

/// Moments, histogram and a test for normality of every channel of a capture.
///
/// # Errors
/// What the database says.
pub fn statistics(reader: &Reader, capture_id: i64) -> Result<StatisticsReport, JobError> {
    let row = reader.capture(capture_id)?;
    let mut distribution = Distribution::new(row.channels);
    let mut next_seq = 0;
    while next_seq < row.samples {
        let limit = CHUNK.min(usize::try_from(row.samples - next_seq).unwrap_or(CHUNK));
        let chunk = reader.read_chunk(capture_id, next_seq, limit, distribution.channels())?;
        if chunk.is_empty() {
            break;
        }
        distribution.take(&chunk);
        next_seq = chunk.next_seq();
    }
    Ok(report::statistics(distribution.statistics(), Extent::read(reader, capture_id, row.samples)?))
}

/// Hands all samples over, pass by pass.
fn take_all(source: &dyn SampleSource, pass: &mut dyn Pass) -> Result<(), JobError> {
    loop {
        let mut next_seq = 0;
        while let Some(plan) = pass.plan().filter(|plan| next_seq < plan.end_seq) {
            let limit = CHUNK.min(usize::try_from(plan.end_seq - next_seq).unwrap_or(CHUNK));
            let chunk = plan.read_chunk(source, next_seq, limit, pass.read_channels())?;
            pass.take(&chunk);
            next_seq = chunk.next_seq();
        }
        while pass.work() {}
        if !pass.end_pass() {
            return Ok(());
        }
    }
}
