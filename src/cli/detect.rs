//! `albireo detect`: describes a detector, and runs it on pictures.

use super::progress::spinner;
use super::terminal::print;
use super::values::{counted, parse_size};
use albireo_core::detection::Detection;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::detector::{
    ClassNames, DetectorConfig, DetectorNetwork, ExecutionProvider, Found, HeadCounts, HeadSetting,
    USUAL_PICTURE, named_classes,
};
use albireo_vision::picture::{
    ColorOrder, EncodedPicture, Fit, FrameLimits, LineStyle, Picture, PictureFormat, PixelLayout,
    ValueRange, decode, outline, picture_files, read_picture_file, to_jpeg,
};
use albireo_vision::screen::decoding_target;
use anyhow::{Context, bail, ensure};
use serde_json::json;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Arguments of `albireo detect`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  albireo detect yolo26n.onnx                       print how the model is read
  albireo detect yolo26n.onnx frame.jpg             and what it finds
  albireo detect yolo26n.onnx frame.jpg --out seen   and draw the boxes
  albireo detect yolo26n.onnx pictures/ --json      one JSON object per picture
  albireo detect plates.onnx frame.jpg \\
      --head 'columns=batch x1 y1 x2 y2 class score'

The options --head, --class-names, --input-size, --range, --color-order and
--fit are the keys of the same name in [detector].

A picture that cannot be used is named and counted, and the others are looked
at; the exit code is then 1.")]
pub(super) struct DetectArguments {
    /// The ONNX file.
    model: PathBuf,
    /// Pictures, or folders of pictures.
    pictures: Vec<PathBuf>,
    /// How the model's output is read: auto, yolo, yolov5, yolox, yolo-nas, end-to-end, detr, rt-detr, d-fine, rtmdet,
    /// fastestdet, or the columns of its output, `columns=batch x1 y1 x2 y2 class score`.
    #[arg(long, default_value_t)]
    head: HeadSetting,
    /// Names of its classes, one per line; `coco` for COCO's 80 [default: those of its metadata, or the head's own
    /// list]
    #[arg(long, value_name = "FILE")]
    class_names: Option<PathBuf>,
    /// Report all classes of the model under their own names and numbers; of COCO's 80, only those of BDD100K
    /// otherwise.
    #[arg(long)]
    all_classes: bool,
    /// The range of the input's values [default: the head's]
    #[arg(long, value_enum)]
    range: Option<ValueRange>,
    /// The order of the input's colours [default: the head's]
    #[arg(long, value_enum)]
    color_order: Option<ColorOrder>,
    /// How a picture is fitted to the input [default: the head's]
    #[arg(long, value_enum)]
    fit: Option<Fit>,
    /// Columns x rows of the input, if the model leaves them open.
    #[arg(long, value_parser = parse_size)]
    input_size: Option<PictureSize>,
    /// Detections below this confidence are dropped.
    #[arg(long, default_value_t = 0.5)]
    confidence: f64,
    /// A box that overlaps a better one of its class by more than this is dropped.
    #[arg(long, default_value_t = 0.45)]
    overlap: f64,
    /// The most detections per picture.
    #[arg(long, default_value_t = 300)]
    most: usize,
    /// The execution provider that runs the model.
    #[arg(long, value_enum, default_value_t = ExecutionProvider::Cpu)]
    provider: ExecutionProvider,
    /// Threads inside one run; 0 for one less than the machine has cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Write one JSON object per line: first the model, then each picture.
    #[arg(long)]
    json: bool,
    /// Draw the boxes into copies of the pictures, as JPEG files in this folder.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Write the model's input into this folder: for each picture a file PICTURE.f32 with the input
    /// tensor, float32, little-endian.
    #[arg(long, value_name = "FOLDER")]
    write_input: Option<PathBuf>,
}

