//! Options: the inputs of a diagnosis besides record and model.

use super::prices::Tails;
use super::remainder::MATERIAL;
use super::work::{Alone, Workers};
use imu_model::effects::EffectKind;

/// The inputs of a diagnosis besides record and model.
#[derive(Clone, Copy)]
pub struct Options<'a> {
    /// The program and its version.
    pub software: &'a str,
    /// The name of the recording.
    pub real: &'a str,
    /// The name of the model.
    pub sim: &'a str,
    /// The chance with which an effect may be named in a record of noise alone.
    pub level: f64,
    /// The scheduler of the work.
    pub workers: &'a dyn Workers,
    /// Part of the gap above which the remainder makes the verdict `unknown_effect`.
    pub unknown_above: f64,
    /// The effects to look for; `None` looks for all.
    pub effects: Option<&'a [EffectKind]>,
    /// Whether the model's B and K are expected to be about right. Otherwise they are fitted without prior knowledge.
    pub believed: bool,
    /// The distribution of chance gains in records of this length ([`super::calibration`]); without it, that of the
    /// shipped table.
    pub tails: Option<&'a Tails>,
}

/// Effects with the spectrum of a band.
pub(super) const BANDS: [EffectKind; 4] =
    [EffectKind::Resonance, EffectKind::ModulatedBand, EffectKind::WanderingLine, EffectKind::Intermittent];

impl Options<'_> {
    /// Returns whether an effect is looked for.
    pub fn wants(&self, effect: EffectKind) -> bool {
        // Lines at multiples of one another are found as tones. Bands whose level changes, lines that wander and bands that come and go are found as bands.
        let alike: &[EffectKind] = match effect {
            EffectKind::Tone | EffectKind::Comb => &[EffectKind::Tone, EffectKind::Comb],
            band if BANDS.contains(&band) => &BANDS,
            _ => &[],
        };
        self.effects.is_none_or(|kinds| kinds.contains(&effect) || alike.iter().any(|kind| kinds.contains(kind)))
    }
}

impl std::fmt::Debug for Options<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Options").field("real", &self.real).field("sim", &self.sim).finish_non_exhaustive()
    }
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self {
            software: "vn100d",
            real: "",
            sim: "",
            level: 0.005,
            workers: &Alone,
            unknown_above: MATERIAL,
            effects: None,
            believed: true,
            tails: None,
        }
    }
}
