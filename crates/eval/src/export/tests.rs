use super::frames::LabelledFrame;
use super::mot::Sequence;
use super::*;
use crate::data;
use crate::data::classes::Evaluated;
use crate::footage::{SourceName, VideoEncoding};
use albireo_core::detection::{ClassId, ObjectId};
use albireo_core::geometry::Corners;
use albireo_core::policy::{BoxSource, FrameState};
use albireo_recording::{AuditMessage, RecordingFile};
use albireo_wire::{BoxMessage, DetectionsMessage, Latency, VERSION};
use bytes::Bytes;
use serde_json::Value;

/// A box of this class, and of this object if it is tracked.
fn one(class: &str, object: Option<u64>) -> BoxMessage {
    BoxMessage {
        corners: [1.0, 2.0, 31.0, 42.0],
        class: class.to_owned(),
        confidence: 0.75,
        source: BoxSource::Detected,
        object: object.map(ObjectId),
        confirmed: true,
    }
}

/// Where each box is.
fn place() -> Corners {
    Corners {
        x1: 1.0,
        y1: 2.0,
        x2: 31.0,
        y2: 42.0,
    }
}

fn picture() -> Bytes {
    let mut file = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut file, 90);
    encoder.encode(&[90; 64 * 48], 64, 48, jpeg_encoder::ColorType::Luma).unwrap();
    file.into()
}

const UNTRACKED: Option<u64> = None;

/// A recording of four frames, two of which the audit keeps.
fn recorded(path: &Path) {
    recorded_at(path, &[0, 100, 200, 300]);
}

/// A recording of frames at these milliseconds, of which the audit keeps every second one.
fn recorded_at(path: &Path, times_ms: &[u64]) {
    let mut file = RecordingFile::create(path).unwrap();
    for (seq, ms) in (0..).zip(times_ms) {
        let t_ns = 1_700_000_000_000_000_000 + ms * 1_000_000;
        let shown = DetectionsMessage {
            v: VERSION,
            seq,
            t_ns,
            clip: "drive".to_owned(),
            state: FrameState::P,
            pending: false,
            degraded: false,
            cause: None,
            passed: None,
            tau_max: None,
            threshold: None,
            width: 64,
            height: 48,
            boxes: vec![one("car", Some(6)), one("truck", Some(seq))],
            latency_ms: Latency::default(),
        };
        let no_position = None;
        file.frame("front", picture(), &shown, no_position).unwrap();
        if seq % 2 == 1 {
            let audit = AuditMessage {
                v: VERSION,
                seq,
                t_ns,
                width: 64,
                height: 48,
                shown: shown.boxes,
                detected: vec![one("car", UNTRACKED)],
            };
            file.audited("front", picture(), &audit).unwrap();
        }
    }
    file.finish().unwrap();
}

#[test]
fn what_the_audit_kept_is_exported_as_coco() {
    let folder = tempfile::tempdir().unwrap();
    recorded(&folder.path().join("a.mcap"));
    recorded(&folder.path().join("b.mcap"));
    let files = recordings(folder.path()).unwrap();
    let out = folder.path().join("out");
    let audit = ExportedFrames::Audit;
    let mut told = Vec::new();
    let done = export(&files, &out, ExportFormat::Coco, audit, |so_far| {
        told.push(so_far.pictures);
    })
    .unwrap();
    assert_eq!(done.recordings, 2);
    assert_eq!(done.pictures, 4);
    assert_eq!(done.boxes, 4);
    assert_eq!(told, [2, 4]);
    assert!(done.left_out.is_empty(), "{:?}", done.left_out);
    let text = std::fs::read(out.join("annotations.json")).unwrap();
    let coco: Value = serde_json::from_slice(&text).unwrap();
    assert_eq!(
        coco["annotations"][0]["bbox"],
        serde_json::json!([1.0, 2.0, 30.0, 40.0])
    );
    assert_eq!(
        coco["categories"],
        serde_json::json!([{"id": 1, "name": "car"}])
    );
    for image in coco["images"].as_array().unwrap() {
        let file = out.join("images").join(image["file_name"].as_str().unwrap());
        assert_eq!(std::fs::read(file).unwrap(), picture());
    }
}

