//! Lines: samples as JSON, one per line, over a Unix socket, for programs that decode no frames.
//!
//! A sample has the names and units of the NDJSON export; `time_s` is the time of its arrival since 1970, and
//! `device_time_s` the sensor's own clock. Each client reads at its own pace: one that is too slow loses the oldest
//! lines, and a line `{"lost":n}` in their place states how many. What a client sends is not read.

use super::figures::{ShareFigures, Way};
use imu_core::sample::{Channel, ChannelSet, Sample};
use imu_files::export::samples::{TextFormat, TextWriter};
use rustix::event::{PollFd, PollFlags, Timespec};
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt as _;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::{broadcast, mpsc};
use tokio_util::sync::CancellationToken;

/// The maximum number of clients.
pub const CLIENTS_MAX: u64 = 16;
/// Lines that a client may lag behind, besides those in the socket: 1.3 s at 800 Hz.
const LAG_LINES: usize = 1024;
/// Lines that are written at once.
const LINES_AT_ONCE: usize = 64;
/// How often it is looked whether a client is still there, if there is nothing to send.
const LOOK: Duration = Duration::from_secs(1);
/// How often it is looked whether the socket is still there.
const UPKEEP: Duration = Duration::from_secs(1);
/// The wait before the socket is created again after an error.
const AGAIN: Duration = Duration::from_secs(5);

/// What is found at the socket's path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Found {
    /// Nothing, or a socket on which nobody listens.
    Free,
    /// A socket on which a program listens.
    InUse,
    /// Something that is no socket.
    Other,
}

/// Returns what is at the path. It never waits for the program that listens.
pub(super) fn look(path: &Path) -> Found {
    let Ok(metadata) = std::fs::symlink_metadata(path) else { return Found::Free };
    if !metadata.file_type().is_socket() {
        return Found::Other;
    }
    let connects = || {
        let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
        let socket = rustix::net::socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
        rustix::net::connect(&socket, &SocketAddrUnix::new(path)?)
    };
    if connects() == Err(Errno::CONNREFUSED) { Found::Free } else { Found::InUse }
}

/// Serves the clients until `stop`; a socket that cannot be created is tried again.
pub(super) async fn run(
    path: PathBuf,
    mode: u32,
    mut samples: mpsc::Receiver<Sample>,
    figures: ShareFigures,
    stop: CancellationToken,
) {
    while !stop.is_cancelled() {
        match Socket::bind(&path, mode) {
            Ok(mut socket) => {
                figures.state(Way::Socket, None);
                tracing::info!(socket = %path.display(), "samples are shared");
                return socket.serve(&mut samples, &figures, &stop).await;
            }
            Err(error) => {
                figures.state(Way::Socket, Some(unmade(&path, &error)));
                tokio::select! {
                    () = stop.cancelled() => {}
                    () = tokio::time::sleep(AGAIN) => {}
                }
            }
        }
    }
}

fn unmade(path: &Path, error: &std::io::Error) -> String {
    let path = path.display();
    format!(
        "the socket {path} of `share.socket` cannot be made ({error}): choose a folder that exists and may be written; it \
         is tried again"
    )
}

/// A socket that is removed with its owner.
struct Socket {
    listener: UnixListener,
    path: PathBuf,
    mode: u32,
    inode: u64,
}

impl Socket {
    fn bind(path: &Path, mode: u32) -> std::io::Result<Self> {
        match look(path) {
            Found::Free => {
                if path.symlink_metadata().is_ok() {
                    std::fs::remove_file(path)?;
                }
            }
            Found::InUse => return Err(std::io::ErrorKind::AddrInUse.into()),
            Found::Other => return Err(std::io::ErrorKind::AlreadyExists.into()),
        }
        let listener = UnixListener::bind(path)?;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))?;
        Ok(Self { listener, path: path.to_owned(), mode, inode: std::fs::symlink_metadata(path)?.ino() })
    }

    /// Returns whether the path still leads to this socket.
    fn is_there(&self) -> bool {
        std::fs::symlink_metadata(&self.path).is_ok_and(|metadata| metadata.ino() == self.inode)
    }

    /// Makes a socket again that was removed; the clients that are there remain.
    fn keep(&mut self, figures: &ShareFigures) {
        if self.is_there() {
            return;
        }
        match Self::bind(&self.path, self.mode) {
            Ok(again) => {
                *self = again;
                figures.state(Way::Socket, None);
            }
            Err(error) => figures.state(Way::Socket, Some(unmade(&self.path, &error))),
        }
    }

    async fn serve(&mut self, samples: &mut mpsc::Receiver<Sample>, figures: &ShareFigures, stop: &CancellationToken) {
        let (lines, _) = broadcast::channel(LAG_LINES);
        let mut rows = Rows::default();
        let mut clients = tokio::task::JoinSet::new();
        let mut upkeep = tokio::time::interval(UPKEEP);
        loop {
            tokio::select! {
                () = stop.cancelled() => return,
                _ = upkeep.tick() => self.keep(figures),
                sample = samples.recv() => {
                    let Some(sample) = sample else { return };
                    let missed = figures.counts.missed.take();
                    if missed > 0 {
                        // No client listens any more, perhaps.
                        let _ = lines.send(lost(missed).into());
                    }
                    let _ = lines.send(rows.line(&sample));
                }
                accepted = self.listener.accept() => match accepted {
                    Ok((stream, _)) if figures.counts.clients.get() < CLIENTS_MAX => {
                        figures.counts.clients.add(1);
                        clients.spawn(client(stream, lines.subscribe(), figures.clone()));
                    }
                    Ok((stream, _)) => {
                        figures.counts.clients_refused.add(1);
                        let refusal = format!("{{\"error\":\"there are {CLIENTS_MAX} clients: end one of them\"}}\n");
                        // The buffer of a new socket has room.
                        let _ = stream.try_write(refusal.as_bytes());
                    }
                    // No file descriptor is free: the clients that are there go on.
                    Err(_) => tokio::time::sleep(RETRY_ACCEPT).await,
                },
                Some(_) = clients.join_next() => figures.counts.clients.set(clients.len() as u64),
            }
        }
    }
}

