//! What looking at pixels brings, as Markdown and as figures.

use super::pixels::{FIGURES, PixelDifference, RateStudy};
use crate::report::plot::{Figure, Point};
use crate::report::{ReportError, ReportFolder};
use std::fmt::Write;
use std::path::Path;

/// Names of the figures; further frame rates have none.
const NAMES: [&str; 4] = ["pixels-1", "pixels-2", "pixels-3", "pixels-4"];

fn rate_of(study: &RateStudy) -> String {
    study.rate.map_or_else(
        || "As recorded".to_owned(),
        |rate| format!("{rate} frames/s"),
    )
}

/// The tables of all frame rates.
// Writing to a string cannot fail, so the results are dropped throughout.
pub fn render_pixels(studies: &[RateStudy]) -> String {
    let mut text = String::new();
    for study in studies {
        let _ = writeln!(
            text,
            "\n### {} ({} clips: {}; {} frames)\n",
            rate_of(study),
            study.clips.len(),
            study.clips.join(", "),
            study.frames
        );
        text.push_str(
            "| skip | policy | knob | reached | AP@50 | AP@75 | mAP | F1@50 | F1@75 | looked |\n\
             | ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n",
        );
        for skip in &study.skips {
            for policy in &skip.policies {
                let _ = write!(
                    text,
                    "| {:.2} | {} | {:.3e} | {:.3} |",
                    skip.skip_rate,
                    policy.policy,
                    policy.value.unwrap_or_default(),
                    policy.mean(|clip| clip.skip_rate)
                );
                for (_, of) in FIGURES {
                    let _ = write!(text, " {:.3} |", policy.mean(of));
                }
                let _ = writeln!(text, " {:.2} |", policy.mean(|clip| clip.looked));
            }
        }
        text.push_str(
            "\n| skip | difference | Δ AP@50 | Δ AP@75 | Δ mAP | Δ F1@50 | Δ F1@75 | worse |\n\
             | ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: |\n",
        );
        for skip in &study.skips {
            for difference in &skip.differences {
                render_difference(&mut text, skip.skip_rate, difference, "");
            }
            render_difference(&mut text, skip.skip_rate, &skip.by_clip, ", clip by clip");
        }
    }
    text.push_str(
        "\nΔ in percentage points with the 95 % confidence interval of the paired t-test over clips. Worse: clips on \
         which AP@75 is lower. Clip by clip: each clip is turned to the skip rate by itself; otherwise one setting \
         holds for all. Looked: share of the frames of which a grey picture was looked at.\n",
    );
    text
}

fn render_difference(text: &mut String, skip: f64, difference: &PixelDifference, how: &str) {
    let _ = write!(
        text,
        "| {skip:.2} | {} − {}{how} |",
        difference.policy, difference.other
    );
    for (mean, test) in &difference.figures {
        let _ = match test {
            Some(t) => write!(
                text,
                " {:+.1} [{:+.1}, {:+.1}] |",
                100.0 * mean,
                100.0 * t.lower,
                100.0 * t.upper
            ),
            None => write!(text, " {:+.1} |", 100.0 * mean),
        };
    }
    let _ = writeln!(text, " {} |", difference.worse);
}

/// Writes `pixels.md`, `pixels.json` and a figure a frame rate into `folder`, making it if need be.
///
/// # Errors
/// [`ReportError`] naming the file.
pub fn write_pixels(studies: &[RateStudy], folder: &Path) -> Result<(), ReportError> {
    let folder = ReportFolder::make(folder)?;
    folder.write("pixels.md", Ok(render_pixels(studies).into_bytes()))?;
    folder.write_json("pixels.json", &studies)?;
    for (study, name) in studies.iter().zip(NAMES) {
        let figure = figure(study, name);
        folder.write(&format!("{name}.svg"), figure.svg().map(String::into_bytes))?;
        folder.write(&format!("{name}.png"), figure.png())?;
    }
    Ok(())
}

fn figure(study: &RateStudy, name: &'static str) -> Figure {
    let points = study.skips.iter().flat_map(|skip| {
        let met = skip.policies.iter().filter(|policy| policy.met);
        met.map(|policy| Point {
            family: policy.policy.clone(),
            setting: String::new(),
            x: 100.0 * policy.mean(|clip| clip.skip_rate),
            y: policy.mean(|clip| clip.ap75),
            interval: None,
            on_frontier: false,
            baseline: false,
        })
    });
    Figure::tradeoff(
        name,
        format!("AP@75 against skip rate: {}", rate_of(study)),
        "Mean over clips.".to_owned(),
        ["Frames without the detector, %", "AP@75"],
        points.collect(),
    )
}
