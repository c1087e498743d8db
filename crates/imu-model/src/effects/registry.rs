//! Every effect under its name: the one list from which files are read, and messages, schema and tables are made.

use super::EffectKind;
use super::spec::Definition;

/// Makes the list: every effect's identity with its name, and the definitions on channels and on triads in the
/// documented order. N, B and K are listed separately.
macro_rules! registry {
    (
        beside: $($own:ident = $own_name:literal),+;
        channel: $($channel:ident = $channel_name:literal),+ $(,)?;
        triad: $($triad:ident = $triad_name:literal),+;
        on both: $($both:ident),+;
    ) => {
        /// The identity of an effect.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum EffectKind {
            $(#[doc = $own_name] $own,)+
            $(#[doc = $channel_name] $channel,)+
            $(#[doc = $triad_name] $triad,)+
        }

        impl EffectKind {
            /// All effects: N, B and K, those on a channel, and those on a triad alone.
            pub const ALL: &[Self] = &[$(Self::$own,)+ $(Self::$channel,)+ $(Self::$triad),+];

            /// Returns the name in files and messages (docs/formats.md).
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$own => $own_name,)+
                    $(Self::$channel => $channel_name,)+
                    $(Self::$triad => $triad_name,)+
                }
            }

            /// Returns the table; for an effect on channels and triads, that on a channel.
            pub fn spec(self) -> &'static Spec {
                match self {
                    $(Self::$own => $own::SPEC,)+
                    $(Self::$channel => $channel::SPEC,)+
                    $(Self::$triad => triad::$triad::SPEC,)+
                }
            }
        }

        /// Effects on a channel, in the documented order.
        pub static CHANNEL: [&Definition<dyn Effect>; [$($channel_name),+].len()] = [$($channel::DEFINITION),+];

        /// Effects on a triad, in the documented order.
        pub static TRIAD: [&Definition<dyn TriadEffect>; [$($triad_name,)+ $(stringify!($both)),+].len()] =
            [$(triad::$triad::DEFINITION,)+ $(triad::$both::DEFINITION),+];
    };
}
pub(super) use registry;

impl EffectKind {
    /// Returns the effect of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|kind| kind.name() == name)
    }
}

impl std::fmt::Display for EffectKind {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(self.name())
    }
}

impl serde::Serialize for EffectKind {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> serde::Deserialize<'de> for EffectKind {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = std::borrow::Cow::<str>::deserialize(deserializer)?;
        Self::from_name(&name).ok_or_else(|| serde::de::Error::custom(format_args!("`{name}` is not an effect")))
    }
}

/// Returns the definition of that name.
pub fn find<E: ?Sized>(all: &'static [&'static Definition<E>], name: &str) -> Option<&'static Definition<E>> {
    all.iter().find(|of| of.spec.name() == name).copied()
}

