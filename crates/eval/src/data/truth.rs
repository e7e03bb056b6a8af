//! Gives a clip of pictures its ground truth: from a file, or from Vanilla's own output.

use super::classes::{self, Evaluated, MOST_NAMED};
use super::picture_name::{NumberedName, file_name, stem};
use super::{
    Clip, DataSet, LoadReport, Rules, bdd100k, coco, imagenet_vid, kitti, mot_challenge, recorded,
    visdrone,
};
use crate::boxes::ScoredBox;
use crate::error::EvalError;
use crate::judge::{Ignored, unlabelled};
use albireo_core::geometry::PictureSize;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

/// The layout of ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum TruthFormat {
    /// JSON of BDD100K MOT (box_track_20), or any labels in the Scalabel form.
    Bdd100k,
    /// A MOTChallenge sequence, or a folder of sequences.
    #[cfg_attr(feature = "cli", value(name = "motchallenge"))]
    MotChallenge,
    /// KITTI tracking: a folder with label_02/.
    Kitti,
    /// COCO JSON with images and annotations.
    Coco,
    /// VisDrone: a folder with annotations/.
    #[cfg_attr(feature = "cli", value(name = "visdrone"))]
    VisDrone,
    /// ImageNet-VID: a folder such as Annotations/VID/val, with a folder of XML files for each clip.
    #[cfg_attr(feature = "cli", value(name = "imagenet-vid"))]
    ImageNetVid,
    /// The layout of `--save-detections`: a folder with sequences.json and groundtruth/.
    Recorded,
}

/// A size in which every box of labels fits whose pictures are not known yet.
const UNKNOWN_SIZE: PictureSize = PictureSize::new(u32::MAX, u32::MAX);

/// The pixels within which no data set has all its boxes. Shares of a picture are up to 1, and a little beyond it.
const NORMALISED: f64 = 2.0;

/// The ground truth of all clips. The files are read once.
#[derive(Clone, Debug)]
pub struct GroundTruth {
    format: TruthFormat,
    classes: Evaluated,
    /// The ground truth by the clip's name.
    clips: BTreeMap<String, ClipTruth>,
    files: Vec<TruthFile>,
}

/// The ground truth of a clip.
#[derive(Clone, Debug)]
struct ClipTruth {
    /// The index of its file.
    file: usize,
    clip: Clip,
}

/// A file or folder of ground truth.
#[derive(Clone, Debug)]
struct TruthFile {
    path: PathBuf,
    /// What was left out of it, until the report of the run has it.
    report: Option<LoadReport>,
}

impl GroundTruth {
    /// Reads files or folders of one layout.
    ///
    /// # Errors
    /// [`EvalError`] when one cannot be read.
    pub fn read(paths: &[PathBuf], format: TruthFormat, rules: Rules) -> Result<Self, EvalError> {
        Self::read_as(paths, format, rules, &Evaluated::Road)
    }

    /// [`read`](Self::read) for a model with the classes `names`: of BDD100K's and the other driving benchmarks' ground
    /// truth the six of the paper, of COCO's, ImageNet-VID's and of labels of one's own all that both have.
    ///
    /// # Errors
    /// Like [`read`](Self::read), when the model has none of its classes, and when no box is left or none is in pixels.
    pub fn for_model(
        paths: &[PathBuf],
        format: TruthFormat,
        rules: Rules,
        names: &[String],
    ) -> Result<Self, EvalError> {
        let truth = Self::read_for(paths, format, rules, names)?;
        truth.check_boxes()?;
        Ok(truth)
    }

    /// [`for_model`](Self::for_model), whatever boxes there are.
    fn read_for(
        paths: &[PathBuf],
        format: TruthFormat,
        rules: Rules,
        names: &[String],
    ) -> Result<Self, EvalError> {
        let own = Evaluated::Own(names.into());
        if matches!(format, TruthFormat::Coco | TruthFormat::ImageNetVid) {
            return Self::read_as(paths, format, rules, &own)?.of_both(names);
        }
        let truth = Self::read_as(paths, format, rules, &Evaluated::Road)?;
        let is_foreign = truth.unmapped().any(|(name, _)| classes::is_foreign_to_bdd100k(name));
        if format == TruthFormat::Bdd100k && is_foreign {
            return Self::read_as(paths, format, rules, &own)?.of_both(names);
        }
        truth.classes.check(names)?;
        Ok(truth)
    }

