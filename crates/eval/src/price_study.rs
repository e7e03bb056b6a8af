//! One price for all cameras, or the same budget for each?
//!
//! Several cameras share a detector. Either each gets the same share of calls, its own λ turned until it skips as much as
//! the others; or all have one λ and calls go where it says that most is lost. Both are run with sequences as cameras, at the
//! same mean skip rate, and judged by what the cameras reach on average and what the worst of them does. So is a λ that is a
//! price in boxes, whatever a camera's crowd, in the place of one in shares of the crowd.

use crate::data::Clip;
use crate::frontier::{
    Candidate, ClipFigures, FrontierError, OperatingPoint, PairedDifference, View, ViewedClip,
};
use crate::statistics::mean;
use crate::table::p_value;
use albireo_core::policy::ExpectedLoss;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use serde::Serialize;
use std::fmt::Write;

/// Mean skip rates of the table.
pub const SKIP_RATES: [f64; 6] = [0.24, 0.38, 0.49, 0.60, 0.70, 0.80];

/// With a crowd that counts as so large at least, the price is one in boxes: no camera has as many.
const CONSTANT_CROWD: f64 = 100.0;

/// Cameras whose mean tells of the worst: a single one is a matter of chance.
const WORST: usize = 3;

/// Ways to share the calls.
const WAYS: [&str; 4] = [
    "equal budgets",
    "one λ, shares of the crowd",
    "one λ, boxes",
    "one λ, loss over the root of the crowd",
];

/// One way at one mean skip rate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Shared {
    /// How the calls are shared.
    pub way: &'static str,
    /// Mean skip rate.
    pub skip_rate: f64,
    /// Mean AP@50 over the cameras.
    pub mean: f64,
    /// AP@50 of the worst camera.
    pub worst: f64,
    /// Mean AP@50 of the three worst cameras.
    pub worst_three: f64,
    /// Largest loss of AP@50 of a camera against the detector on every frame.
    pub largest_loss: f64,
    /// Smallest and largest skip rate of a camera.
    pub skips: [f64; 2],
    /// Against equal budgets, camera by camera.
    pub difference: PairedDifference,
}

/// The comparison at one mean skip rate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PriceStudy {
    /// How the recordings were looked at.
    pub view: View,
    /// Number of cameras.
    pub cameras: usize,
    /// By rising skip rate, the ways in order.
    pub rates: Vec<Vec<Shared>>,
}

/// How often `done` is called for so many skip rates.
pub const fn steps(skip_rates: usize) -> usize {
    skip_rates * WAYS.len()
}

/// Compares the ways on `clips` at each of `skip_rates`; `done` is called after each operating point.
///
/// # Errors
/// [`FrontierError`] when no clip can be judged or a policy fails.
pub fn study(
    clips: &[Clip],
    view: &View,
    skip_rates: &[f64],
    done: &dyn Fn(),
) -> Result<PriceStudy, FrontierError> {
    let viewed: Vec<_> = clips.iter().filter_map(|clip| view.look(clip)).collect();
    if viewed.is_empty() {
        return Err(FrontierError::NoClips);
    }
    let ours = Candidate::as_reported(ExpectedLoss::NAME)?;
    let in_boxes = ours.with_expected_loss("call.least_crowd", CONSTANT_CROWD.into())?;
    let rooted = ours.with_expected_loss("call.rule", "frame".into())?;
    let whole = Candidate::as_reported(&format!("{}:0", ExpectedLoss::NAME))?.run(&viewed)?;
    let mut rates = Vec::new();
    for &skip_rate in skip_rates {
        let equal = equal_budgets(&ours, skip_rate, &viewed)?;
        done();
        let mut points = vec![equal];
        for candidate in [&ours, &in_boxes, &rooted] {
            points.push(candidate.at_skip_rate(points[0].skip_rate, &viewed)?);
            done();
        }
        let shared = WAYS.iter().zip(&points);
        rates.push(
            shared
                .map(|(way, point)| judge(way, point, &points[0], &whole))
                .collect(),
        );
    }
    Ok(PriceStudy {
        view: view.clone(),
        cameras: viewed.len(),
        rates,
    })
}

/// Each clip at its own λ, at which it skips `skip_rate`.
fn equal_budgets(
    candidate: &Candidate,
    skip_rate: f64,
    viewed: &[ViewedClip],
) -> Result<OperatingPoint, FrontierError> {
    let clips: Vec<ClipFigures> = viewed
        .par_iter()
        .map(|clip| {
            let point = candidate.at_skip_rate(skip_rate, std::slice::from_ref(clip))?;
            Ok(point.clips)
        })
        .collect::<Result<Vec<_>, FrontierError>>()?
        .into_iter()
        .flatten()
        .collect();
    Ok(OperatingPoint::of(WAYS[0].to_owned(), None, clips))
}

fn judge(
    way: &'static str,
    point: &OperatingPoint,
    equal: &OperatingPoint,
    whole: &OperatingPoint,
) -> Shared {
    let mut reached: Vec<f64> = point.clips.iter().map(|clip| clip.ap50).collect();
    reached.sort_by(f64::total_cmp);
    let losses = point.clips.iter().zip(&whole.clips);
    let skips = || point.clips.iter().map(|clip| clip.skip_rate);
    Shared {
        way,
        skip_rate: point.skip_rate,
        mean: point.ap50,
        worst: reached.first().copied().unwrap_or_default(),
        worst_three: mean(reached.iter().take(WORST).copied()).unwrap_or_default(),
        largest_loss: losses
            .map(|(own, whole)| whole.ap50 - own.ap50)
            .fold(0.0, f64::max),
        skips: [
            skips().fold(f64::INFINITY, f64::min),
            skips().fold(0.0, f64::max),
        ],
        difference: PairedDifference::new(point, equal),
    }
}

/// The comparison as Markdown.
pub fn render(study: &PriceStudy) -> String {
    // Writing to a string cannot fail, so the results are dropped throughout.
    let mut text = format!(
        "{} cameras, {}.\n\n\
         | skipped | calls are shared by | AP@50: mean | worst | three worst | largest loss | cameras skip | Δ mean | p |\n\
         | ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n",
        study.cameras, study.view.name
    );
    for rate in &study.rates {
        for shared in rate {
            let difference = &shared.difference;
            let [least, most] = shared.skips;
            let change = match difference.ap50_t {
                Some(t) => format!(
                    "{:+.1} [{:+.1}, {:+.1}] | {}",
                    difference.ap50 * 100.0,
                    t.lower * 100.0,
                    t.upper * 100.0,
                    p_value(Some(t.p))
                ),
                None => " | ".to_owned(),
            };
            let _ = writeln!(
                text,
                "| {:.2} | {} | {:.3} | {:.3} | {:.3} | {:.1} | {least:.2} to {most:.2} | {change} |",
                shared.skip_rate,
                shared.way,
                shared.mean,
                shared.worst,
                shared.worst_three,
                shared.largest_loss * 100.0,
            );
        }
    }
    text.push_str(
        "\nWorst: the camera with the lowest AP@50. Largest loss: of a camera against the detector on every frame, percentage \
         points. Δ: against equal budgets, percentage points, with the 95 % interval of the paired t-test over cameras.\n",
    );
    text
}
