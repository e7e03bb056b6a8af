//! Reads ground truth of ImageNet-VID (ILSVRC 2015): a folder of XML files for each clip, one for each labelled frame,
//! `Annotations/VID/val/<clip>/000000.xml` beside the pictures `Data/VID/val/<clip>/000000.JPEG`.
//!
//! A file's name is the frame, counted from 0, and that of its picture. A file without an object is a frame without
//! objects; a frame without a file was not labelled and is not judged. Boxes are corners in pixels from 0. Source:
//! ILSVRC2015 development kit, readme.

use super::classes::Evaluated;
use super::rows::MAX_FRAMES;
use super::{Clip, DataSet, LabelledBox, LeftOut, LoadReport, TRUTH_CONFIDENCE};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use crate::files::{entries, has_extension, read_text};
use crate::footage::clip_name;
use crate::judge::Ignored;
use albireo_core::geometry::{Corners, PictureSize};
use roxmltree::{Document, Node};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The 30 classes: WordNet's number, the data set's name, and COCO's where it is another.
const CLASSES: [(&str, &str, &str); 30] = [
    ("n02691156", "airplane", ""),
    ("n02419796", "antelope", ""),
    ("n02131653", "bear", ""),
    ("n02834778", "bicycle", ""),
    ("n01503061", "bird", ""),
    ("n02924116", "bus", ""),
    ("n02958343", "car", ""),
    ("n02402425", "cattle", "cow"),
    ("n02084071", "dog", ""),
    ("n02121808", "domestic_cat", "cat"),
    ("n02503517", "elephant", ""),
    ("n02118333", "fox", ""),
    ("n02510455", "giant_panda", ""),
    ("n02342885", "hamster", ""),
    ("n02374451", "horse", ""),
    ("n02129165", "lion", ""),
    ("n01674464", "lizard", ""),
    ("n02484322", "monkey", ""),
    ("n03790512", "motorcycle", ""),
    ("n02324045", "rabbit", ""),
    ("n02509815", "red_panda", ""),
    ("n02411705", "sheep", ""),
    ("n01726692", "snake", ""),
    ("n02355227", "squirrel", ""),
    ("n02129604", "tiger", ""),
    ("n04468005", "train", ""),
    ("n01662784", "turtle", ""),
    ("n04530566", "watercraft", "boat"),
    ("n02062744", "whale", ""),
    ("n02391049", "zebra", ""),
];

/// Reads all clips of a folder such as `Annotations/VID/val`, or the folder of one clip.
///
/// # Errors
/// [`EvalError`] for a missing or broken file, or pictures of different sizes within a clip.
pub fn read(folder: &Path) -> Result<DataSet, EvalError> {
    read_as(folder, &Evaluated::Road)
}

/// [`read`] with the boxes of these classes.
pub(super) fn read_as(folder: &Path, classes: &Evaluated) -> Result<DataSet, EvalError> {
    let list = |folder: &Path, wanted: &dyn Fn(&Path) -> bool| {
        let help = "give the folder that contains a folder of XML files for each clip, such as Annotations/VID/val";
        entries(folder, wanted).map_err(|error| EvalError::read(folder, error, help))
    };
    let is_label = |path: &Path| has_extension(path, &["xml"]);
    let mut folders = list(folder, &Path::is_dir)?;
    if folders.is_empty() {
        folders.push(folder.to_owned());
    }
    let mut data = DataSet::default();
    for of_clip in folders {
        let files = list(&of_clip, &is_label)?;
        let clip = read_clip(clip_name(&of_clip), &files, classes, &mut data.report)?;
        data.push(clip);
    }
    data.nonempty(
        folder,
        "a folder of XML files for each clip, such as those in Annotations/VID/val",
    )
}

/// The objects of a frame's file.
#[derive(Default)]
struct LabelFile {
    /// The name that it shares with its picture.
    stem: String,
    boxes: Vec<ScoredBox>,
}

