//! Rates: the summary of a trial, each rate with its count, its total and its interval.

use super::again::WITHIN;
use super::class::Class;
use super::interval::Rate;
use super::judge::{Found, Judgement, Named};
use serde::ser::{Serialize, SerializeMap, Serializer};

/// Confidence from which on a cause counts as sure.
pub const SURE: f64 = 0.97;

/// A rate with its name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NamedRate {
    /// The name in JSON and on the command line.
    pub name: &'static str,
    /// The meaning of the rate.
    pub meaning: &'static str,
    /// The rate.
    pub rate: Rate,
}

/// All rates, in order. Only cases with effects of 1.5 times the limit or above count, except cases without an effect
/// to name and cases outside the library. False places and refusals are counted over all cases.
#[derive(Debug, Clone, PartialEq)]
pub struct Rates(pub Vec<NamedRate>);

impl Serialize for Rates {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for one in &self.0 {
            map.serialize_entry(one.name, &one.rate)?;
        }
        map.end()
    }
}

/// The unchanged halves of a recording's stretches compared with each other: verdict and number of causes of each.
pub type Halves = [(String, usize)];

impl Rates {
    /// Computes the rates from all judgements of a trial, and from a recording's halves if there is one.
    pub fn of(all: &[Judgement], halves: &Halves) -> Self {
        let mut rates = Vec::new();
        let mut add = |name, meaning, rate| rates.push(NamedRate { name, meaning, rate });
        let of = |class: Class| all.iter().filter(move |one| one.class == class);
        let counting = |class: Class| of(class).filter(|one| one.counts);
        let library = || all.iter().filter(|one| one.class.in_library() && one.counts);
        let own_known = |one: &&Judgement| !one.own_unknown;
        let two_to_four = || counting(Class::Pair).chain(counting(Class::Several));
        let first = |class: Class| Rate::of(counting(class).map(Judgement::right_first));
        let named = |class: Class| Rate::of(of(class).map(|one| !one.causes.is_empty()));
        let unknown = |class: Class| Rate::of(of(class).filter(own_known).map(Judgement::unknown));

        add("right_first", "one effect that the model lacks: named first", first(Class::Single));
        add(
            "superfluous_first",
            "one that the model has and the sensor does not: named first, and so",
            first(Class::Superfluous),
        );
        add("size_first", "one that both have differently: named first, and so", first(Class::Size));
        add(
            "cause_and_sense_first",
            "all of these, and two to four: first is right",
            Rate::of(library().map(Judgement::right_first)),
        );
        add(
            "right_first_or_none",
            "one that the model lacks, or none: named first, or nothing named",
            Rate::of(counting(Class::Single).map(Judgement::right_first).chain(of(Class::None).map(Judgement::silent))),
        );
        add("none_named", "none: something named", named(Class::None));
        add("none_unknown", "none: called unknown", unknown(Class::None));
        add("known_named", "one that the model has rightly: something named", named(Class::Known));
        add("known_unknown", "one that the model has rightly: called unknown", unknown(Class::Known));
        add(
            "library_unknown",
            "in the library, yet called unknown",
            Rate::of(library().filter(own_known).map(Judgement::unknown)),
        );
        add("spurious", "with a spurious cause", Rate::of(library().map(Judgement::spurious)));
        add("both_found", "two effects: both found", Rate::of(counting(Class::Pair).map(Judgement::all_found)));
        add(
            "both_exactly",
            "two effects: exactly both, and clean",
            Rate::of(counting(Class::Pair).map(Judgement::exactly)),
        );
        add("pair_first", "two effects: one of them named first", first(Class::Pair));
        add(
            "several_found",
            "three or four effects: all found",
            Rate::of(counting(Class::Several).map(Judgement::all_found)),
        );
        add(
            "several_exactly",
            "three or four effects: exactly these, and clean",
            Rate::of(counting(Class::Several).map(Judgement::exactly)),
        );
        add("several_first", "three or four effects: one of them named first", first(Class::Several));
        add("all_found", "two to four effects: all found", Rate::of(two_to_four().map(Judgement::all_found)));
        for (class, [called, answered], [meaning, also]) in [
            (
                Class::Outside,
                ["outside_unknown", "outside_answered"],
                ["outside the library: called unknown", "the same, or reproduced and said so"],
            ),
            (
                Class::Kept,
                ["kept_unknown", "kept_answered"],
                ["outside the library, kept kinds: called unknown", "the same, or reproduced and said so"],
            ),
        ] {
            add(called, meaning, unknown(class));
            add(answered, also, Rate::of(of(class).filter(own_known).map(Judgement::answered)));
        }
        let found = || library().flat_map(|one| &one.effects).filter(|effect| effect.named);
        add(
            "channels_exact",
            "effects named: all channels and no other",
            Rate::of(found().filter_map(|one| one.channels_exact)),
        );
        add("placed", "effects named: placed by `where`", Rate::of(found().filter_map(|one| one.placed)));
        add(
            "false_place",
            "records with a false place",
            Rate::of(all.iter().filter_map(|one| Some(one.false_places? > 0))),
        );
        add("intervals_hold", "95 % intervals of parameters that hold the truth", intervals(found()));
        add(
            "sure_right",
            "causes of confidence 0.97 and above: right",
            sure(all.iter().filter(|one| !one.class.is_outside())),
        );
        add(
            "sure_right_outside",
            "the same, outside the library",
            sure(all.iter().filter(|one| one.class.is_outside())),
        );
        add("closed_covers", "interval of closed holds the true effect's", Rate::of(library().filter_map(covers)));
        add("refused", "refused", Rate::of(all.iter().map(|one| one.verdict == "refused")));
        // Cases on a recording.
        let on = || all.iter().filter(|one| one.control.is_some());
        let imposed = || on().filter(|one| one.class.in_library() && one.counts);
        let control = |is: fn(&(String, usize)) -> bool| Rate::of(on().filter_map(|one| one.control.as_ref()).map(is));
        add(
            "first_new",
            "on a recording: what is imposed is the first new cause",
            Rate::of(imposed().map(Judgement::right_first)),
        );
        add(
            "new_spurious",
            "on a recording: another new cause beside it",
            Rate::of(imposed().map(Judgement::spurious)),
        );
        add("control_named", "untouched, under its own model: something named", control(|(_, named)| *named > 0));
        add(
            "control_unknown",
            "untouched, under its own model: called unknown",
            control(|(verdict, _)| verdict == "unknown_effect"),
        );
        add(
            "halves_clean",
            "one half under the other's model: no_gap or parameters",
            Rate::of(halves.iter().map(|(verdict, _)| is_clean(verdict))),
        );
        add(
            "halves_named",
            "one half under the other's model: something named",
            Rate::of(halves.iter().map(|(_, named)| *named > 0)),
        );
        add(
            "halves_unknown",
            "one half under the other's model: called unknown",
            Rate::of(halves.iter().map(|(verdict, _)| verdict == "unknown_effect")),
        );
        // Results on unseen data.
        let again = || all.iter().filter(|one| one.counts).filter_map(|one| Some((one, one.again?)));
        let near =
            |(one, again): (&Judgement, super::again::Again)| Some((again.closed? - one.closed?).abs() <= WITHIN);
        add(
            "closed_again",
            "closed on a second record within 0.03 of what was reported",
            Rate::of(again().filter_map(near)),
        );
        add(
            "second_clean",
            "second record under the corrected model: no_gap or parameters",
            Rate::of(again().filter_map(|(_, of)| of.second_clean)),
        );
        add(
            "itself_clean",
            "corrected model's simulation under itself: no_gap or parameters",
            Rate::of(again().map(|(_, of)| of.itself_clean)),
        );
        add(
            "cause_returns",
            "corrected model's simulation under the plain model: the first cause is named",
            Rate::of(again().filter_map(|(_, of)| of.returns)),
        );
        Self(rates)
    }

