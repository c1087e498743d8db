//! Kinds: the effects that a sealed case with a motion may lack.

use crate::draw::Draw;
use crate::kind::kinds;
use imu_core::sample::Triad;
use imu_model::EffectKind;

kinds! {
    /// An effect that a case lacks in its model: an effect of the library has its identity in a row; the others are
    /// outside it.
    row: Option<EffectKind>;
    /// The kinds of the library.
    LIBRARY:
        Bias = "bias" => Some(EffectKind::Bias),
        ScaleFactor = "scale_factor" => Some(EffectKind::ScaleFactor),
        UnsignedNonlinearity = "unsigned_nonlinearity" => Some(EffectKind::ScaleFactorNonlinearity),
        SignedNonlinearity = "signed_nonlinearity" => Some(EffectKind::ScaleFactorNonlinearity),
        Misalignment = "misalignment" => Some(EffectKind::Misalignment),
        CrossAxisSensitivity = "cross_axis_sensitivity" => Some(EffectKind::CrossAxisSensitivity),
        GSensitivity = "g_sensitivity" => Some(EffectKind::GSensitivity),
        Rectification = "rectification" => Some(EffectKind::Rectification),
        TemperatureScale = "temperature_scale" => Some(EffectKind::TemperatureScale),
        Latency = "latency" => Some(EffectKind::Latency),
        Saturation = "saturation" => Some(EffectKind::Saturation),
        LowPass = "low_pass" => Some(EffectKind::LowPass),
        TemperatureBias = "temperature_bias" => Some(EffectKind::TemperatureBias);
    /// The kinds outside the library.
    OUTSIDE:
        Hysteresis = "hysteresis" => None,
        Creep = "creep" => None,
        DeadBand = "dead_band" => None,
        LeverArm = "lever_arm" => None;
}

impl Kind {
    /// Returns the documented effect; `None` outside the library.
    pub fn effect(self) -> Option<EffectKind> {
        self.row()
    }

    /// Returns the triads on which the kind may be.
    pub fn triads(self) -> &'static [Triad] {
        match self {
            Self::GSensitivity => &[Triad::Gyro],
            Self::LeverArm => &[Triad::Accel],
            _ => &[Triad::Gyro, Triad::Accel],
        }
    }

    /// Returns whether the kind is in the model with its channels, not with its triad.
    pub fn on_channels(self) -> bool {
        matches!(self, Self::LowPass | Self::TemperatureBias)
    }

    /// Returns the unit of the kind's numbers on a triad; for kinds outside the library, of the numbers drawn for them.
    pub fn unit(self, triad: Triad) -> &'static str {
        let of = |gyro, accel| if triad == Triad::Gyro { gyro } else { accel };
        match self {
            Self::Bias | Self::DeadBand => of("rad/s", "m/s²"),
            Self::TemperatureBias => of("rad/s/°C", "m/s²/°C"),
            Self::Misalignment => "rad",
            Self::GSensitivity => "rad/s per m/s²",
            Self::Latency => "s",
            Self::LowPass => "of the rate",
            Self::Saturation => "of the samples",
            Self::LeverArm => "m",
            Self::TemperatureScale => "per °C",
            Self::Rectification => of("rad/s per (m/s²)²", "m/s² per (m/s²)²"),
            Self::ScaleFactor | Self::CrossAxisSensitivity => "",
            Self::UnsignedNonlinearity | Self::SignedNonlinearity => "at full scale",
            Self::Hysteresis | Self::Creep => "",
        }
    }

    /// Returns the number of the kind's numbers that a regression finds; `None` if its size is another quantity.
    pub fn numbers(self) -> Option<usize> {
        match self {
            Self::Saturation | Self::LowPass => None,
            Self::GSensitivity => Some(9),
            Self::Latency => Some(1),
            _ => Some(3),
        }
    }
}

/// One effect of a case: its kind and its triad.
pub type Planned = (Kind, Triad);

/// Words that choose classes of cases, beside the kinds' names.
pub const CLASSES: [&str; 4] = ["none", "single", "pair", "outside"];

/// Returns the effects of every case: of `cases`, a fifth have none, half one effect of the library, a fifth two, and a
/// tenth one outside it. `words` choose the classes and kinds; without words, all are used. Each kind occurs as often
/// as the others of its class.
///
/// # Errors
/// The word that names neither a class nor a kind.
pub fn plan<'a>(
    seed: u64,
    cases: usize,
    words: impl IntoIterator<Item = &'a str>,
) -> Result<Vec<Vec<Planned>>, String> {
    let all = |kinds: &[Kind]| -> Vec<Planned> {
        kinds.iter().flat_map(|kind| kind.triads().iter().map(move |triad| (*kind, *triad))).collect()
    };
    plan_among(seed, cases, words, &all(Kind::LIBRARY), &all(Kind::OUTSIDE))
}

