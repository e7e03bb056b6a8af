//! Delivery from the outboxes of nodes to the database of a hub, in one thread under virtual time: the real outbox on its real
//! file, the real schedule, the real decoder and the real writer of the hub's database, joined by a network that loses,
//! delays, doubles and reorders. A seed decides what fails and when; one seed gives one run.
//!
//! `make simulate SEEDS=10000` runs many; `make simulate SEED=7` runs one and prints what happens.

mod hub;
mod node;
mod world;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;
use world::{Run, World};

/// A number from the environment.
fn setting(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Runs a seed; what is wrong afterwards, and how to run it again.
fn run(seed: u64, verbose: bool) -> Result<Run, String> {
    let ran = catch_unwind(AssertUnwindSafe(|| World::new(seed, verbose).run()));
    let ran = ran.unwrap_or_else(|_| Err("it panicked".to_owned()));
    ran.map_err(|wrong| format!("seed {seed}: {wrong}\n  again: make simulate SEED={seed}"))
}

/// What many runs came to.
#[derive(Default)]
struct Summary {
    seeds: u64,
    node_hours: f64,
    reports: u64,
    faults: BTreeMap<&'static str, u64>,
    wrong: Vec<String>,
}

impl Summary {
    fn add(&mut self, ran: Result<Run, String>) {
        self.seeds += 1;
        match ran {
            Ok(run) => {
                self.node_hours += run.node_hours;
                self.reports += run.reports;
                for (fault, times) in run.faults {
                    *self.faults.entry(fault).or_default() += times;
                }
            }
            Err(wrong) => self.wrong.push(wrong),
        }
    }

    fn line(&self, began: Instant) -> String {
        let seconds = began.elapsed().as_secs_f64();
        format!(
            "{} seeds in {seconds:.0} s, {:.0} node-hours, {} reports, {} seeds failed",
            self.seeds,
            self.node_hours,
            self.reports,
            self.wrong.len()
        )
    }
}

#[test]
fn no_seed_loses_or_doubles_a_report() {
    let replayed = setting("ALBIREO_SEED");
    let first = replayed.unwrap_or(0);
    let many = replayed.map_or_else(|| setting("ALBIREO_SEEDS").unwrap_or(1000), |_| 1);
    let (began, next) = (Instant::now(), AtomicU64::new(first));
    let summary = Mutex::new(Summary::default());
    // Each takes some megabytes of memory for its files.
    let threads = std::thread::available_parallelism().map_or(1, |many| many.get().min(8));
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + many {
                        return;
                    }
                    let ran = run(seed, replayed.is_some());
                    let mut summary = summary.lock().unwrap();
                    summary.add(ran);
                    if summary.seeds.is_multiple_of(1000) {
                        println!("{}", summary.line(began));
                    }
                    if summary.wrong.len() >= 5 {
                        return;
                    }
                }
            });
        }
    });
    let summary = summary.into_inner().unwrap();
    println!("{}; faults: {:?}", summary.line(began), summary.faults);
    assert!(summary.wrong.is_empty(), "{}", summary.wrong.join("\n"));
}

#[test]
fn one_seed_gives_one_run() {
    for seed in 0..25 {
        let [once, twice] = [(), ()].map(|()| run(seed, false).unwrap());
        assert!(once.trace == twice.trace, "seed {seed}");
    }
}
