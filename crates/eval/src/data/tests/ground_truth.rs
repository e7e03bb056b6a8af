//! Ground truth belongs to the right frames and classes of a clip, or is refused.

use super::super::*;
use super::{assert_refused, folder};
use crate::judge::{Classes, Interpolation, Truth, accuracy};
use tempfile::TempDir;

/// The truth of `files` in this layout for a model with these classes.
fn for_model(
    files: &TempDir,
    path: &str,
    format: TruthFormat,
    names: &[&str],
) -> Result<GroundTruth, EvalError> {
    let names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
    GroundTruth::for_model(&[files.path().join(path)], format, Rules::Benchmark, &names)
}

/// A clip with its ground truth, of which nothing says that it is the only one, and whose pictures are no files.
fn attached(
    truth: &mut GroundTruth,
    name: &str,
    size: [u32; 2],
    pictures: usize,
) -> Result<Clip, EvalError> {
    let [width, height] = size;
    let picture = PictureSize::new(width, height);
    let clip = Clip::new(name.to_owned(), picture, pictures);
    with_labels(truth, clip)
}

/// The clip `name` of these files, with its ground truth.
fn attached_to_files(
    truth: &mut GroundTruth,
    name: &str,
    files: &[String],
) -> Result<Clip, EvalError> {
    let mut clip = Clip::new(name.to_owned(), PictureSize::new(640, 360), files.len());
    clip.file_names = files.to_vec();
    with_labels(truth, clip)
}

fn with_labels(truth: &mut GroundTruth, mut clip: Clip) -> Result<Clip, EvalError> {
    let pictures = clip.frames;
    let alone = false;
    let mut report = LoadReport::default();
    truth.attach_to(&mut clip, alone, Some(pictures), &mut report)?;
    Ok(clip)
}

/// The frames that somebody labelled.
fn labelled_frames(clip: &Clip) -> Vec<usize> {
    let is_labelled = |frame: &usize| {
        clip.ignored
            .get(*frame)
            .is_none_or(|marks| !marks.contains(&Ignored::UNLABELLED))
    };
    (0..clip.frames).filter(is_labelled).collect()
}

/// The labels of a frame of ImageNet-VID, with these objects: their class and left edge.
fn imagenet_vid(objects: &[(&str, u32)]) -> String {
    let object = |(name, left): &(&str, u32)| {
        format!(
            "<object><trackid>3</trackid><name>{name}</name><bndbox><xmax>{}</xmax><xmin>{left}</xmin>\
             <ymax>90</ymax><ymin>20</ymin></bndbox><occluded>0</occluded><generated>0</generated></object>",
            left + 50
        )
    };
    let objects: String = objects.iter().map(object).collect();
    format!(
        "<annotation><folder>a</folder><filename>000000</filename><source><database>ILSVRC_2015</database></source>\
         <size><width>640</width><height>360</height></size>{objects}</annotation>"
    )
}

#[test]
fn imagenet_vid_tells_unlabelled_frames_from_empty_ones_and_knows_wordnets_numbers() {
    let cat_and_antelope = imagenet_vid(&[("n02121808", 10), ("n02419796", 200)]);
    let nothing = imagenet_vid(&[]);
    let zebra = imagenet_vid(&[("n02391049", 10)]);
    let files = folder(&[
        ("val/a/000000.xml", &cat_and_antelope),
        ("val/a/000002.xml", &nothing),
        ("val/b/000000.xml", &zebra),
    ]);
    let names = ["zebra", "cat", "kite"];
    let mut truth = for_model(&files, "val", TruthFormat::ImageNetVid, &names).unwrap();
    assert_eq!(
        truth.take_report().unmapped_classes,
        [("antelope".to_owned(), 1)].into()
    );
    // No label is a kite: the model's boxes of kites are left out, neither right nor wrong.
    let kite = truth.classes().find("kite");
    assert_eq!(kite, Err(LeftOut::UnmappedClass));
    let clip = attached(&mut truth, "a", [640, 360], 5).unwrap();
    let objects = clip.truth.as_ref().unwrap();
    let [cat] = objects[0].as_slice() else {
        panic!("{objects:?}");
    };
    assert_eq!(cat.class, ClassId(1));
    assert_eq!(cat.object, Some(3));
    assert_eq!(cat.corners.x2, 60.0);
    // Nobody labelled the frames without a file: 1, 3 and 4. That of frame 2 says that nothing is on it.
    assert_eq!(labelled_frames(&clip), [0, 2]);
}

