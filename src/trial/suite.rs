//! Suites: frozen sets of cases that others can compare with.
//!
//! A suite is a seed, a number of cases and a length. Its cases are those of every class and kind, also of those that are kept. What
//! makes them must not change: the manifest of a suite is in the repository, and a test makes it anew. A change of the generator needs a
//! suite of another name.

use super::class::Class;

/// A frozen set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(clippy::exhaustive_structs, reason = "its facts")]
pub struct Suite {
    /// Its name.
    pub name: &'static str,
    /// The seed of its cases.
    pub seed: u64,
    /// How many there are.
    pub cases: usize,
    /// Samples of each.
    pub samples: usize,
    /// SHA-256 of its manifest, as the program writes it.
    pub manifest_sha256: &'static str,
}

/// Those there are.
pub const SUITES: [Suite; 1] = [Suite {
    name: "2026",
    seed: 2026,
    cases: 1_000,
    samples: 65_536,
    manifest_sha256: "d62a91fe7a46160aa9aef39b804ef51d46806815aaecc50af63e3e09662e4bbf",
}];

impl Suite {
    /// The one of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        SUITES.iter().find(|suite| suite.name == name)
    }

    /// The words for the classes of its cases: all.
    #[must_use]
    pub fn words() -> String {
        Class::ALL.map(Class::name).join(",")
    }

    /// What someone needs who compares with it, in words.
    #[must_use]
    pub fn told(&self, manifest_sha256: &str) -> String {
        let kept = if manifest_sha256 == self.manifest_sha256 {
            "the manifest is the frozen one".to_owned()
        } else {
            format!("the manifest is not the frozen one, {}: these are other cases", self.manifest_sha256)
        };
        format!(
            "Suite {}: {} cases of {} samples of seed {}, of every class and kind. Their manifest has SHA-256 {manifest_sha256}; {kept}. \
             Rates of two programs are comparable where the manifest is the same and the rules of judging are those of docs/trial.md.",
            self.name, self.cases, self.samples, self.seed
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trial::case::Case;
    use crate::trial::key::{Key, Manifest};
    use crate::trial::plan::{Wanted, plan};
    use sha2::{Digest as _, Sha256};

    #[test]
    fn the_cases_of_a_suite_never_change() {
        let words = Suite::words();
        let wanted = Wanted::from_words(words.split(',')).unwrap();
        for suite in SUITES {
            let recipes = plan(suite.seed, suite.cases, &wanted);
            let key = |(index, recipe)| Case::make(suite.seed, index, recipe, Some(suite.samples)).unwrap().key();
            let keys: Vec<Key> = recipes.iter().enumerate().map(key).collect();
            let text = serde_json::to_vec_pretty(&Manifest::of(&keys)).unwrap();
            let found: String = Sha256::digest(&text).iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(found, suite.manifest_sha256, "suite {}", suite.name);
        }
    }
}
