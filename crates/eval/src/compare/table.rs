//! Formats a comparison as text.

use super::run::{Comparison, TruthSize};
use super::schedule::schedule;
use super::summary::{Change, Figure, Mean, Summary, VariantSummary};
use super::verdict::verdicts;
use crate::text::{Column, counted, fitted, or_dash, wrapped};
use albireo_wire::{EnergyQuality, FULL_COVERAGE};
use std::fmt::Write;

/// The longest label; a longer one is cut.
const MAX_LABEL: usize = 24;

/// A column of one figure: its name, its unit, and a note below them.
#[derive(Clone, Copy)]
struct FigureColumn {
    figure: Figure,
    name: &'static str,
    unit: &'static str,
    note: &'static str,
}

impl FigureColumn {
    const fn new(figure: Figure, name: &'static str, unit: &'static str) -> Self {
        Self {
            figure,
            name,
            unit,
            note: "",
        }
    }

    const fn with_note(self, note: &'static str) -> Self {
        Self { note, ..self }
    }
}

/// Text of lines with at most `width` characters.
struct Text {
    text: String,
    width: usize,
}

/// Formats the comparison, at most `width` characters wide: the clip, the quality of the energy, three tables, and the
/// verdicts.
pub fn render(comparison: &Comparison, summary: &Summary, width: usize) -> String {
    let mut text = Text {
        text: String::new(),
        width,
    };
    text.paragraph(&heading(comparison, summary));
    text.paragraph(&energy(summary));
    let rounds = summary.rounds;
    let interval = if rounds > 1 {
        format!("Mean of {rounds} runs ± half of its 95 % confidence interval")
    } else {
        "One run each: without --repeat 2 or more there is no confidence interval".to_owned()
    };
    let quality = match summary.energy {
        EnergyQuality::Measured => "measured",
        EnergyQuality::Partial => "partial",
        EnergyQuality::Estimated => "ESTIMATED",
        EnergyQuality::Unavailable => "",
    };
    let mut costs = Vec::new();
    if summary.energy != EnergyQuality::Unavailable {
        costs.extend([
            FigureColumn::new(Figure::Joules, "energy", "J").with_note(quality),
            FigureColumn::new(Figure::Edp, "EDP", "J·ms/frame").with_note(quality),
        ]);
    }
    costs.extend([
        FigureColumn::new(Figure::CpuSeconds, "CPU time", "s"),
        FigureColumn::new(Figure::FrameMilliseconds, "frame time", "ms"),
        FigureColumn::new(Figure::DetectorCalls, "detector calls", ""),
    ]);
    let means = |policy: &VariantSummary, figure| {
        let scale = if is_share(figure) { 100.0 } else { 1.0 };
        policy.mean(figure).map(|found| mean(found, scale))
    };
    text.table(&interval, &summary.policies, &costs, means);

    let first = summary.policies.first().map_or("", |first| &first.policy);
    let against = format!("Change against {first}: mean of the differences within a round");
    let changes = |policy: &VariantSummary, figure| policy.change(figure).map(change);
    // Changes are in percent, whatever the figure's unit.
    let changed: Vec<_> = costs
        .iter()
        .map(|column| FigureColumn {
            unit: "",
            ..*column
        })
        .collect();
    let others = summary.policies.get(1..).unwrap_or_default();
    text.table(&against, others, &changed, changes);

    let reference = comparison.policies.get(comparison.boxes_of);
    let agreement = format!(
        "Boxes against those of {} (IoU 0.5, frames that both answered), and frames",
        reference.map_or("", String::as_str)
    );
    let boxes = [
        FigureColumn::new(Figure::Ap50, "AP@50", "%"),
        FigureColumn::new(Figure::Precision, "precision", "%"),
        FigureColumn::new(Figure::Recall, "recall", "%"),
        FigureColumn::new(Figure::SkipRate, "skip rate", "%"),
        FigureColumn::new(Figure::Dropped, "frames dropped", ""),
    ];
    text.table(&agreement, &summary.policies, &boxes, means);
    if let Some(truth) = comparison.playing.truth {
        let by_truth = [
            FigureColumn::new(Figure::TruthAp50, "AP@50", "%"),
            FigureColumn::new(Figure::TruthPrecision, "precision", "%"),
            FigureColumn::new(Figure::TruthRecall, "recall", "%"),
        ];
        text.table(&truth_heading(truth), &summary.policies, &by_truth, means);
    }
    for verdict in verdicts(comparison, summary) {
        text.paragraph(&verdict.sentence);
    }
    text.text.trim_end().to_owned() + "\n"
}

fn heading(comparison: &Comparison, summary: &Summary) -> String {
    let playing = &comparison.playing;
    let pace = match playing.played_rate {
        Some(rate) if rate == playing.rate => format!("at its own {rate} frames/s"),
        Some(rate) => format!("at {rate} frames/s ({} its own)", playing.rate),
        None => "as fast as the node accepts it".to_owned(),
    };
    let order: Vec<String> = schedule(comparison.policies.len(), summary.rounds.min(2))
        .chunks(comparison.policies.len().max(1))
        .map(|round| {
            let names = round.iter().filter_map(|run| comparison.policies.get(run.variant));
            names.map(String::as_str).collect::<Vec<_>>().join(", ")
        })
        .collect();
    let more = if summary.rounds > 2 {
        ", and so on"
    } else {
        ""
    };
    let rounds = match summary.rounds {
        1 => "1 round".to_owned(),
        rounds => format!("{rounds} rounds"),
    };
    format!(
        "Clip {}: {} frames of {}, played {pace} by a camera over Zenoh to a node in this process, in \
         {rounds} (order: {}{more}), each run after {} s of rest and {} s of warm-up. Detector {} on {} \
         cores.",
        playing.clip,
        playing.frames,
        playing.size,
        order.join(" | "),
        playing.cool_down_s,
        playing.warm_up_s,
        playing.detector,
        playing.cores,
    )
}