pub(super) fn run(arguments: &DetectArguments) -> anyhow::Result<()> {
    let files = pictures(arguments)?;
    // Loading takes seconds for a large model, and minutes for TensorRT.
    let loading = spinner(format!("loading {}", arguments.model.display()));
    let opened = DetectorNetwork::open(&configuration(arguments));
    loading.finish_and_clear();
    let mut network = opened?;
    let names = network.class_names().to_vec();
    let mut unusable = 0;
    if arguments.json {
        let model = &arguments.model;
        let facts = json!({
            "model": model, "head": network.head().as_str(), "input": network.input_format().shape(),
            "open": network.input().open.is_some(),
            "classes": names, "not_reported": network.left_out(),
        });
        println!("{facts}");
    } else {
        let signature = network.signature();
        let description = network.description();
        let provider = network.provider().as_str();
        print(&format!("{}: {signature}", arguments.model.display()));
        print(&format!("{description}, runs on {provider}"));
        print(&classes(&names, network.left_out()));
    }
    for file in &files {
        let outcome = match read_picture_file(file) {
            Ok(encoded) => detect(arguments, &mut network, file, &encoded, &names)
                .with_context(|| file.display().to_string()),
            Err(error) => Err(error.into()),
        };
        // One bad file does not hide what is in the others.
        if let Err(error) = outcome {
            unusable += 1;
            eprintln!("albireo: {error:#}");
        }
    }
    if !arguments.json {
        for found in network.preparation().inputs() {
            print(&found.to_string());
        }
        if arguments.pictures.is_empty() && network.input().open.is_none() {
            print_waste(&network);
        }
    }
    for line in not_reported(&network.counts(), network.left_out()) {
        eprintln!("albireo: {line}");
    }
    if let Some(doubt) = network.doubt() {
        bail!("nothing that the model finds is possible: {doubt}");
    }
    ensure!(
        unusable == 0,
        "{unusable} of {} could not be used",
        counted(files.len() as u64, "picture", "pictures")
    );
    Ok(())
}

/// The pictures to look at. Refuses two of one name where files are named after them.
fn pictures(arguments: &DetectArguments) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in &arguments.pictures {
        files.extend(picture_files(path)?);
    }
    let mut by_name: HashMap<PathBuf, &PathBuf> = HashMap::new();
    for file in &files {
        // Pictures whose drawn files differ have inputs of different names, too.
        let name = if arguments.out.is_some() {
            drawn_name(file)
        } else if arguments.write_input.is_some() {
            input_name(file)
        } else {
            break;
        };
        if let Some(other) = by_name.insert(name, file) {
            bail!(
                "{} and {} would be written under one name: give them in two commands, with a folder each",
                other.display(),
                file.display()
            );
        }
    }
    Ok(files)
}

/// Says what a model of one size wastes on most cameras' pictures, if that is worth a word.
fn print_waste(network: &DetectorNetwork) {
    let usual = network.input().first_use(USUAL_PICTURE);
    if usual.is_wasteful() {
        print(&usual.to_string());
    }
}

/// The classes that are reported, and those that are not.
fn classes(reported: &[String], left_out: &[String]) -> String {
    let named = named_classes(reported);
    let mut text = format!(
        "reports {}: {}",
        counted(named.len() as u64, "class", "classes"),
        named.join(", ")
    );
    if !left_out.is_empty() {
        let first: Vec<_> = left_out.iter().take(8).map(String::as_str).collect();
        let more = if left_out.len() > first.len() {
            ", …"
        } else {
            ""
        };
        text.push_str(&format!(
            "\nnot reported: {} of the model ({}{more}); --all-classes, or detector.report_classes = [], reports them",
            counted(left_out.len() as u64, "class", "classes"),
            first.join(", "),
        ));
    }
    text
}

/// What the model found and was not reported, a line for each reason.
fn not_reported(counts: &HeadCounts, left_out: &[String]) -> Vec<String> {
    let of_others = if left_out.is_empty() {
        ""
    } else {
        " (--all-classes reports them)"
    };
    let reasons = [
        (counts.other_class, format!("of classes that are not reported{of_others}")),
        (
            counts.rejected,
            "impossible: a number that is not finite or no score, a box without an area or much larger than the \
             input"
                .to_owned(),
        ),
        (counts.outside, "outside of the picture".to_owned()),
        (
            counts.unknown_class,
            "of a class number for which there is no name (--class-names; if the numbers begin with 1, let the names \
             begin with one that does not occur)"
                .to_owned(),
        ),
        (counts.over_limit, "beyond the limit of detections (--most)".to_owned()),
    ];
    let mut lines = Vec::new();
    for (count, reason) in reasons {
        if count > 0 {
            let boxes = counted(count, "box", "boxes");
            lines.push(format!("not reported: {boxes} {reason}"));
        }
    }
    lines
}

fn configuration(arguments: &DetectArguments) -> DetectorConfig {
    DetectorConfig {
        model: arguments.model.clone(),
        head: arguments.head.clone(),
        range: arguments.range,
        color_order: arguments.color_order,
        fit: arguments.fit,
        input_size: arguments.input_size.map(|size| [size.width, size.height]),
        class_names: arguments.class_names.clone().map(ClassNames::File),
        report_classes: arguments.all_classes.then(Vec::new),
        confidence: arguments.confidence,
        suppression_overlap: arguments.overlap,
        most_detections: arguments.most,
        providers: match arguments.provider {
            // CUDA runs the parts of a model that TensorRT cannot run.
            ExecutionProvider::TensorRt => {
                vec![ExecutionProvider::TensorRt, ExecutionProvider::Cuda]
            }
            provider => vec![provider],
        },
        threads: arguments.threads,
        ..DetectorConfig::default()
    }
}

