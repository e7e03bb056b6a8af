//! `albireo eval` as a user runs it: its output, its files, and its errors for bad input.
#![allow(clippy::expect_used, clippy::panic)]

use albireo_core::policy::FrameState;
use albireo_eval::trace;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// A recording of three clips: a car that drives through, the same without ground truth, and nothing.
fn recording() -> TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let index = r#"{"sequences": [
        {"name": "drive", "width": 640, "height": 480, "fps": 10, "frames": 40, "camera": "moving"},
        {"name": "unlabelled", "width": 640, "height": 480, "fps": 10, "frames": 40},
        {"name": "nothing", "width": 640, "height": 480, "fps": 10, "frames": 5}]}"#;
    write(folder.path(), "sequences.json", index);
    let mut detections = "frame,x1,y1,x2,y2,score,class\n".to_owned();
    let mut truth = "frame,x1,y1,x2,y2,class,object_id\n".to_owned();
    for frame in 0..40 {
        let x = 20 + 10 * frame;
        let (right, wobble) = (x + 80, frame % 3);
        if frame % 9 != 4 {
            let row = format!("{frame},{},200.5,{right},260,0.9,2\n", x + wobble);
            detections.push_str(&row);
        }
        truth.push_str(&format!("{frame},{x},200,{right},260,2,1\n"));
    }
    write(folder.path(), "detections/drive.csv", &detections);
    write(folder.path(), "detections/unlabelled.csv", &detections);
    write(
        folder.path(),
        "detections/nothing.csv",
        "frame,x1,y1,x2,y2,score,class\n",
    );
    write(folder.path(), "groundtruth/drive.csv", &truth);
    folder
}

fn write(folder: &Path, name: &str, content: &str) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().expect("it has a folder")).expect("made");
    std::fs::write(path, content).expect("written");
}

