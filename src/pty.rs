//! Pseudo-terminals: the only place that creates them, and the links that lead to them. A shell without a loop.
//!
//! In: nothing, or a path for a link. Out: both ends of a raw terminal, whose master never blocks. A link is replaced
//! atomically, and never takes the place of a file that is no link.

use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::pty::OpenptFlags;
use rustix::termios::{OptionalActions, Termios};
use std::ffi::OsString;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};

/// The two ends of a pseudo-terminal.
#[derive(Debug)]
pub struct Pair {
    /// The end of the program that plays the device; reads and writes do not block.
    pub master: OwnedFd,
    /// The end that others open as a serial port.
    pub slave: OwnedFd,
    /// The name of the slave, such as /dev/pts/7.
    pub path: PathBuf,
}

/// Creates a raw pseudo-terminal.
///
/// # Errors
/// The error that the system reports.
pub fn open() -> Result<Pair, Errno> {
    let master = rustix::pty::openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    rustix::pty::grantpt(&master)?;
    rustix::pty::unlockpt(&master)?;
    let name = rustix::pty::ptsname(&master, Vec::new())?;
    let path = PathBuf::from(name.to_string_lossy().into_owned());
    let slave = open_slave(&path)?;
    make_raw(&slave)?;
    let flags = rustix::fs::fcntl_getfl(&master)?;
    rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK)?;
    Ok(Pair { master, slave, path })
}

/// Opens the slave's side without making it this process's controlling terminal.
///
/// # Errors
/// The error that the system reports; [`Errno::BUSY`] if a program has claimed the terminal for itself.
pub fn open_slave(path: &Path) -> Result<OwnedFd, Errno> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    rustix::fs::open(path, flags, Mode::empty())
}

/// Makes a terminal raw, if it is not: a new one echoes and edits lines, which a serial sensor does not.
///
/// # Errors
/// The error that the system reports.
pub fn make_raw(slave: impl AsFd) -> Result<(), Errno> {
    let is = |termios: &Termios| (termios.input_modes, termios.output_modes, termios.local_modes);
    let mut termios = rustix::termios::tcgetattr(&slave)?;
    let before = is(&termios);
    termios.make_raw();
    if is(&termios) == before { Ok(()) } else { rustix::termios::tcsetattr(&slave, OptionalActions::Now, &termios) }
}

/// Makes a link to a terminal, in place of an old link or of nothing.
///
/// # Errors
/// The error that the system reports; [`std::io::ErrorKind::AlreadyExists`] if something that is no link is there.
pub fn link(target: &Path, link: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::symlink;
    if !link.is_symlink() {
        return symlink(target, link);
    }
    // Readers never see a moment without a link.
    let mut aside = OsString::from(".");
    aside.push(link.file_name().unwrap_or_default());
    aside.push(format!(".{}", std::process::id()));
    let aside = link.with_file_name(aside);
    // A process of this number may have died here.
    let _ = std::fs::remove_file(&aside);
    symlink(target, &aside)?;
    std::fs::rename(&aside, link).inspect_err(|_| drop(std::fs::remove_file(&aside)))
}

/// Returns whether the link leads to this terminal.
pub fn is_link_to(link: &Path, target: &Path) -> bool {
    std::fs::read_link(link).is_ok_and(|found| found == target)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_takes_the_place_of_a_link_and_of_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("imu");
        link(Path::new("/dev/pts/998"), &path).unwrap();
        link(Path::new("/dev/pts/999"), &path).unwrap();
        assert!(is_link_to(&path, Path::new("/dev/pts/999")));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left aside");
        let file = folder.path().join("night.csv");
        std::fs::write(&file, "data").unwrap();
        let refused = link(Path::new("/dev/pts/999"), &file).unwrap_err();
        assert_eq!(refused.kind(), std::io::ErrorKind::AlreadyExists);
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "data");
    }

    #[test]
    fn bytes_pass_a_terminal_unchanged() {
        let pair = open().unwrap();
        let sent: Vec<u8> = (0..=255).collect();
        assert_eq!(rustix::io::write(&pair.master, &sent).unwrap(), 256);
        let (mut received, mut buffer) = (Vec::new(), [0; 512]);
        while received.len() < 256 {
            match rustix::io::read(&pair.slave, &mut buffer) {
                Ok(count) => received.extend_from_slice(&buffer[..count]),
                Err(Errno::AGAIN) => std::thread::sleep(std::time::Duration::from_millis(1)),
                Err(error) => panic!("{error}"),
            }
        }
        assert_eq!(received, sent);
        // Nothing is echoed.
        assert_eq!(rustix::io::read(&pair.master, &mut buffer), Err(Errno::AGAIN));
    }
}
