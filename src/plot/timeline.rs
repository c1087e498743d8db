//! Timelines: level and spread of one channel over time, recorded and simulated.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::json::numbers;
use super::number::plain;
use serde::Deserialize;

/// The timeline of one channel, as [`imu_diagnosis::ChannelTimeline`] contains it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Timeline {
    channel: String,
    unit: String,
    #[serde(deserialize_with = "numbers")]
    time_s: Vec<f64>,
    #[serde(deserialize_with = "super::json::number")]
    stretch_s: f64,
    real: Stretches,
    before: Option<Stretches>,
    after: Option<Stretches>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
struct Stretches {
    #[serde(deserialize_with = "numbers")]
    level: Vec<f64>,
    #[serde(deserialize_with = "numbers")]
    spread: Vec<f64>,
}

impl Timeline {
    /// The channel.
    pub fn channel(&self) -> &str {
        &self.channel
    }

    /// The picture of its level; empty if there is nothing to draw.
    pub fn level(&self) -> String {
        let y = format!("mean of {} s, {}", plain(self.stretch_s), self.unit);
        self.drawn(&format!("Level of {} over time", self.channel), &y, |of| &of.level)
    }

    /// The picture of its spread; empty if there is nothing to draw.
    pub fn spread(&self) -> String {
        let y = format!("deviation in {} s, {}", plain(self.stretch_s), self.unit);
        self.drawn(&format!("Spread of {} over time", self.channel), &y, |of| &of.spread)
    }

    fn drawn(&self, title: &str, y: &str, of: impl Fn(&Stretches) -> &[f64]) -> String {
        let curves = [("real", Some(&self.real)), ("before", self.before.as_ref()), ("after", self.after.as_ref())];
        let curves: Vec<(&str, &[f64])> =
            curves.into_iter().filter_map(|(class, stretches)| Some((class, of(stretches?)))).collect();
        let across = Axis::straight(self.time_s.iter().copied());
        let up = Axis::straight(curves.iter().flat_map(|(_, values)| values.iter().copied()));
        let (Some(across), Some(up)) = (across.filter(|_| !self.time_s.is_empty()), up) else { return String::new() };
        let mut drawing = Drawing::new(Frame { title, x: "time in s", y, height: 260.0 }, across, up);
        for (class, values) in curves {
            drawing.curve(class, self.time_s.iter().copied().zip(values.iter().copied()));
        }
        drawing.done()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn recorded_and_simulated_lie_over_each_other_and_what_is_missing_is_left_out() {
        let stretches = |level: f64| json!({"level": [0.0, level, null], "spread": [1.0, 1.1, null]});
        let mut document = json!({"channel": "<x>", "unit": "rad/s", "time_s": [1, 2, 3], "stretch_s": 1,
            "real": stretches(0.1), "before": stretches(0.0), "after": stretches(0.1)});
        let of: Timeline = serde_json::from_value(document.clone()).unwrap();
        let svg = of.level() + &of.spread();
        assert_eq!((svg.matches("<svg").count(), svg.matches("<path class=\"line").count()), (2, 6));
        assert!(svg.contains("mean of 1 s, rad/s") && !svg.contains("<x>") && !svg.contains("NaN"), "{svg}");
        document["time_s"] = json!([]);
        assert_eq!(serde_json::from_value::<Timeline>(document).unwrap().level(), "");
    }
}
