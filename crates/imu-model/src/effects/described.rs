//! Described: the statements of each type of effect, and the macros that define them once.

use super::spec::{Spec, Values, pair_of};
use super::{EffectKind, Stage};
use serde_json::{Value, json};

/// The statements of an effect on a channel or a triad.
pub trait Described {
    /// Returns the name, the place in the chain and parameters with their ranges.
    fn spec(&self) -> &'static Spec;

    /// Returns the parameters in the form of a model's file.
    fn parameters(&self) -> Vec<(&'static str, Value)>;

    /// Returns the identity.
    fn kind(&self) -> EffectKind {
        self.spec().kind
    }

    /// Returns the name in files and messages (docs/formats.md).
    fn name(&self) -> &'static str {
        self.kind().name()
    }

    /// Returns the stage of the chain at which the effect acts.
    fn stage(&self) -> Stage {
        self.spec().stage
    }

    /// Returns a parameter in the form of a model's file; `None` for another name.
    fn parameter(&self, name: &str) -> Option<Value> {
        self.parameters().into_iter().find(|(own, _)| *own == name).map(|(_, value)| value)
    }

    /// Returns a parameter that is a number, in its unit; `None` for another form or name.
    fn number(&self, name: &str) -> Option<f64> {
        self.parameter(name)?.as_f64()
    }

    /// Returns the pairs of a parameter that is a list of pairs.
    fn pairs(&self, name: &str) -> Vec<(f64, f64)> {
        self.parameter(name).iter().filter_map(Value::as_array).flatten().filter_map(pair_of).collect()
    }
}

/// A type of parameter.
pub(super) trait Field: Sized {
    /// Reads the parameter from an entry's checked values.
    fn read(values: &Values<'_>, name: &str) -> Self;
    /// Returns the parameter in the form of an entry.
    fn write(&self) -> Value;
}

macro_rules! fields {
    ($($type:ty: $read:ident, |$value:ident| $write:expr;)+) => {$(
        impl Field for $type {
            fn read(values: &Values<'_>, name: &str) -> Self {
                values.$read(name)
            }
            fn write(&self) -> Value {
                let $value = self;
                $write
            }
        }
    )+};
}

fields! {
    f64: number, |value| (*value).into();
    u64: whole, |value| (*value).into();
    Vec<f64>: numbers, |list| list.clone().into();
    Vec<(f64, f64)>: pairs, |points| super::profile::value(points);
    [[f64; 3]; 3]: matrix, |rows| json!(rows);
}

/// Returns the parameters that a model writes, from values in the table's order.
pub(super) fn written<const N: usize>(spec: &'static Spec, values: [Value; N]) -> Vec<(&'static str, Value)> {
    let pairs = spec.parameters.iter().zip(values).filter(|(parameter, value)| parameter.writes(value));
    pairs.map(|(parameter, value)| (parameter.name, value)).collect()
}

/// Describes a type: its stream, stage, meaning and phrases, its parameters, and how it is read and written.
macro_rules! described {
    (
        $type:ident: $trait:ty, $stream:literal, $stage:expr $(, $nature:ident)?;
        $meaning:literal $(=> $($phrase:literal),+)?;
        [$($parameter:expr),* $(,)?] $(, $forms:expr)?;
        |$values:ident| $make:expr, |$of:ident| $write:expr
    ) => {
        impl $type {
            /// The table of the effect.
            pub const SPEC: &'static $crate::effects::Spec = &$crate::effects::Spec {
                kind: $crate::effects::EffectKind::$type,
                stream: $stream,
                stage: $stage,
                nature: $crate::effects::described::described!(@nature $($nature)?),
                parameters: &[$($parameter),*],
                forms: $crate::effects::described::described!(@forms $($forms)?),
                meaning: $meaning,
                phrases: &[$($($phrase),+)?],
            };
            /// The table of the effect, and how it is made from an entry.
            pub const DEFINITION: &'static $crate::effects::spec::Definition<$trait> =
                &$crate::effects::spec::Definition { spec: Self::SPEC, make: |$values| std::sync::Arc::new($make) };
        }

        impl $crate::effects::described::Described for $type {
            fn spec(&self) -> &'static $crate::effects::Spec {
                Self::SPEC
            }
            fn parameters(&self) -> Vec<(&'static str, serde_json::Value)> {
                let $of = self;
                $write
            }
        }
    };
    (@nature) => {
        $crate::effects::spec::Nature::Other
    };
    (@nature $nature:ident) => {
        $crate::effects::spec::Nature::$nature
    };
    (@forms) => {
        &[]
    };
    (@forms $forms:expr) => {
        $forms
    };
}
pub(super) use described;

/// Defines the type of an effect whose fields are its parameters, and describes it.
macro_rules! effect {
    (
        $(#[$meta:meta])*
        pub struct $type:ident: $trait:ty, $stream:literal, $stage:expr $(, $nature:ident)?;
        $meaning:literal $(=> $($phrase:literal),+)?;
        $($field:ident $(as $key:literal)?: $of:ty = $form:expr, $unit:literal, $words:literal $(, $need:expr)?;)+
    ) => {
        $(#[$meta])*
        pub struct $type {
            $(#[doc = $words] pub $field: $of,)+
        }

        $crate::effects::described::described! {
            $type: $trait, $stream, $stage $(, $nature)?;
            $meaning $(=> $($phrase),+)?;
            [$($crate::effects::spec::Parameter::new(
                $crate::effects::described::effect!(@key $field $($key)?), $form, $unit, $words
            )$(.needed($need))?),+];
            |values| $type {
                $($field: $crate::effects::described::Field::read(
                    values, $crate::effects::described::effect!(@key $field $($key)?)
                )),+
            },
            |of| $crate::effects::described::written(
                Self::SPEC, [$($crate::effects::described::Field::write(&of.$field)),+]
            )
        }
    };
    (@key $field:ident) => {
        stringify!($field)
    };
    (@key $field:ident $key:literal) => {
        $key
    };
}
pub(super) use effect;
