//! Requests for diagnoses, read from the body of an HTTP request without trusting its size.
//!
//! A body may contain a reference of many megabytes. Such a body is read by a separate process, which checks it and
//! returns it in parts; the daemon holds one part at a time.

use super::JobError;
use super::diagnosis_parameters::{DiagnosisParameters, ReferenceAxis, ReferenceMotion, Simulator, read_reference};
use crate::process::{Child, Frame, FrameError, Received, write_frame};
use crate::store::{JobKind, REFERENCE_PART_BYTES, Store};
use imu_model::motion::Kind;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use serde_json::value::RawValue;
use sha2::{Digest as _, Sha256};
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// The maximum size of the member `sim` in bytes: a model of every effect has a tenth.
pub const SIM_BYTES_MAX: usize = 64 * 1024;
/// Private memory of the process that reads a body of 32 MiB: the body, its text, and its rows as numbers.
const MEMORY_BYTES: u64 = 256 << 20;
/// The maximum length of a refusal in characters.
const REASON_CHARS: usize = 500;
/// The time limit of that process.
const TIME: Duration = Duration::from_secs(60);

/// The body of a request for a diagnosis.
#[derive(Debug, Clone, Copy)]
pub enum DiagnosisBody<'a> {
    /// A body in memory.
    Bytes(&'a [u8]),
    /// A body stored in a file.
    File(&'a Path),
}

/// The content of a body; the reference is checked.
#[derive(Debug, PartialEq)]
struct Content<'a> {
    sim: &'a str,
    reference: Option<ReferenceMotion>,
    /// The text of a reference that is to be stored.
    text: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Members<'a> {
    #[serde(borrow)]
    sim: Option<&'a RawValue>,
    #[serde(borrow)]
    reference: Option<&'a RawValue>,
    reference_axis: Option<Value>,
}

/// Returns a refusal, which may quote a part of the body, but not all of it.
fn refused(reason: impl Into<String>) -> JobError {
    let reason: String = reason.into();
    JobError::Parameters { kind: JobKind::Diagnosis.name(), reason: reason.chars().take(REASON_CHARS).collect() }
}

/// Reads a body. Beyond the body, only the text and the rows of the reference are held in memory.
fn read(body: &[u8]) -> Result<Content<'_>, JobError> {
    if body.trim_ascii_start().first() != Some(&b'{') {
        return Err(refused("expected a JSON object {\"sim\": …}"));
    }
    let members: Members<'_> = serde_json::from_slice(body).map_err(|error| refused(error.to_string()))?;
    let sim = members.sim.map_or("null", RawValue::get);
    if sim.len() > SIM_BYTES_MAX {
        let reason = format!(
            "`sim` has {} bytes: a model has at most {SIM_BYTES_MAX}; give a capture's name for a recording",
            sim.len()
        );
        return Err(JobError::TooLarge(reason));
    }
    // Numbers beyond f64 and halves of characters are JSON by its grammar alone.
    model_of(sim)?;
    let axis = members.reference_axis.filter(|value| !value.is_null()).map(axis_of).transpose()?;
    // A member that is null counts as absent.
    let Some(reference) = members.reference.filter(|value| value.get() != "null") else {
        if axis.is_some() {
            return Err(refused("`reference_axis` is that of an encoder: give its rates as `reference`"));
        }
        return Ok(Content { sim, reference: None, text: String::new() });
    };
    let text: String = serde_json::from_str(reference.get())
        .map_err(|_| refused("`reference` is a text: a motion's CSV, or one of still, tumble, poses, rate-table"))?;
    if Kind::from_name(&text).is_some() {
        if axis.is_some() {
            return Err(refused(format!("`reference_axis` is that of an encoder: the motion `{text}` needs none")));
        }
        return Ok(Content { sim, reference: Some(ReferenceMotion::Named(text)), text: String::new() });
    }
    read_reference(&text, "reference", axis).map_err(|reason| refused(format!("`reference`: {reason}")))?;
    let sha256 = Sha256::digest(&text).iter().map(|byte| format!("{byte:02x}")).collect();
    let reference = Some(ReferenceMotion::Stored { sha256, bytes: text.len() as u64, axis });
    Ok(Content { sim, reference, text })
}

fn axis_of(value: Value) -> Result<ReferenceAxis, JobError> {
    let axis = value.as_str().and_then(ReferenceAxis::from_name);
    axis.ok_or_else(|| refused(format!("`reference_axis` is {value}: allowed are \"x\", \"y\" and \"z\"")))
}

fn model_of(sim: &str) -> Result<Value, JobError> {
    serde_json::from_str(sim).map_err(|error| refused(format!("`sim`: {error}")))
}

