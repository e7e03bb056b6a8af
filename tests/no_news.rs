//! Pictures without news cost nothing: a parked dashcam is looked at now and then, one that drives in every frame.

use crate::node_frames::{Bench, ask_frame, attachment, configuration, pictures};
use crate::node_frames::{CAMERA, refused};
use crate::support::{jpeg, shared};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{
    CallCause, EmptyRoad, FrameEvidence, FrameHead, FrameState, GreyPicture, Outcome, PassCause,
    Vanilla, WithPause, decide,
};
use albireo_scene::BoxScene;
use albireo_vision::picture::{
    FrameLimits, Picture, PixelLayout, decode, decode_small_grey, picture_of_file,
};
use albireo_wire::DetectionsMessage;
use rstest::rstest;
use std::process::Command;
use std::time::Instant;

/// A picture of a sensor that sees one brightness: never the same bytes twice.
fn noisy(brightness: u32, seed: u64) -> Vec<u8> {
    let noise =
        |at: u64| (at.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(seed * 977) >> 40) % 5;
    let pixels: Vec<_> =
        (0..3 * 320 * 180).map(|at| (brightness + noise(at / 3) as u32) as u8).collect();
    jpeg(&pixels, [320, 180])
}

/// Shows the node frames at ten per second, by their stamps; returns the answers.
async fn show(bench: &mut Bench, from: u64, frames: Vec<Vec<u8>>) -> Vec<DetectionsMessage> {
    let mut answers = Vec::new();
    for (seq, frame) in (from..).zip(frames) {
        let stamped = attachment(seq, None, None);
        let reply = ask_frame(&bench.session, CAMERA, frame, "image/jpeg", stamped).await;
        assert_eq!(refused(reply), None);
        answers.push(bench.answer().await);
    }
    answers
}

#[rstest]
#[case::in_the_dark(2, 300, PassCause::Dark)]
#[case::by_day(120, 10, PassCause::Unchanged)]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime"]
async fn a_parked_dashcam_asks_the_detector_once_in_ten_seconds_and_wakes_on_the_first_changed_picture(
    #[case] brightness: u32,
    #[case] watched: usize,
    #[case] cause: PassCause,
) {
    let mut config = configuration();
    config.policy.name = "albireo".to_owned();
    config.screen.still_s = 10.0;
    config.audit.share = 0.0;
    let mut bench = Bench::start(&config).await;
    let parked = (0..550).map(|seed| noisy(brightness, seed)).collect();
    let answers = show(&mut bench, 0, parked).await;
    let looks: Vec<usize> = (0..550).filter(|at| !answers[*at].state.is_skipped()).collect();
    let spent = looks.iter().filter(|at| **at <= watched).count();
    assert!(spent >= watched, "{looks:?}");
    // Afterwards the looks are ten seconds apart.
    let later: Vec<usize> = looks.into_iter().filter(|at| *at > watched + 1).collect();
    assert!(later.len() >= 2, "{later:?}");
    assert!(
        later.windows(2).all(|two| (99..=103).contains(&(two[1] - two[0]))),
        "{later:?}"
    );
    for at in later {
        assert_eq!(answers[at].cause, Some(CallCause::EmptyRoad));
    }
    let last = answers.last().unwrap();
    assert_eq!(last.state, FrameState::E);
    assert_eq!(last.passed, Some(cause));
    assert_eq!(last.cause, None);
    assert!(last.boxes.is_empty());
    let passed = bench.snapshot().passed[cause as usize];
    assert!(passed >= 550 - watched as u64 - 15, "{passed}");

    // A car comes in.
    let came = show(&mut bench, 550, pictures(1)).await.remove(0);
    assert_eq!(came.state, FrameState::I);
    assert_eq!(came.passed, None);
    assert!(!came.boxes.is_empty());
    bench.stop().await;
}

const SIZE: PictureSize = PictureSize::new(160, 90);

/// A minute of a clip, looped, as the small grey pictures that are compared; darker by ffmpeg's filter.
fn minute(clip: &str, darker: &str) -> Vec<Vec<u8>> {
    let filter = format!("{darker}fps=10,scale=160:90:flags=area,format=gray");
    let output = Command::new("ffmpeg")
        .args(["-v", "error", "-stream_loop", "-1", "-i"])
        .arg(shared(&format!("media/{clip}")))
        .args(["-t", "60", "-vf", &filter, "-f", "rawvideo", "-"])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    output.stdout.chunks_exact(160 * 90).map(<[u8]>::to_vec).collect()
}

