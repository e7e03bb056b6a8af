use super::*;
use crate::data::classes::{CAR, PERSON};
use crate::judge::{Classes, Interpolation, Truth, accuracy};
use tempfile::TempDir;

/// A folder with these files, each given as its path and content.
fn folder(files: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("it has a folder")).expect("made");
        std::fs::write(path, content).expect("written");
    }
    folder
}

/// Asserts that `read` failed with an error that contains all of `parts`.
fn assert_refused(read: Result<DataSet, EvalError>, parts: &[&str]) {
    let message = read.expect_err("it must be refused").to_string();
    for part in parts {
        assert!(message.contains(part), "{part} in {message}");
    }
}

// Recordings describe their classes for people, too; only `class_names` is read.
const INDEX: &str = r#"{"classes": {"2": "car"},
    "sequences": [{"name": "a", "width": 100, "height": 50, "fps": 10, "frames": 3}]}"#;
const HEADER: &str = "frame,x1,y1,x2,y2,score,class\n";
const TRUTH_HEADER: &str = "frame,x1,y1,x2,y2,class,object_id\n";

fn recorded(index: &str, rows: Option<&str>, truth: Option<&str>) -> Result<DataSet, EvalError> {
    let detections = rows.map(|rows| format!("{HEADER}{rows}"));
    let truth = truth.map(|rows| format!("{TRUTH_HEADER}{rows}"));
    let mut files = vec![("sequences.json", index)];
    files.extend(detections.as_deref().map(|text| ("detections/a.csv", text)));
    files.extend(truth.as_deref().map(|text| ("groundtruth/a.csv", text)));
    recorded::read(folder(&files).path())
}

#[test]
fn recorded_detections_truth_and_ignored_regions_are_read_frame_by_frame_and_written_back() {
    let rows = "0,0.1,0.30000000000000004,3.5,4,0.9,2\n2,1,1,9,9,0.3333333333333333,0\n";
    let truth = format!("{TRUTH_HEADER}1,0,0,5,5,2,7\n");
    let files = folder(&[
        ("sequences.json", INDEX),
        ("detections/a.csv", &format!("{HEADER}{rows}")),
        ("groundtruth/a.csv", &truth),
        ("ignore/a.csv", "frame,x1,y1,x2,y2\n1,0,0,50,20.5\n"),
    ]);
    let read = recorded::read(files.path()).unwrap();
    assert_eq!(read.report, LoadReport::default());
    let clip = &read.clips[0];
    let detections = clip.detections.as_ref().unwrap();
    let counts: Vec<usize> = detections.iter().map(Vec::len).collect();
    assert_eq!(counts, [1, 0, 1]);
    assert_eq!(detections[0][0].corners.x2, 3.5);
    assert_eq!(detections[0][0].class, CAR);
    assert_eq!(clip.truth.as_ref().unwrap()[1][0].object, Some(7));
    let regions: Vec<usize> = clip.ignored.iter().map(Vec::len).collect();
    assert_eq!(
        (regions, clip.ignored[1][0].corners.y2),
        (vec![0, 1, 0], 20.5)
    );
    let copy = tempfile::tempdir().unwrap();
    recorded::write(copy.path(), &read.clips).unwrap();
    let again = recorded::read(copy.path()).unwrap();
    assert_eq!(again.clips, read.clips, "to the last bit");
}

#[test]
fn clips_that_are_written_one_by_one_are_there_after_each() {
    let clip = |name: &str| Clip {
        detections: Some(vec![Vec::new(); 3]),
        ..Clip::new(name.to_owned(), PictureSize::new(100, 50), 3)
    };
    let clips = [clip("a"), clip("b")];
    let folder = tempfile::tempdir().unwrap();
    for done in 1..=clips.len() {
        recorded::write_last(folder.path(), &clips[..done]).unwrap();
        assert_eq!(recorded::read(folder.path()).unwrap().clips, clips[..done]);
    }
}

