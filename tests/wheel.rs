//! The Python package: it decides as the core does, its own tests pass, and the README's example runs where nothing else
//! is installed.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::golden_traces::replay::{Recorded, Screen, decide_frame, reference};
use crate::golden_traces::shared_data::sequences;
use crate::support::{assert_says, project, run_command, text};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{BoxSource, FrameState, Outcome};
use rstest::rstest;
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;
use std::process::Command;

/// The Python that the wheel is installed in, as `make wheel-tests` sets it up.
pub(crate) fn python() -> PathBuf {
    project(".cache/wheel/bin/python")
}

/// Runs a command and returns what it printed.
#[track_caller]
fn run(command: &mut Command) -> String {
    let ended = run_command(command);
    println!("{}\n{}", ended.out, ended.err);
    assert_eq!(ended.code, Some(0), "{command:?}");
    ended.out + &ended.err
}

/// That it keeps the promises of its loop, gives back the type of results that it is given, and answers or refuses whatever it
/// is given.
#[rstest]
#[ignore = "needs the wheel"]
fn the_package_keeps_its_own_tests(
    #[values("test_skipper", "test_results", "test_hostile")] module: &str,
) {
    let mut tests = Command::new(python());
    let tests = tests.args(["-m", "unittest", module]);
    let said = run(tests.current_dir(project("crates/python/tests")));
    assert_says(&said, &["\nOK\n"]);
    assert!(!said.contains("Ran 0 tests"), "{said}");
}

#[test]
#[ignore = "needs the wheel"]
fn the_types_of_the_wheel_are_what_its_stubs_say() {
    let folder = tempfile::tempdir().unwrap();
    let checks = [
        "mypy.stubtest albireo._core",
        "mypy --strict --package=albireo",
    ];
    for check in checks {
        let mut mypy = Command::new(python());
        run(mypy
            .arg("-m")
            .args(check.split(' '))
            .current_dir(folder.path()));
    }
}

/// Numbers of 64 bits, as `golden.py` writes them.
fn push(numbers: &mut Vec<u8>, more: &[f64]) {
    numbers.extend(more.iter().flat_map(|number| number.to_ne_bytes()));
}

/// What the core decides on a recording, in the layout of `golden.py`.
fn decided(
    asked: &str,
    screen: Screen,
    picture: PictureSize,
    frames: u64,
    recorded: &Recorded,
) -> Vec<u8> {
    let mut policy = reference(asked);
    let mut outcome = Outcome::default();
    let mut numbers = Vec::new();
    for index in 0..frames {
        let found = recorded.get(&index).map_or(&[][..], Vec::as_slice);
        decide_frame(&mut *policy, index, screen, picture, found, &mut outcome);
        let state = FrameState::ALL
            .iter()
            .position(|state| *state == outcome.state);
        let counts =
            [state.unwrap(), outcome.active, outcome.boxes.len()].map(|count| count as f64);
        let tau = outcome.tau_max.unwrap_or(-1.0);
        push(&mut numbers, &[counts[0], tau, counts[1], counts[2]]);
        for shown in &outcome.boxes {
            let corners = shown.bounding_box.pixel_corners(picture);
            let source = match shown.source {
                BoxSource::Detected => 0.0,
                BoxSource::Predicted => 1.0,
                BoxSource::Followed => 2.0,
                BoxSource::Rescued => 3.0,
            };
            push(
                &mut numbers,
                &[
                    corners.x1,
                    corners.y1,
                    corners.x2,
                    corners.y2,
                    shown.confidence,
                ],
            );
            let object = shown.object.map_or(-1.0, |id| id.0 as f64);
            push(&mut numbers, &[f64::from(shown.class.0), object, source]);
        }
        let mut objects = Vec::new();
        policy.objects(&mut |object| objects.push(*object));
        push(&mut numbers, &[objects.len() as f64]);
        for object in objects {
            let b = object.bounding_box;
            let confirmed = f64::from(u8::from(object.confirmed));
            push(
                &mut numbers,
                &[object.id.0 as f64, object.class.0.into(), confirmed],
            );
            push(
                &mut numbers,
                &[
                    object.confidence,
                    b.center_x,
                    b.center_y,
                    b.width,
                    b.height,
                    object.tau,
                ],
            );
            let counters = [
                object.hits,
                object.since_update,
                object.since_infer,
                object.misses,
            ];
            push(&mut numbers, &counters.map(f64::from));
        }
    }
    numbers
}

