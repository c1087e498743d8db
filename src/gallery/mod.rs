//! Gallery: the pictures of a capture, by name, each made from the store on request.
//!
//! In: a picture's name, a reader of the store, and the documents of the required analyses. Out: SVG ([`crate::plot`]).
//! Memory is that of one chunk of samples and of the drawn points, however long the capture is.

pub mod apart;
mod facts;
mod samples;

pub use facts::{Facts, causes};

use crate::plot::{self, Deviations};
use crate::store::{Moment, Reader, StoreError};
use imu_core::sample::{Channel, Triad};
use serde_json::Value;

/// Triads that have pictures.
const TRIADS: [Triad; 3] = [Triad::Gyro, Triad::Accel, Triad::Mag];

/// One picture of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Picture {
    /// `timeseries-<channel>`: samples over time.
    Timeseries(Channel),
    /// `histogram-<channel>`: the frequency of values.
    Histogram(Channel),
    /// `allan-<triad>`: Allan deviation.
    Allan(Triad),
    /// `allan-<channel>`: the same of one channel, with the lines of N, B and K.
    AllanOfOne(Channel),
    /// `hourly-<channel>`: Allan deviation hour by hour.
    Hourly(Channel),
    /// `psd-<triad>`: power spectra with the detected lines.
    Psd(Triad),
    /// `gaps`: the times of missing samples.
    Gaps,
}

impl Picture {
    /// All pictures of a capture with these channels.
    pub fn all(channels: &[Channel]) -> Vec<Self> {
        let there = |triad: &Triad| triad.channels().iter().any(|channel| channels.contains(channel));
        let triads: Vec<Triad> = TRIADS.into_iter().filter(there).collect();
        let analysed = |channel: &&Channel| Channel::ANALYSED.contains(channel);
        let mut all = vec![Self::Gaps];
        all.extend(triads.iter().map(|triad| Self::Allan(*triad)));
        all.extend(triads.iter().map(|triad| Self::Psd(*triad)));
        all.extend(channels.iter().filter(analysed).map(|channel| Self::AllanOfOne(*channel)));
        all.extend(channels.iter().filter(analysed).map(|channel| Self::Hourly(*channel)));
        all.extend(channels.iter().map(|channel| Self::Timeseries(*channel)));
        all.extend(channels.iter().map(|channel| Self::Histogram(*channel)));
        all
    }

    /// The picture with that name.
    pub fn from_name(name: &str) -> Option<Self> {
        let triad = |of: &str| TRIADS.into_iter().find(|triad| triad.name() == of);
        let analysed = |of: &str| Channel::from_name(of).filter(|channel| Channel::ANALYSED.contains(channel));
        match name.split_once('-') {
            None => (name == "gaps").then_some(Self::Gaps),
            Some(("timeseries", of)) => Channel::from_name(of).map(Self::Timeseries),
            Some(("histogram", of)) => Channel::from_name(of).map(Self::Histogram),
            Some(("allan", of)) => triad(of).map(Self::Allan).or_else(|| analysed(of).map(Self::AllanOfOne)),
            Some(("hourly", of)) => analysed(of).map(Self::Hourly),
            Some(("psd", of)) => triad(of).map(Self::Psd),
            Some(_) => None,
        }
    }

    /// Its name.
    pub fn name(self) -> String {
        match self {
            Self::Timeseries(channel) => format!("timeseries-{}", channel.name()),
            Self::Histogram(channel) => format!("histogram-{}", channel.name()),
            Self::Allan(triad) => format!("allan-{}", triad.name()),
            Self::AllanOfOne(channel) => format!("allan-{}", channel.name()),
            Self::Hourly(channel) => format!("hourly-{}", channel.name()),
            Self::Psd(triad) => format!("psd-{}", triad.name()),
            Self::Gaps => "gaps".to_owned(),
        }
    }

    /// The channels that it requires.
    pub fn channels(self) -> Vec<Channel> {
        match self {
            Self::Timeseries(channel)
            | Self::Histogram(channel)
            | Self::AllanOfOne(channel)
            | Self::Hourly(channel) => vec![channel],
            Self::Allan(triad) | Self::Psd(triad) => triad.channels().to_vec(),
            Self::Gaps => Vec::new(),
        }
    }

    /// The analyses that it requires.
    pub fn needs(self) -> Needs {
        match self {
            Self::Timeseries(_) | Self::Gaps => Needs::default(),
            Self::Histogram(_) => Needs { statistics: true, ..Needs::default() },
            Self::Allan(_) | Self::AllanOfOne(_) => Needs { allan: true, noise: true, ..Needs::default() },
            // A spectrum can also be drawn without the names of lines.
            Self::Hourly(_) | Self::Psd(_) => Needs { noise: true, ..Needs::default() },
        }
    }

    /// Its height in units in which its width is 560.
    pub fn height(self) -> u32 {
        match self {
            Self::Gaps => 130,
            Self::Timeseries(_) => 280,
            Self::Histogram(_) => 300,
            Self::Hourly(_) => 320,
            Self::Psd(_) => 340,
            Self::Allan(_) | Self::AllanOfOne(_) => 360,
        }
    }

