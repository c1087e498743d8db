//! Suites: frozen sets of cases that others can compare with.
//!
//! A suite is a seed, a number of cases and a length. Its cases cover every class and kind, including the kept ones.
//! The generator must not change: the manifest of a suite and the digests of some of its parcels are in the repository,
//! and a test reproduces them. A change of the generator needs a suite of another name. The digests hold on x86-64
//! Linux with the mathematical functions of Rust's standard library there. On other platforms, the last digits of a
//! logarithm or a cosine may differ.

use super::class::Class;

/// A frozen set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Suite {
    /// The name of the suite.
    pub name: &'static str,
    /// The seed of the cases.
    pub seed: u64,
    /// The number of cases.
    pub cases: usize,
    /// The number of samples per case.
    pub samples: usize,
    /// SHA-256 of the manifest, as the program writes it.
    pub manifest_sha256: &'static str,
    /// SHA-256 of the parcel of the first case of each class, in the order of [`Class::ALL`].
    pub parcels_sha256: [&'static str; Class::ALL.len()],
}

/// All suites.
pub const SUITES: [Suite; 1] = [Suite {
    name: "2026",
    seed: 2026,
    cases: 1_000,
    samples: 65_536,
    manifest_sha256: "7e29f291860dd3cffe4c996d0cd5519ea74b68bf3383852e4892e7ccc0da94c6",
    parcels_sha256: [
        "e85f8ef1e8f4829b29eff2ecacd44d928248df3a3564846d1fbef3fe4df0803f",
        "ca7f4c7ad49cfc5ec66c43ba0748ec4d59921760decc6b4075d856a9f63d3610",
        "a1c49c7b768eec41de8aba1262fb24ed3db20a40c0ee4b2074609fd0f55dfe94",
        "676c714d12afa3dcc18fe61f51760573bac2a83e8dd5d03a235f0c1be5a5f14f",
        "2ed8626fa9065d4ae548b041ae7c621214487fdb96396ea454e8dc42ffc573e4",
        "c6f7e5b6954269722643a1cde8bf56182734666aed4de34af4bfb4607a64c5a1",
        "3e2690f00f6c3739f29d1210ae02811ac6ca732ee86d132db9304bb2869976c2",
        "6ddc0bcd2c6c10c466778268d82fe4c86f8e233f0f42b87a24abbd48857737e5",
        "2bbea878b6c471282aad62aa0163fc585438a5cb5bb7a084d35574a2c28fe651",
    ],
}];

impl Suite {
    /// Returns the suite of this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        SUITES.iter().find(|suite| suite.name == name)
    }

    /// Returns the words for the classes of the cases: all.
    pub fn words() -> String {
        Class::ALL.map(Class::name).join(",")
    }

    /// Returns the information needed for a comparison with the suite, in words.
    pub fn described(&self, manifest_sha256: &str) -> String {
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
    use crate::case::Case;
    use crate::key::{Key, Manifest};
    use crate::parcel::pack;
    use crate::plan::{Wanted, plan};
    use sha2::{Digest as _, Sha256};

    #[test]
    fn the_cases_of_a_suite_never_change() {
        let words = Suite::words();
        let wanted = Wanted::from_words(words.split(',')).unwrap();
        let digest =
            |bytes: &[u8]| -> String { Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect() };
        for suite in SUITES {
            let recipes = plan(suite.seed, suite.cases, &wanted);
            let case = |(index, recipe)| Case::make(suite.seed, index, recipe, Some(suite.samples)).unwrap();
            let cases: Vec<Case> = recipes.iter().enumerate().map(case).collect();
            let keys: Vec<Key> = cases.iter().map(Case::key).collect();
            for (case, key) in cases.iter().zip(&keys) {
                assert_eq!(case.model().check(key.rate_hz), Ok(()), "{key:?}");
            }
            let parcels = Class::ALL.map(|class| {
                let first = &cases[keys.iter().position(|key| key.class == class).unwrap()];
                digest(&pack(&first.record(), &first.model(), first.is_table()).unwrap())
            });
            let manifest = digest(&serde_json::to_vec_pretty(&Manifest::of(&keys)).unwrap());
            let expected = (suite.manifest_sha256.to_owned(), suite.parcels_sha256.map(str::to_owned));
            assert_eq!((manifest, parcels), expected, "suite {}", suite.name);
        }
    }
}
