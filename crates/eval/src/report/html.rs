//! `report.html`: tables and figures in one page that loads nothing.

use super::Report;
use super::plot::Figure;
use crate::result::{ClipResult, Provenance};
use crate::spec::BASELINE;
use crate::summary::{Difference, PolicySummary};
use crate::table::{p_value, short};
use std::collections::HashMap;
use std::fmt::Write;

const STYLE: &str = include_str!("report.css");
const SCRIPT: &str = include_str!("report.js");

/// The page. `figures` come with their SVG documents.
pub(super) fn render(report: &Report, figures: &[(Figure, String)]) -> String {
    let mut page = String::new();
    let title = escape(&report.title);
    // Writing to a string cannot fail.
    let _ = write!(
        page,
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>Albireo evaluation: {title}</title><style>{STYLE}</style></head><body><main>\
         <header><p class=\"kicker\">Albireo evaluation</p><h1>{title}</h1>"
    );
    settings(&mut page, report);
    page.push_str("</header>");
    policies(&mut page, &report.policies);
    for (figure, svg) in figures {
        let _ = write!(
            page,
            "<section><h2>{}</h2><figure>{}<figcaption>{}</figcaption></figure></section>",
            escape(&figure.title),
            svg,
            escape(&figure.caption)
        );
    }
    classes(&mut page, &report.policies);
    clips(&mut page, &report.clips);
    let _ = writeln!(
        page,
        "<footer><p>Made by albireo {}. The same figures are in <code>summary.csv</code> and \
         <code>report.json</code>.</p></footer></main><script>{SCRIPT}</script></body></html>",
        env!("CARGO_PKG_VERSION")
    );
    page
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

fn settings(page: &mut String, report: &Report) {
    page.push_str("<dl>");
    for (name, value) in &report.settings {
        let _ = write!(page, "<dt>{}</dt><dd>{}</dd>", escape(name), escape(value));
    }
    page.push_str("</dl>");
    let lines = report.data.lines();
    if !lines.is_empty() {
        let _ = write!(
            page,
            "<details class=\"note\"><summary>About the data: {} remark{}</summary><ul>",
            lines.len(),
            if lines.len() == 1 { "" } else { "s" }
        );
        for line in lines {
            let _ = write!(page, "<li>{}</li>", escape(&line));
        }
        page.push_str("</ul></details>");
    }
}

/// A figure that may not exist, as a cell with `digits` after the point.
fn cell(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(
        || "<td class=\"none\">–</td>".to_owned(),
        |value| format!("<td>{}</td>", minus(&format!("{value:.digits$}"))),
    )
}

/// With a proper minus sign.
fn minus(text: &str) -> String {
    text.replace('-', "−")
}

/// A change in percentage points with its confidence interval as a tooltip.
fn change(difference: Option<Difference>) -> String {
    let Some(difference) = difference else {
        return "<td class=\"none\">–</td>".to_owned();
    };
    let class = if difference.mean < 0.0 {
        "worse"
    } else {
        "better"
    };
    let hint = difference.t.map_or(String::new(), |t| {
        format!(
            " title=\"95 % confidence interval {:+.2} to {:+.2} pp\"",
            t.lower * 100.0,
            t.upper * 100.0
        )
    });
    let text = minus(&format!("{:+.2}", difference.mean * 100.0));
    format!("<td class=\"{class}\"{hint}>{text}</td>")
}

fn tests(difference: Option<Difference>) -> String {
    let cell = |p: Option<f64>| match p {
        Some(p) => format!("<td>{}</td>", escape(&p_value(Some(p)))),
        None => "<td class=\"none\">–</td>".to_owned(),
    };
    let t = cell(difference.and_then(|d| d.t).map(|t| t.p));
    t + &cell(difference.and_then(|d| d.wilcoxon).map(|w| w.p))
}

/// A word where figures were not measured.
fn badge(provenance: Provenance) -> &'static str {
    match provenance {
        Provenance::Measured => "",
        Provenance::Estimated => " <small>estimated</small>",
        Provenance::Composed => " <small>composed</small>",
        Provenance::Projected => " <small>projected</small>",
    }
}

