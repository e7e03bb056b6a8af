use super::*;

#[test]
fn an_unknown_version_is_rejected_with_its_number() {
    let error = read::<FrameAttachment>(br#"{"v":9,"seq":1}"#).unwrap_err();
    let expected = "message version 9 is not known here; this program reads version 1";
    assert_eq!(error.to_string(), expected);
    assert!(read::<FrameAttachment>(br#"{"seq":1}"#).is_err());
    assert!(read::<FrameAttachment>(b"\xff").is_err());
}

/// The batch that serves as the compression dictionary.
const EXAMPLE: &[u8] = include_bytes!("report/dictionary-1.json");

fn example() -> ReportBatch {
    read(EXAMPLE).unwrap()
}

#[test]
fn a_batch_survives_compression_unchanged() {
    let batch = example();
    assert_eq!(batch.reports.len(), 8);
    assert_eq!(batch.reports[0].id.get_version_num(), 7);
    for compression in [BatchCompression::Best, BatchCompression::Quick] {
        let payload = batch.to_payload(compression).unwrap();
        assert!(payload.len() < 1000, "{}", payload.len());
        assert_eq!(ReportBatch::from_payload(&payload).unwrap(), batch);
    }
    // Every field of the example is known: writing it again gives the same JSON.
    let value = |json: &[u8]| serde_json::from_slice::<serde_json::Value>(json).unwrap();
    assert_eq!(value(&serde_json::to_vec(&batch).unwrap()), value(EXAMPLE));
}

#[test]
fn a_decompression_bomb_is_rejected() {
    use std::io::Write;
    // The second one needs a window of 512 MiB to decompress.
    let spaces = vec![b' '; LARGEST_BATCH_BYTES + 1];
    for window in [None, Some(29)] {
        let mut bomb = zstd::Encoder::new(vec![REPORT_DICTIONARY], 3).unwrap();
        if let Some(window) = window {
            bomb.window_log(window).unwrap();
        }
        bomb.write_all(&spaces).unwrap();
        let error = decompress_batch(&bomb.finish().unwrap()).unwrap_err();
        match window {
            None => assert!(matches!(error, MessageError::TooLarge), "{error}"),
            Some(_) => assert!(matches!(error, MessageError::Compression(_)), "{error}"),
        }
    }
}

#[test]
fn a_corrupt_batch_and_an_unknown_dictionary_are_rejected() {
    let error = ReportBatch::from_payload(&[REPORT_DICTIONARY + 1, 0, 0]).unwrap_err();
    let expected = "compressed with dictionary 2; this program has dictionary 1";
    assert_eq!(error.to_string(), expected);
    assert!(ReportBatch::from_payload(&[]).is_err());
    let sent = example().to_payload(BatchCompression::Best).unwrap();
    let mut corrupt = sent.clone();
    let middle = corrupt.len() / 2;
    corrupt[middle] ^= 0x10;
    assert!(ReportBatch::from_payload(&corrupt).is_err());
    assert!(ReportBatch::from_payload(&sent[..middle]).is_err());
}

#[test]
fn unknown_fields_and_values_in_a_report_are_tolerated() {
    let mut json = serde_json::to_value(&example().reports[0]).unwrap();
    json["ended_by"] = "eclipse".into();
    json["energy"]["quality"] = "guessed".into();
    json["of_a_later_version"] = 7.into();
    json["target"]["speed"] = 3.into();
    let read: ClipReport = serde_json::from_value(json).unwrap();
    assert_eq!(read.ended_by, ClipEnd::Other);
    assert_eq!(read.target, None);
    assert_eq!(read.energy.quality, EnergyQuality::Unavailable);
}

#[test]
fn an_invalid_threshold_is_an_error_rather_than_none() {
    let camera = |threshold: &str| {
        let json = format!(
            r#"{{"name":"front","state":"never_seen","threshold_source":"local"{threshold}}}"#
        );
        serde_json::from_str::<CameraStatus>(&json).map(|camera| camera.threshold)
    };
    assert_eq!(camera("").unwrap(), None);
    let read = camera(r#","other":1,"threshold":{"name":"u","value":3e-4}"#).unwrap();
    assert_eq!(read, Some(Threshold::new("u", 3e-4)));
    assert!(camera(r#","threshold":{"name":"u","value":"x"}"#).is_err());
    assert!(camera(r#","threshold":3e-4"#).is_err());
}

#[test]
fn call_causes_serialise_by_name_and_unknown_ones_are_ignored() {
    let mut calls = DetectorCalls::default();
    for cause in CallCause::ALL {
        assert_eq!(CallCause::ALL[cause as usize], cause);
        assert_eq!(calls.get(cause), 0);
        calls.count(cause);
        assert_eq!(calls.get(cause), 1);
        assert_eq!(serde_json::to_value(cause).unwrap(), cause.as_str());
    }
    let json = serde_json::to_string(&calls).unwrap();
    assert_eq!(serde_json::from_str::<DetectorCalls>(&json).unwrap(), calls);
    let later = serde_json::from_str::<DetectorCalls>(r#"{"uncertain":3,"of_a_later_version":4}"#);
    let mut expected = DetectorCalls::default();
    for _ in 0..3 {
        expected.count(CallCause::Uncertain);
    }
    assert_eq!(later.unwrap(), expected);
}

#[test]
fn a_desired_setting_is_a_threshold_a_target_or_a_null_target() {
    let value = DesiredSetting::Threshold(Threshold::new("u", 5e-4));
    let half = DesiredSetting::Target(Some(Target::SkipRate(0.5)));
    for (setting, text) in [
        (value, r#"{"threshold":{"name":"u","value":0.0005}}"#),
        (half, r#"{"target":{"skip_rate":0.5}}"#),
        (DesiredSetting::Target(None), r#"{"target":null}"#),
    ] {
        let text = format!(r#"{{"v":1,"revision":7,"setting":{text}}}"#);
        let desired = Desired {
            revision: 7,
            setting: Some(setting),
            ..Desired::nothing()
        };
        assert_eq!(serde_json::to_string(&desired).unwrap(), text);
        assert_eq!(read::<Desired>(text.as_bytes()).unwrap(), desired);
    }
    assert!(read::<Desired>(br#"{"v":1,"revision":7,"setting":{"other":1}}"#).is_err());
}

#[test]
fn figures_are_rounded_to_significant_digits() {
    let rounded = |figure| significant(figure, 6);
    assert_eq!([1.912_345_678e-4, 0.0].map(rounded), [1.912_35e-4, 0.0]);
    assert!(rounded(f64::NAN).is_nan());
}

#[test]
fn a_position_that_cannot_be_right_says_why_and_leaves_the_frame() {
    let position = |json: &str| {
        let text = format!(r#"{{"v":1,"seq":7,"position":{json}}}"#);
        let attachment = read::<FrameAttachment>(text.as_bytes()).unwrap();
        assert_eq!(attachment.seq, Some(7));
        attachment.position()
    };
    assert_eq!(position("null"), None);
    let good = position(r#"{"latitude":-33.9,"longitude":18.4,"speed_m_s":8,"fix":3}"#);
    let expected = Position {
        latitude: -33.9,
        longitude: 18.4,
        speed_m_s: Some(8.0),
    };
    assert_eq!(good, Some(Ok(expected)));
    for (json, part) in [
        (
            r#"{"latitude":91,"longitude":0}"#,
            "latitude is 91, not from -90 to 90",
        ),
        (r#"{"latitude":0,"longitude":181}"#, "longitude is 181"),
        (
            r#"{"latitude":0,"longitude":0,"speed_m_s":-1}"#,
            "speed_m_s is -1",
        ),
        (r#"{"latitude":0}"#, "missing field `longitude`"),
        (r#""52.5,13.4""#, "invalid type"),
    ] {
        let reason = position(json).unwrap().unwrap_err();
        assert!(reason.contains(part), "{reason}");
    }
}

#[test]
fn sixty_points_of_a_way_add_a_third_of_a_kilobyte_to_a_compressed_report() {
    let mut batch = example();
    let before = batch.to_payload(BatchCompression::Best).unwrap().len();
    let reports = batch.reports.len();
    let mut place = [13.4_f64, 52.52];
    for (number, report) in batch.reports.iter_mut().enumerate() {
        let mut track = Vec::new();
        for at in 0..MOST_TRACK_POINTS {
            // A town's streets: forty metres on, with a turn now and then.
            let angle = ((number * MOST_TRACK_POINTS + at) as f64 * 0.7).sin() * 2.0;
            place[0] += 6e-4 * angle.cos();
            place[1] += 3.6e-4 * angle.sin();
            track.push(place.map(|degrees| (degrees * 1e5).round() / 1e5));
        }
        report.travel = Some(ClipTravel {
            distance_m: 2412.37,
            fastest_m_s: Some(13.9),
            bounds: [13.4, 52.52, 13.43, 52.54],
            track,
        });
    }
    let json = serde_json::to_vec(&batch.reports[0].travel).unwrap().len();
    let after = batch.to_payload(BatchCompression::Best).unwrap().len();
    let each = (after - before) / reports;
    assert!((1000..1400).contains(&json) && each < 400, "{json} {each}");
    println!("{json} bytes of JSON, {each} compressed");
}
