//! Blind check of the diagnosis with a known motion: sealed cases, keys, scores.
//!
//! In: a sealed seed; diagnoses in the documented form, whoever made them. Out: recordings with references and models that lack
//! something ([`case`]), keys, scores ([`score`]). A device goes through a motion of its own ([`course`]); what it shows of it is
//! made by code apart from the simulator's ([`impose`]), the noise by the trial's own ground.
//!
//! Sizes are told in limits: the size at which a test that knows the noise, and neither of the other effects nor the clock,
//! finds the effect in nine of ten records at the price that the diagnosis asks ([`bound`], from the Cramér–Rao bound).

pub mod bound;
pub mod case;
pub mod course;
pub mod impose;
pub mod kind;
pub mod score;

pub use case::{Case, Key, TrueEffect};
pub use kind::{Kind, plan};
pub use score::{Judgement, Score, judge};
