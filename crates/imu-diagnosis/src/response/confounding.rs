//! Confounding: the parameters that this motion cannot separate, in plain sentences.

use super::candidate::Candidate;
use super::design::Slot;
use super::{AXES, Estimate, Record};
use imu_core::sample::Triad;
use imu_model::effects::EffectKind;
use imu_model::effects::triad::{Axes, Drive};
use imu_model::simulator::Motion;

/// Change of a rate below which an axis counts as not turned, rad/s: well above the Earth's rotation, 7.3e-5.
const STILL_RAD_S: f64 = 1e-3;
/// Change of a specific force, relative to the largest, below which it counts as constant.
const CONSTANT_SHARE: f64 = 0.01;

/// How much of the parameters the motion leaves open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Openness {
    /// The response does not depend on the parameters, or by less than the noise hides: they keep their known values.
    Unseen,
    /// The parameters have the same effect on this record: only their joint effect is known.
    Confounded,
    /// The parameters have nearly the same effect: their intervals hold and are wide.
    Faint,
}

/// A group of parameters that the motion leaves open.
#[derive(Debug, Clone, PartialEq)]
pub struct Confounding {
    /// How much is left open.
    pub openness: Openness,
    /// Whether the parameters include the reference's clock.
    pub of_clock: bool,
    /// One sentence: which parameters, which motion is missing, and which motion would separate them.
    pub sentence: String,
}

/// Returns the quantities that one triad cannot determine about a separate clock.
pub(super) fn latency_or_offset() -> Confounding {
    Confounding {
        openness: Openness::Confounded,
        of_clock: true,
        sentence: "one triad cannot tell apart latency seconds and clock offset_s: both make it late against the \
                   reference; the other triad's delay would tell"
            .to_owned(),
    }
}

/// A record's motion, in words.
#[derive(Debug)]
pub(super) struct Motions {
    triad: Triad,
    /// Largest less smallest value of each input, and whether that range counts as 0.
    turns: [bool; 3],
    force_changes: [bool; 3],
    force_felt: [bool; 3],
}

impl Motions {
    pub(super) fn of(record: &Record<'_>) -> Self {
        let ends = |of: &dyn Fn(&Motion) -> f64| {
            record.reference.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), motion| {
                (low.min(of(motion)), high.max(of(motion)))
            })
        };
        let force: [(f64, f64); 3] = std::array::from_fn(|axis| ends(&|motion| motion.accel_m_s2[axis]));
        let largest = force.iter().map(|(low, high)| low.abs().max(high.abs())).fold(0.0, f64::max);
        Self {
            triad: record.triad,
            turns: std::array::from_fn(|axis| {
                let (low, high) = ends(&|motion| motion.gyro_rad_s[axis]);
                high - low > STILL_RAD_S
            }),
            force_changes: force.map(|(low, high)| high - low > CONSTANT_SHARE * largest),
            force_felt: force.map(|(low, high)| low.abs().max(high.abs()) > CONSTANT_SHARE * largest),
        }
    }

    /// Returns the statement for one group of slots.
    pub(super) fn state(
        &self,
        openness: Openness,
        group: &[usize],
        slots: &[Slot],
        candidates: &[Candidate],
        estimates: &[Estimate],
    ) -> Confounding {
        let names = names(group, slots, candidates, estimates);
        let (lacks, wants) = self.lacks(group, slots, candidates);
        let what = match openness {
            Openness::Unseen => format!("this motion says nothing about {names}"),
            Openness::Confounded => format!("this motion cannot tell apart {names}"),
            Openness::Faint => format!("this motion hardly tells apart {names}"),
        };
        let why = if lacks.is_empty() {
            let together = "what drives them never changes alone".to_owned();
            if openness == Openness::Unseen { "what drives them is too small".to_owned() } else { together }
        } else {
            lacks.join("; ")
        };
        let would = if wants.is_empty() { String::new() } else { format!("; {} would tell", wants.join(" and ")) };
        let of_clock = group.iter().any(|place| estimates[*place].effect.is_none());
        Confounding { openness, of_clock, sentence: format!("{what}: {why}{would}") }
    }

    /// Returns the motion that these columns depend on and the record lacks, and the motion that would provide it.
    fn lacks(&self, group: &[usize], slots: &[Slot], candidates: &[Candidate]) -> (Vec<String>, Vec<String>) {
        let (mut lacks, mut wants) = (Vec::new(), Vec::new());
        let (mut still, mut constant) = ([false; 3], [false; 3]);
        for place in group {
            match slots[*place] {
                Slot::Coefficient(candidate, coefficient) => {
                    let (input, force) = depends(candidates[candidate], coefficient);
                    for axis in 0..3 {
                        let gyro = self.triad == Triad::Gyro;
                        still[axis] |= gyro && input[axis] && !self.turns[axis];
                        let felt = if gyro { force[axis] } else { input[axis] || force[axis] };
                        constant[axis] |= felt && !self.force_changes[axis];
                    }
                }
                Slot::Delay | Slot::RateError | Slot::Cutoff(_) => {
                    let moves = if self.triad == Triad::Gyro { self.turns } else { self.force_changes };
                    if moves == [false; 3] && !lacks.iter().any(|one: &String| one.starts_with("nothing")) {
                        lacks.push("nothing changes by which a delay would show".to_owned());
                        wants.push("a turn".to_owned());
                    }
                }
                Slot::Temperature(_) => lacks.push("the temperature does not change by itself".to_owned()),
            }
        }
        let named = |which: [bool; 3]| (0..3).filter(|axis| which[*axis]).map(|axis| AXES[axis]).collect::<Vec<_>>();
        if still != [false; 3] {
            lacks.push(format!("it never turns about {}", joined(&named(still), "or")));
            wants.push(format!("a turn about {}", joined(&named(still), "and")));
        }
        if constant != [false; 3] {
            let felt = std::array::from_fn(|axis| constant[axis] && self.force_felt[axis]);
            let absent = std::array::from_fn(|axis| constant[axis] && !self.force_felt[axis]);
            if felt != [false; 3] {
                lacks.push(format!("the specific force along {} never changes", joined(&named(felt), "and")));
            }
            if absent != [false; 3] {
                lacks.push(format!("there is never a specific force along {}", joined(&named(absent), "or")));
            }
            wants.push(format!("rests with {} up and down", joined(&named(constant), "and")));
        }
        (lacks, wants)
    }
}