#[test]
fn imagenet_vid_for_other_pictures_is_refused() {
    let cat = imagenet_vid(&[("n02121808", 10)]);
    let files = folder(&[("val/a/000002.xml", &cat)]);
    let mut truth = for_model(&files, "val", TruthFormat::ImageNetVid, &["cat"]).unwrap();
    let refused = attached(&mut truth, "a", [640, 360], 2).unwrap_err().to_string();
    assert!(refused.contains("3 frames, the clip has 2"), "{refused}");
    let refused = attached(&mut truth, "a", [64, 36], 5).unwrap_err().to_string();
    assert!(refused.contains("640x360"), "{refused}");
}

#[test]
fn a_broken_file_of_imagenet_vid_is_named() {
    for (text, part) in [
        ("<annotation>", "000000.xml"),
        ("<annotation/>", "no <size>"),
    ] {
        let files = folder(&[("val/a/000000.xml", text)]);
        assert_refused(imagenet_vid::read(&files.path().join("val")), &[part]);
    }
}

/// Labels in the Scalabel form: a car on each of these frames of the video `drive`.
fn labels_of_drive(frames: &[usize]) -> String {
    let frame = |index: &usize| {
        format!(
            r#"{{"name": "{index}", "videoName": "drive", "frameIndex": {index}, "labels": [
            {{"category": "car", "box2d": {{"x1": 1, "y1": 2, "x2": 30, "y2": 40}}}}]}}"#
        )
    };
    let frames: Vec<String> = frames.iter().map(frame).collect();
    format!("[{}]", frames.join(","))
}

/// The clip `drive` of so many pictures with these labels.
fn drive(labels: &str, pictures: usize) -> Result<Clip, EvalError> {
    let files = folder(&[("drive.json", labels)]);
    let mut truth = for_model(&files, "drive.json", TruthFormat::Bdd100k, &["car"]).unwrap();
    attached(&mut truth, "drive", [640, 360], pictures)
}

#[test]
fn frames_of_a_video_that_its_labels_do_not_list_are_not_judged() {
    let clip = drive(&labels_of_drive(&[0, 30, 60]), 90).unwrap();
    assert_eq!(labelled_frames(&clip), [0, 30, 60]);
}

#[test]
fn pictures_behind_the_last_one_that_labels_name_are_not_judged() {
    // The labels of the paper's authors name pictures, from 1, and leave out those without objects, be they the last.
    let labels = r#"[{"name": "drive-0000001.jpg", "labels": []}, {"name": "drive-0000002.jpg", "labels": [
        {"category": "car", "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}]}]"#;
    assert_eq!(labelled_frames(&drive(labels, 4).unwrap()), [0, 1]);
}

#[test]
fn labels_of_all_frames_of_a_video_are_for_so_many_pictures() {
    let labels = labels_of_drive(&[0, 1, 2]);
    assert_eq!(labelled_frames(&drive(&labels, 3).unwrap()), [0, 1, 2]);
    let refused = drive(&labels, 4).unwrap_err().to_string();
    assert!(refused.contains("3 frames, the clip has 4"), "{refused}");
}

/// A file of COCO with two images of a video, its first picture and its 31st, of which the second has a car. Their numbers say
/// so, if they have some.
fn two_images_of_a_video(with_numbers: bool) -> TempDir {
    let image = |id: usize, place: usize| {
        let number = if with_numbers {
            format!(r#""frame_index": {place},"#)
        } else {
            String::new()
        };
        let file = format!("train/YFCC/v_1/frame{:04}.jpg", place + 1);
        format!(
            r#"{{"id": {id}, "video_id": 7, {number} "file_name": "{file}", "width": 100, "height": 50}}"#
        )
    };
    let set = format!(
        r#"{{"images": [{}, {}], "videos": [{{"id": 7, "name": "train/YFCC/v_1"}}],
        "categories": [{{"id": 3, "name": "car"}}, {{"id": 4, "name": "bus"}}],
        "annotations": [{{"image_id": 2, "category_id": 3, "track_id": 5, "instance_id": 5,
            "bbox": [1, 2, 10, 20]}}]}}"#,
        image(1, 0),
        image(2, 30)
    );
    folder(&[("set.json", &set)])
}

