//! Plans: the number of cases of each kind in a trial, in an order that the sealed seed determines.

use super::class::{Class, Sense};
use super::draw::Draw;
use super::kind::Kind;
use super::recipe::Recipe;

/// Cases of each class among 2,500. Kept classes are used only on request.
pub const MIX: [(Class, f64); 9] = [
    (Class::None, 400.0),
    (Class::Known, 100.0),
    (Class::Single, 600.0),
    (Class::Pair, 350.0),
    (Class::Several, 250.0),
    (Class::Superfluous, 200.0),
    (Class::Size, 200.0),
    (Class::Outside, 400.0),
    (Class::Kept, 400.0),
];

/// Part of the cases of another size whose effect has another place, if possible.
const ELSEWHERE: f64 = 0.5;

/// The reasons why a plan was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// A word names neither a kind nor a class.
    #[error("`{found}` names no kind of case; expected {classes}, or some of {kinds}")]
    Unknown {
        /// The word.
        found: String,
        /// The known classes.
        classes: String,
        /// The known kinds.
        kinds: String,
    },
}

/// The wanted cases.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wanted {
    /// The classes.
    pub classes: Vec<Class>,
    /// The kinds (of the library, outside it, kept), each for the classes that use them.
    pub kinds: Vec<Kind>,
}

impl Default for Wanted {
    /// Returns all except the kept classes and kinds.
    fn default() -> Self {
        let classes = Class::ALL.into_iter().filter(|class| *class != Class::Kept).collect();
        Self { classes, kinds: Kind::all().collect() }
    }
}

impl Wanted {
    /// Reads classes and kinds from words; without words, the default. Kinds given without a class are used one at a
    /// time; a class without given kinds uses all.
    ///
    /// # Errors
    /// [`PlanError`] for a word that is neither.
    pub fn from_words<'a>(words: impl IntoIterator<Item = &'a str>) -> Result<Self, PlanError> {
        let (mut classes, mut kinds) = (Vec::new(), Vec::new());
        for word in words {
            if let Some(class) = Class::ALL.into_iter().find(|class| class.name() == word) {
                classes.push(class);
            } else if let Some(kind) = Kind::from_name(word) {
                kinds.push(kind);
            } else {
                let names = |list: Vec<&str>| list.join(", ");
                return Err(PlanError::Unknown {
                    found: word.to_owned(),
                    classes: names(Class::ALL.map(Class::name).to_vec()),
                    kinds: names(Kind::all().map(Kind::name).collect()),
                });
            }
        }
        if classes.is_empty() && kinds.is_empty() {
            return Ok(Self::default());
        }
        let mut chosen = kinds.clone();
        for (list, alone, takes) in [
            (Kind::LIBRARY, Class::Single, (|class| class.in_library() || class == Class::Known) as fn(Class) -> bool),
            (Kind::TUNED, Class::Outside, |class| class == Class::Outside),
            (Kind::KEPT, Class::Kept, |class| class == Class::Kept),
        ] {
            let named = kinds.iter().any(|kind| list.contains(kind));
            if named && !classes.iter().any(|class| takes(*class)) {
                classes.push(alone);
            }
            if !named {
                chosen.extend(list);
            }
        }
        classes.sort_unstable();
        classes.dedup();
        chosen.sort_unstable();
        chosen.dedup();
        Ok(Self { classes, kinds: chosen })
    }

    fn of(&self, list: &[Kind], may: impl Fn(Kind) -> bool) -> Vec<Kind> {
        self.kinds.iter().copied().filter(|kind| list.contains(kind) && may(*kind)).collect()
    }
}

/// Returns the recipe of every case of a trial.
///
/// Shares are those of [`MIX`] among the wanted classes. Each kind occurs as often as the others of its class.
pub fn plan(seed: u64, cases: usize, wanted: &Wanted) -> Vec<Recipe> {
    let mut draw = Draw::device(seed, u64::MAX, "plan");
    let shares: Vec<(Class, f64)> = MIX.into_iter().filter(|(class, _)| wanted.classes.contains(class)).collect();
    let total: f64 = shares.iter().map(|(_, share)| share).sum();
    let mut made: Vec<Recipe> = Vec::new();
    let mut until = 0.0;
    for (class, share) in shares {
        until += share / total * cases as f64;
        let count = (until.round() as usize).saturating_sub(made.len());
        made.extend(of_class(class, count, wanted, &mut draw));
    }
    draw.shuffle(&mut made);
    made
}

