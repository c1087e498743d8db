//! Wishes: the requests for diagnoses, read from the body of a request without trusting its size.
//!
//! A body may contain a reference of many megabytes. Such a body is read by a separate process, which checks it and
//! returns it in parts; the daemon holds one part at a time.

use super::diagnosis::of_csv;
use super::{DiagnosisParameters, JobError, JobKind, Simulator};
use crate::process::{Child, Frame, FrameError, Heard, write_frame};
use crate::store::{REFERENCE_PART_BYTES, Store};
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

/// The motion of the sensor, as a job's parameters contain it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum GivenReference {
    /// A motion's CSV, which the database keeps.
    Kept {
        /// SHA-256 of its text.
        sha256: String,
        /// Bytes of its text.
        bytes: u64,
    },
    /// A motion that needs no file: `still`, `tumble`, `rate-table`.
    Named(String),
}

/// The body of a request.
#[derive(Debug, Clone, Copy)]
pub enum WishBody<'a> {
    /// A small one.
    Bytes(&'a [u8]),
    /// A body stored in a file.
    File(&'a Path),
}

/// The content of a body; the reference is checked.
#[derive(Debug, PartialEq)]
struct Read<'a> {
    sim: &'a str,
    reference: Option<Text>,
}

#[derive(Debug, PartialEq)]
enum Text {
    Named(String),
    Csv(String),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Members<'a> {
    #[serde(borrow)]
    sim: Option<&'a RawValue>,
    #[serde(borrow)]
    reference: Option<&'a RawValue>,
}

/// A refusal, which may quote a part of the body, but not all of it.
fn refused(reason: impl Into<String>) -> JobError {
    let reason: String = reason.into();
    JobError::Parameters { kind: JobKind::Diagnosis.name(), reason: reason.chars().take(REASON_CHARS).collect() }
}

/// Reads a body. Beyond the body, only the text and the rows of the reference are held in memory.
fn read(body: &[u8]) -> Result<Read<'_>, JobError> {
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
        return Err(JobError::TooLarge { reason });
    }
    // A member that is null counts as absent.
    let reference = members.reference.filter(|value| value.get() != "null").map(|value| {
        let text: String = serde_json::from_str(value.get())
            .map_err(|_| refused("`reference` is a text: a motion's CSV, or one of still, tumble, rate-table"))?;
        if Kind::from_name(&text).is_some() {
            return Ok::<_, JobError>(Text::Named(text));
        }
        of_csv(&text).map_err(|reason| refused(format!("`reference`: {reason}")))?;
        Ok(Text::Csv(text))
    });
    Ok(Read { sim, reference: reference.transpose()? })
}

fn sha256(text: &str) -> String {
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Reads a body in this process. `sim` looks up the simulator, and checks whatever else may refuse the diagnosis,
/// before its reference is stored.
pub(super) fn read_here<'a>(
    store: &'a Store,
    body: &[u8],
    sim: impl FnOnce(Value) -> Result<Simulator, JobError>,
) -> Result<(DiagnosisParameters, Option<Keeping<'a>>), JobError> {
    let read = read(body)?;
    let sim = sim(serde_json::from_str(read.sim)?)?;
    let (reference, keeping) = match read.reference {
        None => (None, None),
        Some(Text::Named(name)) => (Some(GivenReference::Named(name)), None),
        Some(Text::Csv(text)) => {
            let (sha256, bytes) = (sha256(&text), text.len() as u64);
            let mut keeping = Keeping::begin(store, &sha256, bytes)?;
            for part in text.as_bytes().chunks(REFERENCE_PART_BYTES) {
                keeping.keep(part.to_vec())?;
            }
            (Some(GivenReference::Kept { sha256, bytes }), Some(keeping))
        }
    };
    Ok((DiagnosisParameters { sim, reference }, keeping))
}

/// A reference that is being stored: it is released if dropped before a job claims it.
#[derive(Debug)]
pub(super) struct Keeping<'a> {
    store: &'a Store,
    id: i64,
    whole: bool,
    part: u32,
    is_claimed: bool,
}

impl<'a> Keeping<'a> {
    fn begin(store: &'a Store, sha256: &str, bytes: u64) -> Result<Self, JobError> {
        let (id, whole) = store.begin_reference(sha256, bytes)?;
        Ok(Self { store, id, whole, part: 0, is_claimed: false })
    }

    fn keep(&mut self, content: Vec<u8>) -> Result<(), JobError> {
        if !self.whole {
            self.store.keep_reference_part(self.id, self.part, content)?;
            self.part += 1;
        }
        Ok(())
    }

    /// Records that a job has claimed it.
    pub(super) fn claimed(mut self) {
        self.is_claimed = true;
    }
}

impl Drop for Keeping<'_> {
    fn drop(&mut self) {
        if !self.is_claimed
            && let Err(error) = self.store.let_reference_go(self.id)
        {
            // It is then removed at the next start.
            tracing::debug!(%error, "A reference that no diagnosis has stays for now.");
        }
    }
}

/// The messages of the process that reads a body.
#[derive(Debug, Serialize, Deserialize)]
enum Word {
    /// The request; a reference that is to be stored follows in parts.
    Wish { sim: String, reference: Option<GivenReference> },
    /// The next part of the reference is the frame's body.
    Part,
    /// The end of the parts.
    End,
    /// The body is no valid request.
    Refused { reason: String, too_large: bool },
}

