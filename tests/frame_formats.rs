//! Every payload format of a camera is read, and unreadable payloads are rejected by kind.

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
fn ros2_messages_of_another_library_in_both_byte_orders_are_read_and_numbered_unless_cut_short() {
    let read = |payload: &[u8]| read_ros(payload, PayloadFormat::Ros2);
    let expected: Vec<Value> = serde_json::from_slice(&fixture("expected.json")).unwrap();
    assert_eq!(expected.len(), 4);
    for message in expected {
        let number = |key: &str| message[key].as_u64().unwrap();
        let mut payload = fixture(message["file"].as_str().unwrap());
        let frame = read(&payload).unwrap();
        let time = number("sec") * 1_000_000_000 + number("nanosec");
        assert_eq!(frame.time_ns, time);
        let [width, height] = ["image_width", "image_height"].map(|key| number(key) as u32);
        assert_eq!(frame.picture.size, PictureSize::new(width, height));
        let offset = number("data_offset") as usize;
        let length = number("data_len") as usize;
        assert_eq!(frame.picture.bytes, payload[offset..offset + length]);
        let format = match message["format"].as_str().unwrap() {
            "png" => PictureFormat::Png,
            _ => PictureFormat::Jpeg,
        };
        assert_eq!(frame.picture.format, format);
        assert_eq!(frame.sequence, 12, "numbered by arrival");
        // The attachment of rmw_zenoh: number, time and publisher id.
        let stamp = 1_700_000_000_000_000_000_i64.to_le_bytes();
        let attachment = [&900_u64.to_le_bytes()[..], &stamp, &[16], &[3; 16]].concat();
        let limits = FrameLimits::default();
        let numbered = sample(&payload, "", Some(&attachment));
        let numbered = read_as(numbered, PayloadFormat::Ros2, &limits).unwrap();
        // The time is still the header's.
        assert_eq!(numbered.sequence, 900);
        assert_eq!(numbered.time_ns, time);

        for length in (0..60).chain([payload.len() - 1]) {
            let (number, fault) = read(&payload[..length]).unwrap_err();
            assert_eq!(fault.kind(), "undecodable", "{length}: {fault}");
            assert_eq!(number.seq, None);
        }
        // Padding after the message is ignored; another encoding is not.
        payload.extend_from_slice(&[0; 3]);
        assert!(read(&payload).is_ok());
        payload[1] = 9;
        let (_, fault) = read(&payload).unwrap_err();
        assert_eq!(fault.kind(), "unknown_format");
    }
}

/// The byte order of a message, by its number in the second byte.
#[derive(Clone, Copy)]
enum ByteOrder {
    Big = 0,
    Little = 1,
}

fn ros_image(
    order: ByteOrder,
    encoding: &str,
    [width, height, step]: [u32; 3],
    data: &[u8],
) -> Vec<u8> {
    let word = |word: &u32| match order {
        ByteOrder::Big => word.to_be_bytes(),
        ByteOrder::Little => word.to_le_bytes(),
    };
    let words = |words: &[u32]| words.iter().flat_map(word).collect::<Vec<_>>();
    // With its zero and `is_bigendian`, padded to whole words.
    let mut text = [encoding.as_bytes(), &[0, 0]].concat();
    text.resize(text.len().next_multiple_of(4), 0);
    [
        &[0, order as u8, 0, 0][..],
        &words(&[1_700_000_000, 5, 12]),
        b"camera_link\0",
        &words(&[height, width, encoding.len() as u32 + 1]),
        &text,
        &words(&[step, data.len() as u32]),
        data,
    ]
    .concat()
}

#[test]
fn a_ros2_image_is_read_with_and_without_row_padding() {
    let rows: Vec<u8> = (0..18).collect();
    let padded = [&rows[..9], &[255; 3], &rows[9..], &[255; 3]].concat();
    for order in [ByteOrder::Little, ByteOrder::Big] {
        for (step, data) in [(9, &rows), (12, &padded)] {
            let payload = ros_image(order, "bgr8", [3, 2, step], data);
            let frame = read_ros(&payload, PayloadFormat::Ros2).unwrap();
            assert_eq!(frame.picture.format, PictureFormat::Bgr8);
            assert_eq!(frame.picture.size, PictureSize::new(3, 2));
            assert_eq!(frame.picture.bytes, rows);
            assert_eq!(frame.time_ns, 1_700_000_000_000_000_005);
        }
    }
    for (encoding, big_endian, bytes) in [
        ("mono16", 0, [1, 2]),
        ("mono16", 1, [2, 1]),
        ("bayer_grbg16", 1, [2, 1]),
    ] {
        let mut payload = ros_image(ByteOrder::Little, encoding, [1, 1, 4], &[1, 2, 9, 9]);
        // Behind 40 bytes, the text and its zero.
        payload[40 + encoding.len() + 1] = big_endian;
        let frame = read_ros(&payload, PayloadFormat::Ros2).unwrap();
        assert_eq!(frame.picture.bytes.as_ref(), bytes, "{encoding}");
    }
    // 2x2 NV12 with a step of 4: two rows of luma, one of chroma.
    let data = [1, 2, 0, 0, 3, 4, 0, 0, 5, 6, 0, 0];
    let payload = ros_image(ByteOrder::Little, "nv12", [2, 2, 4], &data);
    let frame = read_ros(&payload, PayloadFormat::Ros2).unwrap();
    assert_eq!(frame.picture.bytes.as_ref(), [1, 2, 3, 4, 5, 6]);
}

