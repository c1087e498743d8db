//! `vn100d calibrate`: scale factors, misalignment and bias from a tumble or beside poses, and what corrects them.

use super::args::{CalibrateArgs, Form};
use super::figures::with_interval;
use super::output::Output;
use super::reference::reference;
use super::{Context, Outcome, analysis, failed, table, usage};
use crate::jobs::gridded;
use imu_core::sample::{Channel, Triad};
use imu_diagnosis::{Known, Recording};
use imu_files::export::calibration::Corrections;
use imu_files::recording::COUNTS;
use imu_pose::{Correction, Deviations, Estimate, External, Stretch, Track, tumble};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Sensitivities that are farther from 1 than this are those of another unit, or of a sensor that needs more than a correction.
const FAR_OFF: f64 = 0.4;
/// The strength of the earth's magnetic field, with some for indoors, and in the middle, gauss.
const EARTHS_GAUSS: std::ops::RangeInclusive<f64> = 0.1..=1.0;
const EARTHS_MEAN_GAUSS: f64 = 0.45;
/// The document's format.
const FORMAT: &str = "vn100d-calibration-1";

/// What was found.
#[derive(Debug, Serialize)]
struct Document {
    format: &'static str,
    recording: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    reference: Option<String>,
    /// `si` or `counts`.
    unit: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    tumble: Option<Rested>,
    triads: BTreeMap<&'static str, TriadDocument>,
    notes: Vec<String>,
    /// What the gyroscope shows of 1 rad/s, roughly.
    #[serde(skip)]
    gyro_per_unit: Option<f64>,
    /// The strength of the magnetic field in the recording's unit, if it was not stated.
    #[serde(skip)]
    field: Option<f64>,
}

/// What a tumble consists of.
#[derive(Debug, Serialize)]
struct Rested {
    rests: usize,
    poses: usize,
    turns: usize,
}

#[derive(Debug, Serialize)]
struct TriadDocument {
    #[serde(flatten)]
    deviations: Deviations,
    /// Root mean square of the residuals, in the unit of what is measured (rad for the gyroscope); none if only the rests were used.
    #[serde(skip_serializing_if = "Option::is_none")]
    rms: Option<f64>,
    /// Whether the values are not in the unit that the recording states.
    #[serde(skip)]
    is_other_unit: bool,
    /// x = matrix·(raw − bias).
    #[serde(skip_serializing_if = "Option::is_none")]
    correction: Option<Correction>,
    /// Numbers that the record does not determine.
    not_determined: Vec<String>,
}

impl TriadDocument {
    fn new(deviations: Deviations, rms: Option<f64>) -> Self {
        let (correction, not_determined) = (deviations.correction(), deviations.open());
        Self { correction, not_determined, deviations, rms, is_other_unit: false }
    }
}

/// Runs the command.
pub(super) fn run(context: &Context, args: &CalibrateArgs) -> anyhow::Result<Outcome> {
    let read: Vec<&Path> = [Some(Path::new(&args.real)), args.reference.as_deref()].into_iter().flatten().collect();
    if context.json && !matches!(args.format, Form::Table | Form::Json) {
        return Err(usage("--json prints the document: leave it out to write another --format"));
    }
    let output = args.out.as_deref().map(|path| Output::create(path, args.force, &read)).transpose()?;
    let together = analysis::open(context, std::slice::from_ref(&args.real), args.rate)?;
    let in_counts = together.has_unit(COUNTS);
    let real = gridded(&together.source, &together.plan, u64::MAX)?.recording;
    let mut document = Document {
        format: FORMAT,
        recording: together.name(),
        reference: args.reference.as_ref().map(|path| path.display().to_string()),
        unit: if in_counts { COUNTS } else { "si" },
        tumble: None,
        triads: BTreeMap::new(),
        notes: Vec::new(),
        gyro_per_unit: None,
        field: None,
    };
    match &args.reference {
        Some(_) if in_counts => {
            return Err(usage(
                "a recording in counts is calibrated by a tumble: leave out --reference, or state units with --columns",
            ));
        }
        Some(path) => beside_poses(&mut document, &real, path)?,
        None => by_gravity(&mut document, &real, args, in_counts)?,
    }
    if args.reference.is_some() && has(&real, Triad::Mag) {
        let mag = imu_diagnosis::rows(&real, &[Triad::Mag]);
        let found = tumble::magnetometer(&mag.time_s, mag.triads.first().map_or(&[], Vec::as_slice), args.field);
        magnetometer(&mut document, found, true);
    }
    if together.rejected() {
        let note = "rows or frames of the recording were rejected, which `vn100d show` lists: rests may be missing";
        document.notes.push(note.to_owned());
    }
    if together.plan.channels.contains(&Channel::MagX) && !has(&real, Triad::Mag) {
        let note = "the magnetometer is not calibrated: it lacks an axis, or its values in some rows";
        document.notes.push(note.to_owned());
    }
    units(&mut document);
    let text = if context.json { json(&document)? } else { form(&document, args.format)? };
    match output {
        Some(output) => output.put(text.as_bytes())?,
        None => std::io::stdout().lock().write_all(text.as_bytes())?,
    }
    Ok(if together.rejected() { Outcome::WithLoss } else { Outcome::Done })
}