    /// Makes sure that there are boxes to judge by, and that they are in pixels.
    fn check_boxes(&self) -> Result<(), EvalError> {
        let mut left_out = LoadReport::default();
        let mut paths = Vec::new();
        for file in &self.files {
            merge(&mut left_out, file.report.clone().unwrap_or_default());
            paths.push(file.path.display().to_string());
        }
        let mut boxes = 0;
        let mut furthest = 0.0_f64;
        for ClipTruth { clip, .. } in self.clips.values() {
            boxes += clip.truth_boxes();
            for ScoredBox { corners, .. } in clip.truth.iter().flatten().flatten() {
                furthest = furthest.max(corners.x2).max(corners.y2);
            }
        }
        let paths = paths.join(", ");
        if self.clips.values().all(|known| known.clip.truth.is_none()) {
            return Err(EvalError::new(format!(
                "{paths}: it lists pictures and no labels, so there is nothing to judge by"
            )));
        }
        left_out.check_boxes(boxes).map_err(|error| error.context(&paths))?;
        if furthest < NORMALISED {
            return Err(EvalError::new(format!(
                "{paths}: all its boxes lie within the first {NORMALISED} pixels of their pictures: are they shares of width and \
                 height (normalised)? Give them in pixels"
            )));
        }
        Ok(())
    }

    /// The classes of other names than those that are evaluated, with the number of their boxes.
    fn unmapped(&self) -> impl Iterator<Item = (&String, &usize)> {
        self.files
            .iter()
            .flat_map(|file| &file.report)
            .flat_map(|report| &report.unmapped_classes)
    }

    /// Evaluates those of the model's classes `names` that it has labels of: a box of another class can be neither
    /// right nor wrong. Refuses ground truth of which no box has a class of the model.
    fn of_both(mut self, names: &[String]) -> Result<Self, EvalError> {
        let mut labelled: BTreeSet<usize> = BTreeSet::new();
        for ClipTruth { clip, .. } in self.clips.values() {
            let objects = clip.truth.iter().flatten().flatten().map(|object| object.class);
            let marks = clip.ignored.iter().flatten().filter_map(|ignored| ignored.class);
            labelled.extend(objects.chain(marks).map(|class| usize::from(class.0)));
        }
        if labelled.is_empty() && self.unmapped().next().is_some() {
            let of_truth: Vec<&str> =
                self.unmapped().map(|(name, _)| name.as_str()).take(MOST_NAMED).collect();
            let of_model: Vec<&str> = names.iter().map(String::as_str).take(MOST_NAMED).collect();
            return Err(EvalError::new(format!(
                "the model has none of the classes of the ground truth: {}; its own are {}. Are these the right labels, or the \
                 right names (--class-names)?",
                of_truth.join(", "),
                of_model.join(", ")
            )));
        }
        // The numbers of classes stay: one that only the model has gets an empty name.
        let mut evaluated = names.to_vec();
        for (number, name) in evaluated.iter_mut().enumerate() {
            if !labelled.contains(&number) {
                name.clear();
            }
        }
        self.classes = Evaluated::Own(evaluated.into());
        Ok(self)
    }

    /// The classes of its boxes.
    pub const fn classes(&self) -> &Evaluated {
        &self.classes
    }

    fn read_as(
        paths: &[PathBuf],
        format: TruthFormat,
        rules: Rules,
        classes: &Evaluated,
    ) -> Result<Self, EvalError> {
        let mut clips: BTreeMap<String, ClipTruth> = BTreeMap::new();
        let mut files: Vec<TruthFile> = Vec::new();
        for path in paths {
            let own_rate = None;
            let data = read(path, format, rules, classes)?.judged_by(rules, own_rate);
            for clip in data.clips {
                let name = clip.name.clone();
                if let Some(other) = clips.get(&name) {
                    return Err(EvalError::new(format!(
                        "{} and {} are both ground truth of the clip `{name}`: leave one of them out, or rename it",
                        files[other.file].path.display(),
                        path.display()
                    )));
                }
                let file = files.len();
                clips.insert(name, ClipTruth { file, clip });
            }
            files.push(TruthFile {
                path: path.clone(),
                report: Some(data.report),
            });
        }
        // A recording says itself whose classes its numbers are.
        let classes = match clips.values().next() {
            Some(first) if format == TruthFormat::Recorded => first.clip.classes.clone(),
            _ => classes.clone(),
        };
        Ok(Self {
            format,
            classes,
            clips,
            files,
        })
    }