/// Accepts a body's content: looks up the simulator, then begins to store the reference.
fn accept<'a>(
    store: &'a Store,
    sim: &str,
    reference: Option<ReferenceMotion>,
    find_sim: impl FnOnce(Value) -> Result<Simulator, JobError>,
) -> Result<(DiagnosisParameters, Option<StoringReference<'a>>), JobError> {
    let sim = find_sim(model_of(sim)?)?;
    let storing = match &reference {
        Some(ReferenceMotion::Stored { sha256, bytes, .. }) => Some(StoringReference::begin(store, sha256, *bytes)?),
        Some(ReferenceMotion::Named(_)) | None => None,
    };
    Ok((DiagnosisParameters { sim, reference }, storing))
}

/// Reads a body in this process. `find_sim` looks up the simulator, and checks whatever else may refuse the diagnosis,
/// before its reference is stored.
pub(super) fn read_here<'a>(
    store: &'a Store,
    body: &[u8],
    find_sim: impl FnOnce(Value) -> Result<Simulator, JobError>,
) -> Result<(DiagnosisParameters, Option<StoringReference<'a>>), JobError> {
    let Content { sim, reference, text } = read(body)?;
    let (parameters, mut storing) = accept(store, sim, reference, find_sim)?;
    if let Some(storing) = &mut storing {
        text.as_bytes().chunks(REFERENCE_PART_BYTES).try_for_each(|part| storing.add(part.to_vec()))?;
    }
    Ok((parameters, storing))
}

/// A reference that is being stored: it is released if dropped before a job claims it.
#[derive(Debug)]
pub(super) struct StoringReference<'a> {
    store: &'a Store,
    id: i64,
    whole: bool,
    part: u32,
    is_claimed: bool,
}

impl<'a> StoringReference<'a> {
    fn begin(store: &'a Store, sha256: &str, bytes: u64) -> Result<Self, JobError> {
        let (id, whole) = store.begin_reference(sha256, bytes)?;
        Ok(Self { store, id, whole, part: 0, is_claimed: false })
    }

    fn add(&mut self, content: Vec<u8>) -> Result<(), JobError> {
        if !self.whole {
            self.store.keep_reference_part(self.id, self.part, content)?;
            self.part += 1;
        }
        Ok(())
    }

    /// Records that a job has claimed the reference.
    pub(super) fn claimed(mut self) {
        self.is_claimed = true;
    }
}

impl Drop for StoringReference<'_> {
    fn drop(&mut self) {
        if !self.is_claimed
            && let Err(error) = self.store.let_reference_go(self.id)
        {
            // The reference is then removed at the next start.
            tracing::debug!(%error, "A reference that no diagnosis has stays for now.");
        }
    }
}

/// The messages of the process that reads a body.
#[derive(Debug, Serialize, Deserialize)]
enum Message {
    /// The request; a reference that is to be stored follows in parts.
    Request { sim: String, reference: Option<ReferenceMotion> },
    /// The next part of the reference is the frame's body.
    Part,
    /// All parts were sent.
    End,
    /// The body is no valid request.
    Refused { reason: String, too_large: bool },
}

/// Reads a body as [`read_here`] does, but in a separate process.
pub(super) fn read_apart<'a>(
    store: &'a Store,
    file: &Path,
    find_sim: impl FnOnce(Value) -> Result<Simulator, JobError>,
) -> Result<(DiagnosisParameters, Option<StoringReference<'a>>), JobError> {
    let work = ["diagnosis-body".as_ref(), "--file".as_ref(), file.as_os_str()];
    let mut child = Child::<Message>::start(MEMORY_BYTES, TIME.as_secs(), &work, REFERENCE_PART_BYTES as u64)
        .map_err(JobError::Process)?;
    let died = JobError::Died;
    let begun = Instant::now();
    let (mut find_sim, mut accepted) = (Some(find_sim), None);
    loop {
        match child.receive(TIME.saturating_sub(begun.elapsed())).map_err(JobError::Process)? {
            Received::Frame(Frame { header: Message::Request { sim, reference }, .. }) => {
                let find_sim = find_sim.take().ok_or_else(|| died("the body was read twice".to_owned()))?;
                accepted = Some(accept(store, &sim, reference, find_sim)?);
            }
            Received::Frame(Frame { header: Message::Part, body }) => {
                if let Some((_, Some(storing))) = &mut accepted {
                    storing.add(body)?;
                }
            }
            Received::Frame(Frame { header: Message::Refused { reason, too_large: false }, .. }) => {
                return Err(JobError::Parameters { kind: JobKind::Diagnosis.name(), reason });
            }
            Received::Frame(Frame { header: Message::Refused { reason, too_large: true }, .. }) => {
                return Err(JobError::TooLarge(reason));
            }
            Received::Frame(Frame { header: Message::End, .. }) => {
                return accepted.ok_or_else(|| died("nothing was read of the body".to_owned()));
            }
            Received::Ended(ended) if ended.out_of_memory => {
                let most = MEMORY_BYTES >> 20;
                let reason = format!("the body cannot be read within {most} MiB of memory: send a shorter reference");
                return Err(JobError::TooLarge(reason));
            }
            Received::Ended(ended) => return Err(died(ended.reason)),
            Received::Nothing => return Err(died(format!("the body was not read within {} s", TIME.as_secs()))),
        }
    }
}