/// The clip `v_1` of so many pictures with the labels of these `files`.
fn v_1(files: &TempDir, pictures: usize) -> Result<Clip, EvalError> {
    let mut truth = for_model(files, "set.json", TruthFormat::Coco, &["car", "bus"]).unwrap();
    attached(&mut truth, "v_1", [100, 50], pictures)
}

#[test]
fn images_of_coco_are_placed_by_their_numbers_in_a_video_of_more_pictures() {
    let with_numbers = true;
    let files = two_images_of_a_video(with_numbers);
    let clip = v_1(&files, 40).unwrap();
    assert_eq!(labelled_frames(&clip), [0, 30]);
    assert_eq!(clip.truth.as_ref().unwrap()[30].len(), 1);
    let refused = v_1(&files, 20).unwrap_err().to_string();
    assert!(refused.contains("31 frames, the clip has 20"), "{refused}");
}

#[test]
fn images_of_coco_without_numbers_are_refused_for_a_video_of_more_pictures() {
    let with_numbers = false;
    let refused = v_1(&two_images_of_a_video(with_numbers), 40).unwrap_err().to_string();
    assert!(refused.contains("no frame_id"), "{refused}");
}

#[test]
fn images_of_coco_are_the_pictures_in_their_order_if_there_are_no_more() {
    for with_numbers in [true, false] {
        let clip = v_1(&two_images_of_a_video(with_numbers), 2).unwrap();
        assert_eq!(labelled_frames(&clip), [0, 1]);
        assert_eq!(clip.unlabelled(), 0);
        assert_eq!(clip.truth.as_ref().unwrap()[1].len(), 1);
    }
}

#[test]
fn a_video_of_tao_is_judged_by_the_classes_that_it_is_labelled_for() {
    let set = r#"{"images": [{"id": 1, "video_id": 7, "width": 100, "height": 50},
        {"id": 2, "video_id": 8, "width": 100, "height": 50}],
        "videos": [{"id": 7, "name": "a", "neg_category_ids": [5], "not_exhaustive_category_ids": [4]},
        {"id": 8, "name": "b"}],
        "categories": [{"id": 3, "name": "car_(automobile)"}, {"id": 4, "name": "person"},
        {"id": 5, "name": "bus_(vehicle)"}, {"id": 6, "name": "dog"}],
        "annotations": [{"image_id": 1, "category_id": 3, "bbox": [1, 2, 10, 20]},
        {"image_id": 1, "category_id": 4, "bbox": [50, 2, 10, 20]}]}"#;
    let files = folder(&[("set.json", set)]);
    let names = ["car", "person", "bus", "dog"];
    let mut truth = for_model(&files, "set.json", TruthFormat::Coco, &names).unwrap();
    let said = truth.clone().take_report().lines().join("\n");
    assert!(
        said.contains("labelled for some classes only: 1 clip;"),
        "{said}"
    );
    let clip = attached(&mut truth, "a", [100, 50], 1).unwrap();
    let marked: Vec<_> = clip.ignored[0].iter().filter_map(|ignored| ignored.class).collect();
    // Persons are not all labelled, and nobody looked for dogs.
    assert_eq!(marked, [ClassId(1), ClassId(3)]);
    assert_eq!(clip.truth.as_ref().unwrap()[0].len(), 2);
    // AP@50 of the right boxes and a surer one of this class beside them.
    let judged = |class: u16| {
        let beside = ScoredBox {
            corners: Corners {
                x1: 80.0,
                y1: 30.0,
                x2: 95.0,
                y2: 45.0,
            },
            class: ClassId(class),
            confidence: 0.99,
            object: None,
        };
        let mut found = clip.truth.clone().unwrap();
        for right in &mut found[0] {
            right.confidence = 0.5;
        }
        found[0].push(beside);
        let judged_by = Truth {
            objects: clip.truth.as_deref().unwrap(),
            ignored: &clip.ignored,
        };
        accuracy(&found, judged_by, Classes::Pooled, Interpolation::AllPoints)
            .unwrap()
            .ap50
    };
    let is_excused = [0, 1, 2, 3].map(|class| judged(class) == 1.0);
    assert_eq!(is_excused, [false, true, false, true]);
    // The other video does not say for which classes it is labelled: for all.
    let other = attached(&mut truth, "b", [100, 50], 1).unwrap();
    assert!(other.ignored.iter().all(Vec::is_empty));
}

