//! Axes: straight or logarithmic, with round values, and the unit of an axis of time.

use super::number::plain;

/// The approximate number of lines across a straight axis.
const LINES: f64 = 5.0;
/// Room beyond the values, in parts of their range; of a logarithmic axis in decades.
const ROOM: f64 = 0.04;
const ROOM_DECADES: f64 = 0.06;
/// The minimum number of decades on a logarithmic axis.
const DECADES_MIN: f64 = 0.35;
/// Decades from which on only powers of ten have a line.
const DECADES_MANY: f64 = 2.5;
/// Decades up to which values between powers of ten have lines too.
const DECADES_FEW: f64 = 0.8;
/// The maximum number of labels on a logarithmic axis.
const LABELS: usize = 8;

/// An axis: values from one end to the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    log: bool,
    /// Whether its values have no meaning.
    bare: bool,
    /// Values, or their common logarithms.
    from: f64,
    to: f64,
}

impl Axis {
    /// Returns a straight axis with room for all values; `None` if there is none.
    pub(super) fn straight(values: impl Iterator<Item = f64>) -> Option<Self> {
        let (low, high) = ends(values)?;
        // A flat curve gets some room around it.
        let room = (ROOM * (high - low)).max(1e-3 * high.abs()).max(f64::MIN_POSITIVE);
        Some(Self { log: false, bare: false, from: low - room, to: high + room })
    }

    /// Returns a straight axis between exactly these values.
    pub(super) fn between(from: f64, to: f64) -> Self {
        Self { log: false, bare: false, from, to: if to > from { to } else { from + 1.0 } }
    }

    /// Returns a logarithmic axis for the values above 0; `None` if there is none.
    pub(super) fn logarithmic(values: impl Iterator<Item = f64>) -> Option<Self> {
        let (low, high) = ends(values.filter(|value| *value > 0.0).map(f64::log10))?;
        let room = (DECADES_MIN - (high - low)).max(ROOM_DECADES);
        Some(Self { log: true, bare: false, from: low - room, to: high + room })
    }

    /// Returns an axis without values, lines and labels: everything extends from one end to the other.
    pub(super) fn bare() -> Self {
        Self { log: false, bare: true, from: 0.0, to: 1.0 }
    }

    /// Returns the position of a value, 0 to 1; a value beyond an end is placed at that end.
    pub(super) fn share(&self, value: f64) -> f64 {
        let at = if self.log { value.max(f64::MIN_POSITIVE).log10() } else { value };
        ((at - self.from) / (self.to - self.from)).clamp(0.0, 1.0)
    }

    /// Returns the values with a line, and their labels.
    pub(super) fn ticks(&self) -> Vec<(f64, String)> {
        if self.bare {
            return Vec::new();
        }
        if !self.log {
            let rough = (self.to - self.from) / LINES;
            let decade = 10f64.powf(rough.log10().floor());
            let steps = [1.0, 2.0, 5.0, 10.0].into_iter().map(|of| of * decade);
            let step = steps.into_iter().find(|step| *step >= rough).unwrap_or(rough);
            // A sum of steps is rounded differently from a multiple.
            let whole = (self.from / step).ceil() as i64..=(self.to / step).floor() as i64;
            return whole.map(|of| of as f64 * step).map(|value| (value, plain(value))).collect();
        }
        let decades = (self.from.floor() as i32)..=(self.to.ceil() as i32);
        let steps: &[f64] = match self.to - self.from {
            wide if wide > DECADES_MANY => &[1.0],
            wide if wide > DECADES_FEW => &[1.0, 2.0, 5.0],
            _ => &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0],
        };
        let all = decades.flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)));
        let inside: Vec<f64> = all.filter(|value| (self.from..=self.to).contains(&value.log10())).collect();
        let every = inside.len().div_ceil(LABELS).max(1);
        inside.into_iter().step_by(every).map(|value| (value, plain(value))).collect()
    }
}

/// Returns the factor from seconds to the unit shown, and its name, by the length of the interval.
pub(super) fn time_unit(longest_s: f64) -> (f64, &'static str) {
    match longest_s {
        long if long > 3.0 * 3600.0 => (3600.0, "h"),
        long if long > 300.0 => (60.0, "min"),
        _ => (1.0, "s"),
    }
}

/// Returns the least and the greatest finite value.
fn ends(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let finite = values.filter(|value| value.is_finite());
    finite.fold(None, |ends, value| {
        let (low, high) = ends.unwrap_or((value, value));
        Some((low.min(value), high.max(value)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_axes_have_round_values_and_room() {
        let axis = Axis::straight([-2.0, f64::NAN, 2.0].into_iter()).unwrap();
        let values: Vec<f64> = axis.ticks().into_iter().map(|(value, _)| value).collect();
        assert_eq!(values, [-2.0, -1.0, 0.0, 1.0, 2.0]);
        assert!(axis.share(-2.0) > 0.0 && axis.share(2.0) < 1.0 && axis.share(9.0) == 1.0);
        let flat = Axis::straight([3.0].into_iter()).unwrap();
        assert!((flat.share(3.0) - 0.5).abs() < 1e-9 && !flat.ticks().is_empty());
        assert_eq!(Axis::straight([f64::INFINITY].into_iter()), None);
        assert!(Axis::between(2.0, 2.0).share(2.0) == 0.0);
        assert!(Axis::bare().ticks().is_empty());
    }

    #[test]
    fn logarithmic_axes_have_powers_of_ten_and_more_where_these_are_few() {
        let wide = Axis::logarithmic([1e-3, 0.0, 1e2].into_iter()).unwrap();
        let labels: Vec<String> = wide.ticks().into_iter().map(|(_, label)| label).collect();
        assert_eq!(labels, ["0.001", "0.01", "0.1", "1", "10", "100"]);
        let narrow = Axis::logarithmic([2e-3, 3e-3].into_iter()).unwrap();
        assert!(narrow.ticks().len() >= 2 && narrow.share(2e-3) > 0.0);
        assert!(Axis::logarithmic([1e-30, 1e30].into_iter()).unwrap().ticks().len() <= LABELS);
        assert_eq!(Axis::logarithmic([0.0, -1.0].into_iter()), None);
    }
}