fn eval(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_albireo"))
        .arg("eval")
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the program runs")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

fn printed(output: &Output) -> (String, String) {
    (
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[test]
fn one_command_compares_sweeps_traces_and_reports() {
    let folder = recording();
    let (traces, out) = (folder.path().join("traces"), folder.path().join("out"));
    let output = eval(&[
        "recorded",
        text(folder.path()),
        "--profile",
        "reference",
        "--policy",
        "albireo",
        "--policy",
        "fixed-skip:2",
        "--u",
        "3e-4",
        "--sweep",
        "u=3e-4,1e-3",
        "--screen",
        "detections",
        "--confidence",
        "0.5",
        "--energy-model",
        "config/energy/agx-thor.toml",
        "--traces",
        text(&traces),
        "--out",
        text(&out),
    ]);
    let (table, said) = printed(&output);
    assert!(output.status.success(), "{said}");
    assert!(
        table.lines().all(|line| line.chars().count() <= 100),
        "{table}"
    );
    for label in ["vanilla", "albireo-u3e-4", "albireo-u1e-3", "fixedskip-2"] {
        assert!(table.contains(label), "{label} in\n{table}");
    }
    assert!(table.contains("p: projected"), "{table}");
    assert!(said.contains("unlabelled: no ground truth"), "{said}");
    assert!(said.contains("nothing: not one detection"), "{said}");

    let path = traces.join("albireo-u3e-4-erd-detections/drive.jsonl.gz");
    let frames = trace::read(&path).expect("the trace is there");
    assert_eq!(frames.len(), 40);
    assert_eq!(frames[0].state, FrameState::EI);
    assert_eq!(frames[0].objects.len(), 1);
    let empty = trace::read(&traces.join("albireo-u3e-4-erd-detections/nothing.jsonl.gz"));
    let empty = empty.expect("the trace is there");
    assert!(empty.iter().all(|frame| frame.state == FrameState::E));

    let mut reader = csv::Reader::from_path(out.join("summary.csv")).expect("it is there");
    assert_eq!(reader.records().count(), 4 * 3);
    let report = std::fs::read(out.join("report.json")).expect("it is there");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("it is JSON");
    assert!(report["policies"][1]["projected_energy"]["joules"].is_number());
    for name in [
        "ap50-against-skip-rate",
        "frame-states",
        "clips-ap50-change-against-skip-rate",
    ] {
        let svg = std::fs::read_to_string(out.join(format!("{name}.svg"))).expect("a figure");
        assert!(
            svg.starts_with("<svg"),
            "{name}: {}",
            &svg[..80.min(svg.len())]
        );
    }
    let page = std::fs::read_to_string(out.join("report.html")).expect("the page");
    assert_eq!(page.matches("<figure class=\"plot\"").count(), 3);
    // The conclusion first, then figures, then tables.
    let places = [
        "class=\"conclusion\"",
        "class=\"plot\"",
        "<h2>Policies</h2>",
    ]
    .map(|part| page.find(part).unwrap_or_else(|| panic!("{part}")));
    assert!(places.is_sorted(), "{places:?}");
    assert!(page.contains("<th>Δ pp</th>"));
    // One clip has ground truth: it has no interval.
    assert!(
        !page.contains("<th>95 % pp</th>"),
        "a column that says nothing"
    );
    assert!(page.contains("p: projected"));
    for outside in ["src=", "<link", "@import", "url("] {
        assert!(
            !page.contains(outside),
            "the page loads something: {outside}"
        );
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let folder = recording();
    let run = |threads: &str| {
        let output = eval(&[
            "recorded",
            text(folder.path()),
            "--policy",
            "all",
            "--threads",
            threads,
        ]);
        let (table, said) = printed(&output);
        assert!(output.status.success(), "{said}");
        table
    };
    assert_eq!(run("1"), run("4"));
}

#[test]
fn the_reports_names_are_safe_in_its_page() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write(
        folder.path(),
        "sequences.json",
        r#"{"sequences": [{"name": "<b>&", "width": 64, "height": 48, "frames": 2}]}"#,
    );
    write(
        folder.path(),
        "detections/<b>&.csv",
        "frame,x1,y1,x2,y2,score,class\n0,1,1,9,9,0.9,2\n",
    );
    let out = folder.path().join("out");
    let output = eval(&["recorded", text(folder.path()), "--out", text(&out)]);
    assert!(output.status.success(), "{}", printed(&output).1);
    let page = std::fs::read_to_string(out.join("report.html")).expect("the page");
    assert!(page.contains("&lt;b&gt;&amp;"));
    assert!(!page.contains("<b>&"));
}

#[test]
fn bad_input_ends_with_what_was_wrong_where_and_what_to_do() {
    let folder = recording();
    let good = text(folder.path());
    let broken = recording();
    write(
        broken.path(),
        "detections/drive.csv",
        "frame,x1,y1,x2,y2,score,class\n0,1,1,9,9,0.9,2\n0,1,1,9,zwei,0.9,2\n",
    );
    let lost = recording();
    std::fs::remove_file(lost.path().join("detections/drive.csv")).expect("removed");
    for (arguments, parts) in [
        (
            vec!["recorded", "/nowhere"],
            vec!["/nowhere/sequences.json", "sequences.json that lists"],
        ),
        (
            vec!["recorded", text(broken.path())],
            vec!["detections/drive.csv:3:", "`y2` is `zwei`"],
        ),
        (
            vec!["recorded", text(lost.path())],
            vec!["detections/drive.csv", "needs its detections"],
        ),
        (
            vec!["recorded", good, "--policy", "albiro"],
            vec!["no policy `albiro`", "did you mean `albireo`?"],
        ),
        (
            vec!["recorded", good, "--policy", "nobody"],
            vec!["no policy `nobody`", "`vanilla`"],
        ),
        (
            vec!["recorded", good, "--policy", "statues"],
            vec!["statues-75", "looks at pixels"],
        ),
        (
            vec!["recorded", good, "--u", "-1"],
            vec!["must be a number from"],
        ),
        (
            vec!["recorded", good, "--out", "/dev/null/results"],
            vec!["cannot write to /dev/null/results"],
        ),
        (
            vec!["recorded", good, "--confidence", "1.5"],
            vec!["--confidence 1.5"],
        ),
        (
            vec!["recorded", good, "--policy", "vanilla", "--sweep", "u=1e-3"],
            vec!["no policy of this run has a setting `u`"],
        ),
        (
            vec!["recorded", good, "--energy-model", "/nowhere.toml"],
            vec!["cannot read /nowhere.toml"],
        ),
    ] {
        let output = eval(&arguments);
        let (table, said) = printed(&output);
        assert!(!output.status.success(), "{arguments:?} printed {table}");
        assert!(table.is_empty(), "{arguments:?} printed {table}");
        for part in parts {
            assert_eq!(said.matches(part).count(), 1, "{arguments:?} said {said}");
        }
    }
}

#[test]
fn meaningless_rows_are_counted_and_reported() {
    let folder = recording();
    let path = folder.path().join("detections/drive.csv");
    let mut rows = std::fs::read_to_string(&path).expect("it is there");
    rows.push_str("39,1,1,9,9,NaN,2\n39,9,1,1,9,0.9,2\n39,900,1,990,9,0.9,2\n");
    std::fs::write(&path, rows).expect("written");
    let output = eval(&["recorded", text(folder.path())]);
    let (_, said) = printed(&output);
    assert!(output.status.success(), "{said}");
    for part in [
        "left out 1: coordinate or score not a finite number",
        "left out 1: box inverted or without area",
        "left out 1: box wholly outside the picture",
        "detections/drive.csv:38",
    ] {
        assert!(said.contains(part), "{part} in\n{said}");
    }
}
