//! The study as Markdown, which a terminal shows as well.

use super::{AuditStudy, Claim};
use albireo_core::policy::short;
use std::fmt::Write;

/// The tables, and what they say.
pub fn render(study: &AuditStudy) -> String {
    // Writing to a string cannot fail, so the results are dropped throughout.
    let mut text = format!(
        "{} clips, {}. Vanilla: AP@50 {:.3}.\n\n\
         | policy | skipped | recall | precision | F1 | AP@50 | Δ AP@50 |\n\
         | --- | ---: | ---: | ---: | ---: | ---: | ---: |\n",
        study.clips, study.view.name, study.vanilla
    );
    for row in &study.rows {
        let _ = writeln!(
            text,
            "| {} | {:.2} | {:.3} | {:.3} | {:.3} | {:.3} | {:+.1} |",
            name(&row.policy, row.value),
            row.skip_rate,
            row.recall,
            row.precision,
            row.f1,
            row.ap50,
            row.change * 100.0
        );
    }
    text.push_str(
        "\nRecall, precision and F1: against the detector, on all frames without it. Δ AP@50: against Vanilla and ground truth, \
         percentage points over all frames. F1 falls as more is skipped and so does AP@50, but they are not the same thing: a \
         policy that rescues shows objects the detector misses, which costs precision here and gains AP there. Compare \
         settings of one policy by them, not policies.\n",
    );
    let _ = write!(
        text,
        "\n| policy | looked at | frames | recall: bias | ± | held | precision: bias | ± | held |\n\
         | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n"
    );
    for row in &study.rows {
        for sample in &row.samples {
            let claims = [sample.recall, sample.precision].map(cells);
            let _ = writeln!(
                text,
                "| {} | {:.0} % | {:.0} | {} | {} |",
                name(&row.policy, row.value),
                sample.share * 100.0,
                sample.frames,
                claims[0],
                claims[1]
            );
        }
    }
    let _ = write!(
        text,
        "\nEach line: {} samples. Bias: mean estimate minus the comparison of all frames, percentage points. ±: mean half \
         width of the 95 % interval, percentage points. Held: share of the intervals that hold the comparison of all \
         frames.\n",
        study.seeds
    );
    text
}

fn name(policy: &str, value: Option<f64>) -> String {
    value.map_or_else(
        || policy.to_owned(),
        |value| format!("{policy}:{}", short(value)),
    )
}

fn cells(claim: Claim) -> String {
    format!(
        "{:+.2} | {:.1} | {:.3}",
        claim.bias * 100.0,
        claim.half_width * 100.0,
        claim.coverage
    )
}
