//! The Python package decides as the core does, passes its own tests, and runs the README's example.

use crate::documentation::workshop;
use crate::golden_traces::RUNS;
use crate::golden_traces::replay::{Screen, decide_frame, policy};
use crate::golden_traces::shared_data::{detections, given, sequences};
use crate::support::{assert_contains, project, run_command, text};
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{BoxSource, FrameState, Outcome, Profile};
use albireo_eval::boxes::ScoredBox;
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;
use std::process::Command;

/// The Python with the wheel, set up by `make wheel-tests`.
pub(crate) fn python() -> PathBuf {
    project(".cache/wheel/bin/python")
}

/// The promises of its loop, results of the type it is given, an answer or an error for any input, and the examples of its
/// README with the packages that they are for.
#[rstest::rstest]
#[ignore = "needs the wheel"]
fn the_package_passes_its_own_tests(
    #[values("test_skipper", "test_results", "test_hostile", "test_packages")] module: &str,
) {
    let mut tests = Command::new(python());
    let tests = tests.args(["-m", "unittest", module]);
    let said = run_command(tests.current_dir(project("crates/python/tests"))).err;
    assert_contains(&said, &["\nOK\n"]);
    assert!(!said.contains("Ran 0 tests"), "{said}");
}

#[test]
#[ignore = "needs the wheel"]
fn the_types_of_the_wheel_match_its_stubs() {
    let folder = tempfile::tempdir().unwrap();
    let calls = project("crates/python/tests/typed.py");
    let calls = format!("-m mypy --strict {}", calls.display());
    for check in [
        "-m mypy.stubtest albireo._core",
        "-m mypy --strict --package=albireo",
        calls.as_str(),
    ] {
        let mut mypy = Command::new(python());
        run_command(mypy.args(check.split(' ')).current_dir(folder.path())).succeeds();
    }
}

/// The core's decisions on a recording: 64-bit numbers in the layout of `golden.py`.
fn decided(
    asked: &str,
    screen: Screen,
    picture: PictureSize,
    recorded: &[Vec<Detection>],
) -> Vec<u8> {
    let mut policy = policy(asked, Profile::Reference);
    let mut outcome = Outcome::default();
    let mut numbers = Vec::new();
    for (index, found) in (0..).zip(recorded) {
        decide_frame(&mut *policy, index, screen, picture, found, &mut outcome);
        let state = FrameState::ALL.iter().position(|state| *state == outcome.state).unwrap();
        let tau = outcome.tau_max.unwrap_or(-1.0);
        numbers.extend([state as f64, tau]);
        numbers.extend([outcome.active as f64, outcome.boxes.len() as f64]);
        for shown in &outcome.boxes {
            let corners = shown.bounding_box.pixel_corners(picture);
            let source = match shown.source {
                BoxSource::Detected => 0.0,
                BoxSource::Predicted => 1.0,
                BoxSource::Followed => 2.0,
                BoxSource::Rescued => 3.0,
            };
            let object = shown.object.map_or(-1.0, |id| id.0 as f64);
            numbers.extend([corners.x1, corners.y1, corners.x2, corners.y2]);
            numbers.extend([shown.confidence, shown.class.0.into(), object, source]);
        }
        let mut objects = Vec::new();
        policy.objects(&mut |object| objects.push(*object));
        numbers.push(objects.len() as f64);
        for object in objects {
            let confirmed = f64::from(u8::from(object.confirmed));
            numbers.extend([object.id.0 as f64, object.class.0.into(), confirmed]);
            numbers.push(object.confidence);
            numbers.extend(<[f64; 4]>::from(object.bounding_box));
            numbers.push(object.tau);
            let since = [object.since_update, object.since_infer];
            numbers.extend([object.hits, since[0], since[1], object.misses].map(f64::from));
        }
    }
    numbers.into_iter().flat_map(f64::to_ne_bytes).collect()
}