#[test]
fn a_model_without_any_class_of_the_ground_truth_is_refused_in_every_layout() {
    // A car in each.
    let car = imagenet_vid(&[("n02958343", 10)]);
    let files = folder(&[
        (
            "bdd100k.json",
            r#"[{"name": "a", "labels": [{"category": "car", "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}]}]"#,
        ),
        (
            "motchallenge/seqinfo.ini",
            "[Sequence]\nname=a\nseqLength=1\nimWidth=640\nimHeight=480\n",
        ),
        ("motchallenge/gt/gt.txt", "1,1,10,20,30,40,1,3,1\n"),
        (
            "kitti/label_02/0007.txt",
            "0 1 Car 0 0 -1.5 10 20 60 80 1 1 1 1 1 1 0\n",
        ),
        (
            "coco.json",
            r#"{"images": [{"id": 1, "width": 640, "height": 480}], "categories": [{"id": 3, "name": "car"}],
            "annotations": [{"image_id": 1, "category_id": 3, "bbox": [10, 20, 30, 40]}]}"#,
        ),
        ("visdrone/annotations/a.txt", "1,1,10,20,30,40,1,4,0,0\n"),
        ("imagenet-vid/a/000000.xml", &car),
        (
            "recorded/sequences.json",
            r#"{"sequences": [{"name": "a", "width": 640, "height": 480, "frames": 1}]}"#,
        ),
        (
            "recorded/detections/a.csv",
            "frame,x1,y1,x2,y2,score,class\n",
        ),
        (
            "recorded/groundtruth/a.csv",
            "frame,x1,y1,x2,y2,class,object_id\n0,10,20,40,60,2,1\n",
        ),
    ]);
    for (path, format) in [
        ("bdd100k.json", TruthFormat::Bdd100k),
        ("motchallenge", TruthFormat::MotChallenge),
        ("kitti", TruthFormat::Kitti),
        ("coco.json", TruthFormat::Coco),
        ("visdrone", TruthFormat::VisDrone),
        ("imagenet-vid", TruthFormat::ImageNetVid),
        ("recorded", TruthFormat::Recorded),
    ] {
        let refused = for_model(&files, path, format, &["helmet", "vest"]).unwrap_err().to_string();
        assert!(refused.contains("car"), "{path}: {refused}");
        assert!(refused.contains("helmet, vest"), "{path}: {refused}");
        for_model(&files, path, format, &["helmet", "car"]).unwrap();
    }
}

#[test]
fn a_model_without_the_classes_of_one_s_own_labels_is_told_both() {
    let antelope = imagenet_vid(&[("n02419796", 200)]);
    let files = folder(&[("val/a/000000.xml", &antelope)]);
    let refused = for_model(&files, "val", TruthFormat::ImageNetVid, &["helmet"])
        .unwrap_err()
        .to_string();
    assert!(refused.contains("antelope"), "{refused}");
    assert!(refused.contains("helmet"), "{refused}");
}

#[test]
fn two_files_of_ground_truth_for_one_clip_are_refused_by_name() {
    let objects = imagenet_vid(&[("n02121808", 10)]);
    let files = folder(&[
        ("day/a/000000.xml", &objects),
        ("night/a/000000.xml", &objects),
    ]);
    let paths = ["day", "night"].map(|name| files.path().join(name));
    let refused = GroundTruth::read(&paths, TruthFormat::ImageNetVid, Rules::Benchmark)
        .unwrap_err()
        .to_string();
    for part in ["day", "night", "clip `a`"] {
        assert!(refused.contains(part), "{refused}");
    }
}

/// A file of COCO with images of these names in the clip `v`, of which the first has a car.
fn coco_of(names: &[&str]) -> TempDir {
    let images: Vec<String> = (1..)
        .zip(names)
        .map(|(id, name)| {
            format!(r#"{{"id": {id}, "file_name": "v/{name}", "width": 640, "height": 360}}"#)
        })
        .collect();
    let set = format!(
        r#"{{"images": [{}], "categories": [{{"id": 3, "name": "car"}}],
        "annotations": [{{"image_id": 1, "category_id": 3, "bbox": [1, 2, 10, 20]}}]}}"#,
        images.join(", ")
    );
    folder(&[("set.json", &set)])
}