#[test]
fn every_mark_of_a_recording_is_written_and_read_back() {
    let mark = |class: Option<u16>, mark| Ignored {
        corners: Corners {
            x1: 0.1,
            y1: 0.0,
            x2: 50.0,
            y2: 20.5,
        },
        class: class.map(ClassId),
        mark,
    };
    let clip = Clip {
        detections: Some(vec![Vec::new(); 3]),
        truth: Some(vec![Vec::new(); 3]),
        ignored: vec![
            vec![
                mark(Some(2), Mark::Crowd),
                mark(None, Mark::Distractor),
                mark(None, Mark::Unjudged),
            ],
            vec![mark(Some(0), Mark::Object), mark(None, Mark::Region)],
            vec![Ignored::UNLABELLED],
        ],
        ..Clip::new("a".to_owned(), PictureSize::new(100, 50), 3)
    };
    let folder = tempfile::tempdir().unwrap();
    recorded::write(folder.path(), std::slice::from_ref(&clip)).unwrap();
    assert_eq!(recorded::read(folder.path()).unwrap().clips, [clip]);
    let file = folder.path().join("ignore/a.csv");
    let text = std::fs::read_to_string(&file).unwrap().replace("crowd", "cloud");
    std::fs::write(file, text).unwrap();
    assert_refused(recorded::read(folder.path()), &["a.csv:2: ", "`cloud`"]);
}

#[test]
fn a_broken_row_is_named_with_file_and_line() {
    for (row, part) in [
        ("0,1,2,3,4,0.9", "the row has 6 columns"),
        ("0,1,2,x,4,0.9,2", "`x2` is `x`"),
        ("3,1,2,3,4,0.9,2", "frame 3 does not exist"),
        ("-1,1,2,3,4,0.9,2", "frame -1 does not exist"),
        ("0.5,1,2,3,4,0.9,2", "`frame` is `0.5`"),
        ("0,1,2,3,4,0.9,-2", "`class` is `-2`"),
    ] {
        let rows = format!("0,1,2,3,4,0.9,2\n{row}\n");
        let parts = ["detections/a.csv:3: ", part];
        assert_refused(recorded(INDEX, Some(&rows), None), &parts);
    }
    let files = folder(&[("sequences.json", INDEX), ("detections/a.csv", "frame,x\n")]);
    let parts = ["detections/a.csv", "needs its detections"];
    assert_refused(recorded(INDEX, None, None), &parts);
    let header = "a.csv:1: the header is `frame,x`";
    assert_refused(recorded::read(files.path()), &[header]);
    let index = "{\n\"sequences\": [{]}";
    assert_refused(recorded(index, Some(""), None), &["sequences.json:2: "]);
}

#[test]
fn an_impossible_description_is_rejected() {
    let outside = INDEX.replace("\"a\"", "\"../a\"");
    for (index, part) in [
        (outside, "cannot be a sequence's name"),
        (INDEX.replace("100", "0"), "pictures of 0x50"),
        (INDEX.replace("10,", "-1,"), "frame rate"),
    ] {
        assert_refused(recorded(&index, Some(""), None), &[part]);
    }
}

#[test]
fn meaningless_rows_are_dropped_counted_and_named() {
    let rows = "0,1,2,3,4,NaN,2\n0,inf,2,3,4,0.9,2\n0,5,2,3,4,0.9,2\n0,1,4,3,4,0.9,2\n\
                0,200,2,300,4,0.9,2\n0,1,2,3,4,1.5,2\n1,-5,2,3,4,0.9,2\n";
    let clips = recorded(INDEX, Some(rows), Some("0,9,9,5,5,2,1\n")).unwrap();
    let report = &clips.report;
    let counted = |reason| report.left_out.get(&reason).map_or(0, |(count, _)| *count);
    assert_eq!(counted(LeftOut::NotFinite), 2);
    assert_eq!(counted(LeftOut::EmptyBox), 3);
    assert_eq!(counted(LeftOut::OutsidePicture), 1);
    assert_eq!(counted(LeftOut::ConfidenceRange), 1);
    assert_eq!(report.reaching_outside, 1);
    let kept = clips.clips[0].detections.iter().flatten().flatten();
    assert_eq!(kept.count(), 1);
    let lines = report.lines().join("\n");
    assert!(lines.contains("detections/a.csv:2"), "{lines}");
}

