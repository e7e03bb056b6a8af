//! `albireo eval` end to end: its output, its files, its errors for bad input, and the shipped energy models.

use crate::support::{Ended, assert_contains, project, run};
use albireo_core::policy::FrameState;
use albireo_eval::energy_model::EnergyModel;
use albireo_eval::replay::trace;
use std::path::Path;
use tempfile::TempDir;

const DETECTIONS: &str = "frame,x1,y1,x2,y2,score,class\n";

/// Three recorded clips: a car that drives through, the same without ground truth, and nothing, named like markup.
fn recording() -> TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let index = r#"{"sequences": [
        {"name": "drive", "width": 640, "height": 480, "fps": 10, "frames": 40, "camera": "moving"},
        {"name": "unlabelled", "width": 640, "height": 480, "fps": 10, "frames": 40},
        {"name": "<b>&", "width": 640, "height": 480, "fps": 10, "frames": 5}]}"#;
    write(folder.path(), "sequences.json", index);
    let mut detections = DETECTIONS.to_owned();
    let mut truth = "frame,x1,y1,x2,y2,class,object_id\n".to_owned();
    for frame in 0..40 {
        let x = 20 + 10 * frame;
        let right = x + 80;
        let wobble = frame % 3;
        if frame % 9 != 4 {
            detections.push_str(&format!("{frame},{},200.5,{right},260,0.9,2\n", x + wobble));
        }
        truth.push_str(&format!("{frame},{x},200,{right},260,2,1\n"));
    }
    write(folder.path(), "detections/drive.csv", &detections);
    write(folder.path(), "detections/unlabelled.csv", &detections);
    write(folder.path(), "detections/<b>&.csv", DETECTIONS);
    write(folder.path(), "groundtruth/drive.csv", &truth);
    folder
}

fn write(folder: &Path, name: &str, content: &str) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().expect("it has a folder")).expect("made");
    std::fs::write(path, content).expect("written");
}

pub(crate) fn eval(command: &str) -> Ended {
    let words: Vec<_> = command.split_whitespace().collect();
    run(&[&["eval"], &words[..]].concat(), &[])
}

#[test]
fn one_command_compares_sweeps_traces_and_reports_with_names_escaped() {
    let folder = recording();
    let traces = folder.path().join("traces");
    let out = folder.path().join("out");
    let ended = eval(&format!(
        "recorded {} --profile reference --policy albireo --policy fixed-skip:2 --u 3e-4 --sweep u=3e-4,1e-3 \
         --screen detections --confidence 0.5 --energy-model config/energy/agx-thor.toml --traces {} --out {}",
        folder.path().display(),
        traces.display(),
        out.display()
    ));
    let lacks = "<b>&: the whole clip has no detections";
    assert_contains(&ended.err, &["unlabelled: no ground truth", lacks]);
    let table = ended.succeeds();
    assert!(
        table.lines().all(|line| line.chars().count() <= 100),
        "{table}"
    );
    let labels = "vanilla albireo-u3e-4 albireo-u1e-3 fixed-skip-2";
    assert_contains(&table, &labels.split(' ').collect::<Vec<_>>());
    assert_contains(&table, &["p: projected"]);

    let path = traces.join("albireo-u3e-4-erd-detections/drive.jsonl.gz");
    let frames = trace::read(&path).expect("the trace is there");
    assert_eq!(frames.len(), 40);
    assert_eq!(frames[0].state, FrameState::EI);
    assert_eq!(frames[0].objects.len(), 1);
    let empty = trace::read(&traces.join("albireo-u3e-4-erd-detections/<b>&.jsonl.gz"))
        .expect("the trace is there");
    assert!(empty.iter().all(|frame| frame.state == FrameState::E));

    let mut reader = csv::Reader::from_path(out.join("summary.csv")).expect("it is there");
    assert_eq!(reader.records().count(), 4 * 3);
    let report = std::fs::read(out.join("report.json")).expect("it is there");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("it is JSON");
    assert!(report["policies"][1]["projected_energy"]["joules"].is_number());
    let figures = "ap50-against-skip-rate frame-states clips-ap50-change-against-skip-rate";
    for name in figures.split(' ') {
        let svg = std::fs::read_to_string(out.join(format!("{name}.svg"))).expect("a figure");
        assert!(svg.starts_with("<svg"), "{name}");
    }
    let page = std::fs::read_to_string(out.join("report.html")).expect("the page");
    assert_eq!(page.matches("<figure class=\"plot\"").count(), 3);
    // The conclusion precedes figures and tables.
    let places = ["class=\"conclusion\"", "class=\"plot\"", "<table"].map(|part| page.find(part));
    assert!(places[0].is_some() && places.is_sorted(), "{places:?}");
    assert_contains(&page, &["p: projected", "&lt;b&gt;&amp;"]);
    assert!(!page.contains("<b>&"), "names are escaped");
    for outside in ["src=", "<link", "@import", "url("] {
        let is_loaded = page.contains(outside);
        assert!(!is_loaded, "the page loads something: {outside}");
    }
}