    /// A description of the picture for users who cannot see it.
    pub fn told(self) -> String {
        match self {
            Self::Timeseries(channel) => format!("{} over time", channel.name()),
            Self::Histogram(channel) => format!("Histogram of {}", channel.name()),
            Self::Allan(triad) => format!("Allan deviation of the {} triad over averaging time", triad.name()),
            Self::AllanOfOne(channel) => {
                format!("Allan deviation of {} with its 68 % band and the lines of N, B and K", channel.name())
            }
            Self::Hourly(channel) => format!("Allan deviation of {} hour by hour", channel.name()),
            Self::Psd(triad) => format!("Power spectrum of the {} triad", triad.name()),
            Self::Gaps => "Where samples are missing".to_owned(),
        }
    }

    /// Names that a message can list: `timeseries-<channel>, …`.
    pub fn forms() -> &'static str {
        "timeseries-<channel>, histogram-<channel>, allan-<triad>, allan-<channel>, hourly-<channel>, psd-<triad> and gaps, with the \
         triads gyro, accel and mag"
    }
}

/// The analyses that a picture requires.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Needs {
    /// `vn100d-statistics-1`.
    pub statistics: bool,
    /// `vn100d-allan-1`.
    pub allan: bool,
    /// `vn100d-noise-1`, if there is one.
    pub noise: bool,
}

/// Documents of a capture's analyses, as JSON; `None` if there is none.
#[derive(Debug, Clone, Default)]
pub struct Documents {
    /// `vn100d-statistics-1`.
    pub statistics: Option<String>,
    /// `vn100d-allan-1`.
    pub allan: Option<String>,
    /// `vn100d-noise-1`.
    pub noise: Option<String>,
}

/// The part of a capture for a time series: all of it if both ends are `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Window {
    /// From this time on.
    pub from: Option<Moment>,
    /// Before this time.
    pub to: Option<Moment>,
}

/// The reasons why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum GalleryError {
    /// The error that the database reports.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// An invalid document.
    #[error("an analysis cannot be read: {0}")]
    Document(#[from] serde_json::Error),
}

/// The picture as SVG; empty if there is nothing to draw, or a required document is missing.
///
/// # Errors
/// [`GalleryError`]: the error that the database reports, or an invalid document.
pub fn svg(
    reader: &Reader,
    capture: &str,
    picture: Picture,
    window: Window,
    documents: &Documents,
) -> Result<String, GalleryError> {
    let noise = documents.noise.as_deref();
    Ok(match picture {
        Picture::Timeseries(channel) => samples::course(reader, capture, channel, window)?,
        Picture::Gaps => samples::gaps(reader, capture)?,
        Picture::Psd(triad) => samples::density(reader, capture, triad, &plot::lines(noise)?)?,
        Picture::Histogram(channel) => match &documents.statistics {
            Some(statistics) => histogram(channel, statistics)?,
            None => String::new(),
        },
        Picture::Hourly(channel) => match noise {
            Some(noise) => plot::hourly(channel.name(), channel.unit(), noise)?,
            None => String::new(),
        },
        Picture::Allan(_) | Picture::AllanOfOne(_) => match &documents.allan {
            Some(allan) => deviation(picture, allan, noise)?,
            None => String::new(),
        },
    })
}

/// The picture from `vn100d-allan-1` and, if it exists, `vn100d-noise-1`; empty if the document lacks the channels.
fn deviation(picture: Picture, allan: &str, noise: Option<&str>) -> Result<String, serde_json::Error> {
    let of = Deviations::read(allan, noise)?;
    let channels = picture.channels();
    let names: Vec<&str> = channels.iter().map(|channel| channel.name()).collect();
    let title = match picture {
        Picture::Allan(triad) => format!("Allan deviation, {}", triad.name()),
        _ => format!("Allan deviation, {}", names.join(", ")),
    };
    Ok(of.svg(&title, &names))
}

/// The picture of a channel in `vn100d-statistics-1`; empty if the document lacks it.
fn histogram(channel: Channel, statistics: &str) -> Result<String, serde_json::Error> {
    let document: Value = serde_json::from_str(statistics)?;
    match document["channels"].get(channel.name()) {
        Some(of) => plot::histogram(channel.name(), &of.to_string()),
        None => Ok(String::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_picture_is_found_by_its_name() {
        let all = Picture::all(&Channel::ALL);
        assert!(all.len() > 30);
        for picture in all {
            assert_eq!(Picture::from_name(&picture.name()), Some(picture));
        }
        for wrong in ["", "gaps-x", "psd-attitude", "allan-yaw", "timeseries-", "histogram-gyro", "hourly-gyro", "psd"]
        {
            assert_eq!(Picture::from_name(wrong), None, "{wrong}");
        }
        assert_eq!(Picture::all(&[Channel::GyroX]).len(), 7);
    }
}
