//! `albireo detect`: says what a detector is, and runs it on pictures.

use super::size::parse_size;
use albireo_core::geometry::PictureSize;
use albireo_vision::detector::{
    ClassNames, DetectorConfig, DetectorNetwork, ExecutionProvider, Found, HeadName,
};
use albireo_vision::picture::{
    EncodedPicture, FrameLimits, Picture, PictureFormat, PixelLayout, decode, picture_files,
    read_picture_file, to_jpeg,
};
use albireo_vision::screen::decoding_target;
use anyhow::{Context, ensure};
use indicatif::ProgressBar;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const EXAMPLES: &str = "\
Examples:
  albireo detect yolo26n.onnx                       say how the model is read
  albireo detect yolo26n.onnx frame.jpg             and what it finds
  albireo detect yolo26n.onnx frame.jpg --out seen   and draw the boxes
  albireo detect yolo26n.onnx pictures/ --json      one JSON object per picture";

/// Arguments of `albireo detect`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// The ONNX file.
    model: PathBuf,
    /// Pictures, or folders of pictures.
    pictures: Vec<PathBuf>,
    /// How the model's output is read.
    #[arg(long, value_enum, default_value_t = HeadName::Auto)]
    head: HeadName,
    /// Names of its classes, one per line [default: those of its metadata, or the head's own list]
    #[arg(long, value_name = "FILE")]
    class_names: Option<PathBuf>,
    /// Report all classes of the model under their own names and numbers, not only those of BDD100K.
    #[arg(long)]
    all_classes: bool,
    /// Columns x rows of the input, where the model leaves them open.
    #[arg(long, value_parser = parse_size)]
    input_size: Option<PictureSize>,
    /// Detections below this confidence are dropped.
    #[arg(long, default_value_t = 0.5)]
    confidence: f64,
    /// A box that overlaps a better one of its class by more than this is dropped.
    #[arg(long, default_value_t = 0.45)]
    overlap: f64,
    /// The most detections of a picture.
    #[arg(long, default_value_t = 300)]
    most: usize,
    /// What runs it.
    #[arg(long, value_enum, default_value_t = ExecutionProvider::Cpu)]
    provider: ExecutionProvider,
    /// Threads inside one run; 0 for one less than the machine has cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Write one JSON object a line: first the model, then each picture.
    #[arg(long)]
    json: bool,
    /// Draw the boxes into copies of the pictures, as JPEG files in this folder.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Write what the model is given into this folder: for each picture a file PICTURE.f32 with the input
    /// tensor, float32, little-endian.
    #[arg(long, value_name = "FOLDER")]
    write_input: Option<PathBuf>,
}

/// The printed facts of the model.
#[derive(Serialize)]
struct ModelFacts<'a> {
    model: &'a Path,
    head: &'a str,
    input: [i64; 4],
    classes: &'a [String],
}

/// The printed results of a picture.
#[derive(Serialize)]
struct PictureFacts<'a> {
    picture: &'a Path,
    width: u32,
    height: u32,
    decode_ms: f64,
    letterbox_ms: f64,
    model_ms: f64,
    head_ms: f64,
    detections: Vec<Detected<'a>>,
}

