//! Read: references of other instruments as text.
//!
//! Recognised by their header: poses as docs/formats.md has them, EuRoC's ground truth, TUM's trajectories (no header), OptiTrack's
//! export of a rigid body, Vicon's export of an object with quaternions, a rate about one axis, an encoder.

use crate::error::PoseError;
use crate::reference::{Poses, Rates};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// A quaternion's norm may be this far from 1: decimals are rounded.
const NORM_TOLERANCE: f64 = 0.02;
const RPM: f64 = std::f64::consts::TAU / 60.0;

/// A reference that another instrument measured.
#[derive(Debug, Clone, PartialEq)]
pub enum External {
    /// Attitudes, and perhaps positions.
    Poses(Poses),
    /// Rates about one axis.
    Rates(Rates),
}

/// Where each number of a pose stands in a row, and the factors of times and positions.
struct Layout {
    time: usize,
    /// w, x, y, z.
    attitude: [usize; 4],
    position: Option<[usize; 3]>,
    time_factor: f64,
    position_factor: f64,
    /// Whether y of the world points up.
    y_up: bool,
}

const AXES: [&str; 3] = ["x", "y", "z"];

/// Reads a reference. Returns `None` for a text of another form (a motion of all axes). `axis` is the encoder's.
///
/// # Errors
/// [`PoseError`] with the line.
pub fn read(text: &str, axis: Option<usize>) -> Result<Option<External>, PoseError> {
    let text = text.trim_start_matches('\u{feff}');
    let mut lines = (1_u64..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let Some((_, first)) = lines.next() else {
        return Err(PoseError::Columns { found: String::new() });
    };
    if first.starts_with("Format Version") {
        return optitrack(text, first);
    }
    if let Some(found) = vicon(text) {
        return found;
    }
    let names: Vec<String> = cells(first.trim_start_matches('#')).iter().map(|name| name.to_lowercase()).collect();
    let place = |name: &str| names.iter().position(|own| own == name);
    if first.starts_with('#') && names.first().is_some_and(|name| name.starts_with("timestamp")) {
        let starts = |start: &str| names.iter().position(|own| own.starts_with(start));
        // EuRoC: nanoseconds, position, quaternion beginning with w.
        if let [Some(w), Some(x), Some(y), Some(z)] = ["q_rs_w", "q_rs_x", "q_rs_y", "q_rs_z"].map(starts) {
            let position = ["p_rs_r_x", "p_rs_r_y", "p_rs_r_z"].map(starts);
            let layout = Layout {
                time: 0,
                attitude: [w, x, y, z],
                position: all(position),
                time_factor: 1e-9,
                position_factor: 1.0,
                y_up: false,
            };
            return poses(lines, &layout).map(|poses| Some(External::Poses(poses)));
        }
    }
    if first.starts_with('#') || (names.len() == 8 && names.iter().all(|name| name.parse::<f64>().is_ok())) {
        // TUM: timestamp tx ty tz qx qy qz qw, with comments.
        let rows = (1_u64..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
        let layout = Layout {
            time: 0,
            attitude: [7, 4, 5, 6],
            position: Some([1, 2, 3]),
            time_factor: 1.0,
            position_factor: 1.0,
            y_up: false,
        };
        return poses(rows, &layout).map(|poses| Some(External::Poses(poses)));
    }
    let Some(time) = place("time_s") else { return Err(unknown(first)) };
    if let [Some(w), Some(x), Some(y), Some(z)] = ["q_w", "q_x", "q_y", "q_z"].map(place) {
        let layout = Layout {
            time,
            attitude: [w, x, y, z],
            position: all(["p_x_m", "p_y_m", "p_z_m"].map(place)),
            time_factor: 1.0,
            position_factor: 1.0,
            y_up: false,
        };
        return poses(lines, &layout).map(|poses| Some(External::Poses(poses)));
    }
    let about = AXES.map(|axis| place(&format!("ref_gyro_{axis}_rad_s")));
    if let (Some(column), None) = (place("encoder_rpm"), about.iter().flatten().next()) {
        let axis = axis.ok_or(PoseError::Axis)?;
        return rates(lines, time, column, axis, RPM).map(|rates| Some(External::Rates(rates)));
    }
    match about.iter().flatten().count() {
        1 => {
            let axis = about.iter().position(Option::is_some).unwrap_or_default();
            let column = about[axis].unwrap_or_default();
            rates(lines, time, column, axis, 1.0).map(|rates| Some(External::Rates(rates)))
        }
        3 => Ok(None),
        _ => Err(unknown(first)),
    }
}

fn all(places: [Option<usize>; 3]) -> Option<[usize; 3]> {
    let [Some(x), Some(y), Some(z)] = places else { return None };
    Some([x, y, z])
}

fn unknown(header: &str) -> PoseError {
    PoseError::Columns { found: shortened(header) }
}

fn shortened(text: &str) -> String {
    let text = text.trim();
    if text.chars().count() <= 120 { text.to_owned() } else { text.chars().take(117).chain("...".chars()).collect() }
}

/// Returns the cells of a line that commas, semicolons or blanks separate.
fn cells(line: &str) -> Vec<&str> {
    let separator = |sign: char| if line.contains(',') { sign == ',' } else { sign.is_whitespace() || sign == ';' };
    let parts = line.split(separator).map(|cell| cell.trim().trim_matches('"'));
    if line.contains(',') { parts.collect() } else { parts.filter(|cell| !cell.is_empty()).collect() }
}

fn number(row: &[&str], at: usize, line: u64) -> Result<f64, PoseError> {
    let found = row.get(at).copied().unwrap_or_default();
    let value = found.parse().ok().filter(|value: &f64| value.is_finite());
    value.ok_or_else(|| PoseError::Cell { line, found: shortened(found), expected: "a finite number" })
}

fn poses<'a>(rows: impl Iterator<Item = (u64, &'a str)>, layout: &Layout) -> Result<Poses, PoseError> {
    let mut found = Poses::default();
    // What is added to a large time in ns is lost in binary seconds, so that times count from the first.
    for (line, text) in rows {
        let row = cells(text);
        let lacks = |at: &usize| row.get(*at).is_none_or(|cell| cell.is_empty());
        // A row without an attitude: the instrument had lost the body.
        if layout.attitude.iter().all(lacks) {
            continue;
        }
        let time_s = number(&row, layout.time, line)? * layout.time_factor;
        let mut part = [0.0; 4];
        for (value, at) in part.iter_mut().zip(layout.attitude) {
            *value = number(&row, at, line)?;
        }
        let quaternion = Quaternion::new(part[0], part[1], part[2], part[3]);
        let norm = quaternion.norm();
        if (norm - 1.0).abs() > NORM_TOLERANCE {
            return Err(PoseError::Norm { line, norm });
        }
        if found.time_s.last().is_some_and(|last| time_s <= *last) {
            return Err(PoseError::Backwards { line, time_s });
        }
        let mut attitude = UnitQuaternion::from_quaternion(quaternion);
        if layout.y_up {
            attitude = z_up() * attitude;
        }
        if let Some(places) = layout.position {
            let mut position = Vector3::zeros();
            for axis in 0..3 {
                position[axis] = number(&row, places[axis], line)? * layout.position_factor;
            }
            found.position_m.push(if layout.y_up { z_up() * position } else { position });
        }
        found.time_s.push(time_s);
        found.attitude.push(attitude);
    }
    Ok(found)
}

