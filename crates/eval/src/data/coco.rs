//! Reads COCO JSON: `images`, `annotations`, `categories`, and detections as a list of results.
//!
//! A clip is a video if images have `video_id`, and otherwise a folder of `file_name`; its frames are in order of
//! `frame_id`, and otherwise of the file names, as pictures are. Boxes are `[x, y, width, height]`. Source: COCO data
//! format, cocodataset.org, and its video extensions as in TAO and YouTube-VIS.
//!
//! Images are the pictures of their names. If a clip has more pictures than its images, as with TAO's labels of one
//! frame in thirty, and none has the name of an image, `frame_id` (`frame_index`) is the picture's place in it: counted
//! from 1 if the lowest of the whole file is 1, and otherwise from 0. Names and numbers that contradict each other are
//! refused.
//!
//! A video with TAO's `neg_category_ids` is labelled for these categories, which do not occur in it, and for those that
//! have boxes there, except that of its `not_exhaustive_category_ids` only some objects have one. Boxes of all other
//! classes are not judged in it. A category such as `car_(automobile)` is also found as `car`.
//!
//! An annotation with `iscrowd` is a crowd, one with `ignore` an object that is not judged; both as in pycocotools.

use super::classes::Evaluated;
use super::rows::MAX_FRAMES;
use super::{Clip, DataSet, LabelledBox, LeftOut, TRUTH_CONFIDENCE};
use crate::error::EvalError;
use crate::files::{entries, open_text};
use crate::judge::{Ignored, Mark};
use albireo_core::detection::ClassId;
use albireo_core::geometry::{Corners, PictureSize};
use albireo_vision::picture::natural_key;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::fmt::Display;
use std::hash::Hash;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct Dataset {
    images: Vec<Image>,
    #[serde(default)]
    annotations: Option<Vec<Annotation>>,
    categories: Vec<Category>,
    #[serde(default)]
    videos: Vec<ListedVideo>,
}

impl Dataset {
    /// Makes sure that each id belongs to one entry: files that were merged can both count from 1.
    ///
    /// # Errors
    /// The first id that belongs to two, in words.
    fn check_ids(&self) -> Result<(), String> {
        let mut images = Ids::of("images");
        for image in &self.images {
            images.add(image.id, &image.file_name)?;
        }
        let mut categories = Ids::of("categories");
        for category in &self.categories {
            categories.add(category.id, &category.name)?;
        }
        let mut videos = Ids::of("videos");
        for video in &self.videos {
            videos.add(video.id, video.name.as_deref().unwrap_or_default())?;
        }
        self.check_annotations()
    }

    /// Makes sure that no annotation is listed twice, as in files that were merged. Nothing is found by the id of an
    /// annotation, so some files give all the same one, or that of the image.
    fn check_annotations(&self) -> Result<(), String> {
        let annotations = self.annotations.iter().flatten();
        let mut with_id: Vec<&Annotation> = annotations.filter(|one| one.id.is_some()).collect();
        with_id.sort_unstable_by_key(|annotation| annotation.place());
        for alike in with_id.chunk_by(|a, b| a.place() == b.place()) {
            let mut ids = HashSet::new();
            for annotation in alike {
                let is_new = ids.insert(&annotation.id);
                if let Some(id) = &annotation.id
                    && !is_new
                {
                    let image = annotation.image_id;
                    return Err(format!(
                        "the annotation {id} is listed twice, on the image {image}"
                    ));
                }
            }
        }
        Ok(())
    }
}

/// The entries of a kind by their ids.
struct Ids<I, N> {
    kind: &'static str,
    names: HashMap<I, N>,
}

impl<I: Copy + Eq + Hash + Display, N: Display> Ids<I, N> {
    fn of(kind: &'static str) -> Self {
        let names = HashMap::new();
        Self { kind, names }
    }

    /// Adds an entry.
    ///
    /// # Errors
    /// When its id belongs to another one, in words.
    fn add(&mut self, id: I, name: N) -> Result<(), String> {
        let Some(other) = self.names.get(&id) else {
            self.names.insert(id, name);
            return Ok(());
        };
        let kind = self.kind;
        Err(format!(
            "the id {id} belongs to two {kind}: {other} and {name}"
        ))
    }
}

