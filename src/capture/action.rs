//! Actions and inputs: the requests of a [`super::session::Session`], and the events that it receives. This module has
//! no behaviour.

use super::port::{Latency, OpenError, Port};
use imu_core::sample::{ConnectedSensor, EventKind, GapCause, RateDoubt, Registers};
use std::path::PathBuf;
use vn100_proto::{DeviceError, MeasurementKind, Reply};

/// An action that the session requests.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Look for ports; the reply is [`Input::Ports`].
    Look,
    /// Open the port; the reply is [`Input::Opened`] or [`Input::OpenFailed`].
    Open(PathBuf, u32),
    /// Change the open port's baud rate; a partly received frame is void.
    SetBaud(u32),
    /// Write these bytes.
    Send(Vec<u8>),
    /// Close the port.
    Close,
    /// The session has ended and the port is closed.
    Ended,
    /// Change the recording.
    Record(RecorderAction),
}

/// A change to the recording of the sensor's output.
#[derive(Debug, Clone, PartialEq)]
pub enum RecorderAction {
    /// Frames of this kind are samples from now on, at this rate; `None` is any binary frame or message.
    Accept(MeasurementKind, f64),
    /// The sensor's registers state this rate, in Hz: samples of a doubtful rate belong to it.
    RateKnown(f64),
    /// Whether the messages that are accepted next carry a serial count that increases by one per message.
    Counted(bool),
    /// Record no samples until the next `Accept`; samples missing until then have this cause.
    Interrupt(GapCause),
    /// Look for frames of any kind: frames of the expected kind do not arrive.
    AcceptAny,
    /// Record this event.
    Event(EventKind, String),
    /// The sensor's description, to be stored with the capture.
    Describe(Box<ConnectedSensor>),
}

impl From<RecorderAction> for Action {
    fn from(action: RecorderAction) -> Self {
        Self::Record(action)
    }
}

/// An event for the session.
#[derive(Debug)]
pub enum Input<'a> {
    /// Time has passed.
    Tick,
    /// The ports that were found, best first.
    Ports(Vec<Port>),
    /// The port is open.
    Opened {
        /// The state of its latency timer.
        latency: Latency,
    },
    /// The port could not be opened.
    OpenFailed(OpenError),
    /// The port is gone.
    Disconnected(String),
    /// This many bytes arrived.
    Bytes(usize),
    /// This many bytes belong to no frame.
    Rejected(usize),
    /// Samples without time do not arrive at the known rate.
    RateDoubted(RateDoubt),
    /// The host did not run for a while: silence during that time has no meaning.
    HostStalled,
    /// The sensor answered a command.
    Reply(&'a Reply<'a>),
    /// The sensor reported an error, unprompted or in reply to a command.
    DeviceError(DeviceError),
    /// The capture belongs to the sensor with this serial number; `None`: any.
    Expect(Option<String>),
    /// The sensor spoke at this baud rate in an earlier run of the daemon.
    GoodBaud(u32),
    /// The contents of the output registers before an earlier run of the daemon changed them, to be restored at the
    /// end.
    Previous(Registers),
    /// Stop: restore the sensor's output and close the port.
    Stop,
}
