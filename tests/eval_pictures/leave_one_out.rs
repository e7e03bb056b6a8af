//! Settings of the flow, tried on all clips but one at a time.

use super::albireo;

/// What the command says about the settings of these worlds, on both outputs.
fn said(seeds: &str, setting: &str) -> (bool, String) {
    let run = albireo(&[
        "eval",
        "synth",
        "--seeds",
        seeds,
        "--rate",
        "5",
        "--clip-seconds",
        "4",
        "--size",
        "640x360",
        "--equal-skip",
        "0.5",
        "--leave-one-out",
        setting,
    ]);
    let text = [run.stdout, run.stderr].concat();
    (
        run.status.success(),
        String::from_utf8_lossy(&text).into_owned(),
    )
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn every_clip_is_judged_by_the_value_that_is_best_on_the_others() {
    let (succeeded, text) = said("1-3", "flow.detected=0,1");
    assert!(succeeded, "{text}");
    assert!(
        text.contains("AP@75 of expected-loss+flow, 3 clips, as recorded"),
        "{text}"
    );
    let row = |name: &str| -> Vec<f64> {
        let start = format!("| {name} |");
        let row = text.lines().find(|line| line.starts_with(&start));
        let cells = row.unwrap_or_else(|| panic!("no row {name} in {text}"));
        let cells = cells.split('|').skip(2).map(str::trim);
        cells.filter_map(|cell| cell.parse().ok()).collect()
    };
    let (none, whole, left_out) = (row("0"), row("1"), row("left out"));
    // How often chosen, AP@75 at the one skip rate, and the mean of that one.
    assert_eq!((none.len(), whole.len(), left_out.len()), (3, 3, 2));
    assert_eq!(none[0] + whole[0], 3.0, "{text}");
    assert_ne!(none[1], whole[1], "{text}");
    assert!(left_out[0] > 0.0 && left_out[0] <= 1.0, "{text}");
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn what_cannot_be_tried_is_named() {
    let (succeeded, text) = said("1", "flow.detected=0,1");
    assert!(!succeeded && text.contains("at least two clips"), "{text}");
    let (succeeded, text) = said("1,2", "flow.detected=0,7");
    assert!(!succeeded && text.contains("flow.detected"), "{text}");
}
