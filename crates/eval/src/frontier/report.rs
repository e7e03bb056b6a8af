//! The files of a comparison: `frontier.md`, `frontier.json`, `frontier.csv`, and a figure a view as SVG
//! and PNG.

use super::comparison::{Study, ViewStudy};
use super::operating_point::OperatingPoint;
use super::text;
use crate::pareto::{self, Choice};
use crate::report::plot::{Figure, Point};
use crate::report::{ReportError, ReportFolder};
use std::path::Path;

/// Names of the figures; further views have none.
const FIGURES: [&str; 6] = [
    "frontier-1",
    "frontier-2",
    "frontier-3",
    "frontier-4",
    "frontier-5",
    "frontier-6",
];

/// Writes all files into `folder`, making it if need be.
///
/// # Errors
/// [`ReportError`] naming the file.
pub fn write(study: &Study, folder: &Path) -> Result<(), ReportError> {
    let folder = ReportFolder::make(folder)?;
    folder.write("frontier.md", Ok(text::render(study).into_bytes()))?;
    folder.write_json("frontier.json", study)?;
    folder.write("frontier.csv", rows(study))?;
    for (view, name) in study.views.iter().zip(FIGURES) {
        let figure = figure(view, name);
        folder.write(&format!("{name}.svg"), figure.svg().map(String::into_bytes))?;
        folder.write(&format!("{name}.png"), figure.png())?;
    }
    Ok(())
}

/// One row per view, policy, setting and clip.
fn rows(study: &Study) -> Result<Vec<u8>, String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let written = writer.write_record([
        "view",
        "policy",
        "setting",
        "clip",
        "skip_rate",
        "ap50",
        "map",
    ]);
    written.map_err(|error| error.to_string())?;
    for view in &study.views {
        for point in points(view) {
            for clip in &point.clips {
                let row = [
                    view.view.name.clone(),
                    point.policy.clone(),
                    point.value.map_or(String::new(), |value| value.to_string()),
                    clip.clip.clone(),
                    clip.skip_rate.to_string(),
                    clip.ap50.to_string(),
                    clip.map.to_string(),
                ];
                writer
                    .write_record(row)
                    .map_err(|error| error.to_string())?;
            }
        }
    }
    writer.into_inner().map_err(|error| error.to_string())
}

/// All points of a view.
fn points(view: &ViewStudy) -> Vec<&OperatingPoint> {
    let equal = view.even.iter().chain(&view.in_tracker);
    let equal = equal.chain(&view.published);
    let equal = equal.chain(&view.adaptive).chain(&view.hindsight);
    std::iter::once(&view.without_skips)
        .chain(equal.flat_map(|equal| [&equal.other, &equal.ours]))
        .chain(view.vanilla.iter().map(|reference| &reference.point))
        .collect()
}

fn figure(view: &ViewStudy, name: &'static str) -> Figure {
    let mut drawn = Vec::new();
    for reference in &view.vanilla {
        let setting = format!("≥ {}", reference.confidence);
        drawn.push(point(&reference.point, setting, true));
    }
    drawn.push(point(&view.without_skips, "λ = 0".to_owned(), false));
    for equal in &view.even {
        let setting = format!("{:.2}", equal.ours.value.unwrap_or_default());
        drawn.push(point(&equal.ours, setting, false));
    }
    drawn.extend((view.even.iter()).map(|equal| point(&equal.other, String::new(), false)));
    // What no policy can be stands in the tables: a figure of ten families is no longer read.
    let policies = view.published.iter().chain(&view.adaptive);
    let policies = policies.map(|equal| &equal.other);
    let policies = policies.filter(|other| !other.is_bound());
    drawn.extend(policies.map(|other| point(other, setting(other), false)));
    mark_frontier(&mut drawn);
    Figure::tradeoff(
        name,
        format!("Accuracy against skip rate: {}", view.view.name),
        "Mean over clips. Grey: the Pareto frontier; filled markers are on it.".to_owned(),
        ["Frames without the detector, %", "AP@50"],
        drawn,
    )
}

fn setting(point: &OperatingPoint) -> String {
    match point.value {
        Some(value) if value < 0.01 => format!("{value:e}"),
        Some(value) => value.to_string(),
        None => String::new(),
    }
}

