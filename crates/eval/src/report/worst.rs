//! The frames on which policies lost the most, as boxes in the picture's frame.

use crate::result::ClipResult;
use crate::table::short;
use crate::worst::WorstFrame;
use albireo_core::geometry::Corners;
use maud::{Markup, html};

/// Frames that are shown of each policy.
const SHOWN: usize = 3;

/// Most policies that are shown.
const POLICIES: usize = 8;

/// The frames of each policy that lost most, over all clips; nothing where nothing was lost.
pub(super) fn frames(results: &[ClipResult]) -> Markup {
    let mut policies: Vec<&str> = Vec::new();
    for result in results.iter().filter(|result| !result.worst.is_empty()) {
        if !policies.contains(&result.policy.as_str()) {
            policies.push(&result.policy);
        }
    }
    if policies.is_empty() {
        return Markup::default();
    }
    html! {
        section {
            h2 { "Where it was lost" }
            p.legend {
                "Frames without the detector on which most objects were lost that it would have found: "
                span.truth-word { "ground truth" } ", " span.found-word { "the policy's boxes" } "."
            }
            @for policy in policies.into_iter().take(POLICIES) {
                h3 { (short(policy)) }
                div.frames {
                    @for (clip, worst) in worst_of(results, policy) {
                        (picture(clip, worst))
                    }
                }
            }
        }
    }
}

fn worst_of<'a>(results: &'a [ClipResult], policy: &str) -> Vec<(&'a str, &'a WorstFrame)> {
    let mut worst: Vec<_> = results
        .iter()
        .filter(|result| result.policy == policy)
        .flat_map(|result| {
            result
                .worst
                .iter()
                .map(|worst| (result.clip.as_str(), worst))
        })
        .collect();
    worst.sort_by_key(|(_, worst)| std::cmp::Reverse(worst.lost));
    worst.truncate(SHOWN);
    worst
}

fn picture(clip: &str, worst: &WorstFrame) -> Markup {
    let (width, height) = (worst.picture.width, worst.picture.height);
    // Lines as wide on every picture, whatever its size.
    let stroke = f64::from(width) / 240.0;
    html! {
        figure.frame {
            svg viewBox={ "0 0 " (width) " " (height) } role="img"
                aria-label={ (worst.truth.len()) " objects, " (worst.found.len()) " boxes" } {
                rect.ground width=(width) height=(height) {}
                @for truth in &worst.truth { (rectangle("truth", truth, stroke)) }
                @for found in &worst.found { (rectangle("found", found, stroke)) }
            }
            figcaption {
                (clip) ", frame " (worst.frame) ", state " (worst.state.as_str()) ": " (worst.lost) " lost"
            }
        }
    }
}

fn rectangle(class: &str, corners: &Corners, stroke: f64) -> Markup {
    let round = |value: f64| (value * 10.0).round() / 10.0;
    html! {
        rect class=(class) x=(round(corners.x1)) y=(round(corners.y1))
            width=(round(corners.x2 - corners.x1).max(0.0)) height=(round(corners.y2 - corners.y1).max(0.0))
            stroke-width=(round(stroke)) {}
    }
}