/// The same in a separate process.
pub(super) fn read_apart<'a>(
    store: &'a Store,
    file: &Path,
    sim: impl FnOnce(Value) -> Result<Simulator, JobError>,
) -> Result<(DiagnosisParameters, Option<Keeping<'a>>), JobError> {
    let work = ["wish".as_ref(), "--file".as_ref(), file.as_os_str()];
    let mut child = Child::<Word>::start(MEMORY_BYTES, TIME.as_secs(), &work, REFERENCE_PART_BYTES as u64)
        .map_err(JobError::Process)?;
    let died = |reason: String| JobError::Died { reason };
    let begun = Instant::now();
    let (mut sim, mut parameters, mut keeping) = (Some(sim), None, None);
    loop {
        match child.hear(TIME.saturating_sub(begun.elapsed())).map_err(JobError::Process)? {
            Heard::Frame(Frame { header: Word::Wish { sim: text, reference }, .. }) => {
                let sim = sim.take().ok_or_else(|| died("the body was read twice".to_owned()))?;
                let sim = sim(serde_json::from_str(&text)?)?;
                if let Some(GivenReference::Kept { sha256, bytes }) = &reference {
                    keeping = Some(Keeping::begin(store, sha256, *bytes)?);
                }
                parameters = Some(DiagnosisParameters { sim, reference });
            }
            Heard::Frame(Frame { header: Word::Part, body }) => {
                if let Some(keeping) = &mut keeping {
                    keeping.keep(body)?;
                }
            }
            Heard::Frame(Frame { header: Word::Refused { reason, too_large: false }, .. }) => {
                return Err(JobError::Parameters { kind: JobKind::Diagnosis.name(), reason });
            }
            Heard::Frame(Frame { header: Word::Refused { reason, too_large: true }, .. }) => {
                return Err(JobError::TooLarge { reason });
            }
            Heard::Frame(Frame { header: Word::End, .. }) => {
                let parameters = parameters.ok_or_else(|| died("nothing was read of the body".to_owned()))?;
                return Ok((parameters, keeping));
            }
            Heard::Ended(ended) if ended.out_of_memory => {
                let most = MEMORY_BYTES >> 20;
                let reason = format!("the body cannot be read within {most} MiB of memory: send a shorter reference");
                return Err(JobError::TooLarge { reason });
            }
            Heard::Ended(ended) => return Err(died(ended.reason)),
            Heard::Nothing => return Err(died(format!("the body was not read within {} s", TIME.as_secs()))),
        }
    }
}

/// Reads a body in this process, which [`read_apart`] has started, and writes its content to `out`.
///
/// # Errors
/// [`FrameError`], if the body cannot be read or the parent does not listen.
pub fn answer_wish(file: &Path, mut out: impl Write) -> Result<(), FrameError> {
    let body = std::fs::read(file)?;
    let read = match read(&body) {
        Ok(read) => read,
        Err(error) => {
            let too_large = matches!(error, JobError::TooLarge { .. });
            let reason = if let JobError::Parameters { reason, .. } = error { reason } else { error.to_string() };
            return write_frame(&mut out, &Word::Refused { reason, too_large }, &[]);
        }
    };
    let (reference, text) = match read.reference {
        None => (None, String::new()),
        Some(Text::Named(name)) => (Some(GivenReference::Named(name)), String::new()),
        Some(Text::Csv(text)) => (Some(GivenReference::Kept { sha256: sha256(&text), bytes: text.len() as u64 }), text),
    };
    write_frame(&mut out, &Word::Wish { sim: read.sim.to_owned(), reference }, &[])?;
    for part in text.as_bytes().chunks(REFERENCE_PART_BYTES) {
        write_frame(&mut out, &Word::Part, part)?;
    }
    write_frame(&mut out, &Word::End, &[])
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
        assert_eq!(
            read(body.as_bytes()).unwrap(),
            Read { sim: "\"model-1\"", reference: Some(Text::Csv(format!("{csv}{rows}"))) }
        );
        let named = read(br#" {"reference": "tumble", "sim": 7}"#).unwrap();
        assert_eq!(named, Read { sim: "7", reference: Some(Text::Named("tumble".to_owned())) });
        let none = read(br#"{"sim": {"a": 1}, "reference": null}"#).unwrap();
        assert_eq!(none, Read { sim: "{\"a\": 1}", reference: None });
        for (body, part) in [
            ("[1, 2]", "JSON object"),
            (r#"{"sim": 1, "motion": 1}"#, "motion"),
            (r#"{"sim": 1, "reference": 3}"#, "`reference` is a text"),
            (r#"{"sim": 1, "reference": "motion.csv"}"#, "header line"),
            (r#"{"sim": 1"#, "EOF"),
        ] {
            assert!(reason(body).contains(part), "{body}: {}", reason(body));
        }
        let hostile = format!(r#"{{"sim": {{"x": [{}{{}}]}}}}"#, "{},".repeat(SIM_BYTES_MAX));
        assert!(matches!(read(hostile.as_bytes()), Err(JobError::TooLarge { .. })));
    }
}
