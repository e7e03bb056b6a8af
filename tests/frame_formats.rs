//! Every payload format of a camera is read, and unreadable payloads are rejected by kind.

use crate::node_frames::rmw_attachment;
use albireo_core::geometry::PictureSize;
use albireo_node::input::{Frame, FrameNumber, PayloadFormat, RawSample, read_frame};
use albireo_vision::picture::{FrameFault, FrameLimits, PictureFormat};
use bytes::Bytes;
use serde_json::Value;
use tokio::time::Instant;

fn fixture(name: &str) -> Vec<u8> {
    std::fs::read(crate::support::project("tests/fixtures/ros2").join(name)).unwrap()
}

fn sample<'a>(payload: &[u8], encoding: &'a str, attachment: Option<&'a [u8]>) -> RawSample<'a> {
    RawSample {
        payload: Bytes::copy_from_slice(payload),
        encoding: encoding.into(),
        attachment: attachment.map(Into::into),
        timestamp_ns: Some(77),
        arrival: 12,
        received: Instant::now(),
    }
}

/// A frame, or the number and the fault of an unreadable sample.
type Read = Result<Frame, (FrameNumber, FrameFault)>;

fn read_as(sample: RawSample<'_>, format: PayloadFormat, limits: &FrameLimits) -> Read {
    let (number, frame) = read_frame(sample, format, limits);
    frame.map_err(|fault| (number, fault))
}

fn read(payload: &[u8], encoding: &str, attachment: Option<&str>) -> Read {
    let sample = sample(payload, encoding, attachment.map(str::as_bytes));
    read_as(sample, PayloadFormat::Encoding, &FrameLimits::default())
}

fn read_ros(payload: &[u8], format: PayloadFormat) -> Read {
    read_as(sample(payload, "", None), format, &FrameLimits::default())
}

/// The JPEG and the PNG file inside the fixtures.
fn picture_files() -> (Vec<u8>, Vec<u8>) {
    let [jpeg, png] = ["compressed_image_0.cdr", "compressed_image_2.cdr"].map(fixture);
    (jpeg[48..][..10435].to_vec(), png[32..][..82134].to_vec())
}

#[test]
fn ros2_messages_of_another_library_are_read_in_both_byte_orders() {
    let expected: Vec<Value> = serde_json::from_slice(&fixture("expected.json")).unwrap();
    assert_eq!(expected.len(), 4);
    for message in expected {
        let number = |key: &str| message[key].as_u64().unwrap();
        let payload = fixture(message["file"].as_str().unwrap());
        let frame = read_ros(&payload, PayloadFormat::Ros2CompressedImage).unwrap();
        let time = number("sec") * 1_000_000_000 + number("nanosec");
        assert_eq!(frame.time_ns, time);
        let [width, height] = ["image_width", "image_height"].map(|key| number(key) as u32);
        assert_eq!(frame.picture.size, PictureSize::new(width, height));
        let (offset, length) = (number("data_offset") as usize, number("data_len") as usize);
        assert_eq!(frame.picture.bytes, payload[offset..offset + length]);
        let is_png = message["format"] == "png";
        let format = [PictureFormat::Jpeg, PictureFormat::Png][usize::from(is_png)];
        assert_eq!(frame.picture.format, format);
        assert_eq!(frame.sequence, 12, "numbered by arrival");
        assert_eq!(frame.payload_bytes, payload.len());
    }
}

#[test]
fn trailing_padding_of_a_ros2_message_is_ignored_and_every_truncation_is_rejected() {
    let mut payload = fixture("compressed_image_0.cdr");
    let whole = payload.len();
    payload.extend_from_slice(&[0; 3]);
    assert!(read_ros(&payload, PayloadFormat::Ros2CompressedImage).is_ok());
    for length in (0..60).chain([whole - 1]) {
        let cut = read_ros(&payload[..length], PayloadFormat::Ros2CompressedImage);
        let rejected = cut.unwrap_err();
        assert_eq!(rejected.1.kind(), "undecodable", "{length}: {rejected:?}");
        assert_eq!(rejected.0.seq, None);
    }
    payload[1] = 9;
    let rejected = read_ros(&payload, PayloadFormat::Ros2CompressedImage).unwrap_err();
    assert_eq!(rejected.1.kind(), "unknown_format");
}