#[test]
fn missing_parts_of_a_clip_are_named_and_an_empty_clip_is_counted() {
    let clips = recorded(INDEX, Some(""), Some("0,1,1,5,5,2,1\n")).unwrap();
    let lines = clips.report.lines().join("\n");
    assert!(lines.contains("no detections"), "{lines}");
    let clips = recorded(INDEX, Some("0,1,2,3,4,0.9,2\n"), None).unwrap();
    assert!(clips.report.lines()[0].contains("no ground truth"));
    // The index counts boxes.
    let counted = INDEX.replace("\"frames\"", "\"ground_truth_boxes\": 4, \"frames\"");
    assert_refused(recorded(&counted, Some(""), None), &["groundtruth/a.csv"]);
    let empty = INDEX.replace("\"frames\": 3", "\"frames\": 0");
    assert_refused(recorded(&empty, Some(""), None), &["clip without frames"]);
}

const SEQINFO: &str =
    "[Sequence]\nname=M\nimDir=img1\nframeRate=30\nseqLength=2\nimWidth=640\nimHeight=480\n";

#[test]
fn mot_challenge_counts_frames_and_pixels_from_one_and_knows_both_releases() {
    let truth = "1,4,11,21,10,20,1,1,1.0\n2,4,11,21,10,20,0,1,1.0\n2,5,11,21,10,20,1,8,1\n2,6,1,1,5,5,1,6,1\n\
                 1,7,11,21,10,20,1,3.5,4.5,-1\n";
    let files = folder(&[
        ("train/M/seqinfo.ini", SEQINFO),
        ("train/M/gt/gt.txt", truth),
        ("train/M/det/det.txt", "2,-1,11,21,10,20,0.8,-1,-1,-1\n"),
        ("train/M/img1/000002.jpg", ""),
        ("train/M/img1/000001.jpg", ""),
    ]);
    let clips = mot_challenge::read(&files.path().join("train")).unwrap();
    let clip = &clips.clips[0];
    assert_eq!((clip.name.as_str(), clip.frames), ("M", 2));
    assert_eq!(clip.frame_rate, Some(30.0));
    assert!(clip.pictures[0].ends_with("000001.jpg"));
    let truth = clip.truth.as_ref().unwrap();
    let objects: Vec<_> = truth[0].iter().map(|b| (b.object, b.class)).collect();
    assert_eq!(objects, [(Some(4), PERSON), (Some(7), PERSON)]);
    let c = truth[0][0].corners;
    assert_eq!([c.x1, c.y1, c.x2, c.y2], [10.0, 20.0, 20.0, 40.0]);
    assert!(truth[1].is_empty());
    let marks: Vec<_> = clip.ignored[1].iter().map(|ignored| ignored.mark).collect();
    assert_eq!(marks, [Mark::Unjudged, Mark::Distractor]);
    assert_eq!(clips.report.left_out[&LeftOut::IgnoredRegion].0, 1);
    assert_eq!(clips.report.left_out[&LeftOut::Unjudged].0, 1);
    assert_eq!(clips.report.unmapped_classes["6"], 1);
    assert_eq!(clip.detections.as_ref().unwrap()[1][0].confidence, 0.8);
    let broken = folder(&[("seqinfo.ini", SEQINFO), ("gt/gt.txt", "1,4,11\n")]);
    assert_refused(mot_challenge::read(broken.path()), &["gt.txt:1: "]);
}