#[test]
fn results_are_kept_although_nobody_reads_the_table() {
    let folder = recording();
    let out = folder.path().join("out");
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let ended = std::process::Command::new(env!("CARGO_BIN_EXE_albireo"))
        .args(["eval", "recorded"])
        .args([folder.path(), Path::new("--out"), &out])
        .stdout(writer)
        .status()
        .expect("it runs");
    assert_eq!(ended.code(), Some(141));
    assert!(out.join("report.html").exists());
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let folder = recording();
    let all = format!("recorded {} --policy all", folder.path().display());
    let [one, four] = [1, 4].map(|threads| eval(&format!("{all} --threads {threads}")).succeeds());
    assert_eq!(one, four);
}

/// FOLDER stands for a valid recording.
#[rstest::rstest]
#[case("recorded /nowhere", &["/nowhere/sequences.json", "sequences.json that lists"])]
#[case("recorded FOLDER --policy albiro", &["no policy `albiro`", "did you mean `albireo`?"])]
#[case("recorded FOLDER --policy nobody", &["no policy `nobody`", "`vanilla`"])]
#[case("recorded FOLDER --policy statues", &["statues-75", "looks at pixels"])]
#[case("recorded FOLDER --u -1", &["must be a number from"])]
#[case("recorded FOLDER --out /dev/null/results", &["cannot write to /dev/null/results"])]
#[case("recorded FOLDER --confidence 1.5", &["--confidence 1.5"])]
#[case("recorded FOLDER --policy vanilla --sweep u=1e-3", &["no policy of this run has a setting `u`"])]
#[case("recorded FOLDER --energy-model /nowhere.toml", &["cannot read /nowhere.toml"])]
fn bad_input_is_reported_with_its_place_cause_and_remedy(
    #[case] command: &str,
    #[case] parts: &[&str],
) {
    let folder = recording();
    let ended = eval(&command.replace("FOLDER", folder.path().to_str().unwrap()));
    assert_ne!(ended.code, Some(0));
    assert_eq!(ended.out, "");
    for part in parts {
        let count = ended.err.matches(part).count();
        assert_eq!(count, 1, "{part} in {}", ended.err);
    }
}

#[test]
fn every_shipped_energy_model_states_its_source_and_its_error() {
    let mut boards = Vec::new();
    for file in std::fs::read_dir(project("config/energy")).expect("the shipped models") {
        let path = file.expect("a file").path();
        let model = EnergyModel::load(&path).expect("a model that can be used");
        assert!(model.source.contains("commit "), "{model:?}");
        let missed = model.left_out.expect("it was tested on clips left out");
        assert!(missed.energy_percent > 0.0 && missed.energy_percent < 10.0);
        assert!((missed.saving_measured_percent - missed.saving_projected_percent).abs() < 2.0);
        // A frame without the detector costs less than one with it.
        assert!(model.energy_j.predicted < model.energy_j.detector / 2.0);
        assert!(model.energy_j.screen < model.energy_j.detector / 2.0);
        boards.push(model.board);
    }
    boards.sort();
    assert_eq!(boards, ["NVIDIA Jetson AGX Orin", "NVIDIA Jetson AGX Thor"]);
}

