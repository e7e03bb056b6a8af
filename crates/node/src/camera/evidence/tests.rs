use super::*;
use crate::camera::tests::{detector, live_evidence, picture, pixels, shared_detector};
use futures_util::FutureExt;

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn decoded_pictures_of_all_cameras_share_the_same_buffers() {
    let pictures = [0, 10, 30].map(picture);
    let detector = detector().await;
    let pixels = pixels(&detector);
    let mut cameras = [0; 4].map(|_| live_evidence(&detector, &pixels));
    for _ in 0..3 {
        for picture in &pictures {
            for camera in &mut cameras {
                assert!(camera.detect(picture).await.unwrap().is_some());
                camera.next_frame();
            }
        }
    }
    drop(cameras);
    // Fewer than there are cameras.
    assert!(pixels.idle() <= 3, "{} buffers", pixels.idle());
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_frame_may_join_the_run_of_another_camera_from_its_decision_to_its_answer() {
    let detector = shared_detector(0.3).await;
    let pixels = pixels(&detector);
    let mut first = live_evidence(&detector, &pixels);
    let second = live_evidence(&detector, &pixels);
    let picture = picture(0);
    assert_eq!(second.join(picture.size), 0.0);
    let mut detecting = Box::pin(first.detect(&picture));
    assert!((&mut detecting).now_or_never().is_none());
    assert_eq!(second.join(picture.size), 0.3);
    assert!(detecting.await.unwrap().is_some());
    assert_eq!(second.join(picture.size), 0.0);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_wait_for_a_place_ends_when_the_node_stops() {
    let picture = picture(0);
    let detector = detector().await;
    let mut evidence = live_evidence(&detector, &pixels(&detector));
    let give_up = evidence.give_up.clone();
    let mut held = Vec::new();
    while let Some(Some(place)) = evidence.pixels.place().now_or_never() {
        held.push(place);
    }
    assert!(held.len() >= 3);
    let detecting = evidence.detect(&picture);
    tokio::pin!(detecting);
    assert!((&mut detecting).now_or_never().is_none());
    give_up.cancel();
    assert_eq!(detecting.await.unwrap(), None);
}

#[tokio::test]
#[ignore = "needs ONNX Runtime"]
async fn a_frame_is_charged_its_share_of_a_run_and_no_decoding_for_an_unavailable_detector() {
    let picture = picture(0);
    let detector = detector().await;
    let mut evidence = live_evidence(&detector, &pixels(&detector));
    let took = evidence.detect(&picture).await.unwrap().unwrap().took;
    let run = evidence.times().detector_run.unwrap();
    assert_eq!(run.used, took);
    let latency = evidence.times().latency;
    assert!(latency.detector.unwrap() >= milliseconds(took));
    assert!(latency.decode.unwrap() > 0.0);

    evidence.next_frame();
    assert_eq!(evidence.times().detector_run, None);
    detector.stop().await;
    assert_eq!(evidence.detect(&picture).await.unwrap(), None);
    let latency = evidence.times().latency;
    assert_eq!(latency.decode, None);
    assert_eq!(latency.detector, None);
}