#[test]
#[ignore = "needs ../shared and the wheel"]
fn shared_golden_traces_are_equal_through_the_wheel_to_the_last_bit() {
    let policies = [
        ("albireo", 3e-4, Screen::NeverEmpty),
        ("albireo", 3e-4, Screen::EmptyWithoutDetections),
        ("albireo", 1e-3, Screen::NeverEmpty),
        ("fixed-skip", 2.0, Screen::NeverEmpty),
        ("ctd", 0.5, Screen::NeverEmpty),
        ("expected-loss", 0.3, Screen::NeverEmpty),
    ];
    let folder = tempfile::tempdir().unwrap();
    let mut jobs = String::new();
    let mut expected = Vec::new();
    for sequence in sequences() {
        let (picture, corners) = (sequence.picture(), sequence.corners());
        let recorded = sequence.detections();
        let frames: Vec<_> = (0..sequence.frames)
            .map(|frame| corners.get(&frame).map_or(&[][..], Vec::as_slice))
            .collect();
        for (number, (policy, threshold, screen)) in policies.into_iter().enumerate() {
            let name = format!("{}-{number}", sequence.name);
            let job = json!({
                "name": name, "policy": policy, "threshold": threshold, "frames": frames,
                "size": [picture.width, picture.height],
                "empty_without_detections": matches!(screen, Screen::EmptyWithoutDetections),
            });
            writeln!(jobs, "{job}").unwrap();
            let asked = format!("{policy}:{threshold}");
            let decided = decided(&asked, screen, picture, sequence.frames, &recorded);
            expected.push((name, decided));
        }
    }
    let list = folder.path().join("jobs.jsonl");
    std::fs::write(&list, jobs).unwrap();
    run(Command::new(python())
        .arg(project("crates/python/tests/golden.py"))
        .args([&list, folder.path()]));
    for (name, expected) in expected {
        let found = std::fs::read(folder.path().join(&name)).unwrap();
        assert!(!found.is_empty() && found == expected, "{name}");
    }
}

/// The wheels and the source distribution that were built.
fn built() -> Vec<PathBuf> {
    std::fs::read_dir(project("target/wheels"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_file())
        .collect()
}

#[test]
#[ignore = "needs the wheel"]
fn the_wheel_is_small_and_depends_on_numpy_alone() {
    let wheels: Vec<_> = (built().into_iter())
        .filter(|path| path.extension().is_some_and(|kind| kind == "whl"))
        .collect();
    let [wheel] = &wheels[..] else {
        panic!("one wheel for this machine: {wheels:?}");
    };
    assert!(wheel.metadata().unwrap().len() <= 3_000_000);
    let requires = "import importlib.metadata as m; print(m.requires('albireo'))";
    let said = run(Command::new(python()).args(["-c", requires]));
    assert_eq!(said.trim(), "['numpy>=1.23']");
    let is_source = |path: &PathBuf| path.extension().is_some_and(|kind| kind == "gz");
    assert!(built().iter().any(is_source));
}

#[test]
#[ignore = "needs the wheel"]
fn the_python_example_of_the_readme_runs_in_a_fresh_environment() {
    let page = text("README.md");
    let (_, rest) = page.split_once("```python\n").unwrap();
    let (example, _) = rest.split_once("```").unwrap();
    let folder = tempfile::tempdir().unwrap();
    for name in ["docs", "models"] {
        std::os::unix::fs::symlink(project(name), folder.path().join(name)).unwrap();
    }
    let mut tar = Command::new("tar");
    run(tar
        .arg("-xf")
        .arg(project("demo/road.tar"))
        .current_dir(&folder));
    let mut venv = Command::new(python());
    run(venv.args(["-m", "venv"]).arg(folder.path().join("venv")));
    let fresh = folder.path().join("venv/bin/python");
    // From files that were fetched before: the wheel, and what the example wants beside it.
    let mut install = Command::new(&fresh);
    install.args(["-m", "pip", "install", "--quiet", "--no-index"]);
    install.arg("--disable-pip-version-check");
    for files in ["target/wheels", ".cache/wheel/files"] {
        install.arg("--find-links").arg(project(files));
    }
    run(install.args(["albireo", "onnxruntime", "pillow"]));
    let mut command = Command::new(fresh);
    let said = run(command.args(["-c", example]).current_dir(&folder));
    let skipped = said.split_once("of 88 frames skipped").unwrap().0;
    let skipped: u32 = skipped.split_whitespace().last().unwrap().parse().unwrap();
    assert!((20..70).contains(&skipped), "{said}");
}
