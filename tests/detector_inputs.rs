//! A model with open height and width runs at the smallest input that holds a camera's picture, once it has found the same
//! there; where it cannot, it stays at its largest, and says why.

use super::support::detectors::{CAMERA, decoded};
use super::support::onnx::Planted;
use super::support::{assert_contains, project, python, run_command, shared};
use albireo_core::geometry::PictureSize;
use albireo_eval::footage::{FrameSource, Pictures};
use albireo_vision::detector::{
    CameraSlot, Choice, DetectorConfig, DetectorHandle, DetectorNetwork, HeadName, InputUse,
};
use albireo_vision::onnx::OnnxSession;
use albireo_vision::picture::{InputTensor, Picture};
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;

const SQUARE: PictureSize = PictureSize::new(416, 416);
/// The smallest input that holds the demonstration's pictures, which are 640x360.
const WIDE: PictureSize = PictureSize::new(416, 256);

fn config(model: PathBuf) -> DetectorConfig {
    DetectorConfig {
        model,
        ..DetectorConfig::default()
    }
}

/// The first pictures of a clip of the demonstration's road.
fn road(clip: &str, count: usize) -> Vec<Picture> {
    let road = Pictures::of_archive(&project("demo/road.tar"), 25.0).unwrap();
    let mut clip = road.into_clips().into_iter().find(|one| one.name() == clip).unwrap();
    std::iter::from_fn(|| clip.next().unwrap())
        .take(count)
        .map(|encoded| decoded(&encoded))
        .collect()
}

/// The sizes at which the pictures run, one after the other.
fn sizes(network: &mut DetectorNetwork, pictures: &[Picture]) -> Vec<PictureSize> {
    let run = |picture| {
        let prepared = network.preparation().prepare(picture).unwrap();
        network.detect(&prepared).unwrap();
        prepared.size()
    };
    pictures.iter().map(run).collect()
}

