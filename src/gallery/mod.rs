//! Gallery: the pictures of a capture, by name, each made from the store when it is asked for.
//!
//! In: a picture's name, a reader of the store, and for those that an analysis is drawn of its document. Out: SVG ([`crate::plot`]).
//! Memory is that of one chunk of samples and of what is drawn, however long the capture is.

mod samples;

pub use samples::from_samples;

use crate::plot::{self, Deviations};
use crate::sample::{Channel, Triad};
use serde_json::Value;

/// Triads that have pictures of their own.
const TRIADS: [Triad; 3] = [Triad::Gyro, Triad::Accel, Triad::Mag];

/// One picture of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(clippy::exhaustive_enums, reason = "the contract's names")]
pub enum Picture {
    /// `timeseries-<channel>`: samples over time.
    Timeseries(Channel),
    /// `histogram-<channel>`: how often which value comes.
    Histogram(Channel),
    /// `allan-<triad>`: Allan deviation.
    Allan(Triad),
    /// `allan-<channel>`: the same of one channel, with the lines of N, B and K.
    AllanOfOne(Channel),
    /// `psd-<triad>`: power spectra.
    Psd(Triad),
    /// `gaps`: where samples are missing.
    Gaps,
}

impl Picture {
    /// All of a capture with these channels.
    #[must_use]
    pub fn all(channels: &[Channel]) -> Vec<Self> {
        let there = |triad: &Triad| triad.channels().iter().any(|channel| channels.contains(channel));
        let triads: Vec<Triad> = TRIADS.into_iter().filter(there).collect();
        let analysed = |channel: &&Channel| Channel::ANALYSED.contains(channel);
        let mut all = vec![Self::Gaps];
        all.extend(triads.iter().map(|triad| Self::Allan(*triad)));
        all.extend(triads.iter().map(|triad| Self::Psd(*triad)));
        all.extend(channels.iter().filter(analysed).map(|channel| Self::AllanOfOne(*channel)));
        all.extend(channels.iter().map(|channel| Self::Timeseries(*channel)));
        all.extend(channels.iter().map(|channel| Self::Histogram(*channel)));
        all
    }

    /// The picture of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let triad = |of: &str| TRIADS.into_iter().find(|triad| triad.name() == of);
        match name.split_once('-') {
            None => (name == "gaps").then_some(Self::Gaps),
            Some(("timeseries", of)) => Channel::from_name(of).map(Self::Timeseries),
            Some(("histogram", of)) => Channel::from_name(of).map(Self::Histogram),
            Some(("allan", of)) => {
                let one = || Channel::from_name(of).filter(|channel| Channel::ANALYSED.contains(channel));
                triad(of).map(Self::Allan).or_else(|| one().map(Self::AllanOfOne))
            }
            Some(("psd", of)) => triad(of).map(Self::Psd),
            Some(_) => None,
        }
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Timeseries(channel) => format!("timeseries-{}", channel.name()),
            Self::Histogram(channel) => format!("histogram-{}", channel.name()),
            Self::Allan(triad) => format!("allan-{}", triad.name()),
            Self::AllanOfOne(channel) => format!("allan-{}", channel.name()),
            Self::Psd(triad) => format!("psd-{}", triad.name()),
            Self::Gaps => "gaps".to_owned(),
        }
    }

    /// The channels that it needs.
    #[must_use]
    pub fn channels(self) -> Vec<Channel> {
        match self {
            Self::Timeseries(channel) | Self::Histogram(channel) | Self::AllanOfOne(channel) => vec![channel],
            Self::Allan(triad) | Self::Psd(triad) => triad.channels().to_vec(),
            Self::Gaps => Vec::new(),
        }
    }

    /// Names that a message can list: `timeseries-<channel>, …`.
    #[must_use]
    pub fn forms() -> &'static str {
        "timeseries-<channel>, histogram-<channel>, allan-<triad>, allan-<channel>, psd-<triad> and gaps, with the triads gyro, \
         accel and mag"
    }
}

/// A picture of `vn100d-allan-1` and, where it is there, `vn100d-noise-1`; empty where the document lacks the channels.
///
/// # Errors
/// What is none of these documents.
pub fn from_allan(picture: Picture, allan: &str, noise: Option<&str>) -> Result<String, serde_json::Error> {
    let of = Deviations::read(allan, noise)?;
    let channels = picture.channels();
    let names: Vec<&str> = channels.iter().map(|channel| channel.name()).collect();
    let title = match picture {
        Picture::Allan(triad) => format!("Allan deviation, {}", triad.name()),
        _ => format!("Allan deviation, {}", names.join(", ")),
    };
    Ok(of.svg(&title, &names))
}

/// A picture of a channel in `vn100d-statistics-1`; empty where the document lacks it.
///
/// # Errors
/// What is no such document.
pub fn from_statistics(channel: Channel, statistics: &str) -> Result<String, serde_json::Error> {
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
        for wrong in ["", "gaps-x", "psd-attitude", "allan-yaw", "timeseries-", "histogram-gyro", "psd"] {
            assert_eq!(Picture::from_name(wrong), None, "{wrong}");
        }
        assert_eq!(Picture::all(&[Channel::GyroX]).len(), 6);
    }
}