    /// Makes sure that it is for at least one of the clips `names`.
    ///
    /// # Errors
    /// [`EvalError`] when it is for none of them.
    pub fn check(&self, names: &[String]) -> Result<(), EvalError> {
        let alone = names.len() == 1;
        if names.iter().any(|name| self.has(name, alone)) {
            return Ok(());
        }
        let truths: Vec<&str> = self.clips.keys().map(String::as_str).take(MOST_NAMED).collect();
        Err(EvalError::new(format!(
            "the ground truth is for the clips {}, and none of them is evaluated here ({}): a clip is named after its file",
            truths.join(", "),
            names.join(", ")
        )))
    }

    /// True if it has the clip `name`; `alone` as for [`attach_to`](Self::attach_to).
    pub fn has(&self, name: &str, alone: bool) -> bool {
        self.name_of(name, alone).is_some()
    }

    /// The frames per second of the clip `name`, if the ground truth knows them; `alone` as for
    /// [`attach_to`](Self::attach_to).
    pub fn rate(&self, name: &str, alone: bool) -> Option<f64> {
        let stored_name = self.name_of(name, alone)?;
        self.clips[stored_name].clip.frame_rate
    }

    /// The name under which the ground truth of the clip `name` is stored: COCO's files name a clip by its folder and
    /// the folders before it, `val/drive` or `train/YFCC100M/v_1`.
    fn name_of<'a>(&'a self, name: &'a str, alone: bool) -> Option<&'a str> {
        if self.clips.contains_key(name) {
            return Some(name);
        }
        if alone && self.clips.len() == 1 {
            return self.clips.keys().next().map(String::as_str);
        }
        if self.format != TruthFormat::Coco {
            return None;
        }
        let ending = format!("-{name}");
        let with_ending: Vec<&String> =
            self.clips.keys().filter(|key| key.ends_with(&ending)).collect();
        match with_ending.as_slice() {
            [only] => Some(only.as_str()),
            _ => None,
        }
    }

    /// Takes what was left out of all files, for a report before any clip has it.
    pub fn take_report(&mut self) -> LoadReport {
        let mut all = LoadReport::default();
        for file in &mut self.files {
            if let Some(report) = file.report.take() {
                merge(&mut all, report);
            }
        }
        all
    }

    /// Gives `clip` the ground truth of its name, if there is any, or the only one there is if it is the only clip
    /// (`alone`). `whole` is the number of all its pictures, `None` if the clip was cut to its first frames and nobody
    /// knows it. `report` counts what is left out.
    ///
    /// # Errors
    /// [`EvalError`] when it is for other pictures.
    pub fn attach_to(
        &mut self,
        clip: &mut Clip,
        alone: bool,
        whole: Option<usize>,
        report: &mut LoadReport,
    ) -> Result<(), EvalError> {
        let Some(name) = self.name_of(&clip.name, alone).map(str::to_owned) else {
            return Ok(());
        };
        let known = &self.clips[&name];
        let found = &known.clip;
        let file = &mut self.files[known.file];
        let wrong = |what: String| {
            let path = file.path.display();
            EvalError::new(format!(
                "{}: its ground truth ({path}) is for {what}",
                clip.name
            ))
        };
        let pictures = clip.frames + clip.unusable.len();
        let labels = labels_of(found, self.format, whole, clip).map_err(wrong)?;
        let Some(Labels {
            mut objects,
            mut marks,
            remark,
        }) = labels
        else {
            return Ok(());
        };
        let is_sparse = unlabelled(&marks) > 0
            || !found.places.is_empty()
            || self.format == TruthFormat::ImageNetVid;
        // Only these layouts say how many frames they are for; the others end with the last object, or with the last
        // labelled frame.
        let says_its_length = matches!(
            self.format,
            TruthFormat::MotChallenge | TruthFormat::Bdd100k | TruthFormat::Recorded
        );
        let is_longer = whole.is_some_and(|whole| objects.len() > whole);
        let is_shorter = says_its_length && !is_sparse && objects.len() < pictures;
        if is_longer || is_shorter {
            return Err(wrong(format!(
                "{} frames, the clip has {}: are they the same recording, at the same frame rate?",
                objects.len(),
                whole.unwrap_or(pictures)
            )));
        }
        if found.picture != clip.picture && knows_its_pictures(self.format) {
            return Err(wrong(format!(
                "pictures of {}, the clip's are {}",
                found.picture, clip.picture
            )));
        }
        // A file's rows are counted once, even if it contains several clips.
        if let Some(left_out) = file.report.take() {
            merge(report, left_out);
        }
        let remarks = remark.map(|remark| format!("{}: {remark}", clip.name));
        report.notes.extend(remarks);
        if is_sparse {
            // Nobody labelled what is behind the last label, either.
            let behind = objects.len()..pictures;
            marks.resize(objects.len(), Vec::new());
            marks.extend(behind.map(|_| vec![Ignored::UNLABELLED]));
        }
        objects.resize(pictures, Vec::new());
        let mut truth = usable(objects, &clip.unusable);
        if !knows_its_pictures(self.format) {
            for (frame, objects) in truth.iter_mut().enumerate() {
                *objects = within_picture(objects, frame, clip.picture, report);
            }
        }
        clip.truth = Some(truth);
        clip.ignored = usable(marks, &clip.unusable);
        clip.ignored.truncate(clip.frames);
        Ok(())
    }
}

