//! Ports: finds the sensor's serial port, opens it exclusively, and sets baud rate and latency. The only user of
//! `tokio_serial`.

use std::path::{Path, PathBuf};
use tokio_serial::{ErrorKind, SerialPort as _, SerialStream};

/// The places to search if no device is configured: stable names first, then those that the kernel numbered.
const SEARCH: [&str; 3] = ["/dev/serial/by-id/*", "/dev/ttyUSB*", "/dev/ttyACM*"];
/// FTDI's default of 16 ms bunches messages; 1 ms is the minimum of the chip.
const LATENCY_TIMER_MS: u32 = 1;

/// A serial port that was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// The name by which it is opened.
    pub path: PathBuf,
    /// The kernel's name of the device, which differs if `path` is a link.
    pub target: PathBuf,
    /// Identifies the device: the text differs for another device, and for the same device after it was plugged in
    /// again.
    pub node: String,
}

/// The reasons why a port could not be opened.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// There is no such port, or it has gone.
    #[error("{path} is not there")]
    Gone {
        /// The port.
        path: String,
    },
    /// Another process holds it.
    #[error("{path} is in use by {holder}: stop that program, or choose another port with --device")]
    Busy {
        /// The port.
        path: String,
        /// The process, as far as /proc shows it.
        holder: String,
    },
    /// The user lacks the permission.
    #[error(
        "{path} may not be opened by this user: add the user to the group that owns it (`ls -l {path}`; on Debian `sudo adduser $USER dialout`) and log in again"
    )]
    Permission {
        /// The port.
        path: String,
    },
    /// The system returned another error.
    #[error("{path} cannot be opened as a serial port: {reason}")]
    Other {
        /// The port.
        path: String,
        /// The error message of the system.
        reason: String,
    },
}

/// The state of the adapter's latency timer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Latency {
    /// The adapter has no such timer (a UART, a pseudo-terminal).
    NotApplicable,
    /// The timer is set to this many milliseconds, as wanted.
    Low(u32),
    /// The timer is set to this many milliseconds and could not be changed.
    High(u32),
}

impl Latency {
    /// Returns a sentence for the user, if an action is needed.
    pub fn hint(self) -> Option<String> {
        match self {
            Self::High(ms) => Some(format!(
                "the USB adapter's latency timer is {ms} ms and may not be changed by this user, so samples arrive in bunches: install systemd/70-vn100.rules into /etc/udev/rules.d and plug the adapter in again"
            )),
            _ => None,
        }
    }
    /// Returns the timer in milliseconds, if there is one.
    pub fn timer_ms(self) -> Option<u32> {
        match self {
            Self::NotApplicable => None,
            Self::Low(ms) | Self::High(ms) => Some(ms),
        }
    }
}

/// Returns the ports that may be the sensor's, best first. `device` is a path or a glob pattern; without it the usual
/// places are searched. An invalid pattern matches nothing.
pub fn find(device: Option<&str>) -> Vec<PathBuf> {
    let patterns: &[&str] = match &device {
        Some(device) => std::slice::from_ref(device),
        None => &SEARCH,
    };
    let mut found = Vec::new();
    let mut targets = Vec::new();
    for pattern in patterns {
        let matches: Vec<PathBuf> = if Path::new(pattern).exists() {
            vec![PathBuf::from(pattern)]
        } else {
            glob::glob(pattern).map(|paths| paths.flatten().collect()).unwrap_or_default()
        };
        for path in matches {
            // One adapter has a name by its id and one by its number: it is listed once.
            let target = std::fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
            if !targets.contains(&target) {
                targets.push(target);
                found.push(path);
            }
        }
    }
    found
}

/// Looks for ports as [`find`] does, and adds the device behind each name.
pub fn look(device: Option<&str>) -> Vec<Port> {
    find(device)
        .into_iter()
        .map(|path| {
            let target = std::fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
            Port { node: node(&target), target, path }
        })
        .collect()
}

/// Identifies the device by its location and the time at which it was created.
fn node(target: &Path) -> String {
    use std::os::unix::fs::MetadataExt as _;
    let made = std::fs::metadata(target)
        .map_or(0, |data| i128::from(data.ctime()) * 1_000_000_000 + i128::from(data.ctime_nsec()));
    format!("{} {made}", target.display())
}

/// Opens the port exclusively (TIOCEXCL and `flock`), raw, 8N1, at `baud`.
///
/// # Errors
/// [`OpenError`], one variant per action that the user may take.
pub fn open(path: &Path, baud: u32) -> Result<SerialStream, OpenError> {
    let name = path.display().to_string();
    // The name may be a link that moves (by-id); the present kernel name is opened and locked.
    let target = std::fs::canonicalize(path).map_err(|_| OpenError::Gone { path: name.clone() })?;
    SerialStream::open(&tokio_serial::new(target.to_string_lossy(), baud)).map_err(|error| {
        let reason = error.to_string();
        match error.kind() {
            ErrorKind::Io(std::io::ErrorKind::NotFound) => OpenError::Gone { path: name },
            ErrorKind::Io(std::io::ErrorKind::PermissionDenied) => OpenError::Permission { path: name },
            ErrorKind::NoDevice => OpenError::Busy { holder: holder(&target), path: name },
            _ if reason.contains("lock") => OpenError::Busy { holder: holder(&target), path: name },
            _ => OpenError::Other { path: name, reason },
        }
    })
}