/// Returns a text such as "bias x, scale_factor (x, y) and misalignment z".
fn names(group: &[usize], slots: &[Slot], candidates: &[Candidate], estimates: &[Estimate]) -> String {
    let mut effects: Vec<(String, Vec<&str>)> = Vec::new();
    for place in group {
        let form = match slots[*place] {
            Slot::Coefficient(candidate, _) => candidates[candidate].form(),
            _ => "",
        };
        let effect = format!("{form}{}", estimates[*place].effect.map_or("clock", EffectKind::name));
        let parameter = estimates[*place].parameter.as_str();
        match effects.iter_mut().find(|(of, _)| *of == effect) {
            Some((_, parameters)) => parameters.push(parameter),
            None => effects.push((effect, vec![parameter])),
        }
    }
    let one = |(effect, parameters): &(String, Vec<&str>)| match parameters.as_slice() {
        [one] => format!("{effect} {one}"),
        several => format!("{effect} ({})", several.join(", ")),
    };
    joined(&effects.iter().map(one).collect::<Vec<_>>(), "and")
}

/// Returns the axes of the triad's input and of the specific force on which a coefficient's column depends, as the
/// effect itself reports them.
fn depends(candidate: Candidate, coefficient: usize) -> ([bool; 3], [bool; 3]) {
    let effect = candidate.make(&[]);
    // Any temperature but that at which an effect vanishes.
    let temperature_c = effect.number("reference_c").map(|reference_c| reference_c + 1.0);
    let at = |input, force: Axes| {
        let drive = Drive { input, accel_m_s2: force, vibration_m2_s4: force, temperature_c };
        effect.regress(drive).get(coefficient).copied()
    };
    let none = at([0.0; 3], [0.0; 3]);
    let unit = |axis: usize| std::array::from_fn(|other| if other == axis { 1.0 } else { 0.0 });
    let input = std::array::from_fn(|axis| at(unit(axis), [0.0; 3]) != none);
    let force = std::array::from_fn(|axis| at([0.0; 3], unit(axis)) != none);
    (input, force)
}

/// Returns a text such as "a, b and c" for the word "and".
fn joined<S: AsRef<str>>(names: &[S], word: &str) -> String {
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    match names.as_slice() {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [first @ .., last] => format!("{} {word} {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_depend_on_the_axes_that_their_effect_names() {
        assert_eq!(depends(Candidate::Bias, 1), ([false; 3], [false; 3]));
        assert_eq!(depends(Candidate::ScaleFactor, 1), ([false, true, false], [false; 3]));
        assert_eq!(depends(Candidate::Misalignment, 0), ([false, true, true], [false; 3]));
        assert_eq!(depends(Candidate::GSensitivity, 5), ([false; 3], [false, false, true]));
        assert_eq!(depends(Candidate::Rectification, 2), ([false; 3], [false, false, true]));
        let warm = Candidate::TemperatureScale { reference_c: 25.0 };
        assert_eq!(depends(warm, 0), ([true, false, false], [false; 3]));
    }

    #[test]
    fn names_are_listed_as_one_writes_them() {
        assert_eq!(joined(&["x"], "and"), "x");
        assert_eq!(joined(&["x", "y", "z"], "and"), "x, y and z");
        assert_eq!(joined(&["x", "y"], "or"), "x or y");
    }
}