/// Returns the effects of every case as [`plan`] does, with these in place of the library and of what is outside it.
///
/// # Errors
/// The word that names neither a class nor a kind.
pub fn plan_among<'a>(
    seed: u64,
    cases: usize,
    words: impl IntoIterator<Item = &'a str>,
    library: &[Planned],
    outside: &[Planned],
) -> Result<Vec<Vec<Planned>>, String> {
    let mut draw = Draw::device(seed, u64::MAX, "motion plan");
    let (mut classes, mut kinds): (Vec<&str>, Vec<Kind>) = (Vec::new(), Vec::new());
    for word in words {
        match (CLASSES.iter().find(|class| **class == word), Kind::from_name(word)) {
            (Some(class), _) => classes.push(class),
            (_, Some(kind)) if library.iter().chain(outside).any(|(own, _)| *own == kind) => kinds.push(kind),
            _ => {
                let mut all: Vec<&str> = library.iter().chain(outside).map(|(kind, _)| kind.name()).collect();
                all.dedup();
                return Err(format!("`{word}`: expected {}, or some of {}", CLASSES.join(", "), all.join(", ")));
            }
        }
    }
    let some = |of: &[Planned]| -> Vec<Planned> {
        let own: Vec<Planned> = of.iter().copied().filter(|(kind, _)| kinds.contains(kind)).collect();
        if own.is_empty() { of.to_vec() } else { own }
    };
    if classes.is_empty() {
        if kinds.is_empty() {
            classes.extend(CLASSES);
        }
        let has = |of: &[Planned]| of.iter().any(|(kind, _)| kinds.contains(kind));
        if has(library) {
            classes.push("single");
        }
        if has(outside) {
            classes.push("outside");
        }
    }
    let share = |class: &str| match class {
        "single" => 5.0,
        "outside" => 1.0,
        _ => 2.0,
    };
    let total: f64 = classes.iter().map(|class| share(class)).sum();
    let mut made: Vec<Vec<Planned>> = Vec::new();
    let mut until = 0.0;
    for class in classes {
        until += share(class) / total * cases as f64;
        let count = (until.round() as usize).saturating_sub(made.len());
        let mut list: Vec<Vec<Planned>> = match class {
            "none" => vec![Vec::new()],
            "outside" => in_turn(&some(outside)),
            "pair" => {
                let all = some(library);
                let pairs = all.iter().enumerate().flat_map(|(at, one)| {
                    all[at + 1..].iter().filter(|other| goes_with(*one, **other)).map(|other| vec![*one, *other])
                });
                let mut pairs: Vec<Vec<Planned>> = pairs.collect();
                draw.shuffle(&mut pairs);
                pairs
            }
            _ => in_turn(&some(library)),
        };
        if list.is_empty() {
            list.push(Vec::new());
        }
        made.extend(list.into_iter().cycle().take(count));
    }
    draw.shuffle(&mut made);
    Ok(made)
}

/// Returns each kind once before any kind occurs on its second triad.
fn in_turn(all: &[Planned]) -> Vec<Vec<Planned>> {
    let mut kinds: Vec<Kind> = all.iter().map(|(kind, _)| *kind).collect();
    kinds.dedup();
    let of = |turn: usize| {
        let one = move |kind: Kind| {
            let own: Vec<Planned> = all.iter().copied().filter(|(of, _)| *of == kind).collect();
            vec![own[turn % own.len()]]
        };
        kinds.iter().copied().map(one).collect::<Vec<_>>()
    };
    [of(0), of(1)].concat()
}

/// Returns whether two effects can be separated: not two of the same kind on one triad, not two delays of one sensor's
/// clock, and no effect beside a filter or a limit that would hide it.
fn goes_with(one: Planned, other: Planned) -> bool {
    let alone = |kind: Kind| matches!(kind, Kind::Saturation | Kind::LowPass);
    let late = |kind: Kind| matches!(kind, Kind::Latency | Kind::LowPass);
    one != other && !(late(one.0) && late(other.0)) && !(alone(one.0) && alone(other.0)) && one.0 != other.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_have_their_shares_and_words_choose() {
        let all = plan(1, 1000, []).unwrap();
        let count = |of: &dyn Fn(&Vec<Planned>) -> bool| all.iter().filter(|planned| of(planned)).count();
        assert_eq!(count(&Vec::is_empty), 200);
        assert_eq!(count(&|planned| planned.len() == 2), 200);
        assert_eq!(count(&|planned| planned.len() == 1 && planned[0].0.effect().is_none()), 100);
        for kind in Kind::LIBRARY.iter().copied() {
            let own = count(&|planned| planned.len() == 1 && planned[0].0 == kind);
            assert!((37..=40).contains(&own), "{kind}: {own}");
        }
        let own = plan(1, 20, ["misalignment"]).unwrap();
        assert!(own.iter().all(|planned| planned.len() == 1 && planned[0].0 == Kind::Misalignment));
        assert!(plan(1, 5, ["mislignment"]).unwrap_err().contains("mislignment"));
    }
}