#[derive(Deserialize)]
struct Image {
    id: u64,
    #[serde(default)]
    file_name: String,
    width: u32,
    height: u32,
    #[serde(default)]
    video_id: Option<u64>,
    #[serde(default)]
    frame_id: Option<u64>,
    #[serde(default)]
    frame_index: Option<u64>,
}

impl Image {
    /// The number of its frame; some files have both names for it.
    fn number(&self) -> Option<u64> {
        self.frame_id.or(self.frame_index)
    }
}

#[derive(Deserialize)]
struct Annotation {
    #[serde(default)]
    id: Option<Value>,
    image_id: u64,
    category_id: u64,
    bbox: [f64; 4],
    #[serde(default, deserialize_with = "flag")]
    iscrowd: bool,
    #[serde(default, deserialize_with = "flag")]
    ignore: bool,
    #[serde(default)]
    track_id: Option<u64>,
    #[serde(default)]
    instance_id: Option<u64>,
    #[serde(default)]
    score: Option<f64>,
}

/// The image, the class and the box of an annotation, as bits that can be compared.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct AnnotatedPlace {
    image: u64,
    category: u64,
    bbox: [u64; 4],
}

impl Annotation {
    fn place(&self) -> AnnotatedPlace {
        AnnotatedPlace {
            image: self.image_id,
            category: self.category_id,
            bbox: self.bbox.map(f64::to_bits),
        }
    }
}

/// Reads a flag, which files write as a number or as `true`.
fn flag<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    let is_set = match Value::deserialize(deserializer)? {
        Value::Bool(set) => set,
        Value::Number(number) => number.as_f64() != Some(0.0),
        _ => false,
    };
    Ok(is_set)
}

#[derive(Deserialize)]
struct Category {
    id: u64,
    name: String,
}

#[derive(Deserialize)]
struct ListedVideo {
    id: u64,
    #[serde(default)]
    name: Option<String>,
    #[serde(default)]
    fps: Option<f64>,
    #[serde(default)]
    frame_rate: Option<f64>,
    #[serde(default)]
    neg_category_ids: Option<Vec<u64>>,
    #[serde(default)]
    not_exhaustive_category_ids: Vec<u64>,
}

/// Reads a data set and, if given, a list of results on its images.
///
/// # Errors
/// [`EvalError`] for a missing or broken file, a box on an image that is not listed, or pictures of different sizes
/// within a clip.
pub fn read(dataset: &Path, results: Option<&Path>) -> Result<DataSet, EvalError> {
    read_as(dataset, results, &Evaluated::Road)
}

/// [`read`] with the boxes of these classes.
pub(super) fn read_as(
    dataset: &Path,
    results: Option<&Path>,
    classes: &Evaluated,
) -> Result<DataSet, EvalError> {
    let file = &file_of(dataset)?;
    let set: Dataset = parse(file, "give a COCO file with images and categories")?;
    set.check_ids().map_err(|what| EvalError::content(file, what))?;
    let mut categories = Categories::new();
    for Category { id, name } in &set.categories {
        let class = class_of(name, classes);
        categories.insert(*id, KnownCategory { name, class });
    }
    let has_truth = set.annotations.is_some();
    let (mut drafts, places) = frames(file, &set, has_truth, results.is_some())?;
    let mut data = DataSet::default();
    let report = &mut data.report;
    let labelled_box = |annotation: &Annotation, confidence| {
        let category = categories.get(&annotation.category_id);
        LabelledBox {
            corners: corners(annotation.bbox),
            class: category.map_or(Err(LeftOut::UnmappedClass), |category| category.class),
            class_name: match category {
                Some(category) => category.name.into(),
                None => format!("category {}", annotation.category_id).into(),
            },
            confidence,
            object: annotation.track_id.or(annotation.instance_id),
        }
    };
    for (number, annotation) in set.annotations.iter().flatten().enumerate() {
        let entry = || format!("{}, annotation {number}", file.display());
        let place = place_of(annotation, number, &places, file)?;
        let clip = &mut drafts[place.clip];
        let labelled = labelled_box(annotation, TRUTH_CONFIDENCE);
        let mark = if annotation.iscrowd {
            Some(Mark::Crowd)
        } else if annotation.ignore {
            Some(Mark::Object)
        } else {
            None
        };
        if let Some(mark) = mark
            && let Ok(class) = labelled.class
        {
            let marked = report.mark(labelled.corners, Some(class), mark, clip.picture, entry);
            if let Some(marked) = marked {
                clip.ignore(place.frame, marked);
            }
        } else {
            let kept = report.keep(&labelled, clip.picture, entry);
            if let Some(truth) = &mut clip.truth {
                truth[place.frame].extend(kept);
            }
        }
    }
    if let Some(path) = results {
        let found: Vec<Annotation> = parse(path, "give a COCO list of results")?;
        for (number, result) in found.iter().enumerate() {
            let entry = || format!("{}, result {number}", path.display());
            let place = place_of(result, number, &places, path)?;
            let clip = &mut drafts[place.clip];
            let confidence = result.score.ok_or_else(|| {
                EvalError::content(path, format!("result {number} has no `score`"))
            })?;
            let kept = report.keep(&labelled_box(result, confidence), clip.picture, entry);
            if let Some(detections) = &mut clip.detections {
                detections[place.frame].extend(kept);
            }
        }
    }
    data.report.partly_labelled = mark_other_classes(&set, &places, &mut drafts, &categories);
    for clip in drafts {
        data.push(clip);
    }
    data.nonempty(
        file,
        "a file with images, annotations and categories, such as annotations/instances_val2017.json",
    )
}