#[test]
fn mot_challenge_excuses_its_distractors_and_vehicles_only_for_vehicles() {
    // Classes 1 to 13, each marked as the benchmark's own files do.
    let rows: String = (1..=13)
        .map(|class| {
            format!(
                "1,{class},11,21,10,20,{},{class},1\n",
                i32::from(class == 1)
            )
        })
        .collect();
    let read = |name: &str| {
        let info = SEQINFO.replace("name=M", &format!("name={name}"));
        let files = folder(&[("seqinfo.ini", &info), ("gt/gt.txt", &rows)]);
        let data = mot_challenge::read(files.path()).unwrap();
        let clip = data.clips.into_iter().next().unwrap();
        assert_eq!(clip.truth.unwrap()[0].len(), 1);
        let marks = clip.ignored[0].iter().map(|ignored| (ignored.mark, ignored.class));
        marks.collect::<Vec<_>>()
    };
    let vehicles = |number| (Mark::Distractor, Some(ClassId(number)));
    let any = (Mark::Distractor, None);
    let unjudged = (Mark::Unjudged, None);
    // Person on a vehicle, car, bicycle, motorcycle; static person, distractor, three occluders, reflection, crowd.
    let [car, bicycle, motorcycle] = [2, 1, 3].map(vehicles);
    let expected = [
        any, car, bicycle, motorcycle, any, any, unjudged, unjudged, unjudged, any, unjudged,
    ];
    assert_eq!(read("MOT17-02"), expected);
    // Since 2020 vehicles without motor are distractors, too.
    let with_vehicles = [&expected[..4], &[any], &expected[4..]].concat();
    assert_eq!(read("MOT20-01"), with_vehicles);
}

#[test]
fn visdrone_marks_regions_others_and_objects_of_score_zero() {
    let rows = "1,0,0,0,100,50,0,0,0,0\n1,1,10,20,30,40,1,5,0,0\n2,2,10,20,30,40,0,1,0,0\n\
                2,3,10,20,30,40,1,11,0,0\n2,4,10,20,30,40,1,7,0,0\n";
    let files = folder(&[("annotations/uav.txt", rows)]);
    let data = visdrone::read(files.path(), PictureSize::new(640, 360)).unwrap();
    let clip = &data.clips[0];
    assert_eq!((clip.name.as_str(), clip.frames), ("uav", 2));
    let truth = clip.truth.as_ref().unwrap();
    assert_eq!((truth[0][0].class, truth[0][0].object), (CAR, Some(1)));
    assert_eq!(truth[0][0].corners.x2, 40.0);
    assert!(truth[1].is_empty());
    let regions: Vec<usize> = clip.ignored.iter().map(Vec::len).collect();
    assert_eq!(regions, [1, 2]);
    assert_eq!(data.report.unmapped_classes["tricycle"], 1);
}

#[test]
fn kitti_tracking_maps_its_types_and_counts_dropped_ones() {
    let label = "0 1 Van 0 0 -1.5 10 20 60 80 1 1 1 1 1 1 0\n\
                 0 -1 DontCare -1 -1 -10 1 1 5 5 -1 -1 -1 -1 -1 -1 -1\n\
                 2 2 Tram 0 0 -1.5 10 20 60 80 1 1 1 1 1 1 0\n\
                 2 3 Cyclist 0 0 -1.5 10 20 60 80 1 1 1 1 1 1 0\n";
    let found = "3 -1 Car 0 0 0 10 20 60 80 1 1 1 1 1 1 0 0.75\n";
    let files = folder(&[("label_02/0007.txt", label), ("det_02/0007.txt", found)]);
    let clips = kitti::read(files.path()).unwrap();
    let clip = &clips.clips[0];
    assert_eq!((clip.name.as_str(), clip.frames), ("0007", 4));
    let truth = clip.truth.as_ref().unwrap();
    assert_eq!(truth[0][0].class, CAR);
    assert_eq!(truth[2].len(), 1);
    assert_eq!(clip.detections.as_ref().unwrap()[3][0].confidence, 0.75);
    let regions: Vec<_> = clip.ignored.iter().map(Vec::len).collect();
    assert_eq!((regions[0], clip.ignored[0][0].corners.x2), (1, 5.0));
    assert!(regions[1..].iter().all(|&count| count == 0));
    assert_eq!(clips.report.unmapped_classes["Tram"], 1);
}

