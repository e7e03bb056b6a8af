//! The recomputed main table in words.

use crate::paper::{AgainstVanilla, SystemRow};
use crate::summary::Difference;
use std::fmt::Write;

/// The rows of one file as text of at most 100 columns.
pub fn render(title: &str, rows: &[SystemRow]) -> String {
    let mut text = format!("{title}\n");
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "{:<14} {:>5} {:>6} {:>6} {:>8} {:>7} {:>7} {:>6} {:>5} {:>5} {:>5} {:>5} {:>5}",
        "system",
        "clips",
        "AP@50",
        "mAP",
        "energy J",
        "time ms",
        "EDP",
        "skip %",
        "E %",
        "P %",
        "E+I %",
        "I %",
        "AI %"
    );
    for row in rows {
        let states = row.states.map(|share| share * 100.0);
        let _ = writeln!(
            text,
            "{:<14} {:>5} {:>6.4} {:>6.4} {:>8.2} {:>7.2} {:>7.0} {:>6.2} {:>5.2} {:>5.2} {:>5.2} {:>5.1} \
             {:>5.2}",
            row.system,
            row.clips,
            row.ap50,
            row.map,
            row.energy_j,
            row.frame_time_ms,
            row.edp.of_means,
            row.skip_rate * 100.0,
            states[0],
            states[1],
            states[2],
            states[3],
            states[4]
        );
    }
    let vanilla = rows.iter().find(|row| row.against_vanilla.is_none());
    for row in rows {
        match (&row.against_vanilla, vanilla) {
            (Some(against), Some(vanilla)) => comparison(&mut text, row, against, vanilla),
            (None, Some(vanilla)) if row.system == vanilla.system => {}
            _ => {
                let _ = writeln!(text, "\n{}: no Vanilla rows to compare with", row.system);
            }
        }
    }
    text
}

fn comparison(text: &mut String, row: &SystemRow, against: &AgainstVanilla, vanilla: &SystemRow) {
    let percent = |share: f64| format!("{:+.2} %", share * 100.0);
    let points = |share: f64| format!("{:+.2} pp", share * 100.0);
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{}", format!("  {name:<28} {value}").trim_end());
    };
    line("", String::new());
    line(
        &format!("{} against Vanilla", row.system),
        format!("{} clips", against.ap50.clips),
    );
    line(
        "AP@50",
        format!("{}, {}", points(against.ap50.mean), tests(&against.ap50)),
    );
    line(
        "mAP@50:95",
        format!("{}, {}", points(against.map.mean), tests(&against.map)),
    );
    line("AP@50 kept or better", kept(against));
    line(
        "energy",
        format!(
            "{}, {}",
            percent(against.energy_change),
            tests(&against.energy)
        ),
    );
    line(
        "clips taking less energy",
        format!(
            "{} of {}",
            against.clips_with_less_energy, against.energy.clips
        ),
    );
    line("frame time", percent(against.frame_time_change));
    line(
        "skipped, all frames pooled",
        format!(
            "{:.2} %; largest share of P in a clip {:.1} %",
            row.skip_rate_pooled * 100.0,
            row.largest_predicted_share * 100.0
        ),
    );
    line(
        "AI of detector frames",
        format!("{:.1} %", row.ai_of_detector_frames * 100.0),
    );
    if let (Some(empty), Some(others)) = (against.ap50_mostly_empty, against.ap50_others) {
        line(
            "clips with E above 40 %",
            format!(
                "{}: AP@50 {}; the others {}",
                against.mostly_empty_clips,
                points(empty),
                points(others)
            ),
        );
    }
    let (own, before, change) = (&row.edp, &vanilla.edp, &against.edp_change);
    line("", String::new());
    line("EDP, J·ms/frame", "Vanilla → system".to_owned());
    for (name, before, own, change) in [
        (
            "as in the paper's table",
            before.of_rounded_means,
            own.of_rounded_means,
            change.of_rounded_means,
        ),
        (
            "mean energy × mean time",
            before.of_means,
            own.of_means,
            change.of_means,
        ),
        (
            "by definition, E·T/N",
            before.by_definition,
            own.by_definition,
            change.by_definition,
        ),
        (
            "E × mean frame time",
            before.by_frame_time,
            own.by_frame_time,
            change.by_frame_time,
        ),
    ] {
        line(name, format!("{before:.0} → {own:.0}, {}", percent(change)));
    }
    let _ = writeln!(
        text,
        "  The paper defines EDP per clip, E·T/N, but its table multiplies the means over clips, rounded to\n  \
         a tenth. By its own definition the saving is {}, not {}.",
        percent(-change.by_definition).trim_start_matches('+'),
        percent(-change.of_rounded_means).trim_start_matches('+')
    );
}

fn kept(against: &AgainstVanilla) -> String {
    let mut text = format!("{} of {}", against.clips_keeping_ap50, against.ap50.clips);
    if let Some(loss) = against.median_loss {
        let _ = write!(text, ", median loss on the others {:.2} pp", loss * 100.0);
    }
    text
}

fn tests(difference: &Difference) -> String {
    let t = difference.t.map_or("t undefined".to_owned(), |t| {
        format!("t = {:.2}, p = {:.1e}", t.t, t.p)
    });
    let wilcoxon = difference
        .wilcoxon
        .map_or("Wilcoxon undefined".to_owned(), |w| {
            format!("Wilcoxon p = {:.1e}", w.p)
        });
    format!("{t}; {wilcoxon}")
}