fn policies(page: &mut String, summaries: &[PolicySummary]) {
    let energy = summaries.iter().find_map(|summary| summary.energy);
    let time = summaries.iter().find_map(|summary| summary.frame_time_ms);
    page.push_str(
        "<section><h2>Policies</h2><div class=\"wide\"><table class=\"sortable\"><thead><tr>\
         <th>Policy</th><th>Skipped %</th><th>Detector calls</th><th>AP@50</th><th>Δ pp</th><th>p (t)</th>\
         <th>p (W)</th><th>Clips kept</th><th>mAP</th><th>Δ pp</th><th>Precision</th><th>Recall</th>",
    );
    if let Some((_, kind)) = time {
        let _ = write!(page, "<th>Frame ms{}</th>", badge(kind));
    }
    if let Some(energy) = energy {
        let badge = badge(energy.provenance);
        let _ = write!(
            page,
            "<th>Energy J{badge}</th><th>EDP J·ms{badge}</th><th>Δ EDP %</th>"
        );
    }
    page.push_str("</tr></thead><tbody>");
    let before = summaries
        .iter()
        .find(|summary| summary.policy == BASELINE)
        .and_then(|summary| summary.energy);
    for summary in summaries {
        let against = summary.against_baseline;
        let ap50 = against.and_then(|against| against.ap50);
        let _ = write!(
            page,
            "<tr{}><th scope=\"row\">{}{}</th>{}{}{}{}{}<td>{}</td>{}{}{}{}",
            if summary.policy == BASELINE {
                " class=\"baseline\""
            } else {
                ""
            },
            escape(short(&summary.policy)),
            if summary.on_skip_frontier {
                " <span class=\"star\" title=\"No other skips as much and is as accurate\">★</span>"
            } else {
                ""
            },
            cell(Some(summary.skip_rate * 100.0), 1),
            cell(Some(summary.detector_frames), 1),
            cell(summary.ap50, 4),
            change(ap50),
            tests(ap50),
            against
                .filter(|_| ap50.is_some())
                .map_or("–".to_owned(), |against| {
                    format!("{} of {}", against.clips_keeping_ap50, summary.clips)
                }),
            cell(summary.map, 4),
            change(against.and_then(|against| against.map)),
            cell(summary.precision, 3),
            cell(summary.recall, 3),
        );
        if time.is_some() {
            page.push_str(&cell(summary.frame_time_ms.map(|time| time.0), 2));
        }
        if energy.is_some() {
            page.push_str(&cell(summary.energy.map(|energy| energy.joules), 1));
            page.push_str(&cell(summary.energy.map(|energy| energy.edp), 0));
            let change = summary
                .energy
                .zip(before)
                .filter(|(own, before)| own.provenance == before.provenance)
                .map(|(own, before)| (own.edp / before.edp - 1.0) * 100.0);
            page.push_str(&cell(change.filter(|_| summary.policy != BASELINE), 1));
        }
        page.push_str("</tr>");
    }
    let clips = summaries.first().map_or(0, |summary| summary.clips);
    let without = summaries
        .first()
        .map_or(0, |summary| summary.clips_without_truth);
    let _ = write!(
        page,
        "</tbody></table></div><p class=\"legend\">Unweighted means over {clips} clip{}{}. Δ and p against \
         Vanilla, clip by clip: paired t-test and Wilcoxon signed-rank test, two-sided. Clips kept: same or \
         better AP@50. ★ no other skips as much and is as accurate. Click a column's head to sort.</p></section>",
        if clips == 1 { "" } else { "s" },
        if without > 0 {
            format!("; {without} without ground truth are not in them")
        } else {
            String::new()
        }
    );
}

/// AP@50 by class, where there is more than one.
fn classes(page: &mut String, summaries: &[PolicySummary]) {
    let names: std::collections::BTreeSet<&String> = summaries
        .iter()
        .flat_map(|summary| summary.ap50_by_class.keys())
        .collect();
    if names.len() < 2 {
        return;
    }
    page.push_str(
        "<section><h2>AP@50 by class</h2><div class=\"wide\"><table class=\"sortable\"><thead><tr>\
         <th>Policy</th>",
    );
    for name in &names {
        let _ = write!(page, "<th>{}</th>", escape(name));
    }
    page.push_str("</tr></thead><tbody>");
    for summary in summaries {
        let _ = write!(
            page,
            "<tr><th scope=\"row\">{}</th>",
            escape(short(&summary.policy))
        );
        for name in &names {
            page.push_str(&cell(summary.ap50_by_class.get(*name).copied(), 4));
        }
        page.push_str("</tr>");
    }
    page.push_str(
        "</tbody></table></div><p class=\"legend\">Each class judged by itself; mean over the clips that \
         show it.</p></section>",
    );
}

fn clips(page: &mut String, results: &[ClipResult]) {
    let baseline: HashMap<&str, &ClipResult> = results
        .iter()
        .filter(|result| result.policy == BASELINE)
        .map(|result| (result.clip.as_str(), result))
        .collect();
    page.push_str(
        "<section><h2>Clips</h2><details><summary>Every clip under every policy</summary>\
         <div class=\"wide\"><table class=\"sortable\"><thead><tr><th>Clip</th><th>Policy</th>\
         <th>Frames</th><th>Skipped %</th><th>AP@50</th><th>Δ pp</th><th>mAP</th><th>Boxes</th>\
         <th>Truth</th></tr></thead><tbody>",
    );
    for result in results {
        let before = baseline
            .get(result.clip.as_str())
            .and_then(|before| before.accuracy);
        let difference = result
            .accuracy
            .zip(before)
            .map(|(own, before)| (own.ap50 - before.ap50) * 100.0);
        let _ = write!(
            page,
            "<tr><th scope=\"row\">{}</th><td class=\"text\">{}</td><td>{}</td>{}{}{}{}<td>{}</td>{}</tr>",
            escape(&result.clip),
            escape(short(&result.policy)),
            result.frames,
            cell(Some(result.skip_rate() * 100.0), 1),
            cell(result.accuracy.map(|accuracy| accuracy.ap50), 4),
            cell(difference.filter(|_| result.policy != BASELINE), 2),
            cell(result.accuracy.map(|accuracy| accuracy.map), 4),
            result.boxes,
            cell(result.accuracy.map(|accuracy| accuracy.truths as f64), 0),
        );
    }
    page.push_str("</tbody></table></div></details></section>");
}