fn of_class(class: Class, count: usize, wanted: &Wanted, draw: &mut Draw) -> Vec<Recipe> {
    let in_turn = |mut kinds: Vec<Kind>, draw: &mut Draw| -> Vec<Kind> {
        // Chance determines which of them get one more than the others.
        draw.shuffle(&mut kinds);
        kinds.into_iter().cycle().take(count).collect()
    };
    let lacking = |kinds: Vec<Kind>| kinds.into_iter().map(|kind| Recipe::lacking(&[kind])).collect();
    let library = |may: fn(Kind) -> bool| wanted.of(Kind::LIBRARY, may);
    match class {
        Class::None => vec![Recipe::lacking(&[]); count],
        Class::Single => lacking(in_turn(library(|_| true), draw)),
        Class::Outside => lacking(in_turn(wanted.of(Kind::TUNED, |_| true), draw)),
        Class::Kept => lacking(in_turn(wanted.of(Kind::KEPT, |_| true), draw)),
        Class::Known => {
            let kinds = in_turn(library(Kind::can_be_known), draw);
            kinds.into_iter().map(|kind| Recipe::of_model(kind, Sense::Known)).collect()
        }
        Class::Superfluous => {
            let kinds = in_turn(library(|_| true), draw);
            kinds.into_iter().map(|kind| Recipe::of_model(kind, Sense::Superfluous)).collect()
        }
        Class::Size => {
            let kinds = in_turn(library(Kind::can_be_resized), draw);
            let of = |kind: Kind| {
                let elsewhere = kind.can_be_elsewhere() && draw.chance(ELSEWHERE);
                Recipe::of_model(kind, if elsewhere { Sense::Elsewhere } else { Sense::Size })
            };
            kinds.into_iter().map(of).collect()
        }
        Class::Pair => together(&library(|_| true), 2, count, draw),
        Class::Several => {
            let kinds = library(|_| true);
            let half = count / 2;
            let mut made = together(&kinds, 3, count - half, draw);
            made.extend(together(&kinds, 4, half, draw));
            made
        }
    }
}

/// Maximum number of attempts to combine kinds.
const TRIES: usize = 60;

/// Combines kinds, each with each of the others in turn: no pair occurs again before all were tried.
fn together(kinds: &[Kind], size: usize, count: usize, draw: &mut Draw) -> Vec<Recipe> {
    let mut pairs: Vec<Vec<Kind>> = kinds
        .iter()
        .enumerate()
        .flat_map(|(at, one)| kinds[at + 1..].iter().map(move |other| vec![*one, *other]))
        .filter(|pair| pair[0].goes_with(pair[1]))
        .collect();
    draw.shuffle(&mut pairs);
    let mut filled = |mut together: Vec<Kind>| -> Option<Vec<Kind>> {
        for _ in 0..TRIES {
            if together.len() == size {
                break;
            }
            let next = kinds[draw.whole(0, kinds.len() - 1)];
            if together.iter().all(|one| one.goes_with(next)) {
                together.push(next);
            }
        }
        together.sort_unstable();
        (together.len() == size).then_some(together)
    };
    let all = pairs.into_iter().cycle().take(count).filter_map(&mut filled);
    all.map(|kinds| Recipe::lacking(&kinds)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(plan: &[Recipe]) -> Vec<usize> {
        Class::ALL.map(|class| plan.iter().filter(|recipe| recipe.class == class).count()).to_vec()
    }

    #[test]
    fn a_trial_of_2500_has_its_shares_and_a_smaller_one_too() {
        let full = plan(1, 2500, &Wanted::default());
        let everything = Wanted::from_words(Class::ALL.map(Class::name)).unwrap();
        assert_eq!(counts(&full), [400, 100, 600, 350, 250, 200, 200, 400, 0]);
        assert_eq!(counts(&plan(1, 100, &Wanted::default())), [16, 4, 24, 14, 10, 8, 8, 16, 0]);
        assert_eq!(counts(&plan(1, 290, &everything))[8], 40);
        for kind in Kind::LIBRARY {
            let count = full.iter().filter(|recipe| **recipe == Recipe::lacking(&[*kind])).count();
            assert!((27..=28).contains(&count), "{kind} {count}");
        }
        assert_eq!(full, plan(1, 2500, &Wanted::default()));
        assert_ne!(full, plan(2, 2500, &Wanted::default()));
        for recipe in full {
            let kinds: Vec<Kind> = recipe.kinds().collect();
            for (at, one) in kinds.iter().enumerate() {
                assert!(kinds[at + 1..].iter().all(|other| one.goes_with(*other)), "{kinds:?}");
            }
            let expected = match recipe.class {
                Class::None => 0..=0,
                Class::Pair => 2..=2,
                Class::Several => 3..=4,
                _ => 1..=1,
            };
            assert!(expected.contains(&kinds.len()), "{recipe:?}");
        }
    }

    #[test]
    fn words_choose_classes_and_kinds() {
        let of = |words: &[&str]| plan(1, 20, &Wanted::from_words(words.iter().copied()).unwrap());
        let count = |words: &[&str], class: Class| of(words).iter().filter(|recipe| recipe.class == class).count();
        assert_eq!(count(&["tone"], Class::Single), 20);
        assert!(of(&["tone", "pair", "spikes"]).iter().all(|one| *one == Recipe::lacking(&[Kind::Tone, Kind::Spikes])));
        assert_eq!((count(&["none", "chirp"], Class::None), count(&["none", "chirp"], Class::Outside)), (10, 10));
        assert_eq!(count(&["none"], Class::None), 20);
        assert_eq!(count(&["kept"], Class::Kept), 20);
        assert_eq!(count(&["notch"], Class::Kept), 20);
        let superfluous = of(&["superfluous", "tone"]);
        assert!(superfluous.iter().all(|one| *one == Recipe::of_model(Kind::Tone, Sense::Superfluous)));
        assert_eq!(Wanted::from_words([]).unwrap(), Wanted::default());
        let error = Wanted::from_words(["tune"]).unwrap_err().to_string();
        assert!(error.contains("`tune`") && error.contains("gauss_markov") && error.contains("superfluous"), "{error}");
    }

    #[test]
    fn kinds_that_make_no_pair_give_none() {
        assert!(plan(1, 9, &Wanted::from_words(["pair", "tone", "comb"]).unwrap()).is_empty());
    }
}