fn read_clip(
    name: String,
    files: &[PathBuf],
    classes: &Evaluated,
    report: &mut LoadReport,
) -> Result<Clip, EvalError> {
    let mut labels: BTreeMap<usize, LabelFile> = BTreeMap::new();
    let mut size: Option<PictureSize> = None;
    for file in files {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let number = stem.parse().ok().filter(|number| *number < MAX_FRAMES);
        let frame = number.ok_or_else(|| {
            EvalError::content(file, "its name is no frame's number, such as 000000.xml")
        })?;
        if labels.contains_key(&frame) {
            let what = format!("frame {frame} occurs twice");
            return Err(EvalError::content(file, what));
        }
        let text = read_text(file, "is the file readable?")?;
        let document = Document::parse(&text).map_err(|error| EvalError::content(file, error))?;
        let root = document.root_element();
        let picture = picture_size(root, file)?;
        let first = *size.get_or_insert(picture);
        if picture != first {
            let what = format!("its picture is {picture}, the clip's first {first}");
            return Err(EvalError::content(file, what));
        }
        let mut boxes = Vec::new();
        for object in root.children().filter(|child| child.has_tag_name("object")) {
            let labelled = labelled_box(object, classes, file)?;
            boxes.extend(report.keep(&labelled, picture, || file.display().to_string()));
        }
        let stem = stem.into_owned();
        labels.insert(frame, LabelFile { stem, boxes });
    }
    let frames = labels.last_key_value().map_or(0, |(last, _)| last + 1);
    // A clip without files has no frames either, so its size stands for nothing.
    let picture = size.unwrap_or(PictureSize::new(1, 1));
    let mut clip = Clip::new(name, picture, frames);
    let mut truth = Vec::new();
    for frame in 0..frames {
        let file = labels.remove(&frame);
        if file.is_none() {
            clip.ignore(frame, Ignored::UNLABELLED);
        }
        let LabelFile { stem, boxes } = file.unwrap_or_default();
        truth.push(boxes);
        clip.label_names.push(stem);
    }
    clip.truth = Some(truth);
    Ok(clip)
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str, file: &Path) -> Result<Node<'a, 'i>, EvalError> {
    let found = node.children().find(|child| child.has_tag_name(name));
    let parent = node.tag_name().name();
    found.ok_or_else(|| EvalError::content(file, format!("a <{parent}> has no <{name}>")))
}

fn number(node: Node<'_, '_>, name: &str, file: &Path) -> Result<f64, EvalError> {
    let text = child(node, name, file)?.text().unwrap_or_default().trim();
    text.parse()
        .map_err(|_| EvalError::content(file, format!("<{name}> is `{text}`, not a number")))
}

fn picture_size(root: Node<'_, '_>, file: &Path) -> Result<PictureSize, EvalError> {
    let written = child(root, "size", file)?;
    let width = number(written, "width", file)?;
    let height = number(written, "height", file)?;
    let size = PictureSize::new(width as u32, height as u32);
    if size.pixels() == 0 {
        return Err(EvalError::content(file, "the picture has no size"));
    }
    Ok(size)
}

fn labelled_box<'a>(
    object: Node<'a, '_>,
    classes: &Evaluated,
    file: &Path,
) -> Result<LabelledBox<'a>, EvalError> {
    let written = child(object, "name", file)?.text().unwrap_or_default().trim();
    let known = CLASSES.iter().find(|(wordnet, name, _)| [*wordnet, *name].contains(&written));
    // A name that the data set does not have can still be a class of the user's own model.
    let (wordnet, name, coco) = known.copied().unwrap_or((written, written, ""));
    let class = [wordnet, name, coco].into_iter().find_map(|name| classes.find(name).ok());
    let place = child(object, "bndbox", file)?;
    Ok(LabelledBox {
        corners: Corners {
            x1: number(place, "xmin", file)?,
            y1: number(place, "ymin", file)?,
            x2: number(place, "xmax", file)?,
            y2: number(place, "ymax", file)?,
        },
        class: class.ok_or(LeftOut::UnmappedClass),
        class_name: name.into(),
        confidence: TRUTH_CONFIDENCE,
        object: child(object, "trackid", file)?.text().and_then(|id| id.trim().parse().ok()),
    })
}