/// A category, and the class that it is.
struct KnownCategory<'a> {
    name: &'a str,
    class: Result<ClassId, LeftOut>,
}

/// The categories by their ids.
type Categories<'a> = HashMap<u64, KnownCategory<'a>>;

/// The class of a category: by its name, else by the name without the meaning that TAO and LVIS add in brackets, and
/// with spaces for its underscores.
fn class_of(name: &str, classes: &Evaluated) -> Result<ClassId, LeftOut> {
    let plain = || name.split("_(").next().unwrap_or_default().replace('_', " ");
    classes.find(name).or_else(|_| classes.find(&plain()))
}

/// Marks in each video that says for which categories it is labelled the whole picture for all other classes, and
/// returns the number of these videos.
fn mark_other_classes(
    set: &Dataset,
    places: &Places,
    drafts: &mut [Clip],
    categories: &Categories<'_>,
) -> usize {
    let mut labelled: HashMap<usize, BTreeSet<u64>> = HashMap::new();
    for annotation in set.annotations.iter().flatten() {
        if let Some(place) = places.get(&annotation.image_id) {
            labelled.entry(place.clip).or_default().insert(annotation.category_id);
        }
    }
    let mut clip_of_video = HashMap::new();
    for image in &set.images {
        if let Some(video) = image.video_id
            && let Some(place) = places.get(&image.id)
        {
            clip_of_video.insert(video, place.clip);
        }
    }
    let class_by_id = |id: &u64| categories.get(id)?.class.ok();
    let all: BTreeSet<ClassId> = categories.keys().filter_map(class_by_id).collect();
    let mut limited = 0;
    for video in &set.videos {
        let Some(absent) = &video.neg_category_ids else {
            continue;
        };
        let Some(&index) = clip_of_video.get(&video.id) else {
            continue;
        };
        let mut judged_ids = labelled.remove(&index).unwrap_or_default();
        judged_ids.extend(absent);
        judged_ids.retain(|id| !video.not_exhaustive_category_ids.contains(id));
        let judged: BTreeSet<ClassId> = judged_ids.iter().filter_map(class_by_id).collect();
        let clip = &mut drafts[index];
        let whole_picture = Corners {
            x1: 0.0,
            y1: 0.0,
            x2: f64::from(clip.picture.width),
            y2: f64::from(clip.picture.height),
        };
        for frame in 0..clip.frames {
            for other in all.difference(&judged) {
                let unjudged = Ignored {
                    corners: whole_picture,
                    class: Some(*other),
                    mark: Mark::Region,
                };
                clip.ignore(frame, unjudged);
            }
        }
        limited += 1;
    }
    limited
}

/// The file of a data set: `place` itself, or the one in a folder that `albireo export --to coco` has written.
///
/// # Errors
/// When a folder has no such file.
fn file_of(place: &Path) -> Result<PathBuf, EvalError> {
    if !place.is_dir() {
        return Ok(place.to_owned());
    }
    let exported = place.join("annotations.json");
    if exported.is_file() {
        return Ok(exported);
    }
    let is_json = |path: &Path| path.extension().is_some_and(|extension| extension == "json");
    let found = entries(place, is_json).unwrap_or_default();
    let example = found.first().unwrap_or(&exported).display().to_string();
    let what = format!(
        "this is a folder, and COCO is one JSON file with images, annotations and categories: give it, such as {example}"
    );
    Err(EvalError::content(place, what))
}

