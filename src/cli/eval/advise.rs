//! `albireo eval advise`: finds the value of a policy's threshold that meets a target on a recording.

use super::video::{PassArguments, detect_all};
use super::{JUDGED, WRITTEN};
use crate::cli::terminal;
use crate::cli::values::parse_rate;
use albireo_eval::advise::{Target, advise, render};
use albireo_eval::data::{Clip, recorded};
use albireo_eval::footage::SourceName;
use albireo_eval::settings::Settings;
use albireo_eval::text::counted;
use anyhow::{bail, ensure};
use clap::Args;
use std::path::PathBuf;

/// Arguments of `albireo eval advise`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  albireo eval advise drive.mp4 --detector detector.onnx --target recall=0.95
      what a video of your own road allows, by your own detector
  albireo eval video drive.mp4 --detector detector.onnx --save-detections drive
  albireo eval advise drive --target skip_rate=0.5
      the same detections for another target, without reading the pictures")]
pub(super) struct AdviseArguments {
    /// Video files, folders of pictures, or folders of recorded detections (`albireo eval video … --save-detections`);
    /// an hour of the road the camera sees is a good recording.
    #[arg(required = true)]
    recordings: Vec<PathBuf>,
    /// The target to meet: recall (against the detector) or skip_rate.
    #[arg(long, value_name = "NAME=VALUE", default_value = "recall=0.95")]
    target: Target,
    /// The precision against the detector that a value must have, too, by the lower end of its interval.
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.7,
        allow_negative_numbers = true
    )]
    precision: f64,
    /// The policy whose threshold is chosen.
    #[arg(long, value_name = "NAME", default_value = "albireo")]
    policy: String,
    /// Detections below this confidence are not used, like a node's `detector.confidence`.
    #[arg(long, help_heading = JUDGED, default_value_t = 0.5, allow_negative_numbers = true)]
    confidence: f64,
    /// Frames per second of folders of pictures.
    #[arg(long, help_heading = JUDGED, value_name = "FPS", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Frames in a row that a screen may call empty before the detector runs anyway; 0 for any number.
    #[arg(long, help_heading = JUDGED, value_name = "COUNT", default_value_t = 100)]
    longest_empty_run: u32,
    /// Print the advice as JSON instead.
    #[arg(long, help_heading = WRITTEN)]
    json: bool,
    #[command(flatten)]
    pass: PassArguments,
}

/// Runs the command; the advice goes to standard output, everything else to standard error.
///
/// # Errors
/// When a recording cannot be read, or no value meets the target.
pub(super) fn run(arguments: &AdviseArguments) -> anyhow::Result<()> {
    let confidence = arguments.confidence;
    ensure!(
        (0.0..=1.0).contains(&confidence),
        "--confidence {confidence} is not between 0 and 1"
    );
    let precision = arguments.precision;
    ensure!(
        (0.0..1.0).contains(&precision),
        "--precision {precision} is not from 0 to below 1"
    );
    let settings = Settings {
        confidence,
        longest_empty_run: arguments.longest_empty_run,
        ..Settings::default()
    };
    let clips = read(arguments)?;
    eprintln!(
        "Trying {} on {}",
        arguments.policy,
        counted(clips.len(), "clip")
    );
    let advice = advise(
        &clips,
        arguments.target,
        precision,
        &arguments.policy,
        &settings,
    )?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&advice)?);
    } else {
        print!("{}", render(&advice, terminal::width()));
    }
    if advice.best().is_none() {
        bail!("no value meets {} on this recording", arguments.target);
    }
    Ok(())
}

/// Reads recorded detections, and runs the detector over all other recordings.
fn read(arguments: &AdviseArguments) -> anyhow::Result<Vec<Clip>> {
    let mut clips = Vec::new();
    let mut footage = Vec::new();
    for path in &arguments.recordings {
        if path.join("sequences.json").is_file() {
            let data = recorded::read(path)?.only_with_detections(path)?;
            clips.extend(data.clips);
        } else {
            let name = path.to_string_lossy();
            footage.push(name.parse::<SourceName>().map_err(anyhow::Error::msg)?);
        }
    }
    if footage.is_empty() {
        let mut given = arguments.pass.given();
        if arguments.rate.is_some() {
            given.push("--rate");
        }
        ensure!(
            given.is_empty(),
            "{}: of no effect on recorded detections: leave it out, or name the videos or pictures themselves",
            given.join(", ")
        );
    } else {
        clips.extend(detect_all(&footage, arguments.rate, &arguments.pass)?);
    }
    check_doubles(&clips)?;
    Ok(clips)
}

/// Refuses a clip that is there twice, such as a video and its recorded detections: the intervals would be too narrow.
/// Clips of one name from several days have other detections.
fn check_doubles(clips: &[Clip]) -> anyhow::Result<()> {
    for (number, clip) in clips.iter().enumerate() {
        let is_same = |other: &Clip| other.name == clip.name && other.detections == clip.detections;
        ensure!(
            !clips[..number].iter().any(is_same),
            "the clip `{}` is there twice, with the same detections: name each recording once",
            clip.name
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::geometry::PictureSize;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        advise: AdviseArguments,
    }

    /// Why recordings cannot be read with these arguments; empty if they can.
    fn refused(words: &[&str]) -> String {
        let command = Command::parse_from([&["advise"][..], words].concat());
        match read(&command.advise) {
            Ok(_) => String::new(),
            Err(error) => error.to_string(),
        }
    }

    /// Writes the recorded detections of an empty clip.
    fn recording() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let clip = Clip {
            detections: Some(vec![Vec::new(); 3]),
            ..Clip::new("a".to_owned(), PictureSize::new(100, 50), 3)
        };
        recorded::write(folder.path(), &[clip]).unwrap();
        folder
    }

    #[test]
    fn an_option_of_the_detector_is_refused_where_no_detector_runs() {
        let folder = recording();
        let path = folder.path().to_str().unwrap();
        assert_eq!(refused(&[path, "--confidence", "0.4"]), "");
        for (option, value) in [
            ("--frames", "20"),
            ("--rate", "5"),
            ("--detector", "nothere.onnx"),
            ("--head", "yolo"),
            ("--provider", "cuda"),
            ("--screen-model", "nothere.onnx"),
            ("--class-names", "nothere.txt"),
            ("--save-detections", "nothere"),
        ] {
            let said = refused(&[path, option, value]);
            assert!(said.starts_with(option), "{option}: {said}");
        }
    }

    #[test]
    fn a_recording_that_is_named_twice_does_not_count_twice() {
        let folder = recording();
        let path = folder.path().to_str().unwrap();
        let said = refused(&[path, path]);
        assert!(said.contains("`a` is there twice"), "{said}");
    }
}
