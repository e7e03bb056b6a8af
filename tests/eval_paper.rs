//! The paper's main table and the energy model are recomputed from published per-clip results.
#![allow(clippy::expect_used, clippy::panic)]

use crate::support::shared;
use albireo_eval::energy_fit;
use albireo_eval::energy_model::EnergyModel;
use albireo_eval::paper::table;
use albireo_eval::published::{self, PublishedRow};
use std::path::Path;

fn rows() -> Vec<PublishedRow> {
    let file = "data/published-results/thor/albireo/yolo26x/summary-selected-columns.csv";
    published::read(&shared(file)).expect("the published results")
}

/// Fails unless `value` rounds to `expected` at the last digit given.
fn assert_rounds(what: &str, value: f64, expected: f64, digits: i32) {
    let unit = 10_f64.powi(-digits);
    assert!(
        (value - expected).abs() <= 0.5001 * unit,
        "{what}: {value}, expected {expected}"
    );
}

#[test]
#[ignore = "needs ../shared"]
fn shared_the_papers_main_table_is_recomputed_from_its_clips() {
    let table = table(&rows());
    let [vanilla, albireo] = &table[..] else {
        panic!("the file has two systems");
    };
    assert_eq!((vanilla.clips, albireo.clips), (200, 200));
    assert_rounds("AP@50 Vanilla", vanilla.ap50, 0.6089, 4);
    assert_rounds("AP@50 Albireo", albireo.ap50, 0.6165, 4);
    assert_rounds("mAP Vanilla", vanilla.map, 0.4702, 4);
    assert_rounds("mAP Albireo", albireo.map, 0.4331, 4);
    assert_rounds("energy Vanilla", vanilla.energy_j, 811.54, 2);
    assert_rounds("energy Albireo", albireo.energy_j, 668.62, 2);
    assert_rounds("time Vanilla", vanilla.frame_time_ms, 50.90, 2);
    assert_rounds("time Albireo", albireo.frame_time_ms, 46.42, 2);
    assert_rounds("skip, mean of clips", albireo.skip_rate * 100.0, 19.31, 2);
    assert_rounds("skip, pooled", albireo.skip_rate_pooled * 100.0, 19.01, 2);
    let expected = [4.43, 14.88, 1.32, 30.48, 48.89];
    for (share, expected) in albireo.states.iter().zip(expected) {
        assert_rounds("state", share * 100.0, expected, 2);
    }
    assert_rounds(
        "AI of detector frames",
        albireo.ai_of_detector_frames * 100.0,
        60.8,
        1,
    );
    assert_rounds(
        "largest P",
        albireo.largest_predicted_share * 100.0,
        36.1,
        1,
    );

    let against = albireo.against_vanilla.as_ref().expect("there is Vanilla");
    assert_rounds("mAP change", against.map.mean * 100.0, -3.71, 2);
    assert_rounds("energy change", against.energy_change * 100.0, -17.61, 2);
    assert_rounds("time change", against.frame_time_change * 100.0, -8.80, 2);
    assert_eq!(against.clips_keeping_ap50, 144);
    assert_rounds(
        "median loss",
        against.median_loss.expect("56 lose") * 100.0,
        1.66,
        2,
    );
    assert_eq!(against.clips_with_less_energy, 178);
    let t = against.energy.t.expect("defined");
    assert_rounds("paired t", -t.t, 15.3, 1);
    assert_rounds("p of t, exponent", t.p.log10().floor(), -35.0, 0);
    assert_rounds("p of t", t.p * 1e35, 2.0, 0);
    let wilcoxon = against.energy.wilcoxon.expect("defined");
    assert_rounds("p of Wilcoxon", wilcoxon.p * 1e26, 2.0, 0);
    assert_eq!(against.mostly_empty_clips, 8);
    assert_rounds(
        "their AP@50",
        against.ap50_mostly_empty.expect("8") * 100.0,
        -12.3,
        1,
    );
    assert_rounds(
        "the others'",
        against.ap50_others.expect("192") * 100.0,
        1.3,
        1,
    );
}

