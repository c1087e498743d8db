//! Mutations: a valid input, changed a little or a lot.

use rand::seq::IndexedRandom as _;
use rand::{Rng, RngExt as _};

/// Numbers at which programs often fail.
const INTERESTING: [u64; 12] =
    [0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, 0x7FFF_FFFF_FFFF_FFFF, u64::MAX];
/// Numbers as text.
const INTERESTING_TEXT: [&str; 12] = [
    "0",
    "-0",
    "-1",
    "1e308",
    "-1e309",
    "nan",
    "inf",
    "1e-320",
    "18446744073709551616",
    "9223372036854775807",
    "0x10",
    "",
];
/// Longest input.
const LENGTH_MAX: usize = 64 * 1024;

/// Returns an input of the corpus with one to eight changes.
pub fn mutated(corpus: &[Vec<u8>], dictionary: &[&[u8]], random: &mut impl Rng) -> Vec<u8> {
    let mut input = corpus.choose(random).cloned().unwrap_or_default();
    for _ in 0..random.random_range(1..=8) {
        change(&mut input, corpus, dictionary, random);
    }
    input.truncate(LENGTH_MAX);
    input
}

fn change(input: &mut Vec<u8>, corpus: &[Vec<u8>], dictionary: &[&[u8]], random: &mut impl Rng) {
    let at = random.random_range(0..=input.len());
    let end = (at + random.random_range(0..64)).min(input.len());
    match random.random_range(0..10) {
        0 => {
            if let Some(byte) = input.get_mut(at) {
                *byte ^= 1 << random.random_range(0..8);
            }
        }
        1 => {
            for byte in &mut input[at..end] {
                *byte = random.random();
            }
        }
        2 => input.truncate(at),
        3 => drop(input.drain(at..end)),
        4 => {
            // Repeat a piece, once or many times.
            let piece = input[at..end].repeat(if random.random_bool(0.9) { 1 } else { 50 });
            input.splice(at..at, piece);
        }
        5 => {
            let other = corpus.choose(random).cloned().unwrap_or_default();
            let from = random.random_range(0..=other.len());
            let to = (from + random.random_range(0..512)).min(other.len());
            input.splice(at..end, other[from..to].iter().copied());
        }
        6 => {
            let bytes = INTERESTING.choose(random).copied().unwrap_or(0).to_le_bytes();
            let width = [1, 2, 4, 8].choose(random).copied().unwrap_or(1);
            for (byte, new) in input[at..].iter_mut().zip(&bytes[..width]) {
                *byte = *new;
            }
        }
        7 => {
            let text = INTERESTING_TEXT.choose(random).copied().unwrap_or("");
            let digits = input[at..].iter().take_while(|byte| byte.is_ascii_digit() || **byte == b'.').count();
            input.splice(at..at + digits, text.bytes());
        }
        8 => {
            let word = dictionary.choose(random).copied().unwrap_or(b"\n");
            input.splice(at..if random.random_bool(0.5) { at } else { end }, word.iter().copied());
        }
        _ => input.insert(at, random.random()),
    }
}
