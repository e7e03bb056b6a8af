//! The evaluation agrees with what others compute on the same boxes: the published evaluator's figures and
//! COCO's own tool.

use albireo::eval::average_precision::{Accuracy, Classes, Interpolation, ScoredBox, accuracy};
use albireo::eval::data::{Clip, recorded};
use albireo::eval::scoring::{decayed_confidence, score_object};
use albireo::eval::trace;
use std::collections::HashMap;
use std::path::PathBuf;

/// The folder of shared data; a missing one fails the test with what to do.
pub fn shared() -> PathBuf {
    let folder = std::env::var_os("ALBIREO_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"),
        PathBuf::from,
    );
    assert!(
        folder.join("golden").is_dir(),
        "{} has no golden/: set ALBIREO_SHARED to the folder of shared data",
        folder.display()
    );
    folder
}

/// `summary.csv` of the published code: figures by sequence, policy and column.
pub fn golden_summary() -> HashMap<(String, String), HashMap<String, f64>> {
    let mut reader =
        csv::Reader::from_path(shared().join("golden/summary.csv")).expect("the summary is there");
    let headers = reader.headers().expect("it has a header").clone();
    reader
        .records()
        .map(|record| {
            let record = record.expect("a readable row");
            let figures = headers
                .iter()
                .zip(record.iter())
                .filter_map(|(name, value)| Some((name.to_owned(), value.parse().ok()?)))
                .collect();
            ((record[0].to_owned(), record[4].to_owned()), figures)
        })
        .collect()
}

fn pooled(boxes: &[Vec<ScoredBox>], clip: &Clip) -> Accuracy {
    accuracy(
        boxes,
        clip.truth
            .as_deref()
            .expect("asked for clips with ground truth"),
        Classes::Pooled,
        Interpolation::AllPoints,
    )
    .expect("there are boxes to find")
}

#[test]
fn shared_average_precision_of_the_golden_traces_is_the_published_evaluators() {
    let summary = golden_summary();
    let clips = recorded::read(&shared().join("data/recorded")).expect("the recordings");
    let mut compared = 0;
    for (policy, u) in [
        ("albireo-u3e-4-erd-nonempty", 3e-4),
        ("albireo-u3e-4-erd-detections", 3e-4),
        ("albireo-u1e-3-erd-nonempty", 1e-3),
        ("fixedskip-2", 3e-4),
        ("ctd-0.50", 3e-4),
    ] {
        for clip in clips.clips.iter().filter(|clip| clip.truth.is_some()) {
            let path = shared().join(format!("golden/{policy}/{}.jsonl.gz", clip.name));
            let frames = trace::read(&path).expect("the golden trace");
            let last: Vec<Vec<ScoredBox>> = frames
                .iter()
                .map(|frame| {
                    let objects = frame.objects.iter();
                    objects
                        .map(|object| score_object(object, clip.picture))
                        .collect()
                })
                .collect();
            let decayed: Vec<Vec<ScoredBox>> = frames
                .iter()
                .zip(&last)
                .map(|(frame, boxes)| {
                    let pairs = frame.objects.iter().zip(boxes);
                    pairs
                        .map(|(object, scored)| ScoredBox {
                            confidence: decayed_confidence(object.conf, object.tau, u),
                            ..*scored
                        })
                        .collect()
                })
                .collect();
            let expected = &summary[&(clip.name.clone(), policy.to_owned())];
            let (last, decayed) = (pooled(&last, clip), pooled(&decayed, clip));
            for (name, value) in [
                ("boxes", last.predictions as f64),
                ("gt_boxes", last.truths as f64),
                ("ap50_decayed", decayed.ap50),
                ("map_decayed", decayed.map),
                ("ap50_lastconf", last.ap50),
                ("map_lastconf", last.map),
            ] {
                assert!(
                    (value - expected[name]).abs() < 1e-6,
                    "{policy} {} {name}: {value}, published code {}",
                    clip.name,
                    expected[name]
                );
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 5 * 17 * 6);
}
