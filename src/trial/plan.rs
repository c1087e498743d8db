//! Plans: how many cases of which kinds a trial has, in an order that the sealed seed decides.

use super::draw::Draw;
use super::kind::{Class, Kind};

/// Cases of 2,500 that are of each class.
const MIX: [(Class, f64); 4] =
    [(Class::None, 500.0), (Class::Single, 850.0), (Class::Pair, 650.0), (Class::Outside, 500.0)];

/// Why a plan was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// A word names no kind and no class.
    #[error("`{found}` names no kind of case; expected none, single, pair, outside, or some of {known}")]
    Unknown {
        /// The word.
        found: String,
        /// The kinds.
        known: String,
    },
}

/// Which cases are wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
#[expect(clippy::exhaustive_structs, reason = "an argument that callers write out")]
pub struct Wanted {
    /// Their classes.
    pub classes: Vec<Class>,
    /// Their kinds: those of the library for single ones and pairs, those outside it for the others.
    pub kinds: Vec<Kind>,
}

impl Default for Wanted {
    /// All.
    fn default() -> Self {
        Self { classes: Class::ALL.to_vec(), kinds: Kind::LIBRARY.into_iter().chain(Kind::OUTSIDE).collect() }
    }
}

impl Wanted {
    /// From words: classes, and kinds; all cases if there is no word. Kinds alone are wanted one at a time; a class without
    /// kinds of its own has all.
    ///
    /// # Errors
    /// [`PlanError`]: a word that is neither.
    pub fn from_words<'a>(words: impl IntoIterator<Item = &'a str>) -> Result<Self, PlanError> {
        let (mut classes, mut kinds) = (Vec::new(), Vec::new());
        for word in words {
            if let Some(class) = Class::ALL.into_iter().find(|class| class.name() == word) {
                classes.push(class);
            } else if let Some(kind) = Kind::from_name(word) {
                kinds.push(kind);
                if kind.effect().is_none() {
                    classes.push(Class::Outside);
                }
            } else {
                let known: Vec<_> = Self::default().kinds.into_iter().map(Kind::name).collect();
                return Err(PlanError::Unknown { found: word.to_owned(), known: known.join(", ") });
            }
        }
        if classes.is_empty() && kinds.is_empty() {
            return Ok(Self::default());
        }
        let inside = kinds.iter().any(|kind| kind.effect().is_some());
        if inside && !classes.contains(&Class::Single) && !classes.contains(&Class::Pair) {
            classes.push(Class::Single);
        }
        if !inside {
            kinds.extend(Kind::LIBRARY);
        }
        if !kinds.iter().any(|kind| kind.effect().is_none()) {
            kinds.extend(Kind::OUTSIDE);
        }
        classes.sort_unstable();
        classes.dedup();
        kinds.sort_unstable();
        kinds.dedup();
        Ok(Self { classes, kinds })
    }
}

/// The kinds of every case of a trial.
///
/// Of 2,500 cases 500 have nothing, 850 one effect of the library, 650 two, 500 one outside it; of other numbers as many in
/// proportion. Each kind comes as often as the others of its class.
#[must_use]
pub fn plan(seed: u64, cases: usize, wanted: &Wanted) -> Vec<Vec<Kind>> {
    let mut draw = Draw::device(seed, u64::MAX, "plan");
    let shares: Vec<(Class, f64)> = MIX.into_iter().filter(|(class, _)| wanted.classes.contains(class)).collect();
    let total: f64 = shares.iter().map(|(_, share)| share).sum();
    let mut made: Vec<Vec<Kind>> = Vec::new();
    let mut until = 0.0;
    for (class, share) in shares {
        until += share / total * cases as f64;
        let count = (until.round() as usize).saturating_sub(made.len());
        made.extend(of_class(class, count, wanted, &mut draw));
    }
    draw.shuffle(&mut made);
    made
}

fn of_class(class: Class, count: usize, wanted: &Wanted, draw: &mut Draw) -> Vec<Vec<Kind>> {
    let inside = |inside: bool| -> Vec<Kind> {
        wanted.kinds.iter().copied().filter(|kind| kind.effect().is_some() == inside).collect()
    };
    let in_turn = |mut kinds: Vec<Kind>, draw: &mut Draw| -> Vec<Vec<Kind>> {
        // Which of them get one more than the others is chance.
        draw.shuffle(&mut kinds);
        kinds.into_iter().cycle().take(count).map(|kind| vec![kind]).collect()
    };
    match class {
        Class::None => vec![Vec::new(); count],
        Class::Single => in_turn(inside(true), draw),
        Class::Outside => in_turn(inside(false), draw),
        Class::Pair => {
            let kinds = inside(true);
            let mut pairs: Vec<Vec<Kind>> = kinds
                .iter()
                .enumerate()
                .flat_map(|(at, one)| kinds[at + 1..].iter().map(move |other| vec![*one, *other]))
                .filter(|pair| pair[0].goes_with(pair[1]))
                .collect();
            draw.shuffle(&mut pairs);
            pairs.into_iter().cycle().take(count).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(plan: &[Vec<Kind>]) -> [usize; 4] {
        Class::ALL.map(|class| plan.iter().filter(|kinds| Class::of(kinds) == class).count())
    }

    #[test]
    fn a_trial_of_2500_has_its_shares_and_a_smaller_one_too() {
        let full = plan(1, 2500, &Wanted::default());
        assert_eq!(counts(&full), [500, 850, 650, 500]);
        assert_eq!(counts(&plan(1, 100, &Wanted::default())), [20, 34, 26, 20]);
        for kind in Kind::LIBRARY {
            let count = full.iter().filter(|kinds| **kinds == [kind]).count();
            assert!((38..=39).contains(&count), "{kind} {count}");
        }
        assert_eq!(full, plan(1, 2500, &Wanted::default()));
        assert_ne!(full, plan(2, 2500, &Wanted::default()));
        assert!(full.iter().filter(|kinds| kinds.len() == 2).all(|pair| pair[0].goes_with(pair[1])));
    }

    #[test]
    fn words_choose_classes_and_kinds() {
        let of = |words: &[&str]| plan(1, 20, &Wanted::from_words(words.iter().copied()).unwrap());
        assert_eq!(counts(&of(&["tone"])), [0, 20, 0, 0]);
        assert!(of(&["tone", "pair", "spikes"]).iter().all(|kinds| *kinds == [Kind::Tone, Kind::Spikes]));
        assert_eq!(counts(&of(&["none", "chirp"])), [10, 0, 0, 10]);
        assert_eq!(counts(&of(&["none"])), [20, 0, 0, 0]);
        assert_eq!(Wanted::from_words([]).unwrap(), Wanted::default());
        let error = Wanted::from_words(["tune"]).unwrap_err().to_string();
        assert!(error.contains("`tune`") && error.contains("gauss_markov"), "{error}");
    }

    #[test]
    fn kinds_that_make_no_pair_give_none() {
        assert!(plan(1, 9, &Wanted::from_words(["pair", "tone", "comb"]).unwrap()).is_empty());
    }
}
