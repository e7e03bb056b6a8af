//! Prints the tables of crates/eval/examples/equal_skip.md: every policy beside `expected-loss` at the same mean skip
//! rate. All boxes of a policy are judged, also those too faint to be published; newcomers by the boxes that a node
//! publishes.
//!
//! `cargo run --release -p albireo-eval --example equal_skip -- DIR [--half-rate] [--confidence 0.5]`
#![allow(clippy::print_stdout)]

use albireo_core::policy::PolicyConfig;
use albireo_eval::data::{Clip, recorded};
use albireo_eval::judge::Accuracy;
use albireo_eval::result::ClipResult;
use albireo_eval::run;
use albireo_eval::settings::ScreenRule;
use albireo_eval::settings::Settings;
use albireo_eval::spec::{BASELINE, resolve};
use albireo_eval::statistics::mean;
use albireo_eval::summary::Difference;
use clap::Parser;
use std::error::Error;
use std::path::{Path, PathBuf};

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Skip rates at which evenly spaced calls are compared.
const SKIP_RATES: [f64; 9] = [0.10, 0.24, 0.38, 0.50, 0.60, 0.65, 0.67, 0.75, 0.80];

/// Policies that are compared at their own skip rates.
const POLICIES: &str = "albireo:3e-4 albireo:5e-4 albireo:7e-4 albireo:1e-3 fixed-skip:2 fixed-skip:3 fixed-skip:5 \
    ctd:0.9 ctd:0.7 ctd:0.5 ctd:0.3 kill-only:3e-4 kill+erd:3e-4 kill+erd-10d:3e-4";

#[derive(Parser)]
struct Arguments {
    /// A folder with sequences.json, detections/ and groundtruth/.
    folder: PathBuf,
    /// Use every second frame, as if the camera were half as fast.
    #[arg(long)]
    half_rate: bool,
    /// Detections below this are not shown to the policies.
    #[arg(long, default_value_t = 0.5)]
    confidence: f64,
}

/// Recordings at one confidence.
pub(crate) struct Recordings {
    pub(crate) clips: Vec<Clip>,
    settings: Settings,
}

/// A policy with one value of its threshold on all clips, in their order.
pub(crate) struct Point {
    value: f64,
    clips: Vec<ClipResult>,
}

/// A figure of all boxes of a policy, published or not.
type Figure = fn(&Accuracy) -> f64;

/// The figures that are compared.
const FIGURES: [(&str, Figure); 4] = [
    ("AP@50", |found| found.ap50),
    ("AP@75", |found| found.ap75),
    ("mAP", |found| found.map),
    ("F1@50 ≥ 0.3", |found| found.f1_50_shown),
];

impl Point {
    pub(crate) fn skip_rate(&self) -> f64 {
        mean(self.clips.iter().map(ClipResult::skip_rate)).unwrap_or(f64::NAN)
    }

    fn figure(&self, figure: Figure) -> impl Iterator<Item = f64> {
        self.clips
            .iter()
            .map(move |clip| clip.accuracy_all.as_ref().map_or(f64::NAN, figure))
    }

    pub(crate) fn mean(&self, figure: Figure) -> f64 {
        mean(self.figure(figure)).unwrap_or(f64::NAN)
    }

    /// By how many frames later than with `other` an object is found, of each clip whose objects are numbered.
    fn later_than(&self, other: &Self) -> Vec<f64> {
        let mut later = Vec::new();
        for (ours, theirs) in self.clips.iter().zip(&other.clips) {
            if let (Some(own), Some(others)) = (ours.newcomers, theirs.newcomers) {
                later.push(own.delay_frames - others.delay_frames);
            }
        }
        later
    }

    fn minus(&self, other: &Self, figure: Figure) -> Vec<f64> {
        self.figure(figure)
            .zip(other.figure(figure))
            .map(|(own, other)| own - other)
            .collect()
    }
}

impl Recordings {
    /// The clips of `folder` with a box of ground truth.
    pub(crate) fn read(folder: &Path, half_rate: bool, confidence: f64) -> Outcome<Self> {
        let mut clips = recorded::read(folder)?.only_with_detections(folder)?.clips;
        if half_rate {
            let mut slower = Vec::new();
            for clip in clips {
                let rate =
                    clip.frame_rate.ok_or_else(|| format!("{}: no frame rate", clip.name))?;
                slower.push(clip.thinned(rate / 2.0));
            }
            clips = slower;
        }
        clips.retain(|clip| clip.truth.iter().flatten().any(|truth| !truth.is_empty()));
        let settings = Settings {
            confidence,
            ..Settings::default()
        };
        Ok(Self { clips, settings })
    }