#[test]
fn an_export_as_coco_is_read_by_the_evaluation_with_the_same_boxes() {
    let folder = tempfile::tempdir().unwrap();
    recorded(&folder.path().join("a.mcap"));
    let files = recordings(folder.path()).unwrap();
    let out = folder.path().join("out");
    let audit = ExportedFrames::Audit;
    export(&files, &out, ExportFormat::Coco, audit, |_| {}).unwrap();
    let no_results = None;
    let read = data::coco::read(&out, no_results).unwrap();
    let boxes: Vec<_> = read
        .clips
        .iter()
        .flat_map(|clip| clip.truth.iter().flatten())
        .flatten()
        .collect();
    assert_eq!(boxes.len(), 2);
    let car = Evaluated::Road.find("car").unwrap();
    for found in boxes {
        assert_eq!(found.class, car);
        assert_eq!(found.corners, place());
    }
}

#[test]
fn a_folder_with_files_is_not_written_into() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    recorded(&path);
    let files = recordings(&path).unwrap();
    let audit = ExportedFrames::Audit;
    let error = export(&files, folder.path(), ExportFormat::Coco, audit, |_| {}).unwrap_err();
    assert!(error.to_string().contains("not empty"), "{error}");
}

/// Exports the frames of one recording in this folder as they were shown, into its folder `out`.
fn export_as_shown(folder: &Path) -> Exported {
    recorded(&folder.join("a.mcap"));
    let files = recordings(folder).unwrap();
    let out = folder.join("out");
    let shown = ExportedFrames::Shown;
    export(&files, &out, ExportFormat::Mot, shown, |_| {}).unwrap()
}

#[test]
fn an_export_as_motchallenge_is_read_by_the_evaluation_with_the_same_tracks() {
    let folder = tempfile::tempdir().unwrap();
    export_as_shown(folder.path());
    let out = folder.path().join("out");
    let read = data::mot_challenge::read(&out).unwrap();
    let [clip] = read.clips.as_slice() else {
        panic!("{:?}", read.clips);
    };
    assert_eq!(clip.frames, 4);
    assert_eq!(clip.frame_rate, Some(10.0));
    // MOTChallenge has cars and no trucks; `classes.txt` names these.
    for objects in clip.truth.as_ref().unwrap() {
        let [car, truck] = objects.as_slice() else {
            panic!("{objects:?}");
        };
        assert_eq!(car.corners, place());
        assert_eq!(car.object, Some(7));
        assert_eq!(truck.class, ClassId(7));
    }
    assert_eq!(read.report, data::LoadReport::default());
}

#[test]
fn frames_as_shown_are_exported_as_motchallenge() {
    let folder = tempfile::tempdir().unwrap();
    let done = export_as_shown(folder.path());
    assert_eq!(done.pictures, 4);
    assert_eq!(done.boxes, 8);
    let out = folder.path().join("out");
    let rows = std::fs::read_to_string(out.join("a_front/gt/gt.txt")).unwrap();
    // Frame, track, left, top, width, height, 1, class, 1: tracks and pixels count from 1, and MOTChallenge's car is 3.
    assert_eq!(rows.lines().next(), Some("1,7,2.00,3.00,30.00,40.00,1,3,1"));
    let info = std::fs::read_to_string(out.join("a_front/seqinfo.ini")).unwrap();
    assert!(
        info.contains("frameRate=10.00\nseqLength=4\nimWidth=64\n"),
        "{info}"
    );
    let names = std::fs::read_to_string(out.join("a_front/classes.txt")).unwrap();
    // MOTChallenge has 13 classes, and no truck among them.
    assert_eq!(names, "14 truck\n");
    assert_eq!(
        std::fs::read(out.join("a_front/img1/000004.jpg")).unwrap(),
        picture()
    );
}

/// A recording of two drives with a pause between them, and of both again, at 8 frames per second: their times jump
/// three times.
fn recorded_in_a_loop(path: &Path) {
    let drives = [0, 125, 250, 375, 500_000, 500_125, 500_250];
    recorded_at(path, &[drives, drives].concat());
}