fn has(real: &Recording, triad: Triad) -> bool {
    triad.channels().iter().all(|channel: &Channel| real.values(*channel).is_some())
}

fn by_gravity(document: &mut Document, real: &Recording, args: &CalibrateArgs, in_counts: bool) -> anyhow::Result<()> {
    let there: Vec<Triad> =
        [Triad::Accel, Triad::Gyro, Triad::Mag].into_iter().filter(|triad| has(real, *triad)).collect();
    let (rows, cut) = imu_diagnosis::rows_in_range(real, &there);
    document.notes.extend(cut.into_iter().map(|hint| hint.text));
    let mut of = there.into_iter().zip(rows.triads).collect::<BTreeMap<_, _>>();
    let mut take = |triad| of.remove(&triad).unwrap_or_default();
    let mag = take(Triad::Mag);
    let track = Track::new(rows.time_s, take(Triad::Gyro), take(Triad::Accel));
    let known = tumble::Known { gravity_m_s2: args.gravity, field: args.field, is_si: !in_counts };
    let found = tumble::calibrate(&track, &mag, &known)?;
    document.tumble = Some(Rested { rests: found.rests.len(), poses: found.poses, turns: found.turns });
    document.triads.insert("accel", TriadDocument::new(found.of_accel(), Some(found.accel.rms())));
    if let Some(gyro) = found.of_gyro() {
        document.triads.insert("gyro", TriadDocument::new(gyro, found.gyro.as_ref().map(|of| of.rms())));
    }
    if found.gyro.is_some() {
        document.notes.push(
            "the rotation of the gyroscope is that beside the accelerometer, whose own axes are those in which its matrix is symmetric"
                .to_owned(),
        );
    }
    document.gyro_per_unit = found.gyro_per_unit;
    document.notes.extend(found.without_gyro.map(|why| format!("the gyroscope is not calibrated: {why}")));
    if found.is_bent {
        document.notes.push(
            "the lengths at rest scatter by far more than the noise: the sensor is not linear, its temperature changed, or rests are none; \
             biases and scale factors are those of gravity's range, not of small forces"
                .to_owned(),
        );
    }
    if args.gravity.is_none() {
        document.notes.push(
            "gravity is taken as 9.80665 ± 0.025 m/s²: --gravity with the local one makes the intervals of the scale factors narrower"
                .to_owned(),
        );
    }
    magnetometer(document, found.mag, !mag.is_empty());
    Ok(())
}

fn magnetometer(document: &mut Document, found: Option<tumble::Magnetometer>, is_there: bool) {
    let Some(found) = found else {
        if is_there {
            document.notes.push(
                "the magnetometer is not calibrated: it was turned through too few directions, an axis is dead, or the field changed too \
                 often or for too long"
                    .to_owned(),
            );
        }
        return;
    };
    let triad = TriadDocument::new(found.deviations(), Some(found.fitted.rms()));
    if triad.correction.is_none() {
        document.notes.push(
            "the magnetometer is not calibrated: too few directions, or a magnet that stayed, leave nothing determined"
                .to_owned(),
        );
        return;
    }
    let at = |of: &Stretch| format!("{:.1} to {:.1} s", of.from_s, of.to_s);
    if !found.disturbed.is_empty() {
        let stretches: Vec<String> = found.disturbed.iter().take(8).map(at).collect();
        let more = found.disturbed.len().saturating_sub(stretches.len());
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        document.notes.push(format!(
            "the magnetic field was disturbed from {}{more} (a magnet or iron nearby): these samples are left out",
            stretches.join(", ")
        ));
    }
    if found.is_uneven {
        document.notes.push(
            "the lengths of the magnetic field scatter by more than the noise: a magnet that stayed, another place or a sensor that lags \
             moves hard and soft iron by more than their intervals"
                .to_owned(),
        );
    }
    if !found.is_absolute {
        document.notes.push(
            "the strength of the field is not known: sensitivities of the magnetometer are relative to their mean; --field states it"
                .to_owned(),
        );
    }
    document.field = (!found.is_absolute).then(|| found.strength());
    document.triads.insert("mag", triad);
}