#[test]
#[ignore = "needs ../shared and the wheel"]
fn shared_golden_traces_are_equal_through_the_wheel_to_the_last_bit() {
    let expected_loss = ("", "expected-loss:0.3", Screen::NeverEmpty);
    let runs = RUNS.into_iter().chain([expected_loss]);
    let folder = tempfile::tempdir().unwrap();
    let mut jobs = String::new();
    let mut expected = Vec::new();
    for sequence in sequences() {
        let picture = sequence.picture;
        let recorded = detections(&sequence);
        let corners = |found: &ScoredBox| {
            let (c, class) = (found.corners, found.class.0.into());
            [c.x1, c.y1, c.x2, c.y2, found.confidence, class]
        };
        let frame = |found: &Vec<ScoredBox>| found.iter().map(corners).collect();
        let frames: Vec<Vec<[f64; 6]>> = given(&sequence).iter().map(frame).collect();
        for (number, (_, asked, screen)) in runs.clone().enumerate() {
            let name = format!("{}-{number}", sequence.name);
            let (policy, threshold) = asked.split_once(':').unwrap();
            let threshold: f64 = threshold.parse().unwrap();
            let job = json!({
                "name": name, "policy": policy, "threshold": threshold, "frames": frames,
                "size": [picture.width, picture.height],
                "empty_without_detections": matches!(screen, Screen::EmptyWithoutDetections),
            });
            writeln!(jobs, "{job}").unwrap();
            expected.push((name, decided(asked, screen, picture, &recorded)));
        }
    }
    let list = folder.path().join("jobs.jsonl");
    std::fs::write(&list, jobs).unwrap();
    let mut golden = Command::new(python());
    golden.arg(project("crates/python/tests/golden.py"));
    run_command(golden.args([&list, folder.path()])).succeeds();
    for (name, expected) in expected {
        let found = std::fs::read(folder.path().join(&name)).unwrap();
        assert!(!found.is_empty() && found == expected, "{name}");
    }
}

#[test]
#[ignore = "needs the wheel"]
fn the_wheel_is_small_and_depends_on_numpy_alone() {
    let built: Vec<_> = std::fs::read_dir(project("target/wheels"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    let is_of = |path: &PathBuf, kind: &str| path.extension().is_some_and(|own| own == kind);
    let wheels: Vec<_> = built.iter().filter(|path| is_of(path, "whl")).collect();
    assert_eq!(wheels.len(), 1, "one wheel for this machine: {built:?}");
    // The stable interface: one wheel for every Python since 3.10.
    let name = wheels[0].display().to_string();
    assert_contains(&name, &["-cp310-abi3-manylinux"]);
    assert!(wheels[0].metadata().unwrap().len() <= 3_000_000);
    let sources = built.iter().any(|path| is_of(path, "gz"));
    assert!(sources, "no source distribution");
    let requires = "import importlib.metadata as m; print(m.requires('albireo'))";
    let said = run_command(Command::new(python()).args(["-c", requires])).succeeds();
    assert_eq!(said.trim(), "['numpy>=1.23']");
}

#[test]
#[ignore = "needs the wheel"]
fn the_python_example_of_the_readme_runs_in_a_fresh_environment() {
    let page = text("README.md");
    let (_, rest) = page.split_once("```python\n").unwrap();
    let (example, _) = rest.split_once("```").unwrap();
    let folder = workshop();
    let mut tar = Command::new("tar");
    tar.args(["-xf", "demo/road.tar"]);
    run_command(tar.current_dir(&folder)).succeeds();
    let mut venv = Command::new(python());
    run_command(venv.args(["-m", "venv"]).arg(folder.path().join("venv"))).succeeds();
    let fresh = folder.path().join("venv/bin/python");
    // From local files: the wheel, and the other packages of the example.
    let mut install = Command::new(&fresh);
    install.args(["-m", "pip", "install", "--quiet", "--no-index"]);
    install.arg("--disable-pip-version-check");
    for files in ["target/wheels", ".cache/wheel/files"] {
        install.arg("--find-links").arg(project(files));
    }
    run_command(install.args(["albireo", "onnxruntime", "pillow"])).succeeds();
    let mut command = Command::new(fresh);
    let said = run_command(command.args(["-c", example]).current_dir(&folder)).succeeds();
    let skipped = said.split_once("of 221 frames skipped").unwrap().0;
    let skipped: u32 = skipped.split_whitespace().last().unwrap().parse().unwrap();
    assert!((100..170).contains(&skipped), "{said}");
}