#[test]
#[ignore = "needs ../shared"]
fn shared_the_papers_edp_is_not_its_own_definitions() {
    let table = table(&rows());
    let (vanilla, albireo) = (&table[0].edp, &table[1].edp);
    let change = table[1]
        .against_vanilla
        .as_ref()
        .expect("there is Vanilla")
        .edp_change;
    assert_rounds("paper, Vanilla", vanilla.of_rounded_means, 41305.0, 0);
    assert_rounds("paper, Albireo", albireo.of_rounded_means, 31023.0, 0);
    assert_rounds("paper, change", change.of_rounded_means * 100.0, -24.9, 1);
    assert_rounds("means, Albireo", albireo.of_means, 31036.0, 0);
    assert_rounds("definition, Vanilla", vanilla.by_definition, 49103.0, 0);
    assert_rounds("definition, Albireo", albireo.by_definition, 37998.0, 0);
    assert_rounds("definition, change", change.by_definition * 100.0, -22.6, 1);
    assert_rounds("frame time, Vanilla", vanilla.by_frame_time, 41300.0, 0);
    assert_rounds("frame time, Albireo", albireo.by_frame_time, 31540.0, 0);
    assert_rounds("frame time, change", change.by_frame_time * 100.0, -23.6, 1);
    let text = albireo_eval::paper_text::render("thor", &table);
    assert!(
        text.contains("the saving is 22.62 %, not 24.89 %"),
        "{text}"
    );
    assert!(
        text.lines().all(|line| line.chars().count() <= 100),
        "{text}"
    );
}

#[test]
#[ignore = "needs ../shared"]
fn shared_the_shipped_model_of_agx_thor_is_the_fit_it_says_it_is() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/energy/agx-thor.toml");
    let shipped = EnergyModel::load(&path).expect("the shipped model");
    let fitted = energy_fit::fit(&rows(), &shipped.board, &shipped.detector, &shipped.source)
        .expect("the rows determine it");
    for (name, shipped, fitted, digits) in [
        (
            "detector, J",
            shipped.energy_j.detector,
            fitted.energy_j.detector,
            4,
        ),
        (
            "predicted, J",
            shipped.energy_j.predicted,
            fitted.energy_j.predicted,
            4,
        ),
        (
            "screen, J",
            shipped.energy_j.screen,
            fitted.energy_j.screen,
            4,
        ),
        (
            "detector, ms",
            shipped.time_ms.detector,
            fitted.time_ms.detector,
            3,
        ),
        (
            "predicted, ms",
            shipped.time_ms.predicted,
            fitted.time_ms.predicted,
            3,
        ),
        (
            "screen, ms",
            shipped.time_ms.screen,
            fitted.time_ms.screen,
            3,
        ),
    ] {
        assert_rounds(name, fitted, shipped, digits);
    }
    let (shipped, fitted) = (
        shipped.left_out.expect("it says how far it misses"),
        fitted.left_out.expect("it was tested"),
    );
    assert_rounds(
        "energy error",
        fitted.energy_percent,
        shipped.energy_percent,
        2,
    );
    assert_rounds(
        "time error",
        fitted.frame_time_percent,
        shipped.frame_time_percent,
        2,
    );
    assert_rounds(
        "saving",
        fitted.saving_measured_percent,
        shipped.saving_measured_percent,
        2,
    );
    assert_rounds(
        "projected saving",
        fitted.saving_projected_percent,
        shipped.saving_projected_percent,
        2,
    );
}

#[test]
fn every_shipped_energy_model_says_where_it_comes_from_and_how_far_it_misses() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/energy");
    let mut boards = Vec::new();
    for file in std::fs::read_dir(folder).expect("the shipped models") {
        let path = file.expect("a file").path();
        let model = EnergyModel::load(&path).expect("a model that can be used");
        assert!(
            model.source.contains("commit "),
            "{}: {}",
            path.display(),
            model.source
        );
        let missed = model.left_out.expect("it was tested on clips left out");
        assert!(missed.energy_percent > 0.0 && missed.energy_percent < 10.0);
        assert!((missed.saving_measured_percent - missed.saving_projected_percent).abs() < 2.0);
        // A frame without the detector costs less than one with it.
        assert!(model.energy_j.predicted < model.energy_j.detector / 2.0);
        assert!(model.energy_j.screen < model.energy_j.detector / 2.0);
        boards.push(model.board);
    }
    boards.sort();
    assert_eq!(boards, ["NVIDIA Jetson AGX Orin", "NVIDIA Jetson AGX Thor"]);
}