/// An Image message in CDR, field by field.
fn ros_image(
    little_endian: bool,
    encoding: &str,
    width: u32,
    height: u32,
    step: u32,
    data: &[u8],
) -> Vec<u8> {
    let mut body = Vec::new();
    let word = |body: &mut Vec<u8>, value: u32| {
        while !body.len().is_multiple_of(4) {
            body.push(0);
        }
        body.extend(match little_endian {
            true => value.to_le_bytes(),
            false => value.to_be_bytes(),
        });
    };
    let text = |body: &mut Vec<u8>, value: &str| {
        word(body, value.len() as u32 + 1);
        body.extend_from_slice(value.as_bytes());
        body.push(0);
    };
    word(&mut body, 1_700_000_000);
    word(&mut body, 5);
    text(&mut body, "camera_link");
    word(&mut body, height);
    word(&mut body, width);
    text(&mut body, encoding);
    body.push(0);
    word(&mut body, step);
    word(&mut body, data.len() as u32);
    body.extend_from_slice(data);
    [&[0, u8::from(little_endian), 0, 0][..], &body].concat()
}

#[test]
fn a_ros2_image_is_read_with_and_without_row_padding() {
    let rows: Vec<u8> = (0..18).collect();
    let padded = [&rows[..9], &[255; 3], &rows[9..], &[255; 3]].concat();
    for little_endian in [true, false] {
        for (step, data) in [(9, &rows), (12, &padded)] {
            let payload = ros_image(little_endian, "bgr8", 3, 2, step, data);
            let frame = read_ros(&payload, PayloadFormat::Ros2Image).unwrap();
            assert_eq!(frame.picture.format, PictureFormat::Bgr8);
            assert_eq!(frame.picture.size, PictureSize::new(3, 2));
            assert_eq!(frame.picture.bytes, rows);
            assert_eq!(frame.time_ns, 1_700_000_000_000_000_005);
        }
    }
    // 2x2 NV12 with a step of 4: two rows of luma, one of chroma.
    let data = [1, 2, 0, 0, 3, 4, 0, 0, 5, 6, 0, 0];
    let payload = ros_image(true, "nv12", 2, 2, 4, &data);
    let frame = read_ros(&payload, PayloadFormat::Ros2Image).unwrap();
    assert_eq!(frame.picture.bytes.as_ref(), [1, 2, 3, 4, 5, 6]);
}

#[test]
fn an_inconsistent_ros2_image_is_rejected() {
    for (encoding, width, height, step, bytes, kind) in [
        ("bgr8", 3, 2, 8, 18, "undecodable"),
        ("bgr8", 3, 2, 9, 17, "undecodable"),
        ("mono8", 0, 2, 0, 0, "undecodable"),
        ("rgb8", u32::MAX, u32::MAX, u32::MAX, 4, "oversized"),
        ("mono8", 7000, 4000, u32::MAX, 4, "undecodable"),
        ("16UC1", 2, 2, 4, 8, "unknown_format"),
    ] {
        let payload = ros_image(true, encoding, width, height, step, &vec![0; bytes]);
        let rejected = read_ros(&payload, PayloadFormat::Ros2Image).unwrap_err();
        assert_eq!(rejected.1.kind(), kind, "{encoding}: {rejected:?}");
    }
}

#[test]
fn a_ros2_camera_is_numbered_by_its_own_attachment() {
    let attachment = rmw_attachment(900, 3);
    let message = fixture("compressed_image_1.cdr");
    let sample = sample(&message, "", Some(&attachment));
    let limits = FrameLimits::default();
    let frame = read_as(sample, PayloadFormat::Ros2CompressedImage, &limits).unwrap();
    assert_eq!(frame.sequence, 900);
    assert_eq!(frame.time_ns, 1_700_000_001_246_913_578, "the header's");
}