/// Runs the detector on a picture, prints its detections, and writes the requested files.
fn detect(
    arguments: &DetectArguments,
    network: &mut DetectorNetwork,
    file: &Path,
    encoded: &EncodedPicture,
    names: &[String],
) -> anyhow::Result<()> {
    let started = Instant::now();
    let mut picture = Picture::default();
    decode(
        encoded,
        &FrameLimits::default(),
        PixelLayout::Rgb8,
        Some(decoding_target(network.input_format(), None, encoded.size)),
        &mut picture,
    )?;
    let decoding = started.elapsed();
    let prepared = network.preparation().prepare(&picture)?;
    let found = network.detect(&prepared)?;
    let milliseconds = |time: Duration| time.as_secs_f64() * 1e3;
    let decode_ms = milliseconds(decoding);
    let letterbox_ms = milliseconds(found.letterbox);
    let model_ms = milliseconds(found.model);
    let head_ms = milliseconds(found.head);
    let size = picture.source_size;
    let name_of = |detection: &Detection| {
        names.get(usize::from(detection.class.0)).map_or("", String::as_str)
    };
    if arguments.json {
        let in_json = |detection: &Detection| {
            let corners = detection.bounding_box.pixel_corners(size);
            json!({
                "class": detection.class.0, "class_name": name_of(detection), "confidence": detection.confidence,
                "x1": corners.x1, "y1": corners.y1, "x2": corners.x2, "y2": corners.y2,
            })
        };
        let detections: Vec<_> = found.detections.iter().map(in_json).collect();
        let facts = json!({
            "picture": file, "width": size.width, "height": size.height, "input": prepared.size().to_string(),
            "padding": network.input_format().padding(size, prepared.size()), "decode_ms": decode_ms,
            "letterbox_ms": letterbox_ms, "model_ms": model_ms, "head_ms": head_ms, "detections": detections,
        });
        println!("{facts}");
    } else {
        println!(
            "{} {size}: {} (decode {decode_ms:.1} ms, letterbox {letterbox_ms:.1} ms, model {model_ms:.1} ms, \
             head {head_ms:.1} ms)",
            file.display(),
            counted(found.detections.len() as u64, "detection", "detections"),
        );
        for detection in &found.detections {
            let Corners { x1, y1, x2, y2 } = detection.bounding_box.pixel_corners(size);
            let name = name_of(detection);
            let confidence = detection.confidence;
            println!("  {name:<14} {confidence:.3}  [{x1:.1}, {y1:.1}, {x2:.1}, {y2:.1}]");
        }
    }
    if let Some(folder) = &arguments.out {
        write_drawn(folder, file, encoded, &found)?;
    }
    if let Some(folder) = &arguments.write_input {
        // What the model takes, also where a GPU would make it from the prepared pixels.
        let input = prepared.converted(network.input_format())?;
        let values = input.tensor().to_floats();
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        write(&in_folder(folder, &input_name(file))?, &bytes)?;
    }
    Ok(())
}

/// The name under which a picture is written with its boxes: as JPEG, whatever it is.
fn drawn_name(picture: &Path) -> PathBuf {
    Path::new(picture.file_name().unwrap_or_default()).with_extension("jpg")
}

/// The name under which the input that is made of a picture is written.
fn input_name(picture: &Path) -> PathBuf {
    let mut name = picture.file_name().unwrap_or_default().to_owned();
    name.push(".f32");
    name.into()
}

/// Returns the place of a file in a folder, which is created if needed.
fn in_folder(folder: &Path, name: &Path) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    Ok(folder.join(name))
}

fn write(file: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(file, bytes).with_context(|| file.display().to_string())
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
    // Decoded once more: for the network it may have been decoded at a smaller size.
    let mut picture = Picture::default();
    decode(encoded, &limits, PixelLayout::Rgb8, None, &mut picture)?;
    for detection in &found.detections {
        let Corners { x1, y1, x2, y2 } = detection.bounding_box.pixel_corners(picture.size);
        let colour = COLOURS[usize::from(detection.class.0) % COLOURS.len()];
        outline(&mut picture, [x1, y1, x2, y2], colour, LineStyle::Solid);
    }
    let drawn = EncodedPicture {
        bytes: picture.pixels.into(),
        format: PictureFormat::Rgb8,
        size: picture.size,
        mount: None,
    };
    let target = in_folder(folder, &drawn_name(file))?;
    // A target that does not exist yet has no canonical path, and cannot be the picture.
    if let (Ok(source), Ok(existing)) = (file.canonicalize(), target.canonicalize()) {
        ensure!(
            source != existing,
            "--out would overwrite the picture itself"
        );
    }
    write(&target, &to_jpeg(&drawn, &limits)?)
}