/// The labels of a clip's pictures.
struct Labels {
    objects: Vec<Vec<ScoredBox>>,
    marks: Vec<Vec<Ignored>>,
    /// What is to be said of how they were placed.
    remark: Option<String>,
}

impl Labels {
    /// Puts each frame's labels at its place among `frames` pictures. A picture that gets none was not labelled.
    fn placed(mut self, places: &[Option<usize>], frames: usize) -> Self {
        self.marks.resize(self.objects.len(), Vec::new());
        let mut placed = Self {
            objects: vec![Vec::new(); frames],
            marks: vec![vec![Ignored::UNLABELLED]; frames],
            remark: self.remark,
        };
        let labels = self.objects.into_iter().zip(self.marks);
        for (place, (objects, marks)) in places.iter().zip(labels) {
            if let Some(place) = *place {
                placed.objects[place] = objects;
                placed.marks[place] = marks;
            }
        }
        placed
    }
}

/// The labels of `found`, each at the place of its picture among the `whole` of those of `clip`; `None` if there are
/// none. If they cannot be this clip's, the error says in words what they are for.
fn labels_of(
    found: &Clip,
    format: TruthFormat,
    whole: Option<usize>,
    clip: &Clip,
) -> Result<Option<Labels>, String> {
    let Some(objects) = found.truth.clone() else {
        return Ok(None);
    };
    let mut listed = Labels {
        objects,
        marks: found.ignored.clone(),
        remark: None,
    };
    let pictures = &clip.file_names;
    match places_by_name(&found.label_names, pictures) {
        Err(wrong) => {
            if !are_counted_otherwise(found, format, pictures) {
                return Err(wrong);
            }
            listed.remark = Some(COUNTED_OTHERWISE.to_owned());
        }
        Ok(by_name) => {
            let named: Vec<usize> = by_name.iter().copied().flatten().collect();
            let looked_at = clip.frames + clip.unusable.len();
            if !named.is_empty() && !may_be_by_chance(found, format, &named, looked_at) {
                check_numbers(found, format, &named, pictures)?;
                return Ok(Some(listed.placed(&by_name, pictures.len())));
            }
        }
    }
    // A file of COCO lists pictures, and not always all.
    let lists_all = whole.is_some_and(|whole| whole <= found.frames);
    if format != TruthFormat::Coco || lists_all {
        return Ok(Some(listed));
    }
    let Some(last) = found.places.iter().max() else {
        let which = "and its images have no frame_id to say which of them they are";
        return match whole {
            Some(whole) => Err(format!(
                "{} frames, the clip has {whole}, {which}",
                found.frames
            )),
            None => Ok(Some(listed)),
        };
    };
    let frames = whole.unwrap_or_default().max(last + 1);
    let places: Vec<Option<usize>> = found.places.iter().copied().map(Some).collect();
    Ok(Some(listed.placed(&places, frames)))
}

/// The place of each labelled frame among a clip's `pictures` by their file names: without folders and extensions, or
/// with the extensions if only these tell them apart; `None` for a frame that the labels do not list. There are no
/// places if no label names a picture of the clip, or the names do not tell them apart: then one or the other is named
/// otherwise. If only some do, the error says in words what the labels are for.
fn places_by_name(labelled: &[String], pictures: &[String]) -> Result<Vec<Option<usize>>, String> {
    let ways: [fn(&str) -> &str; 2] = [stem, file_name];
    for way in ways {
        if are_told_apart(labelled, way) && are_told_apart(pictures, way) {
            return places_by(way, labelled, pictures);
        }
    }
    let mut listed = HashSet::new();
    for name in labelled {
        let is_first = listed.insert(name);
        if !is_first && pictures.iter().any(|picture| picture == file_name(name)) {
            return Err(format!("the picture {name} twice"));
        }
    }
    Ok(Vec::new())
}