fn point(point: &OperatingPoint, setting: String, baseline: bool) -> Point {
    Point {
        family: point.policy.clone(),
        setting,
        x: point.skip_rate * 100.0,
        y: point.ap50,
        interval: None,
        on_frontier: false,
        baseline,
    }
}

/// Marks the points that no other beats in both skips and accuracy. Points that were brought to the same
/// skip rate count as equal in it, though the knob meets it to a fraction of a thousandth only.
fn mark_frontier(points: &mut [Point]) {
    let choices: Vec<_> = points
        .iter()
        .map(|point| Choice {
            cost: -(point.x * 10.0).round(),
            value: point.y,
        })
        .collect();
    for index in pareto::frontier(&choices) {
        points[index].on_frontier = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::average_precision::TruthBox;
    use crate::data::{Clip, StoredDetection};
    use crate::frontier::{View, study};
    use albireo_core::detection::ClassId;
    use albireo_core::geometry::{Corners, PictureSize};

    /// A clip in which two boxes drift, and the detector sees them with a little noise.
    fn clip(name: &str, speed: f64) -> Clip {
        let corners = |frame: usize, row: f64| {
            let x = 20.0 + speed * frame as f64;
            Corners {
                x1: x,
                y1: row,
                x2: x + 40.0,
                y2: row + 40.0,
            }
        };
        let frames = 60;
        let noisy = |frame: usize, row: f64| {
            let mut corners = corners(frame, row);
            corners.x1 += (frame as f64 * 1.3).sin();
            StoredDetection {
                corners,
                class: ClassId(0),
                confidence: 0.6 + 0.3 * (frame as f64).cos().abs(),
            }
        };
        let truth = |frame: usize, row: f64| TruthBox {
            corners: corners(frame, row),
            class: ClassId(0),
            object: None,
        };
        let in_rows = [50.0, 150.0];
        Clip {
            name: name.to_owned(),
            picture: PictureSize::new(640, 480),
            frame_rate: Some(10.0),
            camera: None,
            frames,
            detections: Some(
                (0..frames)
                    .map(|frame| in_rows.map(|row| noisy(frame, row)).to_vec())
                    .collect(),
            ),
            screen: None,
            truth: Some(
                (0..frames)
                    .map(|frame| in_rows.map(|row| truth(frame, row)).to_vec())
                    .collect(),
            ),
            pictures: Vec::new(),
        }
    }

    #[test]
    fn a_comparison_meets_the_skip_rates_and_leaves_all_its_files() {
        let clips = [clip("slow", 1.0), clip("fast", 6.0), clip("faster", 8.0)];
        let views = [View::as_recorded(0.5), View::lossy(0.5)];
        let compared = std::cell::Cell::new(0);
        let done = || compared.set(compared.get() + 1);
        let study = study("Three clips", &clips, &views, &done).expect("it can be compared");
        assert_eq!(compared.get(), Study::steps(2));
        for view in &study.views {
            assert_eq!(view.clips, 3);
            assert!(view.without_skips.skip_rate < 0.02);
            for equal in &view.even {
                assert_eq!(equal.ours.clips.len(), 3);
                // 60 frames a clip: the mean over three clips has steps of 1/180.
                let missed = equal.ours.skip_rate - equal.other.skip_rate;
                assert!(missed.abs() < 0.03, "{missed} at {}", equal.other.skip_rate);
            }
        }
        let folder = tempfile::tempdir().expect("a folder");
        write(&study, folder.path()).expect("it can be written");
        let text = std::fs::read_to_string(folder.path().join("frontier.md")).expect("the table");
        for part in [
            "albireo:3e-4",
            "fixed-skip-in-tracker:2",
            "adaptive-rate:0.1",
            "frame-drop-ideal-cue:5",
            "best-n (hindsight)",
            "10 % of the frames lost",
        ] {
            assert!(text.contains(part), "{part} is missing:\n{text}");
        }
        for name in [
            "frontier.json",
            "frontier.csv",
            "frontier-1.svg",
            "frontier-2.png",
        ] {
            let length = std::fs::metadata(folder.path().join(name)).map(|file| file.len());
            assert!(length.expect("the file") > 500, "{name}");
        }
    }

    #[test]
    fn clips_that_cannot_be_judged_are_an_error_not_a_zero() {
        let mut clip = clip("no truth", 1.0);
        clip.truth = None;
        let refused = study("Nothing", &[clip], &[View::as_recorded(0.5)], &|| ());
        assert!(refused.is_err());
    }
}
