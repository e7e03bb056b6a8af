//! Formats the advice as text: a table of the proposals, the recommended one, and the lines for `node.toml`.

use super::choose::{Advice, HeldOut, Proposal};
use super::estimate::Estimate;
use super::target::Target;
use crate::settings::ScreenRule;
use crate::text::{Column, counted, fitted, or_dash, wrapped};
use albireo_core::policy::short;
use std::fmt::Write;

/// Below this share of frames the advice says that nothing is skipped.
const NEGLIGIBLE_SKIP_RATE: f64 = 0.005;

/// With fewer clips than this the advice asks for more.
const FEW_CLIPS: usize = 3;

// Writing to a string cannot fail, so the results are dropped throughout.

/// Formats the advice, at most `width` characters wide.
pub fn render(advice: &Advice, width: usize) -> String {
    let mut text = String::new();
    let recording = format!(
        "Recording: {}, {} frames, {} boxes of the detector at confidence {} or more.",
        counted(advice.clips, "clip"),
        advice.frames,
        advice.boxes,
        advice.confidence
    );
    let target = format!(
        "Target: {}, with a precision of at least {}.",
        advice.target, advice.least_precision
    );
    for sentence in [recording, target] {
        let _ = writeln!(text, "{}", wrapped(&sentence, width));
    }
    text.push('\n');
    let cells = |cell: &dyn Fn(&Proposal) -> String| advice.proposals.iter().map(cell).collect();
    let policies = advice.proposals.iter().enumerate().map(|(index, proposal)| {
        let sign = if !proposal.meets_target {
            '-'
        } else if index == 0 {
            '*'
        } else {
            ' '
        };
        format!("{sign} {}", proposal.policy)
    });
    let columns = [
        Column::new(["  policy", ""], policies.collect()),
        Column::new(
            ["threshold", ""],
            cells(&|found| format!("{} = {}", found.threshold, short(found.value))),
        ),
        Column::new(
            ["screen", ""],
            cells(&|found| match found.screen {
                ScreenRule::Recorded => "model".to_owned(),
                _ => "none".to_owned(),
            }),
        ),
        Column::new(["skipped", ""], cells(&|found| percent(found.skip_rate))),
        Column::new(["recall", ""], cells(&|found| share(found.recall))),
        Column::new(["precision", ""], cells(&|found| share(found.precision))),
    ];
    text.push_str(&fitted(&columns, "  ", width));
    if advice.proposals.iter().any(|found| !found.meets_target) {
        let meaning = "-: does not meet target and precision; the value in the threshold's range that comes nearest";
        let _ = writeln!(text, "{}", wrapped(meaning, width));
    }
    text.push('\n');
    for sentence in sentences(advice) {
        let _ = writeln!(text, "{}", wrapped(&sentence, width));
    }
    if let Some(best) = advice.best().filter(|best| skips(best)) {
        let _ = write!(text, "\nPut into node.toml:\n\n{}", best.node_toml);
    }
    text
}

fn sentences(advice: &Advice) -> Vec<String> {
    let mut sentences = Vec::new();
    match advice.best() {
        None => sentences.push(
            "No value meets the target on this recording, with recall and precision by the lower ends of their intervals: \
             record more, which narrows them, ask for less (--target, --precision), or try another --policy."
                .to_owned(),
        ),
        Some(best) if !skips(best) => sentences.push(
            "At this target nothing can be skipped here: `vanilla`, the detector on every frame, does the same."
                .to_owned(),
        ),
        Some(best) => {
            sentences.push(proposed(best));
            if let Some(held_out) = &best.held_out {
                sentences.push(checked(held_out, advice.target));
            }
        }
    }
    if advice.clips < FEW_CLIPS {
        sentences.push(format!(
            "Only {} of {} frames: record other roads, hours and weather, too, before you rely on it.",
            counted(advice.clips, "clip"),
            advice.frames
        ));
    }
    sentences.push(
        "Recall and precision are against the detector, on the frames without it: a policy that goes on showing an object \
         which the detector misses loses precision here although it may be right, so they do not compare policies. In \
         brackets: the 95 % interval over recordings like this one."
            .to_owned(),
    );
    sentences
}

fn skips(proposal: &Proposal) -> bool {
    proposal.skip_rate.is_some_and(|rate| rate.value >= NEGLIGIBLE_SKIP_RATE)
}

fn proposed(best: &Proposal) -> String {
    let screen = match best.screen {
        ScreenRule::Recorded => " and the screen `model`",
        _ => "",
    };
    format!(
        "Proposed: {} with {} = {}{screen}. The detector is skipped on {} of the frames, and {} of its boxes on these frames are shown.",
        best.policy,
        best.threshold,
        short(best.value),
        percent(best.skip_rate),
        percent(best.recall),
    )
}

fn checked(held_out: &HeldOut, target: Target) -> String {
    let is_reached = match target {
        Target::Recall(least) => held_out.recall.is_none_or(|recall| recall.value >= least),
        // A skip rate that falls short costs energy, not objects, and the sentence shows it.
        Target::SkipRate(_) => true,
    };
    let warning = if is_reached {
        ""
    } else {
        ": below the target, so record more before you rely on it"
    };
    format!(
        "Chosen on every second part of the recording and tried on the others, a value gives a recall of {} at {} \
         skipped{warning}.",
        share(held_out.recall),
        percent(held_out.skip_rate),
    )
}

/// `24 % [21, 27]`.
fn percent(estimate: Option<Estimate>) -> String {
    or_dash(estimate.map(|Estimate { value, low, high }| {
        format!(
            "{:.0} % [{:.0}, {:.0}]",
            value * 100.0,
            low * 100.0,
            high * 100.0
        )
    }))
}

/// `.953 [.941, .965]`.
fn share(estimate: Option<Estimate>) -> String {
    let bare = |value: f64| {
        let text = format!("{value:.3}");
        // `.953` for a share, and `1` for all.
        let shortened = text.strip_suffix(".000").unwrap_or(&text);
        match shortened.strip_prefix("0.") {
            Some(decimals) => format!(".{decimals}"),
            None => shortened.to_owned(),
        }
    };
    or_dash(estimate.map(|Estimate { value, low, high }| {
        format!("{} [{}, {}]", bare(value), bare(low), bare(high))
    }))
}
