//! Blind check of the diagnosis beside poses: effects imposed on a real motion, with the poses that another instrument
//! measured.
//!
//! In: a sealed seed; parts of a recording with the numbers that they show of themselves ([`part`]). Out: recordings
//! with effects that their models lack ([`case`]), keys, judgements ([`mod@judge`]). The laws are those of the trial with a
//! simulated motion ([`crate::motion::impose`]), applied to what the sensor showed ([`impose`]).
//!
//! Sizes are multiples of a limit. The limit is how far a number has to differ from the model's before it is named: the
//! half width of the 95 % interval that the untouched part has of this number, times the factor of the diagnosis.

pub mod case;
pub mod impose;
pub mod judge;
pub mod part;

pub use case::{Case, plan};
pub use judge::judge;
pub use part::{Number, Numbers, Own, Part};