/// A detection, in pixels of the picture.
#[derive(Serialize)]
struct Detected<'a> {
    class: u16,
    class_name: &'a str,
    confidence: f64,
    x1: f64,
    y1: f64,
    x2: f64,
    y2: f64,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    // Seconds for a large model, minutes for TensorRT.
    let loading =
        ProgressBar::new_spinner().with_message(format!("loading {}", arguments.model.display()));
    loading.enable_steady_tick(Duration::from_millis(100));
    let network = DetectorNetwork::open(&configuration(arguments));
    loading.finish_and_clear();
    let mut network = network?;
    let names = network.class_names().to_vec();
    let facts = ModelFacts {
        model: &arguments.model,
        head: network.head().as_str(),
        input: network.input_format().shape(),
        classes: &names,
    };
    if arguments.json {
        println!("{}", serde_json::to_string(&facts)?);
    } else {
        println!("{}: {}", arguments.model.display(), network.signature());
        println!(
            "head {}, fed {:?} ({:?}, {:?}, {:?}), reports {} classes: {}",
            facts.head,
            facts.input,
            network.input_format().fit,
            network.input_format().color_order,
            network.input_format().value_range,
            names.len(),
            names.join(", ")
        );
    }
    for path in &arguments.pictures {
        for file in picture_files(path)? {
            let encoded = read_picture_file(&file)?;
            let started = Instant::now();
            let mut picture = Picture::default();
            decode(
                &encoded,
                &FrameLimits::default(),
                PixelLayout::Rgb8,
                Some(decoding_target(network.input_format(), None, encoded.size)),
                &mut picture,
            )
            .with_context(|| file.display().to_string())?;
            let decode_ms = started.elapsed().as_secs_f64() * 1e3;
            let prepared = network
                .preparation()
                .prepare(&picture)
                .with_context(|| file.display().to_string())?;
            let found = network
                .detect(&prepared)
                .with_context(|| file.display().to_string())?;
            print_detections(arguments.json, &file, &picture, decode_ms, &found, &names)?;
            if let Some(folder) = &arguments.out {
                write_drawn(folder, &file, &encoded, &found)
                    .with_context(|| file.display().to_string())?;
            }
            if let Some(folder) = &arguments.write_input {
                write_input(folder, &file, prepared.values())?;
            }
        }
    }
    let counts = network.counts();
    if counts != Default::default() {
        eprintln!("albireo: not reported: {counts:?}");
    }
    Ok(())
}

fn configuration(arguments: &Arguments) -> DetectorConfig {
    DetectorConfig {
        model: arguments.model.clone(),
        head: arguments.head,
        input_size: arguments.input_size.map(|size| [size.width, size.height]),
        class_names: arguments.class_names.clone().map(ClassNames::File),
        report_classes: arguments.all_classes.then(Vec::new),
        confidence: arguments.confidence,
        suppression_overlap: arguments.overlap,
        most_detections: arguments.most,
        providers: match arguments.provider {
            // CUDA runs what TensorRT cannot.
            ExecutionProvider::TensorRt => {
                vec![ExecutionProvider::TensorRt, ExecutionProvider::Cuda]
            }
            provider => vec![provider],
        },
        threads: arguments.threads,
        ..DetectorConfig::default()
    }
}

fn print_detections(
    json: bool,
    file: &Path,
    picture: &Picture,
    decode_ms: f64,
    found: &Found,
    names: &[String],
) -> anyhow::Result<()> {
    let size = picture.source_size;
    let detections = found
        .detections
        .iter()
        .map(|detection| {
            let corners = detection.bounding_box.pixel_corners(size);
            Detected {
                class: detection.class.0,
                class_name: names
                    .get(usize::from(detection.class.0))
                    .map_or("", String::as_str),
                confidence: detection.confidence,
                x1: corners.x1,
                y1: corners.y1,
                x2: corners.x2,
                y2: corners.y2,
            }
        })
        .collect();
    let facts = PictureFacts {
        picture: file,
        width: size.width,
        height: size.height,
        decode_ms,
        letterbox_ms: found.letterbox.as_secs_f64() * 1e3,
        model_ms: found.model.as_secs_f64() * 1e3,
        head_ms: found.head.as_secs_f64() * 1e3,
        detections,
    };
    let mut out = std::io::stdout().lock();
    if json {
        writeln!(out, "{}", serde_json::to_string(&facts)?)?;
        return Ok(());
    }
    writeln!(
        out,
        "{} {size}: {} detections (decode {decode_ms:.1} ms, letterbox {:.1} ms, model {:.1} ms, head {:.1} ms)",
        file.display(),
        facts.detections.len(),
        facts.letterbox_ms,
        facts.model_ms,
        facts.head_ms,
    )?;
    for found in &facts.detections {
        writeln!(
            out,
            "  {:<14} {:.3}  [{:.1}, {:.1}, {:.1}, {:.1}]",
            found.class_name, found.confidence, found.x1, found.y1, found.x2, found.y2
        )?;
    }
    Ok(())
}