/// Reads a body in this process, which [`read_apart`] has started, and writes its content to `out`.
///
/// # Errors
/// [`FrameError`], if the body cannot be read or the parent does not listen.
pub fn answer_diagnosis_body(file: &Path, mut out: impl Write) -> Result<(), FrameError> {
    let body = std::fs::read(file)?;
    let Content { sim, reference, text } = match read(&body) {
        Ok(content) => content,
        Err(error) => {
            let too_large = matches!(error, JobError::TooLarge(_));
            let reason = if let JobError::Parameters { reason, .. } = error { reason } else { error.to_string() };
            return write_frame(&mut out, &Message::Refused { reason, too_large }, &[]);
        }
    };
    write_frame(&mut out, &Message::Request { sim: sim.to_owned(), reference }, &[])?;
    for part in text.as_bytes().chunks(REFERENCE_PART_BYTES) {
        write_frame(&mut out, &Message::Part, part)?;
    }
    write_frame(&mut out, &Message::End, &[])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reason(body: &str) -> String {
        read(body.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn a_body_is_read_without_what_it_may_hide() {
        let csv = "time_s,ref_gyro_x_rad_s,ref_gyro_y_rad_s,ref_gyro_z_rad_s,ref_accel_x_m_s2,ref_accel_y_m_s2,ref_accel_z_m_s2\n";
        let rows: String = (0..2000).map(|row| format!("{},0,0,0,0,0,9.8\n", f64::from(row) * 0.01)).collect();
        let body = serde_json::json!({ "sim": "model-1", "reference": format!("{csv}{rows}") }).to_string();
        let content = read(body.as_bytes()).unwrap();
        assert_eq!((content.sim, content.text), ("\"model-1\"", format!("{csv}{rows}")));
        assert!(
            matches!(content.reference, Some(ReferenceMotion::Stored { bytes, .. }) if bytes as usize == csv.len() + rows.len())
        );
        let (text, named) = (String::new(), Some(ReferenceMotion::Named("tumble".to_owned())));
        assert_eq!(
            read(br#" {"reference": "tumble", "sim": 7}"#).unwrap(),
            Content { sim: "7", reference: named, text: text.clone() }
        );
        let none = read(br#"{"sim": {"a": 1}, "reference": null}"#).unwrap();
        assert_eq!(none, Content { sim: "{\"a\": 1}", reference: None, text });
        let encoder = "time_s,encoder_rpm\\n0,60\\n0.1,60\\n";
        let turned = format!(r#"{{"sim": 7, "reference": "{encoder}", "reference_axis": "z"}}"#);
        let axis = Some(ReferenceAxis::Z);
        let stored = read(turned.as_bytes()).unwrap().reference.unwrap();
        assert!(matches!(stored, ReferenceMotion::Stored { axis: own, .. } if own == axis), "{stored:?}");
        // A row of the database names the axis, and none where there is none.
        let text = serde_json::to_string(&stored).unwrap();
        assert!(text.ends_with(r#","axis":"z"}"#), "{text}");
        assert_eq!(serde_json::from_str::<ReferenceMotion>(&text).unwrap(), stored);
        let (without, unknown) = (turned.replace(r#", "reference_axis": "z""#, ""), turned.replace("\"z\"", "\"w\""));
        for (body, part) in [
            (without.as_str(), "`reference_axis`"),
            (unknown.as_str(), "`reference_axis` is \"w\": allowed are"),
            (r#"{"sim": 1, "reference": "still", "reference_axis": "x"}"#, "the motion `still` needs none"),
            (r#"{"sim": 1, "reference_axis": "x"}"#, "give its rates as `reference`"),
            ("[1, 2]", "JSON object"),
            (r#"{"sim": 1, "motion": 1}"#, "motion"),
            (r#"{"sim": 1, "reference": 3}"#, "`reference` is a text"),
            (r#"{"sim": 1, "reference": "motion.csv"}"#, "header line"),
            (r#"{"sim": 1"#, "EOF"),
            (r#"{"sim": 1e400}"#, "`sim`: number out of range"),
            (r#"{"sim": "\ud800", "reference": "still"}"#, "`sim`: "),
        ] {
            assert!(reason(body).contains(part), "{body}: {}", reason(body));
        }
        let hostile = format!(r#"{{"sim": {{"x": [{}{{}}]}}}}"#, "{},".repeat(SIM_BYTES_MAX));
        assert!(matches!(read(hostile.as_bytes()), Err(JobError::TooLarge(_))));
    }
}