fn beside_poses(document: &mut Document, real: &Recording, path: &Path) -> anyhow::Result<()> {
    let Known::External(External::Poses(poses)) = reference(path, None)? else {
        return Err(usage(format!(
            "{} has no poses: give a motion or rates to `diagnose --reference`",
            path.display()
        )));
    };
    // As `diagnose` compares them: what was cut off or sent again is left out, and named.
    let (found, spoiled) = imu_diagnosis::beside(real, &External::Poses(poses))?;
    document.notes.extend(spoiled.into_iter().map(|hint| hint.text));
    for (name, fit) in [("gyro", Some(&found.gyro)), ("accel", found.accel.as_ref())] {
        let Some(fit) = fit else { continue };
        if !fit.frames.is_plain() {
            document.notes.push(format!(
                "the axes, signs or unit of the {name} are not those of the reference's body (`diagnose --reference` names them): the \
                 correction leaves the axes as they are"
            ));
        }
        document.triads.insert(name, TriadDocument::new(Deviations::of_poses(fit), Some(fit.rms)));
    }
    document.notes.extend(found.without_accel.map(|why| format!("the accelerometer is not calibrated: {why}")));
    if found.accel.is_none() && found.without_accel.is_none() && has(real, Triad::Accel) {
        document.notes.push("the accelerometer is not calibrated: the poses have no positions".to_owned());
    }
    Ok(())
}

/// Adds what the size of the sensitivities shows about the stated units.
fn units(document: &mut Document) {
    /// Ratios of a unit to the one that is stated, with what the values then are.
    const KNOWN: [(&str, f64, &str); 9] = [
        ("accel", 1.0 / 9.806_65, "g"),
        ("accel", 1e3 / 9.806_65, "mg"),
        ("accel", 1e2, "cm/s²"),
        ("gyro", 57.295_78, "deg/s"),
        ("gyro", 1e3, "mrad/s"),
        ("mag", 100.0, "µT"),
        ("mag", 1e3, "mgauss"),
        ("mag", 1e5, "nT"),
        ("mag", 1e-4, "T"),
    ];
    if document.unit == COUNTS {
        return;
    }
    for (name, of) in &mut document.triads {
        let known: Vec<f64> = of.deviations.sensitivity.iter().flatten().map(|of| of.value).collect();
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        let roughly = match *name {
            "gyro" if known.is_empty() => document.gyro_per_unit,
            // The earth's field is 0.2 to 0.7 gauss.
            "mag" => {
                document.field.filter(|field| !EARTHS_GAUSS.contains(field)).map(|field| field / EARTHS_MEAN_GAUSS)
            }
            _ => None,
        };
        let Some(ratio) = roughly.or(Some(mean)).filter(|ratio| (ratio - 1.0).abs() >= FAR_OFF) else { continue };
        of.is_other_unit = true;
        let near = |known: &f64| (ratio / known).ln().abs() < (1.0 + FAR_OFF).ln();
        let unit = KNOWN.iter().find(|(own, known, _)| own == name && near(known));
        let guess = unit.map_or_else(String::new, |(_, _, unit)| format!(", as values in {unit} would be"));
        document.notes.push(format!(
            "the values of the {name} are {} times what its unit says{guess}: state the unit with --columns",
            rounded(ratio)
        ));
    }
}

/// Returns a ratio with three significant digits.
fn rounded(ratio: f64) -> String {
    format!("{ratio:.*}", (2 - ratio.abs().log10().floor() as i32).clamp(0, 6) as usize)
}

fn json(document: &Document) -> anyhow::Result<String> {
    Ok(serde_json::to_string_pretty(document)? + "\n")
}