/// The wait after a client could not be accepted.
const RETRY_ACCEPT: Duration = Duration::from_millis(20);

impl Drop for Socket {
    fn drop(&mut self) {
        // A socket of another program in this place stays.
        if self.is_there() {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Returns the line in the place of lines that a client did not get.
fn lost(count: u64) -> String {
    format!("{{\"lost\":{count}}}\n")
}

/// Sends lines to a client until it has gone.
async fn client(mut stream: UnixStream, mut lines: broadcast::Receiver<Arc<str>>, figures: ShareFigures) {
    let mut text = String::new();
    loop {
        text.clear();
        let (mut sent, mut lagged) = (0, 0);
        match tokio::time::timeout(LOOK, lines.recv()).await {
            Err(_) if is_gone(&stream) => return,
            Err(_) => continue,
            Ok(Err(RecvError::Closed)) => return,
            Ok(Err(RecvError::Lagged(count))) => lagged += count,
            Ok(Ok(line)) => {
                text.push_str(&line);
                sent += 1;
            }
        }
        while sent < LINES_AT_ONCE as u64 && lagged == 0 {
            match lines.try_recv() {
                Ok(line) => text.push_str(&line),
                Err(TryRecvError::Lagged(count)) => {
                    lagged = count;
                    break;
                }
                Err(_) => break,
            }
            sent += 1;
        }
        if lagged > 0 {
            figures.counts.lost_lines.add(lagged);
            text.push_str(&lost(lagged));
        }
        if stream.write_all(text.as_bytes()).await.is_err() {
            return;
        }
        figures.counts.lines.add(sent);
    }
}

/// Returns whether a client has closed its socket. One that has only ended what it sends still receives.
fn is_gone(stream: &UnixStream) -> bool {
    let mut polled = [PollFd::new(stream, PollFlags::empty())];
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    rustix::event::poll(&mut polled, Some(&at_once)).is_ok() && polled[0].revents().contains(PollFlags::HUP)
}

/// Samples as lines; the columns follow the channels of the sample.
#[derive(Default)]
struct Rows {
    columns: Option<(ChannelSet, bool, TextWriter, Vec<Channel>)>,
}

impl Rows {
    fn line(&mut self, sample: &Sample) -> Arc<str> {
        let (has_time, set) = (sample.device_time_ns.is_some(), sample.channels());
        let fits = self.columns.as_ref().is_some_and(|(of, timed, ..)| (*of, *timed) == (set, has_time));
        if !fits {
            self.columns = None;
        }
        let (_, _, writer, channels) = self.columns.get_or_insert_with(|| {
            let channels: Vec<Channel> = set.iter().collect();
            let writer = TextWriter::new(TextFormat::Ndjson, &channels, false);
            let writer = if has_time { writer.with_column("device_time_s", "s") } else { writer };
            (set, has_time, writer, channels)
        });
        let values = channels.iter().map(|channel| sample.get(*channel).unwrap_or(f64::NAN));
        let device_time_s = sample.device_time_ns.map(|ns| ns as f64 / 1e9);
        let mut line = String::with_capacity(320);
        writer.row(&mut line, sample.host_utc_ns, values.chain(device_time_s));
        line.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_the_samples_channels_and_times() {
        let mut sample = Sample::at(5, 1_790_000_000_123_456_789);
        sample.set(Channel::GyroX, -0.001_25);
        sample.set(Channel::Temperature, 21.5);
        let mut rows = Rows::default();
        assert_eq!(
            &*rows.line(&sample),
            "{\"time_s\":1790000000.123456789,\"gyro_x\":-0.00125,\"temperature\":21.5}\n"
        );
        sample.device_time_ns = Some(86_400_123_456_789);
        assert_eq!(
            &*rows.line(&sample),
            "{\"time_s\":1790000000.123456789,\"gyro_x\":-0.00125,\"temperature\":21.5,\"device_time_s\":86400.123456789}\n"
        );
    }

    #[test]
    fn only_a_socket_without_a_listener_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("imu.sock");
        assert_eq!(look(&path), Found::Free);
        let listener = std::os::unix::net::UnixListener::bind(&path).unwrap();
        assert_eq!(look(&path), Found::InUse);
        drop(listener);
        assert_eq!(look(&path), Found::Free);
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "data").unwrap();
        assert_eq!(look(&path), Found::Other);
    }
}