#[test]
fn a_drive_that_was_replayed_in_a_loop_has_its_own_rate_and_the_loop_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    recorded_in_a_loop(&path);
    let out = folder.path().join("out");
    let files = recordings(&path).unwrap();
    let done = export(
        &files,
        &out,
        ExportFormat::Mot,
        ExportedFrames::Shown,
        |_| {},
    )
    .unwrap();
    let info = std::fs::read_to_string(out.join("a_front/seqinfo.ini")).unwrap();
    assert!(info.contains("frameRate=8.00\nseqLength=14\n"), "{info}");
    let [note] = &*done.notes else {
        panic!("{:?}", done.notes);
    };
    assert!(
        note.starts_with("a_front: its frames are no single drive: their times jump 3 times"),
        "{note}"
    );
}

#[test]
fn footage_of_a_drive_that_was_replayed_in_a_loop_has_the_drives_rate() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    recorded_in_a_loop(&path);
    let name: SourceName = format!("{}:/front/image", path.display()).parse().unwrap();
    let no_given_rate = None;
    let footage = name.open(no_given_rate, VideoEncoding::Jpeg).unwrap();
    assert_eq!(footage.rate(), 8.0);
}

#[test]
fn a_folder_without_recordings_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = recordings(folder.path()).unwrap_err().to_string();
    assert!(error.contains("no MCAP file"), "{error}");
}

#[test]
fn without_audited_frames_the_error_says_how_to_record_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    RecordingFile::create(&path).unwrap().finish().unwrap();
    let files = recordings(&path).unwrap();
    let out = folder.path().join("out");
    let audit = ExportedFrames::Audit;
    let error = export(&files, &out, ExportFormat::Mot, audit, |_| {}).unwrap_err();
    assert!(error.to_string().contains("when = [\"audit\"]"), "{error}");
}

#[test]
fn the_pictures_of_a_recording_that_ends_early_are_exported_and_it_is_noted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    recorded(&path);
    // Without its end, as while it is being written.
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 30]).unwrap();
    let files = recordings(&path).unwrap();
    let out = folder.path().join("out");
    let audit = ExportedFrames::Audit;
    let done = export(&files, &out, ExportFormat::Coco, audit, |_| {}).unwrap();
    assert_eq!(done.pictures, 2);
    assert!(done.left_out.is_empty(), "{:?}", done.left_out);
    let [note] = &*done.notes else {
        panic!("{:?}", done.notes);
    };
    assert!(note.contains("a.mcap ends early"), "{note}");
    assert!(note.contains("the 2 frames"), "{note}");
}

#[test]
fn a_file_that_is_no_recording_is_not_counted_as_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, "This is a letter. ".repeat(10)).unwrap();
    let files = recordings(&path).unwrap();
    let out = folder.path().join("out");
    let audit = ExportedFrames::Audit;
    let error = export(&files, &out, ExportFormat::Coco, audit, |_| {}).unwrap_err().to_string();
    assert!(error.contains("a.mcap is no MCAP file"), "{error}");
    assert!(!error.contains("was read"), "{error}");
}

#[test]
fn a_box_that_was_shown_without_an_object_keeps_its_class() {
    let folder = tempfile::tempdir().unwrap();
    let frame = LabelledFrame {
        camera: "front".to_owned(),
        t_ns: 1_700_000_000_000_000_000,
        seq: 0,
        size: [64, 48],
        picture: picture(),
        boxes: vec![one("car", UNTRACKED)],
    };
    let shown = ExportedFrames::Shown;
    let mut sequence = Sequence::new(Path::new("a.mcap"), &frame, shown, folder.path());
    sequence.add(&frame).unwrap();
    sequence.finish().unwrap();
    let read = data::mot_challenge::read(folder.path()).unwrap();
    let boxes: Vec<_> = read.clips[0].truth.iter().flatten().flatten().collect();
    let [car] = boxes.as_slice() else {
        panic!("{boxes:?}");
    };
    assert_eq!(Ok(car.class), Evaluated::Road.find("car"));
    assert_eq!(car.object, UNTRACKED);
}