/// The ground truth of a file of COCO.
fn cars_of(files: &TempDir) -> GroundTruth {
    for_model(files, "set.json", TruthFormat::Coco, &["car"]).unwrap()
}

/// `frame_1.jpg` to `frame_10.jpg`, in the order of pictures.
fn ten_files() -> Vec<String> {
    (1..=10).map(|number| format!("frame_{number}.jpg")).collect()
}

/// The frames that have a box.
fn frames_with_boxes(clip: &Clip) -> Vec<usize> {
    let truth = clip.truth.as_ref().unwrap();
    (0..truth.len()).filter(|frame| !truth[*frame].is_empty()).collect()
}

#[test]
fn labels_are_for_the_pictures_that_they_name() {
    let some = coco_of(&["frame_10.jpg", "sub\\\\frame_2.PNG"]);
    let clip = attached_to_files(&mut cars_of(&some), "v", &ten_files()).unwrap();
    assert_eq!(frames_with_boxes(&clip), [9]);
    assert_eq!(labelled_frames(&clip), [1, 9]);
}

#[test]
fn labels_in_the_scalabel_form_are_for_the_pictures_that_they_name_whatever_their_numbers() {
    // Numbers from 1, as those of the files.
    let frame = |number: usize| {
        format!(
            r#"{{"name": "frame_{number}.jpg", "videoName": "drive", "frameIndex": {number}, "labels": [
            {{"category": "car", "box2d": {{"x1": 1, "y1": 2, "x2": 30, "y2": 40}}}}]}}"#
        )
    };
    let text = format!("[{}, {}]", frame(3), frame(1));
    let files = folder(&[("drive.json", &text)]);
    let mut truth = for_model(&files, "drive.json", TruthFormat::Bdd100k, &["car"]).unwrap();
    let clip = attached_to_files(&mut truth, "drive", &ten_files()).unwrap();
    assert_eq!(frames_with_boxes(&clip), [0, 2]);
    assert_eq!(labelled_frames(&clip), [0, 2]);
}

#[test]
fn files_of_imagenet_vid_are_for_the_pictures_of_their_names() {
    let cat = imagenet_vid(&[("n02121808", 10)]);
    let files = folder(&[("val/a/0001.xml", &cat), ("val/a/0002.xml", &cat)]);
    let mut truth = for_model(&files, "val", TruthFormat::ImageNetVid, &["cat"]).unwrap();
    let pictures = ["0001.jpg", "0002.jpg"].map(str::to_owned);
    let clip = attached_to_files(&mut truth, "a", &pictures).unwrap();
    assert_eq!(frames_with_boxes(&clip), [0, 1]);
}

#[test]
fn labels_of_which_some_are_for_no_picture_of_the_clip_are_refused() {
    for (names, said) in [
        (
            ["frame_1.jpg", "frame_11.jpg"],
            "for other pictures, too: the clip has no v/frame_11.jpg",
        ),
        (
            ["frame_1.jpg", "frame_1.png"],
            "for other pictures, too: the clip has no v/frame_1.png",
        ),
        (
            ["frame_1.jpg", "frame_1.jpg"],
            "for the picture v/frame_1.jpg twice",
        ),
    ] {
        let files = coco_of(&names);
        let refused = attached_to_files(&mut cars_of(&files), "v", &ten_files()).unwrap_err();
        assert!(refused.to_string().contains(said), "{refused}");
    }
}

#[test]
fn labels_that_name_no_picture_of_the_clip_are_in_the_order_of_their_names() {
    let names = ["f_10.jpg", "f_9.jpg", "f_1.jpg"];
    let files = coco_of(&names);
    let video = attached(&mut cars_of(&files), "v", [640, 360], 3).unwrap();
    let other_names = ten_files();
    let pictures = attached_to_files(&mut cars_of(&files), "v", &other_names[..3]).unwrap();
    for clip in [video, pictures] {
        assert_eq!(frames_with_boxes(&clip), [2]);
        assert_eq!(clip.unlabelled(), 0);
    }
}

/// Labels in the Scalabel form: a car on each frame of the video `drive` with this name and number.
fn named_labels_of_drive(frames: &[(&str, usize)]) -> TempDir {
    let frame = |(name, index): &(&str, usize)| {
        format!(
            r#"{{"name": "{name}", "videoName": "drive", "frameIndex": {index}, "labels": [
            {{"category": "car", "box2d": {{"x1": 1, "y1": 2, "x2": 30, "y2": 40}}}}]}}"#
        )
    };
    let frames: Vec<String> = frames.iter().map(frame).collect();
    folder(&[("drive.json", &format!("[{}]", frames.join(",")))])
}