#[test]
fn an_inconsistent_ros2_image_is_rejected() {
    for (encoding, size_and_step, bytes, kind) in [
        ("bgr8", [3, 2, 8], 18, "undecodable"),
        ("bgr8", [3, 2, 9], 17, "undecodable"),
        ("mono8", [0, 2, 0], 0, "undecodable"),
        ("rgb8", [u32::MAX; 3], 4, "oversized"),
        ("mono8", [7000, 4000, u32::MAX], 4, "undecodable"),
        ("16UC1", [2, 2, 4], 8, "unknown_format"),
    ] {
        let data = vec![0; bytes];
        let payload = ros_image(ByteOrder::Little, encoding, size_and_step, &data);
        let (_, fault) = read_ros(&payload, PayloadFormat::Ros2).unwrap_err();
        assert_eq!(fault.kind(), kind, "{encoding}: {fault:?}");
    }
}

#[test]
fn the_encoding_the_attachment_or_the_first_bytes_tell_what_a_payload_is() {
    let (jpeg, png) = picture_files();
    let sent = r#"{"v":1,"seq":4,"t_ns":9,"clip":"drive","width":3,"height":2,"later":"field"}"#;
    let sent = Some(sent);
    let no_height = Some(r#"{"v":1,"width":3}"#);
    let later_version = Some(r#"{"v":2,"seq":1}"#);
    let no_json = Some("seq=1");
    let cases: [(&[u8], &str, Option<&str>, &str); 27] = [
        (&jpeg, "image/jpeg", None, "Jpeg 320x180"),
        (&png, "image/png", None, "Png 320x180"),
        (&jpeg, "", None, "Jpeg 320x180"),
        (&png, "zenoh/bytes", None, "Png 320x180"),
        (&jpeg, "application/octet-stream", None, "Jpeg 320x180"),
        (&jpeg, "Image/JPEG;q=90", None, "Jpeg 320x180"),
        (&png, "image/jpeg", None, "undecodable"),
        (&jpeg, "image/png", None, "undecodable"),
        (&jpeg, "video/h264", None, "unknown_format"),
        (b"GIF89a", "", None, "unknown_format"),
        (b"", "image/jpeg", None, "undecodable"),
        (&[1; 18], "image/raw;rgb8", sent, "Rgb8 3x2"),
        (&[1; 17], "image/raw;rgb8", sent, "undecodable"),
        (&[1; 18], "image/raw;bgr8", sent, "Bgr8 3x2"),
        (&[1; 17], "image/raw;bgr8", sent, "undecodable"),
        (&[1; 24], "image/raw;rgba8", sent, "Rgba8 3x2"),
        (&[1; 23], "image/raw;rgba8", sent, "undecodable"),
        (&[1; 6], "image/raw;gray8", sent, "Gray8 3x2"),
        (&[1; 5], "image/raw;gray8", sent, "undecodable"),
        // 6 bytes of luma, and chroma rounded up to 2x1 pairs.
        (&[1; 10], "image/raw;nv12", sent, "Nv12 3x2"),
        (&[1; 9], "image/raw;nv12", sent, "undecodable"),
        (&[1; 18], "image/raw;rgb8", None, "unknown_format"),
        (&[1; 18], "image/raw;rgb8", no_height, "unknown_format"),
        (&[1; 18], "image/raw;p010", sent, "unknown_format"),
        (&[1; 18], "image/raw", sent, "unknown_format"),
        (&jpeg, "image/jpeg", later_version, "unknown_format"),
        (&jpeg, "image/jpeg", no_json, "unknown_format"),
    ];
    for (payload, encoding, attachment, expected) in cases {
        let is_sent = attachment == sent;
        let found = match read(payload, encoding, attachment) {
            Ok(frame) => {
                let facts = (frame.sequence, frame.time_ns, frame.clip.as_deref());
                let expected = if is_sent {
                    (4, 9, Some("drive"))
                } else {
                    (12, 77, None)
                };
                assert_eq!(facts, expected, "{encoding}");
                format!("{:?} {}", frame.picture.format, frame.picture.size)
            }
            Err((number, fault)) => {
                assert_eq!(number.seq, is_sent.then_some(4), "{encoding}: {fault}");
                fault.kind().to_owned()
            }
        };
        assert_eq!(found, expected, "{encoding} {attachment:?}");
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
    let pixels = changed(|limits| limits.max_pixels = 320 * 180 - 1);
    for limits in [payload, pixels] {
        for (file, encoding) in [(&jpeg, "image/jpeg"), (&png, "image/png")] {
            let sample = sample(file, encoding, None);
            let (_, fault) = read_as(sample, PayloadFormat::Encoding, &limits).unwrap_err();
            assert_eq!(fault.kind(), "oversized", "{fault:?}");
        }
    }
    // A PNG of 33 bytes that claims four billion by four billion pixels.
    let mut bomb = png[..33].to_vec();
    bomb[16..24].fill(0xFF);
    let (_, fault) = read(&bomb, "image/png", None).unwrap_err();
    assert_eq!(fault.kind(), "oversized");
}
