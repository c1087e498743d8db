//! A connection of the command line to the daemon, which detects that the host behind it is gone.

use std::io::{self, Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use ureq::unversioned::transport::{Buffers, ConnectionDetails, Connector, LazyBuffers, NextTimeout, Transport};

/// Time without a byte after which the host is probed, the interval of probes, and their number: a lost host is
/// detected after two minutes. While the daemon works on an import it sends nothing, and a host that loses power does
/// not close its connections.
const QUIET: Duration = Duration::from_secs(60);
const AGAIN: Duration = Duration::from_secs(15);
const TIMES: u32 = 4;

/// Makes monitored connections.
#[derive(Debug, Default)]
pub(super) struct Watched {
    /// Set once a connection was accepted.
    pub connected: Arc<AtomicBool>,
}

impl Connector for Watched {
    type Out = Connection;

    fn connect(&self, details: &ConnectionDetails<'_>, _: Option<()>) -> Result<Option<Connection>, ureq::Error> {
        let patience = details.timeout.not_zero().map(|patience| *patience);
        let mut failed = io::Error::from(io::ErrorKind::AddrNotAvailable);
        for address in &details.addrs {
            let connected = match patience {
                Some(patience) => TcpStream::connect_timeout(address, patience),
                None => TcpStream::connect(address),
            };
            match connected.and_then(|stream| watch(&stream).map(|()| stream)) {
                Ok(stream) => {
                    self.connected.store(true, Ordering::Release);
                    let (input, output) = (details.config.input_buffer_size(), details.config.output_buffer_size());
                    return Ok(Some(Connection { stream, buffers: LazyBuffers::new(input, output) }));
                }
                Err(error) => failed = error,
            }
        }
        Err(failed.into())
    }
}

/// Lets the system probe a quiet host, and give up one that no longer accepts data.
fn watch(stream: &TcpStream) -> io::Result<()> {
    use rustix::net::sockopt;
    stream.set_nodelay(true)?;
    sockopt::set_socket_keepalive(stream, true)?;
    sockopt::set_tcp_keepidle(stream, QUIET)?;
    sockopt::set_tcp_keepintvl(stream, AGAIN)?;
    sockopt::set_tcp_keepcnt(stream, TIMES)?;
    Ok(())
}

/// A monitored connection.
#[derive(Debug)]
pub(super) struct Connection {
    stream: TcpStream,
    buffers: LazyBuffers,
}

impl Transport for Connection {
    fn buffers(&mut self) -> &mut dyn Buffers {
        &mut self.buffers
    }

    fn transmit_output(&mut self, amount: usize, timeout: NextTimeout) -> Result<(), ureq::Error> {
        self.stream.set_write_timeout(timeout.not_zero().map(|timeout| *timeout))?;
        let output = self.buffers.output().get(..amount).unwrap_or_default();
        self.stream.write_all(output).map_err(|error| convert_error(error, &timeout))
    }

    fn await_input(&mut self, timeout: NextTimeout) -> Result<bool, ureq::Error> {
        self.stream.set_read_timeout(timeout.not_zero().map(|timeout| *timeout))?;
        let read = loop {
            match self.stream.read(self.buffers.input_append_buf()) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                read => break read.map_err(|error| convert_error(error, &timeout))?,
            }
        };
        self.buffers.input_appended(read);
        Ok(read > 0)
    }

    fn is_open(&mut self) -> bool {
        // No connection is used twice: a new connection shows whether the daemon is still there.
        false
    }
}

/// Converts the two errors with which the system gives up a socket; the time limit for a lost host is not ours.
fn convert_error(error: io::Error, timeout: &NextTimeout) -> ureq::Error {
    match error.kind() {
        io::ErrorKind::WouldBlock => ureq::Error::Timeout(timeout.reason),
        _ => error.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::net::sockopt;

    #[test]
    fn a_host_that_is_gone_is_noticed_after_two_minutes() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        assert!(!sockopt::socket_keepalive(&stream).unwrap());
        watch(&stream).unwrap();
        assert!(sockopt::socket_keepalive(&stream).unwrap());
        let (idle, again) = (sockopt::tcp_keepidle(&stream).unwrap(), sockopt::tcp_keepintvl(&stream).unwrap());
        assert_eq!(idle + again * sockopt::tcp_keepcnt(&stream).unwrap(), Duration::from_secs(120));
    }
}
