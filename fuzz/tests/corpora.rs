//! Runs every target on stable Rust: over its corpus, over mutations of it, and over random bytes.

use albireo_fuzz::{TARGETS, Target};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use std::path::Path;

/// The inputs of a target's corpus, including those that fuzzing found.
fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = format!("{}/corpus/{target}", env!("CARGO_MANIFEST_DIR"));
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{folder}: {error}"));
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files.iter().map(|file| std::fs::read(file).unwrap()).collect()
}

/// `input` with some bytes replaced, then possibly truncated or doubled.
fn mutated(input: Vec<u8>) -> impl Strategy<Value = Vec<u8>> {
    let length = input.len().max(1);
    let places = prop::collection::vec((0..length, any::<u8>()), 0..8);
    (places, 0..=length, any::<bool>()).prop_map(move |(places, end, doubled)| {
        let mut bytes = input.clone();
        for (place, byte) in places {
            if let Some(there) = bytes.get_mut(place) {
                *there = byte;
            }
        }
        bytes.truncate(end);
        if doubled {
            bytes.extend_from_within(..);
        }
        bytes
    })
}

#[test]
fn every_target_returns_on_corpus_mutated_and_random_inputs() {
    let mut failed = Vec::new();
    for target in TARGETS {
        if let Err(error) = run(target) {
            failed.push(error);
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

/// Runs a target; returns its name and the input on which it panics, if there is one.
fn run((name, target): Target) -> Result<(), String> {
    let seeds = corpus(name);
    let valid = seeds.iter().filter(|seed| target(seed)).count();
    assert!(valid > 0, "{name}: its corpus has no valid input");
    let from_seed = prop::sample::select(seeds).prop_flat_map(mutated);
    let random = prop::collection::vec(any::<u8>(), 0..300);
    let mut runner = TestRunner::new(Config {
        failure_persistence: None,
        ..Config::with_cases(400)
    });
    let ran = runner.run(&prop_oneof![from_seed, random], |bytes| {
        target(&bytes);
        Ok(())
    });
    ran.map_err(|error| format!("{name}: {error}"))
}

#[test]
fn targets_and_fuzzers_match_one_to_one() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest = std::fs::read_to_string(root.join("Cargo.toml")).unwrap();
    for (name, _) in TARGETS {
        let fuzzer = format!("fuzz_targets/{name}.rs");
        assert!(root.join(&fuzzer).is_file(), "{fuzzer}");
        assert!(manifest.contains(&fuzzer), "{fuzzer} is not in Cargo.toml");
    }
    let fuzzers = std::fs::read_dir(root.join("fuzz_targets")).unwrap();
    assert_eq!(fuzzers.count(), TARGETS.len());
}