/// Says what the boxes are judged by, and of how much the intervals tell.
fn truth_heading(truth: TruthSize) -> String {
    let clips = match truth.clips {
        1 => "one clip".to_owned(),
        clips => format!("{clips} clips as one"),
    };
    format!(
        "Boxes by the clip's ground truth: {} boxes in {} frames of {clips}. A frame that was not answered has no box. \
         The interval is over the rounds, which play the same pictures: of other roads it says nothing",
        truth.boxes, truth.frames
    )
}

/// Describes the quality of the energy.
fn energy(summary: &Summary) -> String {
    let source = &summary.energy_source;
    let mut text = match summary.energy {
        EnergyQuality::Measured => format!("Energy is measured by `{source}`."),
        EnergyQuality::Partial if summary.coverage >= FULL_COVERAGE => format!(
            "Energy is measured by `{source}`, for a part of the machine only (`albireo power` says what is left out)."
        ),
        EnergyQuality::Partial => format!(
            "Energy is measured by `{source}`, but with gaps: samples cover {:.1} % of the worst run. Where they \
             do not cover the whole run its energy is not known, and neither energy nor EDP is shown.",
            summary.coverage * 100.0
        ),
        EnergyQuality::Estimated => "There is no power meter here (`albireo power` says why not): what is measured is \
             CPU time, frame time and detector calls. Energy and EDP are ESTIMATED from the utilisation of the \
             whole machine with assumed watts, and are no measurement."
            .to_owned(),
        EnergyQuality::Unavailable => "There is no power meter here (`albireo power` says why not), so there is no \
             energy: what is measured is CPU time, frame time and detector calls."
            .to_owned(),
    };
    if let Some(share) = summary.meter_share_of_core {
        let _ = write!(
            text,
            " Reading it took at most {:.2} % of one core.",
            share * 100.0
        );
    }
    if !summary.power_modes.is_empty() {
        let _ = write!(text, " Power mode: {}.", summary.power_modes.join("; "));
    }
    if summary.throttled_runs > 0 {
        let _ = write!(
            text,
            " In {} clocks were held back by heat or power: rest longer with --cool-down, or cool the board.",
            counted(summary.throttled_runs, "run")
        );
    }
    text
}

impl Text {
    /// Adds a wrapped paragraph and an empty line.
    fn paragraph(&mut self, paragraph: &str) {
        self.text.push_str(&wrapped(paragraph, self.width));
        self.text.push_str("\n\n");
    }

    /// Adds a table with its title, a line for each policy, and an empty line; nothing without policies.
    fn table(
        &mut self,
        title: &str,
        policies: &[VariantSummary],
        columns: &[FigureColumn],
        cell: impl Fn(&VariantSummary, Figure) -> Option<String>,
    ) {
        if policies.is_empty() {
            return;
        }
        let names = policies.iter().map(|policy| cut(&policy.policy)).collect();
        let mut table = vec![Column::new(["policy", ""], names)];
        for column in columns {
            let cells = policies.iter().map(|policy| or_dash(cell(policy, column.figure)));
            let head = format!("{} {}", column.name, column.unit);
            table.push(Column::new([head.trim_end(), column.note], cells.collect()));
        }
        self.text.push_str(&wrapped(title, self.width));
        self.text.push('\n');
        self.text.push_str(&fitted(&table, "  ", self.width));
        self.text.push('\n');
    }
}

/// Cuts a label so that it leaves room for the columns.
fn cut(label: &str) -> String {
    if label.chars().count() > MAX_LABEL {
        label.chars().take(MAX_LABEL - 1).chain(['…']).collect()
    } else {
        label.to_owned()
    }
}

/// True if a figure lies between 0 and 1, and is shown in percent.
fn is_share(figure: Figure) -> bool {
    matches!(
        figure,
        Figure::Ap50
            | Figure::Precision
            | Figure::Recall
            | Figure::SkipRate
            | Figure::TruthAp50
            | Figure::TruthPrecision
            | Figure::TruthRecall
    )
}

/// Formats `12.34 ± 0.56` with the decimals that the interval justifies.
fn mean(found: Mean, scale: f64) -> String {
    let mean = found.mean * scale;
    match found.half.map(|half| half * scale) {
        Some(half) if mean.abs() >= 1e6 => format!("{mean:.2e} ± {half:.0e}"),
        Some(half) if half > 0.0 => {
            let digits = decimals(half);
            format!("{mean:.digits$} ± {half:.digits$}")
        }
        Some(_) => format!("{} ± 0", exact(mean)),
        None => exact(mean),
    }
}

fn change(change: Change) -> String {
    match change.half {
        // Even equal differences have an interval of rounding errors.
        Some(half) if half < 1e-9 => format!("{:+.1} ± 0 %", change.percent),
        Some(half) => {
            let digits = decimals(half.max(0.1)).min(1);
            format!("{:+.digits$} ± {half:.digits$} %", change.percent)
        }
        None => format!("{:+.1} %", change.percent),
    }
}

/// The number of decimals that show two significant digits of `scale`, at most three.
fn decimals(scale: f64) -> usize {
    let digits = 1.0 - scale.abs().log10().floor();
    digits.clamp(0.0, 3.0) as usize
}

fn exact(value: f64) -> String {
    if (value - value.round()).abs() < 1e-9 {
        format!("{value:.0}")
    } else {
        let digits = decimals(value) + 1;
        format!("{value:.digits$}")
    }
}

#[cfg(test)]
mod tests;
