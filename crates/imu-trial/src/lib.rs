//! Trial: a blind check of the diagnosis on cases that an independent party might have made. Pure.
//!
//! In: a sealed seed; diagnoses in the form of docs/formats.md, from any program. Out: recordings with models that lack an effect
//! ([`case`]), keys and a manifest that binds them ([`key`]), scores ([`score`]) and a page of them ([`page`]).
//!
//! A case is a device ([`setting`]) with noise from separate code ([`ground`]). Its effects have forms that differ on
//! purpose from those that the diagnosis fits ([`impose`]). Their sizes follow from the limits of a feasibility study
//! ([`limit`]). [`bound`] computes the size below which no test finds an effect, and [`detection`] the size from which
//! on this diagnosis finds it. [`plan`] determines the cases, [`declared`] a model's statements of the effects that it
//! has, [`stamps`] the form of stamps, and [`suite`] the frozen sets. The rules of [`mod@fit`] decide whether a named
//! cause is right, those of [`place`] whether `where` is right, and those of [`again`] whether the result holds on
//! other data. Effects act on columns of samples ([`columns`]), simulated or recorded: [`recorded`] imposes them on an
//! existing recording.
//!
//! The shell keeps this order: one process makes the cases and another diagnoses them. The cases are passed on as
//! parcels ([`parcel`]), which carry no information about the key. The manifest comes first, the keys last.

pub mod again;
pub mod bound;
pub mod case;
pub mod class;
pub mod columns;
mod compare;
pub mod declared;
pub mod detection;
pub mod draw;
pub mod fit;
pub mod ground;
pub mod impose;
pub mod interval;
pub mod judge;
pub mod key;
pub mod kind;
pub mod limit;
pub mod motion;
pub mod of_kind;
pub mod page;
pub mod parcel;
pub mod place;
pub mod plan;
pub mod posed;
pub mod rates;
pub mod recipe;
pub mod recorded;
pub mod report;
pub mod score;
pub mod setting;
pub mod stamps;
pub mod suite;

pub use again::Again;
pub use case::Case;
pub use class::{Class, Sense};
pub use impose::Effect;
pub use judge::{Answer, judge};
pub use key::{Key, Manifest};
pub use kind::Kind;
pub use plan::{Wanted, plan};
pub use rates::Rates;
pub use recipe::Recipe;
pub use recorded::{Stretch, Survey};
pub use report::Report;
pub use score::Score;
pub use suite::Suite;