/// AP@50 of Vanilla, published and of all boxes, as `albireo eval` reports it.
fn ap50(folder: &Path, command: &str) -> f64 {
    let out = folder.join("out");
    let command = format!("{command} --policy vanilla --out {}", out.display());
    eval(&command.replace("FOLDER", folder.to_str().unwrap())).succeeds();
    let report = std::fs::read(out.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    report["policies"][0]["ap50"].as_f64().unwrap()
}

#[test]
fn boxes_in_a_crowd_are_judged_by_the_rules_of_coco_or_of_the_papers_evaluator() {
    let folder = tempfile::tempdir().unwrap();
    let mut images = Vec::new();
    let mut annotations = Vec::new();
    let mut found = Vec::new();
    for image in 1..=4 {
        images.push(serde_json::json!({"id": image, "file_name": format!("{image}.jpg"), "width": 640, "height": 480}));
        for (crowd, sides) in [(0, [10, 10, 60, 40]), (1, [200, 100, 300, 200])] {
            annotations.push(
                serde_json::json!({"id": 2 * image + crowd, "image_id": image, "category_id": 3,
                "bbox": sides, "area": sides[2] * sides[3], "iscrowd": crowd}),
            );
        }
        // The crowd's boxes are the surer ones.
        for (score, sides) in [
            (0.6, [10, 10, 60, 40]),
            (0.9, [200, 100, 60, 40]),
            (0.8, [300, 150, 60, 40]),
            (0.7, [400, 200, 60, 40]),
        ] {
            found.push(serde_json::json!({"image_id": image, "category_id": 3, "bbox": sides, "score": score}));
        }
    }
    let set = serde_json::json!({"images": images, "annotations": annotations, "categories": [{"id": 3, "name": "car"}]});
    write(folder.path(), "set.json", &set.to_string());
    write(
        folder.path(),
        "found.json",
        &serde_json::json!(found).to_string(),
    );
    let command = "coco FOLDER/set.json --detections FOLDER/found.json";
    assert_eq!(ap50(folder.path(), command), 1.0);
    assert_eq!(
        ap50(folder.path(), &format!("{command} --rules paper")),
        0.25
    );
}

#[test]
fn a_box_on_a_distractor_is_judged_by_the_rules_of_motchallenge_and_the_rate_is_that_of_the_data() {
    let folder = tempfile::tempdir().unwrap();
    let info = "[Sequence]\nname=M\nframeRate=25\nseqLength=3\nimWidth=640\nimHeight=480\n";
    write(folder.path(), "seqinfo.ini", info);
    let mut truth = String::new();
    let mut found = String::new();
    for frame in 1..=3 {
        truth += &format!("{frame},1,11,11,40,80,1,1,1\n{frame},2,200,11,40,80,0,8,1\n");
        found +=
            &format!("{frame},-1,11,11,40,80,0.6,-1,-1,-1\n{frame},-1,200,11,40,80,0.9,-1,-1,-1\n");
    }
    write(folder.path(), "gt/gt.txt", &truth);
    write(folder.path(), "det/det.txt", &found);
    let command = "motchallenge FOLDER";
    assert_eq!(ap50(folder.path(), command), 1.0);
    assert_eq!(
        ap50(folder.path(), &format!("{command} --rules paper")),
        0.5
    );
    let path = folder.path().display();
    let said = eval(&format!("motchallenge {path} --rules paper")).succeeds();
    assert_contains(
        &said,
        &["as the paper's evaluator", "Frame rate: 25 frames/s"],
    );
    let said = eval(&format!("motchallenge {path} --fps 5 --settled")).succeeds();
    assert_contains(
        &said,
        &[
            "Frame rate: 5 frames/s",
            "by the rules of the data's benchmark",
        ],
    );
}
