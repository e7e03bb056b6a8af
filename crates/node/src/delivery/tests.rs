//! Simulates delivery and settings between nodes and a hub, in one thread under virtual time: the real code on real files,
//! connected by a network that loses, delays, duplicates and reorders messages. A seed decides what fails and when; the same
//! seed always gives the same run.
//!
//! `make simulate SEEDS=10000` runs many seeds, each day others, and prints what was checked; `make simulate SEED=7` runs one
//! and prints its events.

mod clocks;
mod hub;
mod node;
mod settings;
mod timeline;
mod world;

use parking_lot::Mutex;
use settings::Settings;
use std::collections::BTreeMap;
use std::panic::catch_unwind;
use std::time::Instant;
use world::World;

fn setting(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Whether events are printed as they happen.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Output {
    Silent,
    Printed,
}

/// Runs a seed; panics if the final state is wrong, and returns all that happened.
type Simulation = fn(u64, Output) -> String;

/// How often each oracle was asked.
static ORACLES: Mutex<BTreeMap<&str, u64>> = Mutex::new(BTreeMap::new());

/// Asks an oracle; panics with its name and what is wrong if it is not `right`.
fn holds(oracle: &'static str, right: bool, wrong: impl FnOnce() -> String) {
    *ORACLES.lock().entry(oracle).or_default() += 1;
    assert!(right, "oracle `{oracle}`: {}", wrong());
}

/// What is wrong with the run of a seed, and the command that reproduces it.
fn fault_of(simulation: Simulation, seed: u64, output: Output) -> Option<String> {
    let panic = catch_unwind(|| simulation(seed, output)).err()?;
    let text = match panic.downcast_ref::<String>() {
        Some(text) => text.as_str(),
        // A message without values.
        None => panic.downcast_ref::<&str>().copied().unwrap_or_default(),
    };
    Some(format!(
        "seed {seed}: {text}\n  again: make simulate SEED={seed}"
    ))
}

/// Runs a `share`-th of the seeds on all cores.
fn run_seeds(simulation: Simulation, share: u64) {
    let many = setting("ALBIREO_SEEDS").unwrap_or(1000).div_ceil(share);
    let first = setting("ALBIREO_FIRST_SEED").unwrap_or(0);
    let (seeds, output) = match setting("ALBIREO_SEED") {
        Some(seed) => (seed..seed + 1, Output::Printed),
        None => (first..first + many, Output::Silent),
    };
    let began = Instant::now();
    // Each thread needs a few megabytes of memory for its files.
    let threads = std::thread::available_parallelism().map_or(1, |many| many.get().min(8));
    let mut faults: Vec<_> = std::thread::scope(|scope| {
        let spawn = |number| {
            let seeds = seeds.clone().skip(number).step_by(threads);
            let faults = seeds.filter_map(move |seed| fault_of(simulation, seed, output));
            scope.spawn(|| faults.collect::<Vec<_>>())
        };
        let spawned: Vec<_> = (0..threads).map(spawn).collect();
        spawned.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    println!(
        "seeds {seeds:?} in {:.0?}; the oracles, and how often each was asked:",
        began.elapsed()
    );
    for (oracle, asked) in &*ORACLES.lock() {
        println!("{asked:>9} {oracle}");
    }
    faults.truncate(5);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn no_seed_loses_or_duplicates_a_report() {
    run_seeds(World::run, 1);
}

#[test]
fn no_seed_forgets_a_change_or_a_return() {
    // A seed takes ten times as long as one of delivery.
    run_seeds(Settings::run, 10);
}

#[test]
fn seeds_that_once_found_a_fault_of_changes_and_rollouts_find_none() {
    // 77: a hub that was put back from its backup gave a revision a second time, which a node had already. 2289: a hub was
    // killed between stopping a rollout and noting its end, and the rollout stayed open for ever. 2256, 2343: a node kept a
    // value under the revision before it, and a power cut between the two files made it refuse the right one.
    for seed in [77, 2289, 2256, 2343] {
        assert_eq!(fault_of(Settings::run, seed, Output::Silent), None);
    }
}

#[test]
fn one_seed_gives_one_run_byte_for_byte() {
    for simulation in [World::run as Simulation, Settings::run] {
        for seed in 0..8 {
            let once = simulation(seed, Output::Silent);
            let twice = simulation(seed, Output::Silent);
            let other = once.lines().zip(twice.lines()).find(|(once, twice)| once != twice);
            assert_eq!(other, None, "seed {seed}");
            // Nor is one the beginning of the other.
            assert!(once == twice, "seed {seed}");
            assert!(
                once.lines().count() > 50,
                "seed {seed}: too little happened"
            );
        }
        let first = simulation(1, Output::Silent);
        let second = simulation(2, Output::Silent);
        assert_ne!(first, second);
    }
}
