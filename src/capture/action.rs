//! Actions and inputs: what a [`super::session::Session`] wants done, and what it is told. Data alone.

use super::description::Registers;
use super::port::{Latency, OpenError};
use crate::protocol::{DeviceError, MeasurementKind, Reply};
use crate::sample::{EventKind, GapCause, RateDoubt};
use std::path::PathBuf;

/// A serial port as it was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// The name by which it is opened.
    pub path: PathBuf,
    /// The kernel's name of what stands behind it: another one where the name is a link.
    pub target: PathBuf,
    /// What stands behind the name: another text where it is another device, or the same one plugged in anew.
    pub node: String,
}

/// What the session wants done.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Look for ports; answer with [`Input::Ports`].
    Look,
    /// Open; answer with [`Input::Opened`] or [`Input::OpenFailed`].
    Open(PathBuf, u32),
    /// Change the open port's baud rate; what was half received is void.
    SetBaud(u32),
    /// Write these bytes.
    Send(Vec<u8>),
    /// Close the port.
    Close,
    /// Frames of this kind are samples from now on, at this rate; `None` is any binary frame or message.
    Accept(MeasurementKind, f64),
    /// The registers say that the sensor sends at this rate, in Hz: what came in doubt of the rate is of it.
    RateKnown(f64),
    /// Whether the messages that are accepted next carry a serial count that steps by one for each.
    Counted(bool),
    /// No samples until the next `Accept`; what is missing until then has this cause.
    Interrupt(GapCause),
    /// Look for frames of any kind: those of the expected kind do not come.
    AcceptAny,
    /// Remember this.
    Event(EventKind, String),
    /// The sensor's description, to be stored with the capture.
    Describe(serde_json::Value),
    /// The session has ended and the port is closed.
    Ended,
}

/// What happened.
#[derive(Debug)]
pub enum Input<'a> {
    /// Time passed.
    Tick,
    /// The ports that were found, best first.
    Ports(Vec<Port>),
    /// The port is open.
    Opened {
        /// What to say about its latency timer.
        latency: Latency,
    },
    /// It is not.
    OpenFailed(OpenError),
    /// The port is gone.
    Disconnected(String),
    /// This many bytes arrived.
    Bytes(usize),
    /// So many of them are part of no frame.
    Rejected(usize),
    /// Samples without time do not come at the rate that is known.
    RateDoubted(RateDoubt),
    /// The host did not run for a while: that nothing was heard meanwhile says nothing.
    HostStalled,
    /// The sensor answered a command.
    Reply(&'a Reply<'a>),
    /// The sensor reported an error, by itself or to a command.
    DeviceError(DeviceError),
    /// The capture belongs to the sensor with this serial number; `None`: any.
    Expect(Option<String>),
    /// The sensor spoke at this baud rate in an earlier run of the daemon.
    GoodBaud(u32),
    /// What the output registers held before an earlier run of the daemon changed them: to be put back in the end.
    Previous(Registers),
    /// End: put back the sensor's output and close.
    Stop,
}
