//! The code of clip reports recomputes the published results per clip from their inputs.
//!
//! The expected values are in the README of the shared data; the means are over 200 clips.

use crate::support::shared;
use albireo_wire::{ClipEnergy, FrameStates};
use serde::Deserialize;
use std::time::Duration;

#[derive(Deserialize)]
struct Row {
    system: String,
    infer_count: u64,
    skip_count: u64,
    erd_empty_count: u64,
    predict_count: u64,
    erd_infer_count: u64,
    augmented_infer_count: u64,
    pure_infer_count: u64,
    wall_duration_s: f64,
    energy_j: f64,
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    assert_eq!(values.len(), 200);
    values.iter().sum::<f64>() / values.len() as f64
}

fn states(row: &Row) -> FrameStates {
    let states = FrameStates {
        e: row.erd_empty_count,
        p: row.predict_count,
        ei: row.erd_infer_count,
        i: row.pure_infer_count,
        ai: row.augmented_infer_count,
    };
    assert_eq!(states.frames(), row.infer_count + row.skip_count);
    states
}

/// The energy-delay product of a clip as in its report, J·ms per frame.
fn energy_delay_product(row: &Row) -> f64 {
    let energy = ClipEnergy {
        joules: Some(row.energy_j),
        coverage: 1.0,
        ..ClipEnergy::default()
    };
    let duration = Duration::from_secs_f64(row.wall_duration_s);
    albireo_node::camera::clip::energy_delay_product(&energy, duration, states(row).frames())
        .unwrap()
}

#[test]
#[ignore = "needs ../shared"]
fn shared_the_published_energy_delay_products_and_skip_rates_are_reproduced() {
    let file = shared("data/published-results/thor/albireo/yolo26x/summary-selected-columns.csv");
    let rows: Vec<Row> = csv::Reader::from_path(file)
        .unwrap()
        .deserialize()
        .collect::<Result<_, _>>()
        .unwrap();
    let of = |system: &'static str| rows.iter().filter(move |row| row.system == system);
    let near = |found: f64, expected: f64, by: f64| {
        assert!((found - expected).abs() <= by, "{found}, not {expected}");
    };
    let joules = |row: &Row| row.energy_j;
    let skip_rate = |row: &Row| states(row).skip_rate(0);
    near(mean(of("Vanilla").map(joules)), 811.54, 0.005);
    near(mean(of("Adaptive").map(joules)), 668.62, 0.005);
    near(mean(of("Vanilla").map(energy_delay_product)), 49_103.0, 0.5);
    near(
        mean(of("Adaptive").map(energy_delay_product)),
        37_998.0,
        0.5,
    );
    near(mean(of("Vanilla").map(skip_rate)), 0.0, 0.0);
    near(mean(of("Adaptive").map(skip_rate)), 0.1931, 5e-5);
}