fn parse<T: DeserializeOwned>(path: &Path, help: &str) -> Result<T, EvalError> {
    // Such files can be large, so their text is never in memory as a whole.
    let text = open_text(path, help)?;
    serde_json::from_reader(text).map_err(|error| EvalError::json(path, &error))
}

fn corners([x, y, width, height]: [f64; 4]) -> Corners {
    Corners {
        x1: x,
        y1: y,
        x2: x + width,
        y2: y + height,
    }
}

/// The place of an image: the clip by its index, and the frame.
#[derive(Clone, Copy)]
struct Place {
    clip: usize,
    frame: usize,
}

/// The place of each image, by the image's id.
type Places = HashMap<u64, Place>;

/// The place of the image of an annotation, which is the one of this `number` in the file.
fn place_of(
    annotation: &Annotation,
    number: usize,
    places: &Places,
    path: &Path,
) -> Result<Place, EvalError> {
    let id = annotation.image_id;
    places.get(&id).copied().ok_or_else(|| {
        let what = format!("entry {number} is on image {id}, which is not listed");
        EvalError::content(path, what)
    })
}

/// The name of an image's clip: its video's, else that of its folder.
fn clip_of(image: &Image, videos: &HashMap<u64, &ListedVideo>) -> String {
    if let Some(id) = image.video_id {
        return videos
            .get(&id)
            .and_then(|video| video.name.clone())
            .unwrap_or_else(|| format!("video-{id}"));
    }
    match Path::new(&image.file_name).parent() {
        Some(folder) if folder != Path::new("") => folder.to_string_lossy().replace('/', "-"),
        _ => "images".to_owned(),
    }
}

/// Creates the clips without boxes, and finds each image's clip and frame.
fn frames(
    path: &Path,
    set: &Dataset,
    has_truth: bool,
    has_detections: bool,
) -> Result<(Vec<Clip>, Places), EvalError> {
    let videos: HashMap<u64, &ListedVideo> =
        set.videos.iter().map(|video| (video.id, video)).collect();
    let mut groups: BTreeMap<String, Vec<&Image>> = BTreeMap::new();
    for image in &set.images {
        groups.entry(clip_of(image, &videos)).or_default().push(image);
    }
    let lowest = set.images.iter().filter_map(|image| image.number()).min();
    let first = u64::from(lowest == Some(1));
    let mut clips = Vec::new();
    let mut places = Places::new();
    for (name, mut images) in groups {
        let order = |image: &&Image| (image.number(), natural_key(Path::new(&image.file_name)));
        images.sort_by_cached_key(order);
        let picture = PictureSize::new(images[0].width, images[0].height);
        for (frame, image) in images.iter().enumerate() {
            if PictureSize::new(image.width, image.height) != picture || picture.pixels() == 0 {
                let what = format!(
                    "image {} of clip `{name}` is {}x{}, the clip's first {picture}: all pictures of a clip must have \
                     the same size, and it must not be zero",
                    image.id, image.width, image.height
                );
                return Err(EvalError::content(path, what));
            }
            let clip = clips.len();
            places.insert(image.id, Place { clip, frame });
        }
        let place_in_video = |image: &&Image| {
            let number = image.number()?.checked_sub(first)?;
            usize::try_from(number).ok().filter(|number| *number < MAX_FRAMES)
        };
        let all_places: Option<Vec<usize>> = images.iter().map(place_in_video).collect();
        let mut label_names: Vec<String> =
            images.iter().map(|image| image.file_name.clone()).collect();
        if label_names.iter().any(String::is_empty) {
            // Such an image cannot be placed by its name, so none is.
            label_names.clear();
        }
        let video = images[0].video_id.and_then(|id| videos.get(&id));
        let frame_rate = video.and_then(|video| video.fps.or(video.frame_rate));
        clips.push(Clip {
            frame_rate: frame_rate.filter(|rate| *rate > 0.0),
            detections: has_detections.then(|| vec![Vec::new(); images.len()]),
            truth: has_truth.then(|| vec![Vec::new(); images.len()]),
            places: all_places.unwrap_or_default(),
            label_names,
            ..Clip::new(name, picture, images.len())
        });
    }
    Ok((clips, places))
}