/// A policy that calls the detector on every frame, with the pause.
fn parked() -> WithPause {
    let still = EmptyRoad {
        still_s: 10.0,
        ..EmptyRoad::default()
    };
    WithPause::new(Box::new(Vanilla::default()), still.frames(Some(10.0)))
}

/// True if a frame in which the detector finds nothing is passed over.
fn is_passed(policy: &mut WithPause, index: u64, grey: GreyPicture<'_>) -> bool {
    let head = FrameHead {
        index,
        step: 1,
        picture: PictureSize::new(1280, 720),
    };
    let mut known = FrameEvidence {
        grey: Some(grey),
        ..FrameEvidence::detections(&[])
    };
    let mut outcome = Outcome::default();
    let Ok(()) = decide(policy, head, &mut known, &mut outcome);
    outcome.passed.is_some()
}

/// The share of a drive's frames that are passed over because the picture seems to have no news.
fn passed(drive: &[Vec<u8>]) -> f64 {
    let mut policy = parked();
    let mut passed = 0;
    for (index, pixels) in (0..).zip(drive) {
        let grey = GreyPicture { size: SIZE, pixels };
        if is_passed(&mut policy, index, grey) {
            passed += 1;
        }
    }
    f64::from(passed) / drive.len() as f64
}

/// No frame is passed over, so recall is that of a node without the pause: the night clip, and the clips by day made dark,
/// down to a mean of 9 of 255 grey levels.
#[test]
#[ignore = "needs ../shared and ffmpeg"]
fn shared_a_car_that_drives_at_night_is_looked_at_in_every_frame() {
    for clip in [
        "road_night_empty.mp4",
        "highway_restored.mp4",
        "highway_busy.mp4",
        "highway_two_cars.mp4",
        "highway_two_near.mp4",
        "highway_empty_then_car.mp4",
    ] {
        for darker in ["", "lutyuv=y=16+(val-16)*0.3,", "lutyuv=y=16+(val-16)*0.1,"] {
            let drive = minute(clip, darker);
            assert_eq!(drive.len(), 600, "{clip}");
            let pixels = drive.iter().flatten();
            let mean = pixels.map(|pixel| u64::from(*pixel)).sum::<u64>() / (600 * 160 * 90);
            let share = passed(&drive);
            println!("{clip} {darker} mean {mean}: {share:.3} passed");
            assert_eq!(share, 0.0, "{clip} {darker} mean {mean}");
        }
    }
}

/// Milliseconds of the fastest of some runs.
fn fastest(mut run: impl FnMut()) -> f64 {
    let mut fastest = f64::INFINITY;
    for _ in 0..20 {
        let begun = Instant::now();
        run();
        fastest = fastest.min(begun.elapsed().as_secs_f64() * 1e3);
    }
    fastest
}

#[test]
fn comparing_a_picture_costs_a_fraction_of_decoding_it() {
    let limits = FrameLimits::default();
    for size in [PictureSize::new(1280, 720), PictureSize::new(1920, 1080)] {
        let file = BoxScene::new(12, size).frame(0).jpeg(85).unwrap();
        let file = picture_of_file(file.into(), &limits).unwrap();
        let mut picture = Picture::default();
        let whole =
            fastest(|| decode(&file, &limits, PixelLayout::Rgb8, None, &mut picture).unwrap());
        let small = fastest(|| decode_small_grey(&file, &limits, 160, &mut picture).unwrap());
        let grey = GreyPicture {
            size: picture.size,
            pixels: &picture.pixels,
        };
        let mut policy = parked();
        let mut index = 0;
        let mut compare = || {
            index += 1;
            is_passed(&mut policy, index, grey);
        };
        // Within the first second, a picture is compared once.
        for _ in 0..20 {
            compare();
        }
        let compared = fastest(compare);
        println!(
            "{size}: decoded {whole:.2} ms, small grey picture {small:.2} ms, compared {compared:.3} ms"
        );
        assert!(
            2.0 * (small + compared) < whole,
            "{small} {compared} {whole}"
        );
    }
}