/// Changes the baud rate of an open port.
///
/// # Errors
/// [`OpenError::Other`] if the port does not support that rate.
pub fn set_baud(stream: &mut SerialStream, path: &Path, baud: u32) -> Result<(), OpenError> {
    stream
        .set_baud_rate(baud)
        .map_err(|error| OpenError::Other { path: path.display().to_string(), reason: format!("{baud} baud: {error}") })
}

/// Sets the USB adapter's latency timer through sysfs, if it exists and is writable.
pub fn lower_latency(path: &Path) -> Latency {
    let Ok(target) = std::fs::canonicalize(path) else { return Latency::NotApplicable };
    let Some(name) = target.file_name() else { return Latency::NotApplicable };
    lower_latency_at(&Path::new("/sys/class/tty").join(name).join("device/latency_timer"))
}

fn lower_latency_at(timer: &Path) -> Latency {
    let read = || std::fs::read_to_string(timer).ok().and_then(|text| text.trim().parse::<u32>().ok());
    let Some(before) = read() else { return Latency::NotApplicable };
    if before <= LATENCY_TIMER_MS {
        return Latency::Low(before);
    }
    // The value is read back: writing may succeed without effect.
    match std::fs::write(timer, LATENCY_TIMER_MS.to_string()).ok().and_then(|()| read()) {
        Some(after) if after <= LATENCY_TIMER_MS => Latency::Low(after),
        after => Latency::High(after.unwrap_or(before)),
    }
}

/// Returns the process that holds the port, as far as /proc shows it to this user: the one that locked it, else any
/// that has it open.
fn holder(target: &Path) -> String {
    let of = |pid: &str| {
        let name = std::fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
        format!("process {pid} ({})", name.trim())
    };
    if let Some(pid) = lock_holder(target) {
        return of(&pid);
    }
    let own = std::process::id().to_string();
    let processes = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    for process in processes {
        let pid = process.file_name().to_string_lossy().into_owned();
        if !pid.bytes().all(|byte| byte.is_ascii_digit()) || pid == own {
            continue;
        }
        let Ok(descriptors) = std::fs::read_dir(process.path().join("fd")) else { continue };
        if descriptors.flatten().any(|fd| std::fs::read_link(fd.path()).is_ok_and(|link| link == target)) {
            return of(&pid);
        }
    }
    "another program".to_owned()
}

/// Returns the process that `flock`ed the file, from /proc/locks: `1: FLOCK ADVISORY WRITE 4711 00:1a:9 0 EOF`.
fn lock_holder(target: &Path) -> Option<String> {
    use std::os::unix::fs::MetadataExt as _;
    let inode = std::fs::metadata(target).ok()?.ino().to_string();
    let device = rustix::fs::stat(target).ok()?.st_dev;
    let file = format!("{:02x}:{:02x}:{inode}", rustix::fs::major(device), rustix::fs::minor(device));
    let of_line = |line: &str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        (fields.get(1) == Some(&"FLOCK") && fields.get(5) == Some(&file.as_str())).then(|| fields[4].to_owned())
    };
    // The list is no snapshot: an entry may be missed while others come and go.
    (0..3).find_map(|_| std::fs::read_to_string("/proc/locks").ok()?.lines().find_map(of_line))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_finds_each_port_once_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let port = folder.path().join("ttyUSB7");
        std::fs::write(&port, "").unwrap();
        std::os::unix::fs::symlink(&port, folder.path().join("usb-FTDI-if00")).unwrap();
        let pattern = folder.path().join("*").display().to_string();
        assert_eq!(find(Some(&pattern)).len(), 1);
        assert_eq!(find(Some(port.to_str().unwrap())), [port]);
        assert!(find(Some("/nowhere/tty*")).is_empty());
    }

    #[test]
    fn a_missing_port_and_a_file_that_is_no_port_are_distinguished() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(open(&folder.path().join("none"), 115_200), Err(OpenError::Gone { .. })));
        let file = folder.path().join("night.csv");
        std::fs::write(&file, "no port").unwrap();
        let error = open(&file, 115_200).unwrap_err();
        assert!(matches!(error, OpenError::Other { .. }), "{error}");
    }

    #[test]
    fn the_latency_timer_is_lowered_where_it_may_be_and_reported_where_not() {
        let folder = tempfile::tempdir().unwrap();
        let timer = folder.path().join("latency_timer");
        assert_eq!(lower_latency_at(&timer), Latency::NotApplicable);
        std::fs::write(&timer, "16\n").unwrap();
        assert_eq!(lower_latency_at(&timer), Latency::Low(1));
        assert_eq!(lower_latency_at(&timer), Latency::Low(1));
        assert!(Latency::High(16).hint().unwrap().contains("70-vn100.rules"));
    }
}
