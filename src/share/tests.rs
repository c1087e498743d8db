//! Tests of the share with readers of every kind, without a daemon.

use super::*;
use imu_core::sample::Channel;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

fn options(folder: &Path) -> ShareOptions {
    ShareOptions { link: Some(folder.join("tty")), socket: Some(folder.join("imu.sock")), mode: 0o660 }
}

fn until<T>(what: &str, mut condition: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + Duration::from_secs(20);
    loop {
        if let Some(found) = condition() {
            return found;
        }
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Returns a running share whose link and socket are there.
fn shared(folder: &Path) -> Share {
    let share = Share::start(options(folder)).unwrap();
    until("link and socket", || (folder.join("tty").exists() && folder.join("imu.sock").exists()).then_some(()));
    share
}

fn status(share: &Share) -> crate::observe::ShareStatus {
    share.figures().unwrap().status()
}

fn open(folder: &Path) -> std::fs::File {
    // Without waiting, and not as this process's terminal.
    let flags = (rustix::fs::OFlags::NONBLOCK | rustix::fs::OFlags::NOCTTY).bits();
    let mut options = std::fs::OpenOptions::new();
    options.read(true).write(true).custom_flags(flags.try_into().unwrap()).open(folder.join("tty")).unwrap()
}

/// Returns what arrives until there are `count` bytes, or nothing more for a while.
fn read(file: &mut std::fs::File, count: usize) -> Vec<u8> {
    let (mut bytes, mut buffer, mut last) = (Vec::new(), [0; 4096], Instant::now());
    while bytes.len() < count && last.elapsed() < Duration::from_secs(5) {
        match file.read(&mut buffer) {
            Ok(read) if read > 0 => {
                bytes.extend_from_slice(&buffer[..read]);
                last = Instant::now();
            }
            _ => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    bytes
}

fn line(number: u32) -> Vec<u8> {
    let body = format!("VNGYR,+00.{number:06},+00.000000,-00.000001");
    let sum = body.bytes().fold(0_u8, |sum, byte| sum ^ byte);
    format!("${body}*{sum:02X}\r\n").into_bytes()
}

fn sample(number: u32) -> Sample {
    let mut sample = Sample::at(0, i64::from(number));
    sample.set(Channel::GyroX, f64::from(number));
    sample
}

fn reading(share: &Share, wanted: bool) {
    until("the reader is noticed", || (status(share).reading == wanted).then_some(()));
}

#[test]
fn what_is_in_the_way_is_refused_and_stays() {
    let folder = tempfile::tempdir().unwrap();
    let wanted = options(folder.path());
    let (link, socket) = (wanted.link.clone().unwrap(), wanted.socket.clone().unwrap());
    std::fs::write(&link, "data").unwrap();
    let refused = Share::start(wanted.clone()).unwrap_err();
    assert!(matches!(refused, ShareError::LinkOccupied { .. }) && refused.is_configuration(), "{refused}");
    assert_eq!(std::fs::read_to_string(&link).unwrap(), "data");
    std::fs::remove_file(&link).unwrap();
    // Links of somebody else, such as an emulator.
    for target in ["/etc/hostname", "/dev/pts/0"] {
        std::os::unix::fs::symlink(target, &link).unwrap();
        assert!(matches!(Share::start(wanted.clone()), Err(ShareError::LinkOccupied { .. })));
        assert_eq!(std::fs::read_link(&link).unwrap().to_str(), Some(target));
        std::fs::remove_file(&link).unwrap();
    }
    std::fs::create_dir(&socket).unwrap();
    assert!(matches!(Share::start(wanted.clone()), Err(ShareError::SocketOccupied { .. })));
    std::fs::remove_dir(&socket).unwrap();
    let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    assert!(matches!(Share::start(wanted.clone()), Err(ShareError::SocketInUse { .. })));
    // As a killed daemon leaves them.
    drop(listener);
    std::os::unix::fs::symlink("/dev/pts/./99999", &link).unwrap();
    let share = Share::start(wanted).unwrap();
    until("both work", || (link.exists() && UnixStream::connect(&socket).is_ok()).then_some(()));
    let mode = std::fs::metadata(&link).unwrap().permissions().mode() & 0o777;
    assert_eq!((mode, std::fs::metadata(&socket).unwrap().permissions().mode() & 0o777), (0o660, 0o660));
    drop(share);
    assert!(!link.is_symlink() && !socket.exists(), "both are removed at the end");
}

#[test]
fn a_missing_folder_is_waited_for_and_what_is_removed_returns() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("later");
    let share = Share::start(options(&inner)).unwrap();
    until("the error is reported", || status(&share).error);
    let error = status(&share).error.unwrap();
    assert!(
        error.contains("`share.link` cannot be made") && error.contains("`share.socket` cannot be made"),
        "{error}"
    );
    std::fs::create_dir(&inner).unwrap();
    until("both appear", || (inner.join("tty").exists() && inner.join("imu.sock").exists()).then_some(()));
    until("the error is over", || status(&share).error.is_none().then_some(()));
    let client = UnixStream::connect(inner.join("imu.sock")).unwrap();
    until("the client is there", || (status(&share).clients == 1).then_some(()));
    std::fs::remove_file(inner.join("tty")).unwrap();
    std::fs::remove_file(inner.join("imu.sock")).unwrap();
    until("both return", || (inner.join("tty").exists() && inner.join("imu.sock").exists()).then_some(()));
    let second = until("the socket listens", || UnixStream::connect(inner.join("imu.sock")).ok());
    until("both clients are there", || (status(&share).clients == 2).then_some(()));
    share.tap().sample(&sample(3));
    for stream in [client, second] {
        assert_eq!(lines(stream).next().unwrap()["gyro_x"], 3.0);
    }
    // Another program's link stays, and is reported.
    std::fs::remove_file(inner.join("tty")).unwrap();
    std::os::unix::fs::symlink("/dev/pts/99999", inner.join("tty")).unwrap();
    let error = until("the other link is reported", || status(&share).error);
    assert!(error.contains("leads elsewhere"), "{error}");
    drop(share);
    assert!(inner.join("tty").is_symlink());
}

#[test]
fn a_program_gets_the_bytes_from_a_frame_on_and_what_it_writes_is_discarded() {
    let folder = tempfile::tempdir().unwrap();
    let share = shared(folder.path());
    let tap = share.tap();
    // Nobody reads yet: the cut line is the only one that a reader still gets.
    tap.bytes(&line(0));
    tap.bytes(&line(1)[..20]);
    std::thread::sleep(Duration::from_millis(100));
    let mut file = open(folder.path());
    reading(&share, true);
    tap.bytes(&line(1)[20..]);
    tap.bytes(&line(2));
    tap.bytes(b"\x00\x03\x04\r\n\x11\x13\x1a\xff");
    let wanted = [&line(1)[..], &line(2), b"\x00\x03\x04\r\n\x11\x13\x1a\xff"].concat();
    assert_eq!(read(&mut file, wanted.len()), wanted);
    file.write_all(b"$VNWRG,06,0*XX\r\n").unwrap();
    until("what it wrote is counted", || (status(&share).ignored_bytes == 16).then_some(()));
    assert_eq!(read_now(&mut file), b"", "nothing is echoed");
    assert_eq!((status(&share).bytes, status(&share).dropped_bytes), (wanted.len() as u64, 0));
}

fn read_now(file: &mut std::fs::File) -> Vec<u8> {
    let mut buffer = [0; 4096];
    let count = file.read(&mut buffer).unwrap_or(0);
    buffer[..count].to_vec()
}

#[test]
fn the_next_program_gets_nothing_of_the_last_ones_bytes_and_settings() {
    let folder = tempfile::tempdir().unwrap();
    let share = shared(folder.path());
    let tap = share.tap();
    let file = open(folder.path());
    reading(&share, true);
    // The program edits lines, claims the terminal and reads nothing.
    let mut termios = rustix::termios::tcgetattr(&file).unwrap();
    termios.input_modes |= rustix::termios::InputModes::ICRNL;
    termios.local_modes |= rustix::termios::LocalModes::ICANON | rustix::termios::LocalModes::ECHO;
    rustix::termios::tcsetattr(&file, rustix::termios::OptionalActions::Now, &termios).unwrap();
    rustix::termios::ioctl_tiocexcl(&file).unwrap();
    (0..50).for_each(|number| tap.bytes(&line(number)));
    until("it has bytes", || (status(&share).bytes > 0).then_some(()));
    drop(file);
    reading(&share, false);
    std::thread::sleep(Duration::from_millis(200));
    let mut file = open(folder.path());
    reading(&share, true);
    tap.bytes(&line(7));
    assert_eq!(read(&mut file, line(7).len()), line(7));
    assert_eq!(read_now(&mut file), b"");
}

#[test]
fn a_program_that_never_reads_holds_nothing_up_and_misses_whole_frames() {
    let folder = tempfile::tempdir().unwrap();
    let share = shared(folder.path());
    let tap = share.tap();
    let mut file = open(folder.path());
    reading(&share, true);
    let begun = Instant::now();
    for number in 0..20_000 {
        tap.bytes(&line(number));
        if number % 100 == 0 {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
    assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
    let dropped = until("it is full", || Some(status(&share).dropped_bytes).filter(|bytes| *bytes > 0));
    assert_eq!(dropped as usize % line(0).len(), 0, "whole frames are dropped");
    // It reads at last: whole lines, and the last one is the newest.
    let received = read(&mut file, usize::MAX);
    let dropped = status(&share).dropped_bytes;
    assert_eq!(received.len() as u64 + dropped, 20_000 * line(0).len() as u64);
    assert!(received.chunks(line(0).len()).all(|of| of.starts_with(b"$VN") && of.ends_with(b"\r\n")));
    assert!(received.ends_with(&line(19_999)));
}

#[test]
fn a_thousand_programs_one_after_the_other_and_several_at_once_are_served() {
    let folder = tempfile::tempdir().unwrap();
    let share = shared(folder.path());
    let tap = share.tap();
    for number in 0..1000 {
        let _file = open(folder.path());
        tap.bytes(&line(number));
    }
    let mut files: Vec<_> = (0..8).map(|_| open(folder.path())).collect();
    reading(&share, true);
    (0..100).for_each(|number| tap.bytes(&line(number)));
    // They share the bytes among them.
    let mut received = 0;
    until("all bytes arrive", || {
        received += files.iter_mut().map(|file| read_now(file).len()).sum::<usize>();
        (received >= 100 * line(0).len()).then_some(())
    });
    drop(files);
    reading(&share, false);
    assert_eq!(status(&share).error, None);
}

fn lines(stream: UnixStream) -> impl Iterator<Item = serde_json::Value> {
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    BufReader::new(stream).lines().map(|line| serde_json::from_str(&line.unwrap()).unwrap())
}

#[test]
fn a_client_that_has_ended_its_own_side_receives_and_one_that_is_slow_learns_what_it_lost() {
    let folder = tempfile::tempdir().unwrap();
    let share = shared(folder.path());
    let tap = share.tap();
    let path = folder.path().join("imu.sock");
    tap.sample(&sample(0));
    let half = UnixStream::connect(&path).unwrap();
    half.shutdown(std::net::Shutdown::Write).unwrap();
    let slow = UnixStream::connect(&path).unwrap();
    until("both are clients", || (status(&share).clients == 2).then_some(()));
    // Longer than the interval at which clients that have gone are looked for.
    std::thread::sleep(Duration::from_millis(1500));
    let fast = std::thread::spawn(move || {
        let numbers = lines(half).map(|line| line["gyro_x"].as_f64().unwrap());
        numbers.take_while(|number| *number < 30_000.0).collect::<Vec<_>>()
    });
    for number in 1..=30_000 {
        tap.sample(&sample(number));
        if number % 50 == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    assert_eq!(fast.join().unwrap(), (1..30_000).map(f64::from).collect::<Vec<_>>());
    let (mut received, mut lost) = (0, 0);
    for line in lines(slow) {
        match line["lost"].as_u64() {
            Some(count) => lost += count,
            None => received += 1,
        }
        if line["gyro_x"] == 30_000.0 {
            break;
        }
    }
    assert!(lost > 0 && received + lost == 30_000, "{received} {lost}");
    until("clients that have gone are noticed", || (status(&share).clients == 0).then_some(()));
    let status = status(&share);
    assert_eq!((status.lines, status.lost_lines), (29_999 + 1 + received, lost));
}

#[test]
fn ten_thousand_clients_leave_sixteen() {
    let folder = tempfile::tempdir().unwrap();
    let share = shared(folder.path());
    let path = folder.path().join("imu.sock");
    let kept: Vec<UnixStream> = (0..CLIENTS_MAX).map(|_| UnixStream::connect(&path).unwrap()).collect();
    until("sixteen", || (status(&share).clients == CLIENTS_MAX).then_some(()));
    for _ in 0..10_000 {
        drop(UnixStream::connect(&path).unwrap());
    }
    let mut refused = String::new();
    UnixStream::connect(&path).unwrap().read_to_string(&mut refused).unwrap();
    assert!(refused.starts_with("{\"error\":\"there are 16 clients"), "{refused}");
    assert_eq!((status(&share).clients, status(&share).clients_refused), (CLIENTS_MAX, 10_001));
    share.tap().sample(&sample(5));
    for stream in kept {
        assert_eq!(lines(stream).next().unwrap()["gyro_x"], 5.0);
    }
    until("places are free again", || (status(&share).clients == 0).then_some(()));
}