/// Returns the turn that lets z point up where y did.
fn z_up() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2)
}

fn rates<'a>(
    rows: impl Iterator<Item = (u64, &'a str)>,
    time: usize,
    column: usize,
    axis: usize,
    factor: f64,
) -> Result<Rates, PoseError> {
    let mut found = Rates { axis, ..Rates::default() };
    for (line, text) in rows {
        let row = cells(text);
        let time_s = number(&row, time, line)?;
        if found.time_s.last().is_some_and(|last| time_s <= *last) {
            return Err(PoseError::Backwards { line, time_s });
        }
        found.time_s.push(time_s);
        found.rate_rad_s.push(number(&row, column, line)? * factor);
    }
    Ok(found)
}

/// Reads OptiTrack's export: the first rigid body with a rotation as a quaternion. y points up there.
fn optitrack(text: &str, first: &str) -> Result<Option<External>, PoseError> {
    let head = cells(first);
    let after = |name: &str| head.iter().position(|cell| *cell == name).and_then(|at| head.get(at + 1)).copied();
    let position_factor = match after("Length Units") {
        Some("Millimeters") => 1e-3,
        Some("Centimeters") => 1e-2,
        _ => 1.0,
    };
    let mut lines = (1_u64..).zip(text.lines());
    let mut above = Vec::new();
    let header = loop {
        let Some((_, line)) = lines.next() else { return Err(unknown(first)) };
        let row = cells(line);
        if row.first() == Some(&"Frame") {
            break row;
        }
        above = row;
    };
    let column = |kind: &str, name: &str| {
        let mut places = above.iter().zip(&header);
        places.position(|(own, axis)| *own == kind && *axis == name)
    };
    let [w, x, y, z] = ["W", "X", "Y", "Z"].map(|name| column("Rotation", name));
    let (Some(w), Some(x), Some(y), Some(z)) = (w, x, y, z) else { return Err(unknown(first)) };
    let layout = Layout {
        time: 1,
        attitude: [w, x, y, z],
        position: all(["X", "Y", "Z"].map(|name| column("Position", name))),
        time_factor: 1.0,
        position_factor,
        y_up: true,
    };
    let rows = lines.filter(|(_, line)| !line.trim().is_empty());
    poses(rows, &layout).map(|poses| Some(External::Poses(poses)))
}