/// Colours of boxes, by class.
const COLOURS: [[u8; 3]; 6] = [
    [79, 179, 255],
    [107, 226, 143],
    [255, 180, 84],
    [255, 105, 180],
    [214, 226, 107],
    [180, 140, 255],
];

/// Writes a picture with its boxes into `folder`.
fn write_drawn(
    folder: &Path,
    file: &Path,
    encoded: &EncodedPicture,
    found: &Found,
) -> anyhow::Result<()> {
    let limits = FrameLimits::default();
    // The network may have been given a smaller one.
    let mut picture = Picture::default();
    decode(encoded, &limits, PixelLayout::Rgb8, None, &mut picture)?;
    for detection in &found.detections {
        let corners = detection.bounding_box.pixel_corners(picture.size);
        let colour = COLOURS[usize::from(detection.class.0) % COLOURS.len()];
        outline(
            &mut picture,
            [corners.x1, corners.y1, corners.x2, corners.y2],
            colour,
        );
    }
    let drawn = EncodedPicture {
        bytes: picture.pixels.into(),
        format: PictureFormat::Rgb8,
        size: picture.size,
    };
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let name = Path::new(file.file_name().unwrap_or_default()).with_extension("jpg");
    let target = folder.join(name);
    if let (Ok(source), Ok(target)) = (file.canonicalize(), target.canonicalize()) {
        ensure!(source != target, "--out would overwrite the picture itself");
    }
    std::fs::write(&target, to_jpeg(&drawn, &limits)?).with_context(|| target.display().to_string())
}

/// Draws the outline of a box, `[x1, y1, x2, y2]` in pixels, into an RGB picture; what lies outside it is cut off.
fn outline(picture: &mut Picture, corners: [f64; 4], colour: [u8; 3]) {
    let (width, height) = (
        i64::from(picture.size.width),
        i64::from(picture.size.height),
    );
    // Two pixels in a picture of 640 columns.
    let thick = (width / 320).max(1);
    let [x1, y1, x2, y2] = corners.map(|place| place.round() as i64);
    for y in y1.max(0)..y2.min(height) {
        let edge = y - y1 < thick || y2 - y <= thick;
        for x in x1.max(0)..x2.min(width) {
            if edge || x - x1 < thick || x2 - x <= thick {
                let at = usize::try_from(3 * (y * width + x)).unwrap_or(usize::MAX);
                if let Some(pixel) = picture.pixels.get_mut(at..at.saturating_add(3)) {
                    pixel.copy_from_slice(&colour);
                }
            }
        }
    }
}

fn write_input(folder: &Path, picture: &Path, values: &[f32]) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let mut name = picture.file_name().unwrap_or_default().to_owned();
    name.push(".f32");
    let file = folder.join(name);
    let bytes: Vec<u8> = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    std::fs::write(&file, bytes).with_context(|| file.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_outlined_and_cut_off_at_the_border_of_the_picture() {
        let mut picture = Picture::black(PictureSize {
            width: 8,
            height: 6,
        });
        outline(&mut picture, [2.0, 1.0, 20.0, 5.0], [9, 9, 9]);
        let lit = |x: usize, y: usize| picture.pixels[3 * (8 * y + x)] == 9;
        assert!(lit(2, 1) && lit(7, 1) && lit(2, 4) && lit(7, 4));
        assert!(!lit(3, 2) && !lit(7, 2) && !lit(1, 1) && !lit(2, 5));
    }
}