fn form(document: &Document, form: Form) -> anyhow::Result<String> {
    let correction = |name: &str| document.triads.get(name).and_then(|of| of.correction);
    let all = Corrections { mag: correction("mag"), accel: correction("accel"), gyro: correction("gyro") };
    if document.unit == COUNTS && matches!(form, Form::Registers | Form::Kalibr) {
        return Err(usage(
            "a recording in counts has no correction in m/s² and rad/s: choose --format json, imu-tk-accel, imu-tk-gyro or imu-calib",
        ));
    }
    if form == Form::Registers && document.triads.values().any(|of| of.is_other_unit) {
        return Err(usage(
            "the values are not in the unit that the recording states, and lines for a sensor would be wrong: state the unit with --columns",
        ));
    }
    let is_left_handed = |of: &imu_pose::Correction| {
        let [a, b, c] = of.matrix;
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])
            < 0.0
    };
    if form == Form::Kalibr && all.gyro.as_ref().is_some_and(is_left_handed) {
        return Err(usage(
            "the gyroscope's axes are left-handed beside the accelerometer's, which Kalibr has no form for: exchange a sign with --columns, or \
             take --format json",
        ));
    }
    let none = |triad: &str| failed(format!("there is nothing to write: the {triad} is not calibrated"));
    match form {
        Form::Table => Ok(shown(document)),
        Form::Json => json(document),
        Form::Registers => Ok(all.registers()),
        Form::Kalibr => Ok(all.kalibr()),
        Form::ImuTkAccel => all.imu_tk_accel().ok_or_else(|| none("accelerometer")),
        Form::ImuTkGyro => all.imu_tk_gyro().ok_or_else(|| none("gyroscope")),
        Form::ImuCalib => all.imu_calib().ok_or_else(|| none("accelerometer")),
    }
}

/// Returns the text for people.
fn shown(document: &Document) -> String {
    let mut text = String::new();
    let by = match (&document.tumble, &document.reference) {
        (Some(of), _) => format!("{} rests in {} poses and {} turns between them", of.rests, of.poses, of.turns),
        (None, Some(path)) => format!("the poses of {path}"),
        (None, None) => "nothing".to_owned(),
    };
    // Writing to a text cannot fail.
    let _ = writeln!(text, "{}: calibrated by {by}. Values with 95 % intervals.", document.recording);
    let mut rows = table(&["", "x", "y", "z"]);
    for (name, of) in &document.triads {
        let is_si = document.unit != COUNTS;
        let (unit, per) = match *name {
            "accel" => ("m/s²", "m/s²"),
            "gyro" => ("rad/s", "rad/s"),
            _ => ("gauss", "gauss"),
        };
        let unit = if is_si { unit } else { COUNTS };
        let percent = |of: &Option<Estimate>, from: f64| {
            of.map_or_else(
                || "–".to_owned(),
                |of| with_interval(100.0 * (of.value - from), of.ci95.map(|end| 100.0 * (end - from))),
            )
        };
        let plain = |of: &Option<Estimate>| of.map_or_else(|| "–".to_owned(), |of| with_interval(of.value, of.ci95));
        let own = &of.deviations;
        let mut row = |what: String, cells: [String; 3]| {
            rows.add_row(std::iter::once(what).chain(cells));
        };
        match is_si {
            true => row(format!("{name} scale factor, %"), own.sensitivity.each_ref().map(|of| percent(of, 1.0))),
            false => row(format!("{name}, {COUNTS} per {per}"), own.sensitivity.each_ref().map(plain)),
        }
        row(format!("{name} cross-axis xy, xz, yz, %"), own.cross.each_ref().map(|of| percent(of, 0.0)));
        if let Some(turned) = &own.turned_deg {
            row(format!("{name} rotation about, °"), turned.each_ref().map(plain));
        }
        row(format!("{name} bias, {unit}"), own.bias.each_ref().map(plain));
    }
    let _ = writeln!(text, "{rows}");
    for (name, of) in document.triads.iter().filter(|(_, of)| !of.not_determined.is_empty()) {
        let _ = writeln!(
            text,
            "Not determined by this record ({name}): {}. More poses, turns about more axes, or longer rests determine them.",
            of.not_determined.join(", ")
        );
    }
    for (name, of) in document.triads.iter().filter(|(_, of)| of.deviations.exchange.is_some()) {
        let exchange = of.deviations.exchange.unwrap_or_default();
        let _ = writeln!(text, "The {name} has other axes or signs than the accelerometer: by rows {exchange:?}.");
    }
    for note in &document.notes {
        let _ = writeln!(text, "Note: {note}.");
    }
    let _ = writeln!(
        text,
        "To correct: --format registers (VN-100), kalibr, imu-tk-accel, imu-tk-gyro, imu-calib or json, with --out FILE. Nothing is \
         written to the sensor."
    );
    text
}