    /// Runs `NAME[:SETTING]` over `clips`.
    pub(crate) fn run(&self, clips: &[Clip], policy: &str) -> Outcome<Point> {
        let base = PolicyConfig::default();
        let screen = ScreenRule::Nonempty;
        let has_pictures = false;
        // The baseline comes first.
        let mut specs = resolve(&[policy.to_owned()], &[], &base, screen, has_pictures)?;
        let spec = specs.pop().ok_or("there is no policy")?;
        let value = spec.config.build()?.threshold().unwrap_or_default();
        let clips = run::run(clips, &[spec], &self.settings, &|| ())?;
        Ok(Point { value, clips })
    }

    /// The policy `name` with its threshold where the mean skip rate is nearest to `wanted`, found by bisection.
    pub(crate) fn at_skip_rate(&self, name: &str, wanted: f64) -> Outcome<Point> {
        // Average precision is not needed to find the place.
        let mut unjudged = self.clips.clone();
        for clip in &mut unjudged {
            clip.truth = None;
        }
        let mut config = PolicyConfig::default();
        config.select(name)?;
        let spec = config.build()?.threshold_spec().ok_or("it has no threshold")?;
        let frames: usize = self.clips.iter().map(|clip| clip.frames).sum();
        // The rates that can be reached are about a frame apart.
        let near = 2e-4f64.max(0.5 / frames as f64);
        // The square root is bisected: its steps are fine where the threshold is small, and zero can be reached.
        let mut low = spec.minimum.sqrt();
        let mut high = spec.maximum.sqrt();
        let mut nearest = String::new();
        let mut least_distance = f64::INFINITY;
        for _ in 0..18 {
            let middle: f64 = (low + high) / 2.0;
            let value = (middle * middle).clamp(spec.minimum, spec.maximum);
            let policy = format!("{name}:{value:e}");
            let reached = self.run(&unjudged, &policy)?.skip_rate();
            let distance = (reached - wanted).abs();
            if distance < least_distance {
                least_distance = distance;
                nearest = policy;
            }
            if least_distance <= near {
                break;
            }
            if reached < wanted {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.run(&self.clips, &nearest)
    }

    /// Prints the row of a policy beside `expected-loss` at its skip rate.
    fn row(&self, name: &str, other: &Point) -> Outcome<()> {
        let ours = self.at_skip_rate("expected-loss", other.skip_rate())?;
        let (_, ap50) = FIGURES[0];
        let skip = other.skip_rate();
        let theirs = other.mean(ap50);
        let value = ours.value;
        let own = ours.mean(ap50);
        print!("| {name} | {skip:.3} | {theirs:.3} | {value:.3} | {own:.3} |");
        for (_, figure) in FIGURES {
            let points: Vec<f64> =
                ours.minus(other, figure).into_iter().map(|change| 100.0 * change).collect();
            print!(" {} |", with_interval(&points, 1));
        }
        print!(" {} |", with_interval(&ours.later_than(other), 2));
        let worse = ours.minus(other, ap50).into_iter().filter(|change| *change < 0.0).count();
        println!(" {worse} |");
        Ok(())
    }
}

/// The mean of `differences` with its 95 % interval; nothing if there is no interval.
fn with_interval(differences: &[f64], decimals: usize) -> String {
    let Some(Difference {
        mean,
        interval: Some([lower, upper]),
        ..
    }) = Difference::of(differences)
    else {
        return String::new();
    };
    format!("{mean:+.decimals$} [{lower:+.decimals$}, {upper:+.decimals$}]")
}

fn main() -> Outcome<()> {
    let arguments = Arguments::parse();
    let half_rate = arguments.half_rate;
    let confidence = arguments.confidence;
    let recordings = Recordings::read(&arguments.folder, half_rate, confidence)?;
    let clips = &recordings.clips;
    let count = clips.len();
    let rate = if half_rate {
        ", every second frame"
    } else {
        ""
    };
    println!("{count} clips, detections >= {confidence}{rate}\n");
    for policy in [BASELINE, "expected-loss:0"] {
        let point = recordings.run(clips, policy)?;
        let figures = FIGURES.map(|(name, figure)| format!("{name} {:.3}", point.mean(figure)));
        let delays = point.clips.iter().filter_map(|clip| Some(clip.newcomers?.delay_frames));
        let new = mean(delays).unwrap_or(f64::NAN);
        println!("- {policy}: {}, new {new:.2} frames", figures.join(", "));
    }
    let changes = "Δ AP@50 | Δ AP@75 | Δ mAP | Δ F1@50 ≥ 0.3 | Δ new, frames";
    println!("\n| policy | skip | AP@50 | λ | AP@50 | {changes} | worse |");
    println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for skip_rate in SKIP_RATES {
        let even = recordings.at_skip_rate("even-skip-in-tracker", skip_rate)?;
        recordings.row("even calls", &even)?;
    }
    for policy in POLICIES.split(' ') {
        let point = recordings.run(clips, policy)?;
        recordings.row(policy, &point)?;
    }
    Ok(())
}