#[test]
fn bdd100k_reads_both_spellings_and_maps_seven_classes_to_six() {
    let old = r#"[{"name": "v-1.jpg", "video_name": "v", "index": 0, "labels": [
        {"id": "00122062", "category": "rider", "attributes": {"Crowd": true},
         "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}},
        {"id": "3", "category": "trailer", "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}]},
        {"name": "v-3.jpg", "video_name": "v", "index": 2, "labels": null},
        {"name": "w-1.jpg", "video_name": "w", "index": 0, "labels": null}]"#;
    let new = r#"{"frames": [{"name": "v-2.jpg", "videoName": "v", "frameIndex": 1, "labels": [
        {"category": "car", "score": 0.5, "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}]}]}"#;
    let files = folder(&[("gt.json", old), ("pred.json", new)]);
    let [truth, found] = ["gt.json", "pred.json"].map(|name| files.path().join(name));
    let source = |truth, detections| bdd100k::Source {
        truth,
        detections,
        picture: PictureSize::new(1280, 720),
        frame_rate: Some(bdd100k::BDD100K_FRAME_RATE),
        rules: Rules::Paper,
    };
    // The benchmark judges neither crowds nor trailers.
    let judged = bdd100k::Source {
        rules: Rules::Benchmark,
        ..source(Some(&truth), Some(&found))
    };
    let judged = bdd100k::read(&judged).unwrap();
    assert!(judged.clips[0].truth.as_ref().unwrap()[0].is_empty());
    let regions: Vec<usize> = judged.clips[0].ignored.iter().map(Vec::len).collect();
    assert_eq!(
        regions,
        [2, 1, 0],
        "the labels do not list the second frame"
    );
    assert_eq!(judged.clips[0].unlabelled(), 1);
    // The paper's evaluator takes a crowd for an object, and does not know trailers.
    let clips = bdd100k::read(&source(Some(&truth), Some(&found))).unwrap();
    assert_eq!(clips.clips[0].ignored.iter().flatten().count(), 1);
    let clip = &clips.clips[0];
    assert_eq!((clip.name.as_str(), clip.frames), ("v", 3));
    let rider = clip.truth.as_ref().unwrap()[0][0];
    assert_eq!((rider.class, rider.object), (PERSON, Some(122_062)));
    assert_eq!(clip.detections.as_ref().unwrap()[1].len(), 1);
    assert_eq!(clips.clips[1].detections, None, "no predictions for `w`");
    assert_eq!(clips.report.unmapped_classes["trailer"], 1);
    // Ground truth in place of predictions is an error, and so is a repeated frame.
    let swapped = bdd100k::read(&source(None, Some(&truth)));
    assert_refused(swapped, &["has no `score`"]);
    let twice = folder(&[("gt.json", &old.replace("\"index\": 2", "\"index\": 0"))]);
    let repeated = bdd100k::read(&source(Some(&twice.path().join("gt.json")), None));
    assert_refused(repeated, &["occurs twice"]);
}

#[test]
fn labels_without_videos_are_divided_by_the_names_of_their_pictures() {
    let frame = |name: &str| format!(r#"{{"name": "{name}", "labels": []}}"#);
    let names = ["b1c6-0000002.jpg", "b1c6-0000001.jpg", "b1ca-0000001.jpg"];
    let text = format!("[{}]", names.map(frame).join(","));
    let files = folder(&[
        ("val_gt.json", &text),
        ("other.json", &text.replace("-000000", "-")),
    ]);
    let read = |name: &str| {
        let truth = files.path().join(name);
        let source = bdd100k::Source {
            truth: Some(&truth),
            detections: None,
            picture: PictureSize::new(1280, 720),
            frame_rate: None,
            rules: Rules::Benchmark,
        };
        let clips = bdd100k::read(&source).unwrap().clips;
        let lengths = clips.into_iter().map(|clip| (clip.name, clip.frames));
        lengths.collect::<Vec<_>>()
    };
    let expected = [("b1c6".to_owned(), 2), ("b1ca".to_owned(), 1)];
    assert_eq!(read("val_gt.json"), expected);
    // Names that are not BDD100K's say nothing: the file is one video.
    assert_eq!(read("other.json"), [("other".to_owned(), 3)]);
}

#[test]
fn clips_without_detections_are_dropped_by_name_or_rejected() {
    let clip = |name: &str| Clip::new(name.to_owned(), PictureSize::new(10, 10), 1);
    let truth = Path::new("gt.json");
    let mut clips = DataSet::default();
    clips.push(clip("b"));
    assert_refused(clips.clone().only_with_detections(truth), &["--detections"]);
    clips.push(Clip {
        detections: Some(vec![Vec::new()]),
        ..clip("a")
    });
    let clips = clips.only_with_detections(truth).unwrap();
    assert_eq!(clips.clips.len(), 1);
    let lines = clips.report.lines().join("\n");
    let expected = "b: ground truth without stored detections";
    assert!(lines.contains(expected), "{lines}");
}

#[test]
fn coco_groups_images_into_clips_and_marks_crowds_and_ignored_objects() {
    let set = r#"{"images": [
        {"id": 5, "file_name": "v/2.jpg", "width": 100, "height": 50},
        {"id": 4, "file_name": "v/1.jpg", "width": 100, "height": 50}],
        "categories": [{"id": 3, "name": "car"}, {"id": 9, "name": "boat"}],
        "annotations": [
        {"id": 1, "image_id": 5, "category_id": 3, "bbox": [1, 2, 10, 20], "iscrowd": 0, "track_id": 8},
        {"id": 2, "image_id": 5, "category_id": 3, "bbox": [1, 2, 10, 20], "iscrowd": 1},
        {"id": 5, "image_id": 5, "category_id": 3, "bbox": [1, 2, 10, 20], "ignore": true},
        {"id": 6, "image_id": 5, "category_id": 9, "bbox": [1, 2, 10, 20], "iscrowd": 1},
        {"id": 3, "image_id": 4, "category_id": 9, "bbox": [1, 2, 10, 20]},
        {"id": 4, "image_id": 4, "category_id": 3, "bbox": [1, 2, -10, 20]}]}"#;
    let found = r#"[{"image_id": 4, "category_id": 3, "bbox": [1, 2, 10, 20], "score": 0.5}]"#;
    let files = folder(&[("set.json", set), ("results.json", found)]);
    let [set, results] = ["set.json", "results.json"].map(|name| files.path().join(name));
    let clips = coco::read(&set, Some(&results)).unwrap();
    let clip = &clips.clips[0];
    assert_eq!((clip.name.as_str(), clip.frames), ("v", 2));
    let truth = clip.truth.as_ref().unwrap();
    assert_eq!(truth[1][0].object, Some(8));
    assert_eq!(truth[1][0].corners.x2, 11.0);
    assert!(truth[0].is_empty());
    assert_eq!(clip.detections.as_ref().unwrap()[0].len(), 1);
    let marks: Vec<_> =
        clip.ignored[1].iter().map(|ignored| (ignored.mark, ignored.class)).collect();
    let car = Some(CAR);
    assert_eq!(marks, [(Mark::Crowd, car), (Mark::Object, car)]);
    assert_eq!(clips.report.left_out[&LeftOut::IgnoredRegion].0, 2);
    assert_eq!(clips.report.left_out[&LeftOut::EmptyBox].0, 1);
    assert_eq!(clips.report.unmapped_classes["boat"], 2);
    let lost = found.replace("\"image_id\": 4", "\"image_id\": 77");
    std::fs::write(&results, lost).unwrap();
    assert_refused(coco::read(&set, Some(&results)), &["image 77"]);
}

#[test]
fn clips_with_equal_names_get_different_file_names() {
    let mut clips = DataSet::default();
    for name in ["a/b", "a-b", "..", "a-b"] {
        clips.push(Clip::new(name.to_owned(), PictureSize::new(10, 10), 1));
    }
    let names: Vec<&str> = clips.clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["a-b", "a-b-2", "-2", "a-b-3"]);
}

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

