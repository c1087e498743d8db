//! The reasons why a tumble calibrates nothing.

/// A record that cannot be calibrated by gravity.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TumbleError {
    /// There is no accelerometer.
    #[error("the recording has no accelerometer of three axes; gravity is what a tumble is compared with")]
    NoAccelerometer,
    /// A channel shows one value.
    #[error("{channel} shows the same value throughout: an axis is dead, and nothing can be calibrated")]
    Dead {
        /// The channel.
        channel: String,
    },
    /// The sensor did not rest in enough poses.
    #[error(
        "rests found: {rests}, poses in them: {poses} (8° apart, {shortest_s} s or longer each); at least {least} poses are \
         needed: rest with each face up, then on edges and corners"
    )]
    Poses {
        /// The rests that were found.
        rests: usize,
        /// The poses in them.
        poses: usize,
        /// The poses that are needed.
        least: usize,
        /// The shortest rest, s.
        shortest_s: f64,
    },
    /// The means at rest do not lie on an ellipsoid.
    #[error(
        "the specific forces at rest do not have one length after any calibration (they scatter by {rms_m_s2:.2} m/s², at most \
         {most_m_s2} m/s² is a calibration's): is a channel wrapped, clipped or exchanged for another?"
    )]
    Scatter {
        /// The scatter, m/s².
        rms_m_s2: f64,
        /// The scatter that is allowed, m/s².
        most_m_s2: f64,
    },
}