/// Reads Vicon's export of objects or segments: the first one. A line states the frames per second, `Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ`
/// is the header, and the line below it the units. z points up there. Returns `None` for a text of another form.
fn vicon(text: &str) -> Option<Result<Option<External>, PoseError>> {
    /// Lines above the header at most.
    const ABOVE: usize = 8;
    let numbered = || (1_u64..).zip(text.lines());
    let (at, header) = numbered().take(ABOVE).find(|(_, line)| line.starts_with("Frame,Sub Frame"))?;
    let names = cells(header);
    let place = |name: &str| names.iter().position(|own| *own == name);
    let [Some(w), Some(x), Some(y), Some(z)] = ["RW", "RX", "RY", "RZ"].map(place) else {
        return Some(Err(PoseError::Angles { line: at }));
    };
    let above = numbered().take_while(|(line, _)| *line < at);
    let rate_hz = above.filter_map(|(_, line)| cells(line).first()?.parse::<f64>().ok()).find(|rate| *rate > 0.0);
    let Some(rate_hz) = rate_hz else { return Some(Err(unknown(header))) };
    let position = all(["TX", "TY", "TZ"].map(place));
    let units = numbered().find(|(line, _)| *line == at + 1).map(|(_, line)| cells(line)).unwrap_or_default();
    let metres = match position.and_then(|places| units.get(places[0]).copied()) {
        Some("mm") => 1e-3,
        Some("cm") => 1e-2,
        _ => 1.0,
    };
    let layout = Layout {
        time: 0,
        attitude: [w, x, y, z],
        position,
        time_factor: 1.0 / rate_hz,
        position_factor: metres,
        y_up: false,
    };
    // Below the header are the units, and other tables follow behind an empty line.
    let rows = numbered().skip_while(|(line, _)| *line <= at + 1).take_while(|(_, line)| !line.trim().is_empty());
    Some(poses(rows, &layout).map(|poses| Some(External::Poses(poses))))
}
