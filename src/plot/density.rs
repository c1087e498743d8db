//! Power spectra of a triad's channels, and the lines detected in them.

use super::axis::Axis;
use super::deviation::class;
use super::drawing::{Drawing, Frame};
use super::lines::{NamedLine, joined};
use super::number::rounded;
use imu_core::sample::Channel;

/// The number of lines labelled with their frequency: the strongest.
const LABELS: usize = 10;

/// Amplitude densities of channels of one unit over the same frequencies.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Density<'a> {
    /// "Power spectrum, gyro".
    pub title: &'a str,
    /// The channels' unit.
    pub unit: &'a str,
    /// Hz, ascending, above 0.
    pub frequency_hz: Vec<f64>,
    /// For each channel the root of its two-sided power density, U/√Hz: white noise has the value of its
    /// N.
    pub channels: Vec<(Channel, Vec<f64>)>,
    /// Detected lines; those of other channels are not drawn.
    pub lines: &'a [NamedLine<'a>],
}

impl Density<'_> {
    /// Returns the picture; empty if nothing is above 0.
    pub fn svg(&self) -> String {
        let across = Axis::logarithmic(self.frequency_hz.iter().copied());
        let up = Axis::logarithmic(self.channels.iter().flat_map(|(_, values)| values).copied());
        let (Some(across), Some(up)) = (across, up) else { return String::new() };
        let y = format!("density in {}/√Hz", self.unit);
        let frame = Frame { title: self.title, x: "frequency in Hz", y: &y, height: 340.0 };
        let channels: Vec<Channel> = self.channels.iter().map(|(channel, _)| *channel).collect();
        let class = |channel: &Channel| class(channel.name(), channels.len());
        let key: Vec<(&str, &str)> = channels.iter().map(|channel| (class(channel), channel.name())).collect();
        let mut drawing = Drawing::keyed(frame, &key, across, up);
        let mut lines = joined(self.lines, &channels, self.unit);
        lines.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (place, (frequency_hz, _, what)) in lines.iter().enumerate() {
            drawing.stretch("mark", [*frequency_hz; 2], Some(what));
            if place < LABELS {
                drawing.beside(*frequency_hz, &format!("{} Hz", rounded(*frequency_hz, 3)));
            }
        }
        for (channel, values) in &self.channels {
            drawing.curve(class(channel), self.frequency_hz.iter().copied().zip(values.iter().copied()));
        }
        drawing.done()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_noise::robust::Line;

    #[test]
    fn each_channel_has_a_curve_and_each_line_a_mark() {
        let channels = vec![(Channel::GyroX, vec![1e-3, 1e-4]), (Channel::GyroY, vec![0.0, 2e-4])];
        let line = Line {
            frequency_hz: 11.4,
            band_hz: [11.3, 11.5],
            amplitude: 1e-3,
            ratio: 9.0,
            persistent: true,
            broad: false,
            may_be_mains_hz: Vec::new(),
        };
        let (title, lines) = ("Power spectrum, gyro", [(Channel::GyroX, &line), (Channel::AccelX, &line)]);
        let of = Density { title, unit: "rad/s", frequency_hz: vec![0.1, 20.0], channels, lines: &lines };
        let svg = of.svg();
        assert_eq!((svg.matches("class=\"line x").count(), svg.matches("class=\"mark\"").count()), (2, 1), "{svg}");
        assert!(
            svg.contains("density in rad/s/√Hz")
                && svg.contains("<title>11.4 Hz on gyro_x: amplitude 0.001 rad/s</title>")
                && svg.contains(">11.4 Hz</text>")
                && !svg.contains("NaN")
        );
        assert_eq!(Density::default().svg(), "");
    }
}
