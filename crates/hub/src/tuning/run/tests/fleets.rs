//! Whole rollouts on simulated fleets: nodes vary from hour to hour, park, lie and die.
//!
//! `ALBIREO_ROLLOUTS=1000 cargo test -p albireo-hub --release whole_rollouts -- --nocapture` prints the table of
//! docs/fleet.md; the default number of rollouts is just enough to detect a broken promise.

use super::super::super::metric::{Figure, Figures};
use super::super::super::plan::{Basics, RolloutPlan};
use super::super::*;
use super::{in_windows, new, old, reported};
use albireo_wire::Threshold;

const HOUR: Millis = 3_600_000;
/// Time between two steps of the simulation.
const STEP: Millis = HOUR / 2;

/// Hour-to-hour standard deviation of the logarithm of a node's level.
const SIGMA: f64 = 0.4;
/// Standard deviation within an hour, of ten clips that are correlated by 0.9.
const WITHIN: f64 = SIGMA / 3.0 / 3.162_277_66;
/// Share of the hours in which a node is parked.
const PARKED: f64 = 0.2;
/// Share of the nodes that report invented figures.
const LIARS: f64 = 0.05;

/// Evenly spread numbers from 0 to 1 that depend on their arguments alone.
fn chance(seed: u64, key: [u64; 3]) -> f64 {
    let mut hash = seed;
    for part in key {
        // Steele, Lea and Flood 2014: the mixer of SplitMix64.
        hash = hash.wrapping_add(part).wrapping_add(0x9e37_79b9_7f4a_7c15);
        hash = (hash ^ (hash >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        hash = (hash ^ (hash >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        hash ^= hash >> 31;
    }
    (hash >> 11) as f64 / (1_u64 << 53) as f64
}

/// Normally distributed numbers with deviation 1, by the method of Box and Muller.
fn normal(seed: u64, node: u64, hour: u64) -> f64 {
    // Above 0, for the logarithm.
    let radius = 1.0 - chance(seed, [node, hour, 1]);
    let angle = chance(seed, [node, hour, 2]);
    (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
}

/// A fleet whose nodes apply requested values at once.
struct Fleet {
    seed: u64,
    /// The relative increase of a clip's energy with the new value.
    change: f64,
    /// Each node's value.
    has: Vec<Threshold>,
    now: Millis,
}

impl Fleet {
    fn number(node: &str) -> u64 {
        node.parse().unwrap()
    }

    fn is_parked(&self, node: u64, at: Millis) -> bool {
        chance(self.seed, [node, at.div_euclid(HOUR) as u64, 3]) < PARKED
    }

    /// Clips of the hours of a window in which the node drives.
    fn clips(&self, window: &Window) -> Figures {
        let node = Self::number(&window.node);
        let mut figures = Figures::new();
        let factor = if window.value == new().value.to_string() {
            1.0 + self.change
        } else {
            1.0
        };
        let lies = chance(self.seed, [node, 0, 4]) < LIARS;
        for hour in window.from_ms.div_euclid(HOUR)..window.until_ms.div_euclid(HOUR) {
            if self.is_parked(node, hour * HOUR) {
                continue;
            }
            let noise = |what: u64| {
                let hour = hour as u64;
                let each = 8 * what;
                SIGMA * normal(self.seed + each, node, hour)
                    + WITHIN * normal(self.seed + each + 1, node, hour)
            };
            let invented = 30.0 * (chance(self.seed, [node, hour as u64, 5]) - 0.5);
            let level = |what| {
                if lies {
                    f64::exp(invented)
                } else {
                    noise(what).exp()
                }
            };
            for (figure, value) in [
                (Figure::JoulesMeasured, factor * level(1)),
                (Figure::LatencyP99, level(2)),
                (Figure::SkipRate, 0.5 + 0.1 * noise(3)),
                (Figure::Degraded, 0.0),
            ] {
                let mean = figures.entry(figure).or_default();
                mean.clips += 10;
                mean.sum += 10.0 * value;
            }
        }
        figures
    }

    fn step(&mut self, rollout: &mut Run) {
        self.now += STEP;
        for due in rollout.due() {
            for node in &due.nodes {
                self.has[Self::number(node) as usize] = due.threshold;
            }
            rollout.given(&due, 1, self.now);
        }
        rollout.observe(self.now, |node| {
            let number = Self::number(node);
            let view = reported(1, self.has[number as usize]);
            if self.is_parked(number, self.now) {
                Some(view.silent())
            } else {
                Some(view)
            }
        });
        if let Some(windows) = rollout.tick(self.now) {
            let found = in_windows(&windows, |window| self.clips(window));
            rollout.measured(&found, self.now);
        }
    }
}

/// The number of rollouts by outcome.
#[derive(Debug, Default)]
struct Ends {
    in_force: u32,
    failed: u32,
    undecided: u32,
}

/// Rollouts of one plan on fleets of one size.
struct Study<'a> {
    nodes: usize,
    stages: &'a [&'a str],
    /// Hours of driving in which a stage soaks.
    driving_hours: f64,
    /// The relative increase of a clip's energy with the new value.
    change: f64,
    rollouts: u64,
}

/// Runs the rollouts, and prints their row of the table.
fn run(study: &Study<'_>) -> Ends {
    let Study {
        nodes,
        stages,
        driving_hours,
        change,
        rollouts,
    } = *study;
    let soak = driving_hours / (1.0 - PARKED) * 3600.0;
    let plan = RolloutPlan {
        stages: stages.iter().map(|size| (*size).to_owned()).collect(),
        basics: Basics {
            baseline_s: soak,
            apply_within_s: 7200.0,
            ..Basics::default()
        },
        soak_s: soak,
        patience_s: soak / 2.0,
        offline_deadline_s: 30.0 * 86_400.0,
        held_for_s: 3600.0,
        ..RolloutPlan::default()
    };
    let mut ends = Ends::default();
    for seed in 0..rollouts {
        let candidates =
            (0..nodes).map(|node| Member::new(node.to_string(), old(), true)).collect();
        let kind = Kind::Rollout {
            to: new(),
            plan: plan.clone(),
        };
        let start = 1_000 * HOUR;
        let mut rollout = Run::begin(kind, candidates, seed, "ops", start).unwrap();
        let mut fleet = Fleet {
            seed: seed.wrapping_mul(1_000_003) ^ nodes as u64,
            change,
            has: vec![old(); nodes],
            now: start,
        };
        while !matches!(
            rollout.phase,
            Phase::Finishing | Phase::Done | Phase::Returning
        ) {
            fleet.step(&mut rollout);
        }
        let failed = rollout.record.iter().any(|e| e.verdict == Some(Verdict::Failed));
        match rollout.phase {
            Phase::Returning if failed => ends.failed += 1,
            Phase::Returning => ends.undecided += 1,
            _ => ends.in_force += 1,
        }
    }
    let share = |count: u32| f64::from(count) / rollouts as f64 * 100.0;
    println!(
        "| {nodes} | {} | {driving_hours} | {:+.0} % | {:.1} % | {:.1} % | {:.1} % | {rollouts} |",
        stages.join(", "),
        change * 100.0,
        share(ends.in_force),
        share(ends.undecided),
        share(ends.failed),
    );
    ends
}

/// The number of rollouts to simulate: from the environment, or `usual`.
fn count(usual: u64) -> u64 {
    std::env::var("ALBIREO_ROLLOUTS").map_or(usual, |text| text.parse().unwrap())
}

/// Half of the nodes are left to compare with.
const HALF_OF_ALL: &[&str] = &["1", "10%", "50%"];
const ALL_NODES: &[&str] = &["1", "10%", "50%", "100%"];

#[test]
fn whole_rollouts_without_any_effect_are_judged_failed_at_most_one_time_in_twenty() {
    for (nodes, rollouts) in [(8, 100), (30, 60), (100, 60), (1000, 6), (5000, 1)] {
        let rollouts = count(rollouts);
        for (stages, driving_hours) in [(HALF_OF_ALL, 8.0), (ALL_NODES, 24.0)] {
            let ends = run(&Study {
                nodes,
                stages,
                driving_hours,
                change: 0.0,
                rollouts,
            });
            let most = 0.05 * rollouts as f64;
            assert!(f64::from(ends.failed) <= most.max(1.0), "{nodes}: {ends:?}");
        }
    }
}

#[test]
fn whole_rollouts_of_a_value_that_costs_a_quarter_more_undo_it() {
    let rollouts = count(40);
    let quarter_more = Study {
        nodes: 100,
        stages: HALF_OF_ALL,
        driving_hours: 8.0,
        change: 0.25,
        rollouts,
    };
    let ends = run(&quarter_more);
    let most = 0.05 * rollouts as f64;
    assert!(f64::from(ends.in_force) <= most, "{ends:?}");
    // The other rows of the table in docs/fleet.md.
    if rollouts >= 100 {
        for (nodes, driving_hours, change) in [
            (30, 8.0, 0.25),
            (100, 24.0, 0.25),
            (100, 24.0, 0.10),
            (1000, 8.0, 0.10),
            (1000, 24.0, 0.10),
            (1000, 24.0, 0.0),
            (1000, 24.0, -0.10),
            (100, 72.0, 0.0),
        ] {
            run(&Study {
                nodes,
                driving_hours,
                change,
                ..quarter_more
            });
        }
    }
}
