use crate::camera::answer;
use crate::settings::tests::{config, prepared, thresholds};
use albireo_core::geometry::PictureSize;
use albireo_core::policy::FrameState;
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use bytes::Bytes;
use serde_json::Value;
use std::sync::Arc;

#[test]
fn a_camera_has_its_own_threshold_or_that_of_the_policy() {
    let mut config = config(None, "albireo:7e-4");
    config.cameras[1].threshold = Some(1e-3);
    assert_eq!(thresholds(&prepared(&config).board), [7e-4, 1e-3]);
}

#[test]
fn only_a_second_place_of_one_name_has_a_number() {
    let board = prepared(&config(None, "albireo")).board;
    let name = |place: &str| board.forward_to(place.to_owned()).to.clone();
    assert_eq!(name("mqtt://h:18830"), "mqtt://h:18830");
    assert_eq!(name("mqtt://h:1883"), "mqtt://h:1883");
    assert_eq!(name("mqtt://h:1883"), "mqtt://h:1883 (2)");
    assert_eq!(name("mqtt://h:1883"), "mqtt://h:1883 (3)");
}

#[test]
fn an_event_is_written_as_json_once_however_many_read_it() {
    let board = prepared(&config(None, "albireo")).board;
    let mut readers: Vec<_> = (0..64).map(|_| board.subscribe()).collect();
    let picture = EncodedPicture {
        format: PictureFormat::Rgb8,
        bytes: Bytes::new(),
        size: PictureSize::new(0, 0),
        mount: None,
    };
    board.cameras[0].show(Arc::new(answer(7, FrameState::I)), picture);
    let events: Vec<_> = readers.iter_mut().map(|reader| reader.try_recv().unwrap()).collect();
    assert_eq!(events[0].news.camera(), Some("front"));
    let first = events[0].json();
    let frame: Value = serde_json::from_str(first).unwrap();
    assert_eq!(frame["camera"], "front");
    assert_eq!(frame["seq"], 7);
    // The same allocation, not just equal text.
    assert!(events.iter().all(|event| std::ptr::eq(event.json(), first)));
}
