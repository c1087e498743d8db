//! Gallery: the pictures of a capture, by name, each made from the store on request.
//!
//! In: a picture's name, a reader of the store, and the required analyses. Out: SVG ([`crate::plot`]) or PNG.
//! Memory is that of one chunk of samples and of the drawn points, however long the capture is.

pub mod apart;
mod facts;
mod samples;

pub use facts::{facts, pictures};

use crate::jobs::{Documents, JobError, JobKind};
use crate::plot::{self, NamedLine, raster};
use crate::store::{Moment, Reader, StoreError};
use imu_core::sample::{Channel, Triad};
use imu_noise::NoiseReport;

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
    /// `allan-<channel>`: Allan deviation of one channel, with the lines of N, B and K.
    AllanOfOne(Channel),
    /// `hourly-<channel>`: Allan deviation hour by hour.
    Hourly(Channel),
    /// `psd-<triad>`: power spectra with the detected lines.
    Psd(Triad),
    /// `gaps`: the times of missing samples.
    Gaps,
}

impl Picture {
    /// Returns all pictures of a capture with these channels.
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

    /// Returns the picture with that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::all(&Channel::ALL).into_iter().find(|picture| picture.name() == name)
    }

    /// Returns the name.
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

    /// Returns the channels that it requires.
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

    /// Returns the analyses that it requires. Noise parameters may be absent.
    pub fn needs(self) -> &'static [JobKind] {
        match self {
            Self::Timeseries(_) | Self::Gaps => &[],
            Self::Histogram(_) => &[JobKind::Statistics],
            Self::Allan(_) | Self::AllanOfOne(_) => &[JobKind::Allan, JobKind::Noise],
            // A spectrum can also be drawn without the names of lines.
            Self::Hourly(_) | Self::Psd(_) => &[JobKind::Noise],
        }
    }

    /// Returns the height in units in which its width is 560.
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

    /// Returns a description of the picture for users who cannot see it.
    pub fn description(self) -> String {
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

/// The part of a capture for a time series: all of it if both ends are `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Window {
    /// From this time on.
    pub from: Option<Moment>,
    /// Before this time.
    pub to: Option<Moment>,
}

/// The file format of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// SVG, with its style.
    Svg,
    /// PNG.
    Png,
}

impl Form {
    /// Returns the form of files whose name ends with this.
    pub fn from_suffix(suffix: &str) -> Option<Self> {
        match suffix {
            "svg" => Some(Self::Svg),
            "png" => Some(Self::Png),
            _ => None,
        }
    }
    /// Returns the media type.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Svg => "image/svg+xml",
            Self::Png => "image/png",
        }
    }
}

/// Returns the content of a picture's file; `None` if there is nothing to draw, or a required document is missing. A
/// PNG is made in a separate process if `is_apart`.
///
/// # Errors
/// The error that the database reports, or the reason why there is no PNG.
pub fn file(
    reader: &Reader,
    capture: &str,
    (picture, window): (Picture, Window),
    documents: &Documents,
    form: Form,
    is_apart: bool,
) -> Result<Option<Vec<u8>>, JobError> {
    written(svg(reader, capture, picture, window, documents)?, form, is_apart)
}

/// Returns the content of the file of a picture with the Allan deviation of one channel in two captures, each with its
/// name and documents; `None` if there is nothing to draw. A PNG is made in a separate process if `is_apart`.
///
/// # Errors
/// The reason why there is no PNG.
pub fn beside(
    channel: Channel,
    captures: [(&str, &Documents); 2],
    form: Form,
    is_apart: bool,
) -> Result<Option<Vec<u8>>, JobError> {
    let [Some(a), Some(b)] = captures.map(|(name, of)| Some((name, of.allan.as_ref()?))) else { return Ok(None) };
    written(plot::deviation_beside(channel, [a, b]), form, is_apart)
}

fn written(svg: String, form: Form, is_apart: bool) -> Result<Option<Vec<u8>>, JobError> {
    Ok(match form {
        _ if svg.is_empty() => None,
        Form::Svg => Some(plot::alone(&svg).into_bytes()),
        Form::Png if is_apart => Some(apart::png(&svg).map_err(JobError::Died)?),
        Form::Png => {
            let refused = |error: raster::RasterError| JobError::InsufficientData(error.to_string());
            Some(raster::png(&svg, raster::SCALE).map_err(refused)?)
        }
    })
}

/// Returns the picture as SVG; empty if there is nothing to draw, or a required document is missing.
///
/// # Errors
/// The error that the database reports.
pub fn svg(
    reader: &Reader,
    capture: &str,
    picture: Picture,
    window: Window,
    documents: &Documents,
) -> Result<String, StoreError> {
    let Documents { statistics, allan, noise } = documents;
    let deviation = |of: &str| {
        let title = format!("Allan deviation, {of}");
        Some(plot::deviation(&title, &picture.channels(), allan.as_ref()?, noise.as_ref()))
    };
    let drawn = match picture {
        Picture::Timeseries(channel) => Some(samples::course(reader, capture, channel, window)?),
        Picture::Gaps => Some(samples::gaps(reader, capture)?),
        Picture::Psd(triad) => Some(samples::density(reader, capture, triad, &lines(noise.as_ref()))?),
        Picture::Histogram(channel) => statistics
            .as_ref()
            .and_then(|report| report.channels.get(&channel))
            .map(|of| plot::histogram(channel.name(), of)),
        Picture::Hourly(channel) => noise
            .as_ref()
            .and_then(|report| report.disturbances.get(&channel)?.dynamic.as_ref())
            .map(|of| plot::hourly(channel.name(), channel.unit(), of)),
        Picture::Allan(triad) => deviation(triad.name()),
        Picture::AllanOfOne(channel) => deviation(channel.name()),
    };
    Ok(drawn.unwrap_or_default())
}

/// Returns the lines of all channels.
fn lines(noise: Option<&NoiseReport>) -> Vec<NamedLine<'_>> {
    let disturbances = noise.into_iter().flat_map(|report| &report.disturbances);
    disturbances.flat_map(|(channel, found)| found.lines.iter().map(|line| (*channel, line))).collect()
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