fn only_input(network: &DetectorNetwork) -> InputUse {
    let mut inputs = network.preparation().inputs();
    assert_eq!(inputs.len(), 1, "{inputs:?}");
    inputs.remove(0)
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn after_ten_pictures_that_agree_the_model_runs_at_the_smallest_input_and_finds_the_same_there() {
    let mut network = DetectorNetwork::open(&config(project("models/yolox_nano.onnx"))).unwrap();
    assert_contains(&network.description(), &["416x416", "416x256", "9 %"]);
    let pictures = road("two-near", 20);
    let sizes = sizes(&mut network, &pictures);
    assert_eq!(sizes, [[SQUARE; 10], [WIDE; 10]].concat());
    let found = only_input(&network);
    let Choice::Smallest(agreement) = &found.choice else {
        panic!("{found:?}");
    };
    assert_eq!(agreement.pictures, 10);
    assert!(
        agreement.boxes >= 20 && agreement.paired == agreement.boxes,
        "{agreement:?}"
    );
    assert_contains(
        &found,
        &["9 % of the input 416x256", "not 44 % of 416x416", "640x360"],
    );

    // What is compared is what is then found.
    let picture = &pictures[19];
    let mut at = |size| {
        let prepared = match size {
            WIDE => network.preparation().prepare(picture).unwrap(),
            _ => DetectorNetwork::open(&config(project("models/yolox_nano.onnx")))
                .unwrap()
                .preparation()
                .prepare(picture)
                .unwrap(),
        };
        assert_eq!(prepared.size(), size);
        network.detect(&prepared).unwrap().detections
    };
    let wide = at(WIDE);
    let square = at(SQUARE);
    assert_eq!(wide.len(), square.len());
    for (wide, square) in wide.iter().zip(&square) {
        let overlap = wide.bounding_box.intersection_over_union(square.bounding_box);
        assert!(
            wide.class == square.class && overlap > 0.9,
            "{wide:?} {square:?}"
        );
    }
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn pictures_of_each_shape_have_an_input_of_their_own() {
    let mut network = DetectorNetwork::open(&config(project("models/yolox_nano.onnx"))).unwrap();
    let black = |width, height| Picture::black(PictureSize::new(width, height));
    // Nothing is in view, and nothing tells against the smallest input for a hundred pictures.
    let upright = sizes(&mut network, &vec![black(360, 640); 101]);
    assert_eq!((upright[0], upright[99]), (SQUARE, SQUARE));
    assert_eq!(upright[100], PictureSize::new(256, 416));
    // A square picture fills the largest, and a second upright one the input of the first.
    sizes(
        &mut network,
        &[black(500, 500), black(1080, 1920), black(640, 480)],
    );
    let inputs = network.preparation().inputs();
    let choices: Vec<_> = inputs.iter().map(|found| found.choice.as_str()).collect();
    assert_eq!(choices, ["comparing", "smallest", "smallest"], "{inputs:?}");
}

/// A model of one class whose output is always the same: one box in pixels of the input.
fn constant(input: &[i64]) -> Planted {
    let row = |number: usize, value: f32| (number * 3549 + 7, value);
    let numbers = [
        row(0, 208.0),
        row(1, 208.0),
        row(2, 100.0),
        row(3, 60.0),
        row(4, 0.9),
    ];
    with_metadata(Planted::default().input("images", input)).output(
        "output0",
        &[1, 5, -1],
        &[1, 5, 3549],
        0.0,
        &numbers,
    )
}

/// A model of YOLOX's shape whose output has the cells of 416x416 at any size.
fn of_one_size() -> Planted {
    let numbers: Vec<_> = [208.0, 208.0, 100.0, 60.0, 0.9, 1.0].into_iter().enumerate().collect();
    with_metadata(Planted::default().input("images", &OPEN)).output(
        "output",
        &[1, 3549, 6],
        &[1, 3549, 6],
        0.0,
        &numbers,
    )
}

fn with_metadata(planted: Planted) -> Planted {
    planted
        .entry("stride", "32")
        .entry("imgsz", "[416, 416]")
        .entry("names", "{0: 'car'}")
}

const OPEN: [i64; 4] = [1, 3, -1, -1];

#[rstest::rstest]
#[case::it_finds_something_else(
    constant(&OPEN), HeadName::Yolo, 10, "finds something else at the smallest input (0 of 20 boxes"
)]
#[case::it_cannot_be_read(
    of_one_size(),
    HeadName::Yolox,
    1,
    "does not run at 416x256: its output has another shape"
)]
#[test]
#[ignore = "needs ONNX Runtime"]
fn a_model_that_is_wrong_at_another_size_stays_at_its_largest_and_says_why(
    #[case] model: Planted,
    #[case] head: HeadName,
    #[case] pictures: usize,
    #[case] reason: &str,
) {
    let folder = tempfile::tempdir().unwrap();
    let model = config(model.write(folder.path()));
    let head = head.into();
    let mut network = DetectorNetwork::open(&DetectorConfig { head, ..model }).unwrap();
    let black = Picture::black(PictureSize::new(640, 360));
    let largest = vec![SQUARE; pictures];
    assert_eq!(sizes(&mut network, &vec![black.clone(); pictures]), largest);
    let found = only_input(&network);
    assert!(matches!(found.choice, Choice::Largest(_)), "{found:?}");
    assert_contains(
        &found,
        &["44 % of the input 416x416", "9 % of 416x256", reason],
    );
    assert_eq!(sizes(&mut network, &vec![black; 3]), [SQUARE; 3]);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn cameras_that_share_a_detector_have_each_the_input_of_their_pictures() {
    let detector = DetectorHandle::start(&config(project("models/yolox_nano.onnx"))).await.unwrap();
    let wide: Vec<_> = road("two-near", 12).into_iter().map(Arc::new).collect();
    let square = Arc::new(Picture::black(PictureSize::new(500, 500)));
    for picture in wide {
        let one = detector.detect(CAMERA, picture);
        let other = detector.detect(CameraSlot(1), Arc::clone(&square));
        let (one, other) = tokio::join!(one, other);
        assert!(!one.unwrap().output.detections.is_empty());
        assert_eq!(other.unwrap().output.detections, []);
    }
    let inputs: Vec<_> = detector.inputs().iter().map(|found| found.input().size).collect();
    assert_eq!(inputs, [WIDE, SQUARE]);
    assert_eq!(detector.counters().failed, 0);
    detector.stop().await;
}

#[test]
#[ignore = "needs ../shared and ONNX Runtime and Python"]
fn shared_the_script_opens_the_published_file_into_ours_which_equals_it_at_its_size() {
    let published = shared("models/yolox_nano_416.onnx");
    let ours = project("models/yolox_nano.onnx");
    let folder = tempfile::tempdir().unwrap();
    let opened = folder.path().join("opened.onnx");
    let script = |file: &str| {
        let mut script = Command::new(python());
        script.arg(project("models/open_input.py")).arg(shared(file)).arg(&opened);
        script
    };
    run_command(&mut script("models/yolox_nano_416.onnx")).succeeds();
    assert!(
        std::fs::read(&opened).unwrap() == std::fs::read(&ours).unwrap(),
        "another file"
    );
    let refused = run_command(&mut script("models/fastestdet_352.onnx"));
    assert_eq!(refused.code, Some(1));
    assert_contains(&refused.err, &["sizes written into it", "Reshape"]);

    let picture = decoded_square();
    let outputs = [published, ours].map(|model| {
        let mut session = OnnxSession::open(&config(model).session_settings()).unwrap();
        let shape = [1, 3, 416, 416];
        session
            .run(shape, SQUARE, &[&picture], |outputs| {
                (outputs[0].shape.to_vec(), outputs[0].values.to_vec())
            })
            .unwrap()
    });
    assert!(outputs[0] == outputs[1], "they differ at 416x416");
}

/// A picture of the road as YOLOX-Nano's square input.
fn decoded_square() -> InputTensor {
    let network = DetectorNetwork::open(&config(project("models/yolox_nano.onnx"))).unwrap();
    let picture = road("busy", 1).remove(0);
    network.preparation().prepare(&picture).unwrap().tensor().clone()
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn what_a_fixed_square_wastes_is_said_once_with_how_it_is_exported_without() {
    let folder = tempfile::tempdir().unwrap();
    let model = constant(&[1, 3, 416, 416]).write(folder.path());
    let program = || Command::new(env!("CARGO_BIN_EXE_albireo"));
    let mut detect = program();
    let mut check = program();
    detect.arg("detect").arg(&model);
    check.args(["check", "config/node.toml"]).env("ALBIREO_DETECTOR__MODEL", &model);
    for command in [&mut detect, &mut check] {
        let said = run_command(command).succeeds();
        let words: Vec<_> = said.split_whitespace().collect();
        let words = words.join(" ");
        assert_contains(
            &words,
            &[
                "44 % of the input 416x416",
                "416x256 would have 9 %",
                "dynamic=True",
                "imgsz=[256, 416]",
            ],
        );
        assert_eq!(words.matches("44 %").count(), 1, "{said}");
    }
}