#[test]
fn the_format_comes_from_the_encoding_or_the_first_bytes() {
    let (jpeg, png) = picture_files();
    for (payload, encoding, format) in [
        (&jpeg, "image/jpeg", PictureFormat::Jpeg),
        (&png, "image/png", PictureFormat::Png),
        (&jpeg, "", PictureFormat::Jpeg),
        (&png, "zenoh/bytes", PictureFormat::Png),
        (&jpeg, "application/octet-stream", PictureFormat::Jpeg),
        (&jpeg, "Image/JPEG;q=90", PictureFormat::Jpeg),
    ] {
        let frame = read(payload, encoding, None).unwrap();
        assert_eq!(frame.picture.format, format, "{encoding}");
        assert_eq!(frame.picture.size, PictureSize::new(320, 180));
        assert_eq!((frame.sequence, frame.time_ns), (12, 77));
        assert_eq!(frame.clip, None);
    }
    for (payload, encoding, kind) in [
        (&png, "image/jpeg", "undecodable"),
        (&jpeg, "image/png", "undecodable"),
        (&jpeg, "video/h264", "unknown_format"),
        (&b"GIF89a".to_vec(), "", "unknown_format"),
        (&vec![], "image/jpeg", "undecodable"),
    ] {
        let rejected = read(payload, encoding, None).unwrap_err();
        assert_eq!(rejected.1.kind(), kind, "{encoding}: {rejected:?}");
    }
}

#[test]
fn raw_pictures_take_their_size_from_the_attachment() {
    let attachment =
        r#"{"v":1,"seq":4,"t_ns":9,"clip":"drive","width":3,"height":2,"later":"field"}"#;
    for (name, bytes) in [
        ("rgb8", 18),
        ("bgr8", 18),
        ("gray8", 6),
        // 6 bytes of luma, and chroma rounded up to 2x1 pairs.
        ("nv12", 10),
        ("rgba8", 24),
    ] {
        let encoding = format!("image/raw;{name}");
        let frame = read(&vec![1; bytes], &encoding, Some(attachment)).unwrap();
        assert_eq!(frame.picture.size, PictureSize::new(3, 2));
        assert_eq!((frame.sequence, frame.time_ns), (4, 9));
        assert_eq!(frame.clip.as_deref(), Some("drive"));
        let rejected = read(&vec![1; bytes - 1], &encoding, Some(attachment)).unwrap_err();
        assert_eq!(rejected.1.kind(), "undecodable", "{rejected:?}");
        assert_eq!(rejected.0.seq, Some(4));
    }
    for (encoding, attachment) in [
        ("image/raw;rgb8", None),
        ("image/raw;rgb8", Some(r#"{"v":1,"width":3}"#)),
        ("image/raw;yuyv", Some(attachment)),
        ("image/raw", Some(attachment)),
    ] {
        let rejected = read(&[1; 18], encoding, attachment).unwrap_err();
        assert_eq!(rejected.1.kind(), "unknown_format", "{rejected:?}");
    }
}

#[test]
fn an_unreadable_attachment_is_rejected_without_a_number() {
    let (jpeg, _) = picture_files();
    for attachment in [r#"{"v":2,"seq":1}"#, "seq=1"] {
        let rejected = read(&jpeg, "image/jpeg", Some(attachment)).unwrap_err();
        assert_eq!(rejected.1.kind(), "unknown_format");
        assert_eq!(rejected.0.seq, None);
    }
}

#[test]
fn an_oversized_picture_is_recognised_by_its_header_alone() {
    let (jpeg, png) = picture_files();
    let changed = |change: fn(&mut FrameLimits)| {
        let mut limits = FrameLimits::default();
        change(&mut limits);
        limits
    };
    let payload = changed(|limits| limits.max_payload_bytes = 5000);
    let width = changed(|limits| limits.max_width = 319);
    let height = changed(|limits| limits.max_height = 179);
    let decoded = changed(|limits| limits.max_decoded_bytes = 320 * 180 * 3 - 1);
    for limits in [payload, width, height, decoded] {
        for (file, encoding) in [(&jpeg, "image/jpeg"), (&png, "image/png")] {
            let sample = sample(file, encoding, None);
            let rejected = read_as(sample, PayloadFormat::Encoding, &limits).unwrap_err();
            assert_eq!(rejected.1.kind(), "oversized", "{rejected:?}");
        }
    }
    // A PNG of 33 bytes that claims four billion by four billion pixels.
    let mut bomb = png[..33].to_vec();
    bomb[16..24].fill(0xFF);
    let rejected = read(&bomb, "image/png", None).unwrap_err();
    assert_eq!(rejected.1.kind(), "oversized");
}