    /// Returns the rate of this name.
    pub fn get(&self, name: &str) -> Option<Rate> {
        self.0.iter().find(|one| one.name == name).map(|one| one.rate)
    }

    /// Returns the names of the rates.
    pub fn names() -> Vec<&'static str> {
        Self::of(&[], &[]).0.into_iter().map(|one| one.name).collect()
    }

    /// Returns the rates with at least one case.
    pub fn stated(&self) -> impl Iterator<Item = &NamedRate> {
        self.0.iter().filter(|one| one.rate.of > 0)
    }
}

fn is_clean(verdict: &str) -> bool {
    matches!(verdict, "no_gap" | "parameters")
}

fn covers(one: &Judgement) -> Option<bool> {
    let (truth, [low, high]) = (one.closed_by_truth?, one.closed_ci95?);
    Some((low..=high).contains(&truth))
}

fn intervals<'a>(found: impl Iterator<Item = &'a Found>) -> Rate {
    let [held, of] = found.fold([0; 2], |[held, of], one| [held + one.intervals[0], of + one.intervals[1]]);
    Rate::new(held, of)
}

fn sure<'a>(all: impl Iterator<Item = &'a Judgement>) -> Rate {
    let is_sure = |cause: &&Named| cause.confidence.is_some_and(|confidence| confidence >= SURE);
    let named = all.filter(|one| one.is_of_account()).flat_map(|one| &one.causes);
    Rate::of(named.filter(is_sure).map(|cause| cause.right))
}
