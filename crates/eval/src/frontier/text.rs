//! The comparison as Markdown, which a terminal shows as well.

use super::comparison::{EqualSkip, PairedDifference, Study, ViewStudy};
use crate::statistics::PairedT;
use crate::table::p_value;
use std::fmt::Write;

/// The tables of all views.
pub fn render(study: &Study) -> String {
    let mut text = format!("# {}\n", study.title);
    for view in &study.views {
        render_view(&mut text, view);
    }
    text.push_str(
        "\nAP@50 and mAP@50:95: classes pooled, all points, unweighted mean over the clips. Δ: \
         expected-loss minus the other at the same mean skip rate, percentage points, with the 95 % \
         confidence interval of the paired t-test over clips, and its p. Worse: clips on which \
         expected-loss has the lower AP@50, and the largest loss. `frame-drop-ideal-cue` is told of every new object as \
         soon as the detector would see it, and pays nothing for that; `best-n` has for each clip the fixed interval that \
         serves it best, chosen after the fact with the ground truth: bounds, no policies.\n",
    );
    text
}

// Writing to a string cannot fail, so the results are dropped throughout.
fn render_view(text: &mut String, study: &ViewStudy) {
    let _ = writeln!(text, "\n## {} ({} clips)\n", study.view.name, study.clips);
    for reference in &study.vanilla {
        let point = &reference.point;
        let _ = writeln!(
            text,
            "- Vanilla, detections ≥ {}: AP@50 {:.3}, mAP {:.3}; {}",
            reference.confidence,
            point.ap50,
            point.map,
            match reference.crossing {
                Some(skip_rate) =>
                    format!("expected-loss is as accurate at a skip rate of {skip_rate:.2}"),
                None => "expected-loss does not cross it".to_owned(),
            }
        );
    }
    let _ = writeln!(
        text,
        "- expected-loss without a skip: AP@50 {:.3}, mAP {:.3}\n\n\
         | skip | λ | AP@50 | mAP | even calls: AP@50 | mAP | Δ AP@50 | p | Δ mAP | worse |\n\
         | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
        study.without_skips.ap50, study.without_skips.map
    );
    for EqualSkip {
        other,
        ours,
        difference,
    } in &study.even
    {
        let _ = writeln!(
            text,
            "| {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {} |",
            ours.skip_rate,
            ours.value.unwrap_or_default(),
            ours.ap50,
            ours.map,
            other.ap50,
            other.map,
            differences(difference)
        );
    }
    text.push_str(
        "\n| policy | skip | AP@50 | mAP | expected-loss: AP@50 | mAP | Δ AP@50 | p | Δ mAP | worse |\n\
         | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n",
    );
    for EqualSkip {
        other,
        ours,
        difference,
    } in (study.in_tracker.iter())
        .chain(&study.published)
        .chain(&study.adaptive)
        .chain(&study.hindsight)
    {
        let setting = other.value.map_or(String::new(), |value| {
            if value < 0.01 {
                format!(":{value:e}")
            } else {
                format!(":{value}")
            }
        });
        let _ = writeln!(
            text,
            "| {}{setting} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {} |",
            other.policy,
            other.skip_rate,
            other.ap50,
            other.map,
            ours.ap50,
            ours.map,
            differences(difference)
        );
    }
}

/// The last four cells of a row.
fn differences(difference: &PairedDifference) -> String {
    let worse = match &difference.worst {
        Some((_, worst)) => format!("{} ({:.1})", difference.worse_clips, worst * 100.0),
        None => "0".to_owned(),
    };
    format!(
        "{} | {} | {} | {worse}",
        interval(difference.ap50, difference.ap50_t),
        p_value(difference.ap50_t.map(|t| t.p)),
        interval(difference.map, difference.map_t)
    )
}

fn interval(mean: f64, t: Option<PairedT>) -> String {
    match t {
        Some(t) => format!(
            "{:+.1} [{:+.1}, {:+.1}]",
            mean * 100.0,
            t.lower * 100.0,
            t.upper * 100.0
        ),
        None => format!("{:+.1}", mean * 100.0),
    }
}