/// Returns the names of definitions, in order.
pub fn names<E: ?Sized>(all: &[&Definition<E>]) -> Vec<&'static str> {
    all.iter().map(|of| of.spec.name()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::spec::Form;
    use crate::effects::{CHANNEL, Spec, TRIAD};
    use std::collections::BTreeSet;

    #[test]
    fn the_documentation_has_a_row_for_every_effect_with_all_its_parameters() {
        let page = include_str!("../../../../docs/effects.md");
        let (channel, triad) = page.split_once("## On a triad").unwrap();
        let row = |page: &str, spec: &Spec| {
            let row = page.lines().find(|line| line.starts_with(&format!("| `{}` |", spec.name())));
            let row = row.unwrap_or_else(|| panic!("docs/effects.md has no row for {}", spec.name()));
            for name in spec.names() {
                assert!(row.contains(&format!("`{name}`")), "docs/effects.md, {}: `{name}` is missing", spec.name());
            }
        };
        CHANNEL.iter().for_each(|kind| row(channel, kind.spec));
        TRIAD.iter().for_each(|kind| row(triad, kind.spec));
    }

    #[test]
    fn names_differ_and_streams_are_given_once() {
        let channel: BTreeSet<_> = names(&CHANNEL).into_iter().collect();
        assert_eq!(channel.len(), CHANNEL.len());
        assert_eq!(names(&TRIAD).into_iter().collect::<BTreeSet<_>>().len(), TRIAD.len());
        let mut streams: Vec<u16> = CHANNEL.iter().map(|kind| kind.spec.stream).filter(|stream| *stream > 0).collect();
        streams.extend([1, 2, 3, crate::effects::timing::LOSS_STREAM]);
        let distinct: BTreeSet<_> = streams.iter().collect();
        assert_eq!(distinct.len(), streams.len());
    }

    #[test]
    fn every_effect_has_all_properties() {
        let channel = CHANNEL.iter().map(|of| of.spec);
        for spec in channel.chain(TRIAD.iter().map(|of| of.spec)).chain(EffectKind::ALL.iter().map(|kind| kind.spec()))
        {
            let name = spec.name();
            assert_eq!(EffectKind::from_name(name), Some(spec.kind), "{name}");
            assert_eq!(spec.kind.spec().kind, spec.kind, "{name}");
            assert!(!spec.meaning.is_empty() && !spec.parameters.is_empty(), "{name}");
            let numbers: serde_json::Map<_, _> =
                spec.names().into_iter().map(|name| (name.to_owned(), 0.5.into())).collect();
            let phrase = spec.phrase(Some(&numbers.into()), "");
            assert!(!phrase.is_empty() && !phrase.contains(['{', '}', '_']), "{name}: {phrase}");
            for parameter in spec.parameters {
                let is_plain = matches!(parameter.form, Form::Choice(_) | Form::Effect(_)) || parameter.unit.is_empty();
                assert!(!parameter.meaning.is_empty(), "{name}: {}", parameter.name);
                // Times and frequencies state a unit. Only instants have the form of a time; durations have another
                // form.
                assert!(!(is_plain && parameter.name.ends_with("_s")), "{name}: {}", parameter.name);
                let is_instant = ["at_s", "from_s", "to_s"].contains(&parameter.name);
                assert_eq!(parameter.form == Form::Time, is_instant, "{name}: {}", parameter.name);
            }
        }
    }

    #[test]
    fn every_time_is_moved_and_nothing_else() {
        use serde_json::json;
        let cases = [
            (EffectKind::BiasStep, json!({"at_s": 3.5, "size": 2.0}), json!({"at_s": 13.5, "size": 2.0})),
            (
                EffectKind::VarianceChange,
                json!([{"from_s": 1, "to_s": 2.5, "factor": 3.0}, {"profile": [[0.0, 1.0], [60.0, 2.0]]}]),
                json!([{"from_s": 11.0, "to_s": 12.5, "factor": 3.0}, {"profile": [[10.0, 1.0], [70.0, 2.0]]}]),
            ),
            (
                EffectKind::Bursts,
                json!({"intervals": [[1.0, 2.0], [4.0, 5.0]], "sigma": 0.1}),
                json!({"intervals": [[11.0, 12.0], [14.0, 15.0]], "sigma": 0.1}),
            ),
            (
                EffectKind::BiasStep,
                json!({"at_s": [3.0, 4.0], "size": [1.0, 3.0]}),
                json!({"at_s": [13.0, 14.0], "size": [1.0, 3.0]}),
            ),
            (EffectKind::WarmUp, json!({"tau_s": [7.0, 9.0]}), json!({"tau_s": [7.0, 9.0]})),
            (
                EffectKind::ModulatedBand,
                json!({"level": [[0.0, 1.0], [60.0, 2.0]]}),
                json!({"level": [[10.0, 1.0], [70.0, 2.0]]}),
            ),
        ];
        for (kind, mut entry, moved) in cases {
            kind.spec().move_times(&mut entry, 10.0);
            assert_eq!(entry, moved);
        }
    }
}
