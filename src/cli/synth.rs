//! `albireo synth`: writes frames of the synthetic dashcam with their ground truth into a folder.
//!
//! The folder gets one JPEG a frame, `seed-7-clip-3-00642.jpg` (the number is the frame's index since
//! the start of the world of that seed), and `ground_truth.jsonl`: one JSON object a line and frame,
//! [`FrameLine`]. The scripts in `models/` train on it.

use super::size::parse_size;
use albireo_core::detection::BDD100K_CLASSES;
use albireo_core::geometry::PictureSize;
use albireo_synth::{Dashcam, DashcamSettings, GroundTruthBox, SyntheticFrame};
use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  albireo synth --out pictures                     a minute of world 1, 10 pictures a second
  albireo synth --out train --seeds 1-40 --frames 200 --every 5
      a training set of forty worlds
  albireo synth --out small --size 640x360 --rate 5";

/// Write pictures of the synthetic dashcam and their ground truth into a folder.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct SynthArguments {
    /// Folder to write to; made if missing. It must not hold a ground truth file yet.
    #[arg(long, value_name = "FOLDER")]
    pub out: PathBuf,
    /// Worlds to film: numbers and ranges, such as `7` or `1-40,90`.
    #[arg(long, default_value = "1", value_parser = parse_seeds)]
    pub seeds: Seeds,
    /// Frames to write of each world.
    #[arg(long, default_value_t = 600)]
    pub frames: u64,
    /// Index of the first frame.
    #[arg(long, default_value_t = 0)]
    pub first: u64,
    /// Write every n-th frame only.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub every: u64,
    /// Size of the pictures, columns x rows.
    #[arg(long, default_value = "1280x720", value_parser = parse_size)]
    pub size: PictureSize,
    /// Frames a second.
    #[arg(long = "rate", alias = "frame-rate", default_value_t = 10.0)]
    pub frame_rate: f64,
    /// Length of a clip, seconds.
    #[arg(long, default_value_t = 20.0)]
    pub clip_seconds: f64,
    /// JPEG quality, 1 to 100.
    #[arg(long, default_value_t = 85, value_parser = clap::value_parser!(u8).range(1..=100))]
    pub quality: u8,
}

/// The worlds to film, in order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seeds(pub Vec<u64>);

/// One line of `ground_truth.jsonl`.
#[derive(Debug, Serialize)]
pub struct FrameLine<'a> {
    /// Name of the picture in the folder.
    pub file: &'a str,
    /// The world.
    pub seed: u64,
    /// Name of the clip.
    pub clip: &'a str,
    /// Index of the frame in the world.
    pub index: u64,
    /// Seconds since the start of the world.
    pub time_s: f64,
    /// Columns of the picture.
    pub width: u32,
    /// Rows of the picture.
    pub height: u32,
    /// What is to be seen.
    pub objects: Vec<ObjectLine>,
}

/// One object of a frame. Fields as in [`GroundTruthBox`]; corners in pixels.
#[derive(Debug, Serialize)]
pub struct ObjectLine {
    /// Identity in the world.
    pub object: u64,
    /// Number of the class.
    pub class: u16,
    /// Name of the class.
    pub class_name: &'static str,
    /// Left edge.
    pub x1: f64,
    /// Top edge.
    pub y1: f64,
    /// Right edge.
    pub x2: f64,
    /// Bottom edge.
    pub y2: f64,
    /// Share hidden by something nearer.
    pub occlusion: f64,
    /// Share outside the picture.
    pub truncation: f64,
    /// Whether it need not be found.
    pub ignore: bool,
}

impl From<&GroundTruthBox> for ObjectLine {
    fn from(found: &GroundTruthBox) -> Self {
        let round = |value: f64, digits: f64| (value * digits).round() / digits;
        let class = found.class.0;
        Self {
            object: found.object,
            class,
            class_name: BDD100K_CLASSES
                .get(usize::from(class))
                .unwrap_or(&"unknown"),
            x1: round(found.corners.x1, 100.0),
            y1: round(found.corners.y1, 100.0),
            x2: round(found.corners.x2, 100.0),
            y2: round(found.corners.y2, 100.0),
            occlusion: round(found.occlusion, 1000.0),
            truncation: round(found.truncation, 1000.0),
            ignore: found.ignore,
        }
    }
}

