//! Fuzzing on the stable toolchain: mutations of small valid inputs, by a seed.
//!
//! Each target ([`targets`]) is a function of bytes that panics if its promise does not hold; libFuzzer runs the same
//! functions (`fuzz/`). Here each runs for `VN100D_FUZZ` (default `2s`) on mutations of a corpus made by this project's
//! own encoders. A failure prints seed, case and a minimised input; `VN100D_FUZZ_SEED=N` repeats a run. Besides the
//! targets' promises, every input must stay within a limit of memory and of time.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on fails")]

mod corpus;
mod mutate;
mod regressions;
mod targets;

use peak_alloc::PeakAlloc;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use std::panic::AssertUnwindSafe;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// The maximum memory that one input may take in addition: readers' buffers, not the claim of a length field.
const MEMORY_MAX_BYTES: usize = 48 << 20;
/// The time limit of one input on a loaded machine.
const TIME_MAX: Duration = Duration::from_secs(20);

/// One target at a time: memory is counted for the whole process.
static ALONE: Mutex<()> = Mutex::new(());

/// Returns the reason why an input failed; `None` if it did not.
fn failure(target: targets::Target, input: &[u8]) -> Option<String> {
    ALLOCATOR.reset_peak_usage();
    let before = ALLOCATOR.current_usage();
    let started = Instant::now();
    let outcome = std::panic::catch_unwind(AssertUnwindSafe(|| target(input)));
    let taken = ALLOCATOR.peak_usage().saturating_sub(before);
    match outcome {
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            Some(text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic").to_owned())
        }
        Ok(()) if taken > MEMORY_MAX_BYTES => Some(format!("it took {taken} bytes of memory")),
        Ok(()) if started.elapsed() > TIME_MAX => Some(format!("it took {:?}", started.elapsed())),
        Ok(()) => None,
    }
}

/// Returns a smaller input that fails too: pieces are removed as long as it does.
fn minimised(target: targets::Target, mut input: Vec<u8>) -> Vec<u8> {
    let deadline = Instant::now() + Duration::from_secs(10);
    let mut piece = input.len() / 2;
    while piece > 0 && Instant::now() < deadline {
        let mut at = 0;
        while at < input.len() && Instant::now() < deadline {
            let mut shorter = input.clone();
            shorter.drain(at..(at + piece).min(input.len()));
            if failure(target, &shorter).is_some() { input = shorter } else { at += piece }
        }
        piece /= 2;
    }
    input
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn check(name: &str, target: targets::Target, input: &[u8], context: &str) {
    let Some(why) = failure(target, input) else { return };
    let small = minimised(target, input.to_vec());
    panic!("{name}, {context}: {why}\nminimised, {} bytes: {}", small.len(), hex(&small));
}

/// Runs a target on its regressions, its corpus, and mutations of the corpus.
fn fuzz(name: &str) {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let target = targets::TARGETS.iter().find(|(known, _)| *known == name).unwrap().1;
    for (index, input) in regressions::of(name).iter().enumerate() {
        check(name, target, input, &format!("regression {index}"));
    }
    let corpus = corpus::of(name);
    for (index, input) in corpus.iter().enumerate() {
        check(name, target, input, &format!("corpus {index}"));
    }
    let patience = std::env::var("VN100D_FUZZ").map_or(Duration::from_secs(2), |text| {
        imu_core::units::parse_duration(&text).expect("VN100D_FUZZ is a duration such as 20s")
    });
    let seed = std::env::var("VN100D_FUZZ_SEED").map_or_else(
        |_| std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs(),
        |text| text.parse().expect("VN100D_FUZZ_SEED is a whole number"),
    );
    let started = Instant::now();
    let mut cases = 0;
    // Each case has a separate random stream, so that it does not depend on the number of earlier cases.
    while started.elapsed() < patience {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(cases);
        let input = mutate::mutated(&corpus, corpus::dictionary(name), &mut random);
        check(name, target, &input, &format!("VN100D_FUZZ_SEED={seed}, case {cases}"));
        cases += 1;
    }
    println!("{name}: seed {seed}, {cases} cases in {:.1} s", started.elapsed().as_secs_f64());
    assert!(cases > 0);
}

#[test]
fn the_decoder_accounts_for_every_byte_in_any_split() {
    fuzz("decoder");
}

#[test]
fn a_csv_gives_every_row_as_a_sample_or_a_rejected_one() {
    fuzz("csv");
}

#[test]
fn raw_text_gives_every_line_as_a_sample_or_a_rejected_one() {
    fuzz("raw_text");
}

#[test]
fn a_bag_of_any_bytes_takes_bounded_memory_and_loses_nothing_unreported() {
    fuzz("bag");
}

#[test]
fn a_bag_of_ros_2_of_any_bytes_takes_bounded_memory_and_loses_nothing_unreported() {
    fuzz("db3");
}

#[test]
fn an_mcap_file_of_any_bytes_takes_bounded_memory_and_loses_nothing_unreported() {
    fuzz("mcap");
}

#[test]
fn a_table_of_any_form_takes_bounded_memory_and_loses_nothing_unreported() {
    fuzz("table");
}

#[test]
fn a_map_and_a_part_of_any_kind_are_refused_or_kept_to() {
    fuzz("mapped");
}

#[test]
fn raw_bytes_of_any_kind_take_bounded_memory_and_lose_nothing_unreported() {
    fuzz("raw_bytes");
}

#[test]
fn a_configuration_is_taken_or_refused_with_its_place() {
    fuzz("config");
}

#[test]
fn no_request_is_answered_with_a_server_error() {
    fuzz("http");
}

#[test]
fn requests_of_the_corpus_reach_what_they_ask_for() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    for input in corpus::of("http").iter().filter(|input| input.starts_with(b"GET ")) {
        let status = targets::http::answered(input).unwrap().as_u16();
        assert!(status < 300, "{status}: {}", String::from_utf8_lossy(input));
    }
}

#[test]
fn a_script_of_faults_is_taken_or_refused_with_its_line() {
    fuzz("faults");
}

#[test]
fn a_failing_target_is_found_and_its_input_minimised() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let target: targets::Target = |input| assert!(!input.windows(2).any(|pair| pair == b"$V"), "found");
    let corpus = [b"a line with $VN in it".to_vec(), b"another".to_vec()];
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let failing = (0..1000)
        .map(|_| mutate::mutated(&corpus, &[], &mut random))
        .find(|input| failure(target, input).is_some())
        .unwrap();
    assert_eq!(minimised(target, failing), b"$V");
    let hungry: targets::Target = |_| drop(std::hint::black_box(vec![1_u8; MEMORY_MAX_BYTES + 1]));
    assert!(failure(hungry, b"").unwrap().contains("bytes of memory"));
}

/// Writes the corpora for libFuzzer: `cargo test --test fuzz -- --ignored write_the_corpora`.
#[test]
#[ignore = "writes fuzz/corpus"]
fn write_the_corpora() {
    for (name, _) in targets::TARGETS {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        for (index, input) in corpus::of(name).iter().chain(&regressions::of(name)).enumerate() {
            std::fs::write(folder.join(format!("seed-{index}")), input).unwrap();
        }
        let words = corpus::dictionary(name).iter().map(|word| {
            let escaped: String = word.iter().map(|byte| format!("\\x{byte:02X}")).collect();
            format!("\"{escaped}\"\n")
        });
        std::fs::write(folder.with_extension("dict"), words.collect::<String>()).unwrap();
    }
}