/// True if this part of the names is another one for each; a frame that is not listed has none.
fn are_told_apart(names: &[String], part: fn(&str) -> &str) -> bool {
    let listed: Vec<&String> = names.iter().filter(|name| !name.is_empty()).collect();
    let parts: HashSet<&str> = listed.iter().map(|name| part(name)).collect();
    parts.len() == listed.len()
}

/// [`places_by_name`] by this part of the names.
fn places_by(
    part: fn(&str) -> &str,
    labelled: &[String],
    pictures: &[String],
) -> Result<Vec<Option<usize>>, String> {
    let mut known = HashMap::new();
    for (place, picture) in pictures.iter().enumerate() {
        known.insert(part(picture), place);
    }
    let mut places = Vec::new();
    let mut unknown = None;
    for name in labelled {
        let place = known.get(part(name)).copied();
        places.push(place);
        if place.is_none() && !name.is_empty() {
            unknown.get_or_insert(name);
        }
    }
    if places.iter().all(Option::is_none) {
        return Ok(Vec::new());
    }
    match unknown {
        Some(name) => Err(format!(
            "other pictures, too: the clip has no {name}. Leave out the labels of others, or name its pictures as the \
             labels do"
        )),
        None => Ok(places),
    }
}

/// True if nothing but names says that labels are for the first of more pictures: the files of every fifth frame can be
/// numbered on, too.
fn may_be_by_chance(found: &Clip, format: TruthFormat, named: &[usize], looked_at: usize) -> bool {
    let are_first = named.iter().max().is_some_and(|last| last + 1 == named.len());
    let has_no_numbers = match format {
        // Numbers without a gap are of all frames.
        TruthFormat::Bdd100k => found.places.is_empty() && found.frames == named.len(),
        TruthFormat::Coco => found.places.is_empty(),
        _ => false,
    };
    are_first && has_no_numbers && named.len() < looked_at
}

/// Makes sure that the numbers of the labels, if they have some, do not contradict the places of the pictures that they
/// name.
///
/// # Errors
/// What the labels are for, in words.
fn check_numbers(
    found: &Clip,
    format: TruthFormat,
    named: &[usize],
    pictures: &[String],
) -> Result<(), String> {
    let numbers = match format {
        TruthFormat::Coco => found.places.clone(),
        // Those that are in the names say nothing else.
        TruthFormat::Bdd100k if found.places.is_empty() => listed_frames(&found.label_names),
        _ => return Ok(()),
    };
    let are_all_in_order = named.len() == pictures.len() && named.is_sorted();
    // Numbers without a gap may only count the labels.
    let may_count = are_same(&numbers, 0..numbers.len());
    // A name that has the number itself fits by no chance, such as one of a video of which some pictures are kept.
    let are_in_names =
        last_numbers(&found.label_names).is_some_and(|in_names| are_same(&numbers, in_names));
    let is_certain = are_all_in_order || may_count || are_in_names;
    if is_certain || are_same(&numbers, named.iter().copied()) {
        return Ok(());
    }
    let pairs = numbers.iter().zip(named);
    let furthest = pairs.max_by_key(|(number, place)| number.abs_diff(**place));
    let Some((number, place)) = furthest else {
        return Ok(());
    };
    Err(format!(
        "the picture {} by a name, and for picture {} of the clip by the number of that frame (frame_id or \
         frameIndex): leave out the numbers, or name the pictures as those of the clip",
        pictures[*place],
        number + 1
    ))
}

/// The last number in the name of each frame that labels list; `None` if one has none.
fn last_numbers(names: &[String]) -> Option<Vec<usize>> {
    let mut last = Vec::new();
    for frame in listed_frames(names) {
        let numbers = NumberedName::of(stem(&names[frame])).numbers;
        last.push(usize::try_from(*numbers.last()?).ok()?);
    }
    Some(last)
}

/// True if these numbers are the places, be they counted from 0 or 1.
fn are_same(numbers: &[usize], places: impl IntoIterator<Item = usize>) -> bool {
    let mut differences = BTreeSet::new();
    for (number, place) in numbers.iter().zip(places) {
        if number.abs_diff(place) > 1 {
            return false;
        }
        differences.insert(number.cmp(&place));
    }
    differences.len() <= 1
}

/// What is said of labels that go by their order or numbers although their names differ.
const COUNTED_OTHERWISE: &str = "its ground truth counts the names of the pictures from another number than their \
    files: its labels are for the pictures in their order";