/// A clip of so many pictures with its truth.
fn attached(
    truth: &mut GroundTruth,
    name: &str,
    size: [u32; 2],
    pictures: usize,
) -> Result<Clip, EvalError> {
    let mut clip = Clip::new(
        name.to_owned(),
        PictureSize::new(size[0], size[1]),
        pictures,
    );
    truth.attach_to(&mut clip, false, Some(pictures), &mut LoadReport::default())?;
    Ok(clip)
}

fn labelled_frames(clip: &Clip) -> Vec<usize> {
    let is_labelled = |frame: &usize| {
        clip.ignored
            .get(*frame)
            .is_none_or(|marks| !marks.contains(&Ignored::UNLABELLED))
    };
    (0..clip.frames).filter(is_labelled).collect()
}

/// The labels of a frame of ImageNet-VID, with these objects: their class and left edge.
fn vid(objects: &[(&str, u32)]) -> String {
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
    let [cats, none, zebra] = [
        vid(&[("n02121808", 10), ("n02419796", 200)]),
        vid(&[]),
        vid(&[("n02391049", 10)]),
    ];
    let files = folder(&[
        ("val/a/000000.xml", &cats),
        ("val/a/000002.xml", &none),
        ("val/b/000000.xml", &zebra),
    ]);
    let names = ["zebra", "cat", "kite"];
    let mut truth = for_model(&files, "val", TruthFormat::ImageNetVid, &names).unwrap();
    assert_eq!(
        truth.take_report().unmapped_classes,
        [("antelope".to_owned(), 1)].into()
    );
    let kite = truth.classes().find("kite");
    assert_eq!(
        kite,
        Err(LeftOut::UnmappedClass),
        "no label is one, so none can be right"
    );
    let clip = attached(&mut truth, "a", [640, 360], 5).unwrap();
    let objects = clip.truth.as_ref().unwrap();
    assert_eq!((objects[0].len(), objects[0][0].class), (1, ClassId(1)));
    assert_eq!(
        (objects[0][0].object, objects[0][0].corners.x2),
        (Some(3), 60.0)
    );
    // The second has no file, the third has one without objects, and nobody labelled the last two.
    assert_eq!(labelled_frames(&clip), [0, 2]);
    let refused = attached(&mut truth, "a", [640, 360], 2).unwrap_err().to_string();
    assert!(refused.contains("3 frames, the clip has 2"), "{refused}");
    let refused = attached(&mut truth, "a", [64, 36], 5).unwrap_err().to_string();
    assert!(refused.contains("640x360"), "{refused}");
    let refused = for_model(&files, "val", TruthFormat::ImageNetVid, &["helmet"]);
    let refused = refused.unwrap_err().to_string();
    assert!(
        refused.contains("antelope") && refused.contains("helmet"),
        "{refused}"
    );
    for (text, part) in [
        ("<annotation>", "000000.xml"),
        ("<annotation/>", "no <size>"),
    ] {
        let files = folder(&[("val/a/000000.xml", text)]);
        assert_refused(imagenet_vid::read(&files.path().join("val")), &[part]);
    }
}

