//! Blind check of the diagnosis with a known motion: sealed cases, keys, scores.
//!
//! In: a sealed seed; diagnoses in the documented form, from any program. Out: recordings with references and models
//! that lack an effect ([`case`]), keys, scores ([`score`]). Each device goes through a separate motion ([`course`]).
//! Code separate from the simulator's computes its response ([`impose`]), and the trial's own ground makes the noise.
//!
//! Sizes are multiples of a limit. The limit is the size at which a test finds the effect in nine of ten records at the
//! diagnosis' price ([`bound`], from the Cramér–Rao bound). That test knows the noise, but neither the other effects
//! nor the clock.

pub mod bound;
pub mod case;
pub mod course;
pub mod impose;
pub mod kind;
pub mod score;

pub use case::{Case, Key, TrueEffect};
pub use kind::{Kind, plan};
pub use score::{Judgement, Score, judge};