/// True if labels name pictures as their files are named, and only count them from another number: each name differs
/// from that of the picture at its own place by as much.
fn are_counted_otherwise(found: &Clip, format: TruthFormat, pictures: &[String]) -> bool {
    let has_places = format == TruthFormat::Coco && found.frames < pictures.len();
    let mut all_apart = HashSet::new();
    for frame in listed_frames(&found.label_names) {
        let mut place = frame;
        if has_places && let Some(numbered) = found.places.get(frame) {
            place = *numbered;
        }
        let Some(picture) = pictures.get(place) else {
            return false;
        };
        let label = NumberedName::of(stem(&found.label_names[frame]));
        let file = NumberedName::of(stem(picture));
        if label.pattern != file.pattern {
            return false;
        }
        let numbers = label.numbers.iter().zip(&file.numbers);
        let apart: Vec<i64> = numbers.map(|(of_label, of_file)| of_label - of_file).collect();
        all_apart.insert(apart);
    }
    all_apart.len() == 1
}

/// The frames that labels list, by the names of their pictures.
fn listed_frames(names: &[String]) -> Vec<usize> {
    (0..names.len()).filter(|frame| !names[*frame].is_empty()).collect()
}

/// The entries of `frames` whose pictures can be used.
fn usable<T>(frames: Vec<T>, unusable: &[usize]) -> Vec<T> {
    let mut usable = Vec::new();
    for (place, frame) in frames.into_iter().enumerate() {
        if !unusable.contains(&place) {
            usable.push(frame);
        }
    }
    usable
}

/// The objects of a frame that are in its picture; the others are counted.
fn within_picture(
    objects: &[ScoredBox],
    frame: usize,
    picture: PictureSize,
    report: &mut LoadReport,
) -> Vec<ScoredBox> {
    let mut within = Vec::new();
    for object in objects {
        match report.check(object.corners, picture) {
            Some(reason) => report.leave_out(reason, || format!("ground truth, frame {frame}")),
            None => within.push(*object),
        }
    }
    within
}

/// True if the layout says how large its pictures are.
fn knows_its_pictures(format: TruthFormat) -> bool {
    match format {
        TruthFormat::MotChallenge
        | TruthFormat::Coco
        | TruthFormat::ImageNetVid
        | TruthFormat::Recorded => true,
        TruthFormat::Bdd100k | TruthFormat::Kitti | TruthFormat::VisDrone => false,
    }
}

fn read(
    path: &Path,
    format: TruthFormat,
    rules: Rules,
    classes: &Evaluated,
) -> Result<DataSet, EvalError> {
    match format {
        TruthFormat::Bdd100k => {
            let source = bdd100k::Source {
                truth: Some(path),
                detections: None,
                picture: UNKNOWN_SIZE,
                frame_rate: Some(bdd100k::BDD100K_FRAME_RATE),
                rules,
            };
            bdd100k::read_as(&source, classes)
        }
        TruthFormat::MotChallenge => mot_challenge::read(path),
        TruthFormat::Kitti => kitti::read(path),
        TruthFormat::Coco => {
            let no_results = None;
            coco::read_as(path, no_results, classes)
        }
        TruthFormat::ImageNetVid => imagenet_vid::read_as(path, classes),
        TruthFormat::VisDrone => visdrone::read(path, UNKNOWN_SIZE),
        TruthFormat::Recorded => recorded::read(path),
    }
}

/// Adds the counts of a reader of ground truth. Its notes are about detections, which ground truth does not have.
fn merge(report: &mut LoadReport, other: LoadReport) {
    for (reason, (count, place)) in other.left_out {
        let (total, _) = report.left_out.entry(reason).or_insert((0, place));
        *total += count;
    }
    for (class, count) in other.unmapped_classes {
        *report.unmapped_classes.entry(class).or_default() += count;
    }
    report.reaching_outside += other.reaching_outside;
    report.partly_labelled += other.partly_labelled;
}

/// Returns Vanilla's own output as ground truth: the clip's detections from `confidence` on. It measures how far a
/// policy departs from running the detector on every frame, not how right either is.
pub fn vanilla_as_truth(clip: &Clip, confidence: f64) -> Vec<Vec<ScoredBox>> {
    let mut frames = Vec::new();
    for detections in clip.detections.iter().flatten() {
        let is_sure = |found: &&ScoredBox| found.confidence >= confidence;
        frames.push(detections.iter().filter(is_sure).copied().collect());
    }
    frames
}
