//! Trial: a blind check of the diagnosis on cases that somebody else might have made. Pure.
//!
//! In: a sealed seed; diagnoses in the form of docs/formats.md, whoever made them. Out: recordings with models that lack
//! something ([`case`]), keys and a manifest that binds them ([`key`]), scores ([`score`]) and a page of them ([`page`]).
//!
//! A case is a device ([`setting`]) with noise by code of its own ([`ground`]) and with effects whose forms are on purpose not
//! those that the diagnosis fits ([`impose`]); how large they are follows from the limits of a feasibility study ([`limit`]).
//! Below which size no test at all finds one is in [`bound`], from which on this one does in [`detection`]. Which cases there are is in [`plan`],
//! what a model says of the effects that it has in [`declared`], how stamps are written in [`stamps`], which sets are frozen in [`suite`].
//! Whether a cause that was named is right is decided by the rules of [`mod@fit`], whether `where` is by those of [`place`], whether it
//! holds on other data by those of [`again`].
//! Effects act on columns of samples ([`columns`]), made here or recorded: [`recorded`] imposes them on a recording that somebody made.
//!
//! Order, which the shell keeps: cases are made by another process than the one that diagnoses them and cross over as
//! parcels ([`parcel`]), which say nothing of the key; the manifest comes first, the keys last.

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
