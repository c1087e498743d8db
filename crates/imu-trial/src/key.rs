//! Keys: the contents of a sealed case, and the manifest that binds the keys before any case is diagnosed.
//!
//! A manifest lists SHA-256 of every case's key as compact JSON. A key has 16 bytes of salt, so that it cannot be
//! guessed. The manifest is written first. The keys are opened last and must have the listed digests.

use super::class::{Class, Sense};
use super::kind::Kind;
use super::stamps::Stamps;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use std::collections::BTreeMap;

/// The manifest's format.
pub const MANIFEST_FORMAT: &str = "vn100d-trial-manifest-1";

/// An effect that a case has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrueEffect {
    /// The kind.
    pub kind: Kind,
    /// The documented name; none outside the library.
    pub effect: Option<String>,
    /// How sensor and model differ in the effect.
    pub sense: Sense,
    /// The size in the units of [`super::limit::limit`].
    pub size: f64,
    /// The size over the limit; for an effect that both have at different sizes, that of the difference.
    pub over_limit: f64,
    /// The channels.
    pub channels: Vec<String>,
    /// The parameters by channel, in the documented form, as far as known without samples. For an effect that the
    /// sensor lacks, they are the model's.
    pub parameters: BTreeMap<String, Value>,
    /// The model's statement, if it has the effect.
    #[serde(rename = "told")]
    pub declared: Option<BTreeMap<String, Value>>,
}

impl TrueEffect {
    /// Returns the parameters to which a cause of this sense refers. For an effect that both have at two places, a
    /// cause that states that the sensor lacks it refers to the model's.
    pub fn meant(&self, sense: Sense) -> &BTreeMap<String, Value> {
        match &self.declared {
            Some(declared) if self.sense == Sense::Elsewhere && sense == Sense::Superfluous => declared,
            _ => &self.parameters,
        }
    }
}

/// The contents of a case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// The case's number.
    pub case: usize,
    /// The case's class.
    pub class: Class,
    /// Samples per second.
    pub rate_hz: f64,
    /// Samples per channel.
    pub samples: usize,
    /// The channels.
    pub channels: Vec<String>,
    /// The effects, in the order in which they act.
    pub effects: Vec<TrueEffect>,
    /// The true N, B and K of each channel.
    pub true_nbk: BTreeMap<String, [f64; 3]>,
    /// How samples are stamped, if they are.
    pub stamps: Option<Stamps>,
    /// 16 random bytes.
    pub salt: String,
}

/// A mismatch of keys and manifest.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// The key of a case is not the sealed one.
    #[error("the key of case {case} has SHA-256 {found}; the manifest has {expected}")]
    Digest {
        /// The case's number.
        case: usize,
        /// The digest in the manifest.
        expected: String,
        /// The digest of the key.
        found: String,
    },
    /// The numbers of keys and digests differ.
    #[error("the manifest has {expected} cases; there are keys of {found}")]
    Count {
        /// The number of digests in the manifest.
        expected: usize,
        /// The number of keys.
        found: usize,
    },
}

impl Key {
    /// Returns the SHA-256 of the key, in hexadecimal digits.
    pub fn digest(&self) -> String {
        // A key only has finite numbers, texts and lists, so that it always has a text.
        let text = serde_json::to_string(self).unwrap_or_default();
        Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// The document that is published before a trial.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`MANIFEST_FORMAT`].
    pub format: String,
    /// SHA-256 of each case's key.
    pub digests: Vec<String>,
}

impl Manifest {
    /// Creates the manifest of these keys.
    pub fn of(keys: &[Key]) -> Self {
        Self::of_digests(keys.iter().map(Key::digest).collect())
    }

    /// Creates the manifest of keys with these digests.
    pub fn of_digests(digests: Vec<String>) -> Self {
        Self { format: MANIFEST_FORMAT.to_owned(), digests }
    }

    /// Checks whether these are the sealed keys.
    ///
    /// # Errors
    /// The first [`KeyError`].
    pub fn verify(&self, keys: &[Key]) -> Result<(), KeyError> {
        self.verify_digests(keys.iter().map(|key| (key.case, key.digest())).collect())
    }

    /// Checks keys with these numbers and digests.
    ///
    /// # Errors
    /// The first [`KeyError`].
    pub fn verify_digests(&self, keys: Vec<(usize, String)>) -> Result<(), KeyError> {
        if keys.len() != self.digests.len() {
            return Err(KeyError::Count { expected: self.digests.len(), found: keys.len() });
        }
        for ((case, found), expected) in keys.into_iter().zip(&self.digests) {
            if found != *expected {
                return Err(KeyError::Digest { case, expected: expected.clone(), found });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Case;

    #[test]
    fn keys_fit_their_manifest_also_after_a_file_and_no_other_does() {
        let keys: Vec<Key> =
            Kind::LIBRARY.iter().enumerate().map(|(case, kind)| Case::draw(5, case, &[*kind]).unwrap().key()).collect();
        let manifest = Manifest::of(&keys);
        let read: Vec<Key> = serde_json::from_str(&serde_json::to_string_pretty(&keys).unwrap()).unwrap();
        assert_eq!(manifest.verify(&read), Ok(()));
        assert_eq!(manifest.verify(&read[1..]), Err(KeyError::Count { expected: 22, found: 21 }));
        let mut other = read;
        other[3].effects[0].size *= 1.0 + 1e-15;
        other[3].effects[0].size += 1e-9;
        assert!(matches!(manifest.verify(&other), Err(KeyError::Digest { case: 3, .. })));
    }

    #[test]
    fn a_salt_is_the_cases_own() {
        let key = |case| Case::draw(5, case, &[]).unwrap().key();
        assert_ne!(key(1).salt, key(2).salt);
        assert_eq!(key(1).salt.len(), 32);
    }
}