/// The clip `drive` of these files with these labels.
fn drive_of(labels: &TempDir, files: &[String]) -> Result<Clip, EvalError> {
    let mut truth = for_model(labels, "drive.json", TruthFormat::Bdd100k, &["car"]).unwrap();
    attached_to_files(&mut truth, "drive", files)
}

#[test]
fn labels_of_all_frames_of_a_shorter_video_are_refused_although_pictures_have_their_names() {
    let labels = named_labels_of_drive(&[("frame_1.jpg", 0), ("frame_2.jpg", 1)]);
    let refused = drive_of(&labels, &ten_files()).unwrap_err().to_string();
    assert!(refused.contains("2 frames, the clip has 10"), "{refused}");
    let coco = coco_of(&["frame_1.jpg", "frame_2.jpg"]);
    let refused = attached_to_files(&mut cars_of(&coco), "v", &ten_files()).unwrap_err();
    assert!(refused.to_string().contains("no frame_id"), "{refused}");
}

/// [`coco_of`] `frame_1.jpg` and on, with these numbers.
fn numbered_coco(numbers: &[usize]) -> TempDir {
    let image = |(number, frame): (usize, &usize)| {
        format!(
            r#"{{"id": {number}, "file_name": "v/frame_{number}.jpg", "frame_id": {frame}, "width": 640, "height": 360}}"#
        )
    };
    let images: Vec<String> = (1..).zip(numbers).map(image).collect();
    let set = format!(
        r#"{{"images": [{}], "categories": [{{"id": 3, "name": "car"}}],
        "annotations": [{{"image_id": 2, "category_id": 3, "bbox": [1, 2, 10, 20]}}]}}"#,
        images.join(", ")
    );
    folder(&[("set.json", &set)])
}

#[test]
fn names_and_numbers_of_labels_that_contradict_each_other_are_refused_with_both() {
    let coco = numbered_coco(&[0, 5]);
    let refused = attached_to_files(&mut cars_of(&coco), "v", &ten_files()).unwrap_err();
    let said = "for the picture frame_2.jpg by a name, and for picture 6 of the clip by the number";
    assert!(refused.to_string().contains(said), "{refused}");
    let scalabel = named_labels_of_drive(&[("frame_1.jpg", 0), ("frame_2.jpg", 5)]);
    let refused = drive_of(&scalabel, &ten_files()).unwrap_err().to_string();
    assert!(refused.contains(said), "{refused}");
}

#[test]
fn numbers_that_agree_with_the_names_of_pictures_or_only_count_the_labels_are_no_contradiction() {
    let agreeing = numbered_coco(&[0, 1]);
    let clip = attached_to_files(&mut cars_of(&agreeing), "v", &ten_files()).unwrap();
    assert_eq!(labelled_frames(&clip), [0, 1]);
    // Of the pictures frame_3 and frame_9.
    let counting = named_labels_of_drive(&[("frame_3.jpg", 0), ("frame_9.jpg", 1)]);
    let clip = drive_of(&counting, &ten_files()).unwrap();
    assert_eq!(frames_with_boxes(&clip), [2, 8]);
    // Of a video of which only every second picture is kept.
    let kept: Vec<String> = ten_files().into_iter().step_by(2).collect();
    let labels = named_labels_of_drive(&[("frame_3.jpg", 2), ("frame_9.jpg", 8)]);
    assert_eq!(
        frames_with_boxes(&drive_of(&labels, &kept).unwrap()),
        [1, 4]
    );
    // The numbers of a longer video, of which these are all pictures.
    let files = ten_files();
    let clip = attached_to_files(&mut cars_of(&numbered_coco(&[0, 5])), "v", &files[..2]).unwrap();
    assert_eq!(frames_with_boxes(&clip), [1]);
}