/// Runs `albireo synth`.
pub fn run(arguments: &SynthArguments) -> Result<()> {
    let out = &arguments.out;
    let settings = |seed| DashcamSettings {
        seed,
        size: arguments.size,
        frame_rate: arguments.frame_rate,
        clip_seconds: arguments.clip_seconds,
    };
    // What cannot be filmed is refused before anything is written.
    Dashcam::new(settings(0))?;
    let last = (arguments.frames.saturating_sub(1))
        .checked_mul(arguments.every)
        .and_then(|way| way.checked_add(arguments.first));
    if last.is_none() {
        bail!("--first, --frames and --every: the number of the last frame is too large");
    }
    std::fs::create_dir_all(out)
        .with_context(|| format!("cannot make the folder {}", out.display()))?;
    let listing = out.join("ground_truth.jsonl");
    if listing.exists() {
        bail!(
            "{} exists already: remove it or choose another folder with --out",
            listing.display()
        );
    }
    let file =
        File::create(&listing).with_context(|| format!("cannot write {}", listing.display()))?;
    let mut listing = BufWriter::new(file);
    let total = (arguments.seeds.0.len() as u64).saturating_mul(arguments.frames);
    let progress = ProgressBar::new(total).with_style(
        ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {per_sec}, {eta} left")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    for &seed in &arguments.seeds.0 {
        let mut dashcam = Dashcam::new(settings(seed))?;
        for number in 0..arguments.frames {
            let frame = dashcam.frame(arguments.first + number * arguments.every);
            write_frame(arguments, seed, &frame, &mut listing)?;
            progress.inc(1);
        }
    }
    listing
        .flush()
        .context("cannot finish ground_truth.jsonl")?;
    progress.finish();
    Ok(())
}

fn write_frame(
    arguments: &SynthArguments,
    seed: u64,
    frame: &SyntheticFrame,
    listing: &mut impl Write,
) -> Result<()> {
    let name = format!("{}-{:05}.jpg", frame.clip, frame.index);
    let path = arguments.out.join(&name);
    std::fs::write(&path, frame.encode_jpeg(arguments.quality)?)
        .with_context(|| format!("cannot write {}", path.display()))?;
    let line = FrameLine {
        file: &name,
        seed,
        clip: &frame.clip,
        index: frame.index,
        time_s: frame.time_seconds,
        width: frame.size.width,
        height: frame.size.height,
        objects: frame.ground_truth.iter().map(ObjectLine::from).collect(),
    };
    serde_json::to_writer(&mut *listing, &line).context("cannot write ground_truth.jsonl")?;
    listing
        .write_all(b"\n")
        .context("cannot write ground_truth.jsonl")
}

/// Reads `1-40,90`.
pub(super) fn parse_seeds(text: &str) -> Result<Seeds, String> {
    let wrong =
        |part: &str| format!("`{part}`: seeds are numbers and ranges, such as 7 or 1-40,90");
    let number = |text: &str, part: &str| text.trim().parse::<u64>().map_err(|_| wrong(part));
    let mut seeds = Vec::new();
    for part in text.split(',') {
        let (from, to) = part.split_once('-').unwrap_or((part, part));
        let (from, to) = (number(from, part)?, number(to, part)?);
        if to < from || to - from >= 100_000 {
            return Err(format!(
                "`{part}`: a range runs upwards and holds at most 100000 seeds"
            ));
        }
        seeds.extend(from..=to);
    }
    Ok(Seeds(seeds))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_numbers_and_ranges() {
        assert_eq!(parse_seeds("3-5,9").unwrap().0, [3, 4, 5, 9]);
        for wrong in ["", "x", "5-3", "1-", "0-99999999"] {
            assert!(parse_seeds(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_export_holds_a_picture_and_a_line_for_every_frame() {
        let folder = tempfile::tempdir().unwrap();
        let arguments = SynthArguments {
            out: folder.path().join("set"),
            seeds: Seeds(vec![4, 5]),
            frames: 3,
            first: 10,
            every: 20,
            size: PictureSize::new(320, 180),
            frame_rate: 10.0,
            clip_seconds: 4.0,
            quality: 80,
        };
        run(&arguments).unwrap();
        let text = std::fs::read_to_string(arguments.out.join("ground_truth.jsonl")).unwrap();
        let lines: Vec<serde_json::Value> = text
            .lines()
            .map(|l| serde_json::from_str(l).unwrap())
            .collect();
        assert_eq!(lines.len(), 6);
        for line in &lines {
            let file = line["file"].as_str().unwrap();
            let bytes = std::fs::read(arguments.out.join(file)).unwrap();
            assert_eq!(bytes[..3], [0xff, 0xd8, 0xff], "{file} is a JPEG");
        }
        assert_eq!(lines[5]["clip"], "seed-5-clip-1");
        assert_eq!(lines[5]["index"], 50);
        let again = run(&arguments).unwrap_err().to_string();
        assert!(again.contains("exists already"), "{again}");
    }
}