#[test]
fn labels_of_a_video_that_list_some_frames_leave_the_others_unjudged() {
    let frame = |index: usize| {
        format!(
            r#"{{"name": "{index}", "videoName": "drive", "frameIndex": {index}, "labels": [
            {{"category": "car", "box2d": {{"x1": 1, "y1": 2, "x2": 30, "y2": 40}}}}]}}"#
        )
    };
    let list = |frames: &[usize]| {
        let frames: Vec<String> = frames.iter().map(|index| frame(*index)).collect();
        format!("[{}]", frames.join(","))
    };
    let read = |text: &str, pictures| {
        let files = folder(&[("drive.json", text)]);
        let mut truth = for_model(&files, "drive.json", TruthFormat::Bdd100k, &["car"]).unwrap();
        attached(&mut truth, "drive", [640, 360], pictures)
    };
    let sparse = list(&[0, 30, 60]);
    assert_eq!(labelled_frames(&read(&sparse, 90).unwrap()), [0, 30, 60]);
    // The authors' labels name pictures, and leave out those without objects, the last ones, too.
    let named = |place: usize| format!(r#"{{"name": "drive-{place:07}.jpg", "labels": []}}"#);
    let named = format!("[{}, {}]", named(1), named(2));
    assert_eq!(labelled_frames(&read(&named, 4).unwrap()), [0, 1]);
    // Labels of all frames say how many there are.
    let all = list(&[0, 1, 2]);
    assert_eq!(labelled_frames(&read(&all, 3).unwrap()), [0, 1, 2]);
    let refused = read(&all, 4).unwrap_err().to_string();
    assert!(refused.contains("3 frames, the clip has 4"), "{refused}");
}

