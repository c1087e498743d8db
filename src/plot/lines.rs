//! Lines: the narrow peaks that an analysis found, by name, for the spectra that contain them.

use super::number::rounded;
use imu_core::sample::Channel;
use imu_noise::robust::Line;

/// Lines that differ by less than this part of their frequency are one: channels of one sensor are subject to the same
/// machine.
const SAME: f64 = 5e-3;

/// A line of a channel.
pub type NamedLine<'a> = (Channel, &'a Line);

/// Returns the lines of these channels by frequency, with those of several channels combined: frequency in Hz, the
/// largest amplitude, and a description.
pub(super) fn joined(lines: &[NamedLine<'_>], channels: &[Channel], unit: &str) -> Vec<(f64, f64, String)> {
    let mut own: Vec<&NamedLine<'_>> = lines.iter().filter(|(channel, _)| channels.contains(channel)).collect();
    own.sort_by(|(_, a), (_, b)| a.frequency_hz.total_cmp(&b.frequency_hz));
    own.chunk_by(|(_, a), (_, b)| b.frequency_hz - a.frequency_hz < SAME * b.frequency_hz)
        .map(|together| {
            let lines = together.iter().map(|(_, line)| *line);
            let strongest = lines.max_by(|a, b| a.amplitude.total_cmp(&b.amplitude)).unwrap_or(together[0].1);
            let names: Vec<&str> = together.iter().map(|(channel, _)| channel.name()).collect();
            let mut description = format!(
                "{}{} Hz on {}: amplitude {} {unit}",
                if strongest.broad { "vibration around " } else { "" },
                rounded(strongest.frequency_hz, 4),
                names.join(", "),
                rounded(strongest.amplitude, 2)
            );
            if let Some(mains) = strongest.may_be_mains_hz.first() {
                description += &format!(", perhaps {} Hz from the mains", rounded(*mains, 3));
            }
            (strongest.frequency_hz, strongest.amplitude, description)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_two_channels_is_one() {
        let line = |frequency_hz: f64, amplitude: f64| Line {
            frequency_hz,
            band_hz: [frequency_hz; 2],
            amplitude,
            ratio: 9.0,
            persistent: true,
            broad: false,
            may_be_mains_hz: vec![50.0],
        };
        let lines = [line(10.0, 1e-3), line(10.001, 3e-3), line(12.0, 1e-3), line(3.0, 1.0)];
        let channels = [Channel::GyroX, Channel::GyroY, Channel::GyroY, Channel::AccelX];
        let found: Vec<NamedLine<'_>> = channels.into_iter().zip(&lines).collect();
        let combined = joined(&found, &[Channel::GyroX, Channel::GyroY], "rad/s");
        assert_eq!(combined.len(), 2);
        assert_eq!(
            (combined[0].0, combined[0].2.as_str()),
            (10.001, "10 Hz on gyro_x, gyro_y: amplitude 0.003 rad/s, perhaps 50 Hz from the mains")
        );
    }
}
