//! Simulates delivery and settings between nodes and a hub, in one thread under virtual time: the real code on real files,
//! connected by a network that loses, delays, duplicates and reorders messages. A seed decides what fails and when; the same
//! seed always gives the same run.
//!
//! `make simulate SEEDS=10000` runs many seeds; `make simulate SEED=7` runs one and prints its events.

mod hub;
mod node;
mod settings;
mod timeline;
mod world;

use settings::Settings;
use std::collections::BTreeMap;
use std::panic::catch_unwind;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;
use timeline::Run;
use world::World;

/// A number from the environment.
fn setting(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Runs a seed; returns an error if the final state is wrong.
type Simulation = fn(u64, bool) -> Result<Run, String>;

const DELIVERY: Simulation = |seed, verbose| World::new(seed, verbose).run();
const SETTINGS: Simulation = |seed, verbose| Settings::new(seed, verbose).run();

/// Runs a seed; an error names the command that reproduces it.
fn run(simulation: Simulation, seed: u64, verbose: bool) -> Result<Run, String> {
    let ran = catch_unwind(|| simulation(seed, verbose));
    let ran = ran.unwrap_or_else(|_| Err("panicked".to_owned()));
    ran.map_err(|wrong| format!("seed {seed}: {wrong}\n  again: make simulate SEED={seed}"))
}

/// Runs a `share`-th of the seeds on all cores, until five have failed.
fn run_seeds(simulation: Simulation, what: &str, share: u64) {
    let replayed = setting("ALBIREO_SEED");
    let first = replayed.unwrap_or(0);
    let many = setting("ALBIREO_SEEDS").unwrap_or(1000).div_ceil(share);
    let many = replayed.map_or(many, |_| 1);
    let (began, next) = (Instant::now(), AtomicU64::new(first));
    let (runs, wrong) = (Mutex::new(Vec::new()), Mutex::new(Vec::new()));
    // Each thread needs a few megabytes of memory for its files.
    let threads = std::thread::available_parallelism().map_or(1, |many| many.get().min(8));
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while wrong.lock().unwrap().len() < 5 {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + many {
                        return;
                    }
                    match run(simulation, seed, replayed.is_some()) {
                        Ok(run) => runs.lock().unwrap().push(run),
                        Err(one) => wrong.lock().unwrap().push(one),
                    }
                }
            });
        }
    });
    let (runs, wrong) = (runs.into_inner().unwrap(), wrong.into_inner().unwrap());
    let mut faults = BTreeMap::<&str, u64>::new();
    for (fault, times) in runs.iter().flat_map(|run| &run.faults) {
        *faults.entry(fault).or_default() += times;
    }
    println!(
        "{} seeds in {:.0} s, {} {what}, {} seeds failed; faults: {faults:?}",
        runs.len(),
        began.elapsed().as_secs_f64(),
        runs.iter().map(|run| run.made).sum::<u64>(),
        wrong.len()
    );
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_seed_loses_or_duplicates_a_report() {
    run_seeds(DELIVERY, "reports", 1);
}

#[test]
fn no_seed_forgets_a_change_or_a_return() {
    // A seed takes ten times as long as one of delivery.
    run_seeds(SETTINGS, "orders and rollouts", 10);
}

#[test]
fn seeds_that_once_found_a_fault_of_changes_and_rollouts_find_none() {
    // Revisions were reused after a restore; a rollout stopped just as the hub was killed never ended.
    for seed in [6, 1185] {
        let ran = run(SETTINGS, seed, false);
        assert_eq!(ran.err(), None);
    }
}

#[test]
fn one_seed_gives_one_run() {
    for simulation in [DELIVERY, SETTINGS] {
        for seed in 0..5 {
            let [once, twice] = [(), ()].map(|()| run(simulation, seed, false).unwrap());
            assert!(once.trace == twice.trace, "seed {seed}");
        }
    }
}