#[test]
fn labels_whose_names_count_from_another_number_are_in_their_order_which_is_told() {
    let complete = named_labels_of_drive(&[("f_0.jpg", 0), ("f_1.jpg", 1), ("f_2.jpg", 2)]);
    let some = named_labels_of_drive(&[("f_0.jpg", 0), ("f_2.jpg", 2)]);
    let files = ["f_1.jpg", "f_2.jpg", "f_3.jpg"].map(str::to_owned);
    for (labels, expected) in [(complete, vec![0, 1, 2]), (some, vec![0, 2])] {
        let mut truth = for_model(&labels, "drive.json", TruthFormat::Bdd100k, &["car"]).unwrap();
        let mut clip = Clip::new("drive".to_owned(), PictureSize::new(640, 360), 3);
        clip.file_names = files.to_vec();
        let mut report = LoadReport::default();
        truth.attach_to(&mut clip, false, Some(3), &mut report).unwrap();
        assert_eq!(frames_with_boxes(&clip), expected);
        let said = report.lines().join("\n");
        assert!(said.contains("drive: its ground truth counts"), "{said}");
    }
}

#[test]
fn files_of_imagenet_vid_from_zero_are_for_pictures_from_one_in_their_order() {
    let cat = imagenet_vid(&[("n02121808", 10)]);
    let files = folder(&[("val/a/0000.xml", &cat), ("val/a/0001.xml", &cat)]);
    let mut truth = for_model(&files, "val", TruthFormat::ImageNetVid, &["cat"]).unwrap();
    let pictures = ["0001.jpg", "0002.jpg"].map(str::to_owned);
    let clip = attached_to_files(&mut truth, "a", &pictures).unwrap();
    assert_eq!(frames_with_boxes(&clip), [0, 1]);
}

#[test]
fn names_that_are_told_apart_only_by_their_endings_are_compared_with_them() {
    let files = ["1.jpg", "1.png", "2.jpg", "2.png"].map(str::to_owned);
    let labels = named_labels_of_drive(&[("1.png", 0), ("2.png", 1)]);
    let clip = drive_of(&labels, &files).unwrap();
    assert_eq!(frames_with_boxes(&clip), [1, 3]);
}

#[test]
fn labels_of_several_folders_are_in_their_order() {
    let labels = named_labels_of_drive(&[("a/frame_1.jpg", 0), ("b/frame_1.jpg", 1)]);
    let clip = drive_of(&labels, &ten_files()[..2]).unwrap();
    assert_eq!(frames_with_boxes(&clip), [0, 1]);
}

/// The error of ground truth that cannot judge a model of cars.
fn unusable_truth(files: &TempDir, path: &str, format: TruthFormat) -> String {
    for_model(files, path, format, &["car"]).unwrap_err().to_string()
}

#[test]
fn ground_truth_without_a_box_is_refused_with_what_was_left_out() {
    let images = r#""images": [{"id": 1, "width": 640, "height": 360}], "categories": [{"id": 3, "name": "car"}]"#;
    let crowd = r#"[{"image_id": 1, "category_id": 3, "bbox": [1, 2, 10, 20], "iscrowd": 1}]"#;
    let crowds = format!(r#"{{{images}, "annotations": {crowd}}}"#);
    let no_labels = format!("{{{images}}}");
    let trams = "0 1 Tram 0 0 -1.5 10 20 60 80\n";
    let files = folder(&[
        ("crowds.json", &crowds),
        ("no_labels.json", &no_labels),
        ("kitti/label_02/a.txt", trams),
    ]);
    for (path, format, said) in [
        ("crowds.json", TruthFormat::Coco, "left out 1: marked as"),
        (
            "no_labels.json",
            TruthFormat::Coco,
            "pictures and no labels",
        ),
        ("kitti", TruthFormat::Kitti, "classes not mapped: Tram 1"),
    ] {
        let refused = unusable_truth(&files, path, format);
        assert!(refused.contains(path), "{refused}");
        assert!(refused.contains("to judge by"), "{refused}");
        assert!(refused.contains(said), "{refused}");
    }
}

#[test]
fn boxes_in_shares_of_the_picture_are_refused() {
    let labels = labels_of_drive(&[0]).replace(
        r#""x1": 1, "y1": 2, "x2": 30, "y2": 40"#,
        r#""x1": 0.1, "y1": 0.2, "x2": 1, "y2": 0.4"#,
    );
    let files = folder(&[("drive.json", &labels)]);
    let refused = unusable_truth(&files, "drive.json", TruthFormat::Bdd100k);
    assert!(refused.contains("normalised"), "{refused}");
}