#[test]
fn images_of_coco_are_frames_of_their_video_by_their_number_if_it_has_more() {
    let set = |with_numbers: bool| {
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
        format!(
            r#"{{"images": [{}, {}], "videos": [{{"id": 7, "name": "train/YFCC/v_1"}}],
            "categories": [{{"id": 3, "name": "car"}}, {{"id": 4, "name": "bus"}}],
            "annotations": [{{"image_id": 2, "category_id": 3, "track_id": 5, "instance_id": 5,
                "bbox": [1, 2, 10, 20]}}]}}"#,
            image(1, 0),
            image(2, 30)
        )
    };
    let files = folder(&[("set.json", &set(true)), ("unnumbered.json", &set(false))]);
    let truth = |file| for_model(&files, file, TruthFormat::Coco, &["car", "bus"]).unwrap();
    let clip = attached(&mut truth("set.json"), "v_1", [100, 50], 40).unwrap();
    assert_eq!(labelled_frames(&clip), [0, 30]);
    assert_eq!(clip.truth.as_ref().unwrap()[30].len(), 1);
    // A folder with the labelled pictures alone has them in their order.
    let clip = attached(&mut truth("set.json"), "v_1", [100, 50], 2).unwrap();
    assert_eq!((labelled_frames(&clip), clip.unlabelled()), (vec![0, 1], 0));
    let refused = attached(&mut truth("set.json"), "v_1", [100, 50], 20).unwrap_err();
    assert!(
        refused.to_string().contains("31 frames, the clip has 20"),
        "{refused}"
    );
    let refused = attached(&mut truth("unnumbered.json"), "v_1", [100, 50], 40).unwrap_err();
    assert!(refused.to_string().contains("no frame_id"), "{refused}");
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
    let judged = |class: u16| {
        let place = Corners {
            x1: 80.0,
            y1: 30.0,
            x2: 95.0,
            y2: 45.0,
        };
        let beside = ScoredBox {
            corners: place,
            class: ClassId(class),
            confidence: 0.99,
            object: None,
        };
        let mut found = clip.truth.clone().unwrap();
        found[0].iter_mut().for_each(|found| found.confidence = 0.5);
        found[0].push(beside);
        let truth = Truth {
            objects: clip.truth.as_deref().unwrap(),
            ignored: &clip.ignored,
        };
        accuracy(&found, truth, Classes::Pooled, Interpolation::AllPoints).unwrap().ap50
    };
    let is_right = [0, 1, 2, 3].map(|class| judged(class) == 1.0);
    assert_eq!(is_right, [false, true, false, true]);
    let clip = attached(&mut truth, "b", [100, 50], 1).unwrap();
    assert!(clip.ignored.iter().all(Vec::is_empty));
}

#[test]
fn a_model_without_any_class_of_the_ground_truth_is_refused_in_every_layout() {
    let files = folder(&[
        ("annotations/uav.txt", "1,1,10,20,30,40,1,5,0,0\n"),
        (
            "label_02/0007.txt",
            "0 1 Van 0 0 -1.5 10 20 60 80 1 1 1 1 1 1 0\n",
        ),
        (
            "l.json",
            r#"[{"name": "a", "labels": [{"category": "car", "box2d": {"x1": 1, "y1": 2, "x2": 30, "y2": 40}}]}]"#,
        ),
    ]);
    for (path, format) in [
        ("", TruthFormat::VisDrone),
        ("", TruthFormat::Kitti),
        ("l.json", TruthFormat::Bdd100k),
    ] {
        let refused = for_model(&files, path, format, &["helmet", "vest"]);
        let refused = refused.unwrap_err().to_string();
        assert!(
            refused.contains("person, bicycle") && refused.contains("helmet"),
            "{refused}"
        );
        for_model(&files, path, format, &["helmet", "car"]).unwrap();
    }
}
