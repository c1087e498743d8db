//! Timelines: level and spread of one channel over time, recorded and simulated.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::number::plain;
use imu_diagnosis::{ChannelTimeline, Stretches};

/// Returns the picture of a channel's level; empty if there is nothing to draw.
pub fn level(of: &ChannelTimeline) -> String {
    let y = format!("mean of {} s, {}", plain(of.stretch_s), of.unit);
    drawn(of, &format!("Level of {} over time", of.channel), &y, |of| &of.level)
}

/// Returns the picture of its spread; empty if there is nothing to draw.
pub fn spread(of: &ChannelTimeline) -> String {
    let y = format!("deviation in {} s, {}", plain(of.stretch_s), of.unit);
    drawn(of, &format!("Spread of {} over time", of.channel), &y, |of| &of.spread)
}

fn drawn(of: &ChannelTimeline, title: &str, y: &str, values: impl Fn(&Stretches) -> &[Option<f64>]) -> String {
    let curves = [("real", Some(&of.real)), ("before", of.before.as_ref()), ("after", of.after.as_ref())];
    let known = |stretches| values(stretches).iter().map(|value| value.unwrap_or(f64::NAN)).collect();
    let curves: Vec<(&str, Vec<f64>)> =
        curves.into_iter().filter_map(|(class, stretches)| Some((class, known(stretches?)))).collect();
    let across = Axis::straight(of.time_s.iter().copied());
    let up = Axis::straight(curves.iter().flat_map(|(_, values)| values.iter().copied()));
    let (Some(across), Some(up)) = (across.filter(|_| !of.time_s.is_empty()), up) else { return String::new() };
    let mut drawing = Drawing::new(Frame { title, x: "time in s", y, height: 260.0 }, across, up);
    for (class, values) in curves {
        drawing.curve(class, of.time_s.iter().copied().zip(values));
    }
    drawing.done()
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
        let of: ChannelTimeline = serde_json::from_value(document.clone()).unwrap();
        let svg = level(&of) + &spread(&of);
        assert_eq!((svg.matches("<svg").count(), svg.matches("<path class=\"line").count()), (2, 6));
        assert!(svg.contains("mean of 1 s, rad/s") && !svg.contains("<x>") && !svg.contains("NaN"), "{svg}");
        document["time_s"] = json!([]);
        assert_eq!(level(&serde_json::from_value(document).unwrap()), "");
    }
}
