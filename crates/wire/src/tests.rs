use super::*;
use albireo_core::policy::FrameState;

#[test]
fn an_unknown_version_is_refused_by_name() {
    let error = read::<FrameAttachment>(br#"{"v":9,"seq":1}"#).unwrap_err();
    assert_eq!(
        error.to_string(),
        "message version 9 is not known here; this program reads version 1"
    );
    assert!(read::<FrameAttachment>(br#"{"seq":1}"#).is_err());
    assert!(read::<FrameAttachment>(b"\xff").is_err());
}

#[test]
fn the_five_states_add_up() {
    let mut states = FrameStates::default();
    for state in FrameState::ALL {
        states.count(state);
        assert_eq!(states.get(state), 1);
    }
    assert_eq!(states.frames(), 5);
    assert!((states.skip_rate(0) - 0.4).abs() < 1e-12);
}

#[test]
fn a_batch_comes_back_as_it_was_sent_and_a_bomb_is_refused() {
    let batch = ReportBatch {
        v: VERSION,
        node: "car-7".into(),
        instance: "0123456789abcdef0123456789abcdef".into(),
        machine: None,
        first: 4,
        last: 4,
        lost: 0,
        reports: Vec::new(),
    };
    for compression in [BatchCompression::Best, BatchCompression::Quick] {
        let payload = batch.to_payload(compression).unwrap();
        let error = ReceivedBatch::from_payload(&payload).unwrap_err();
        assert_eq!(error.to_string(), "no reports");
    }

    // One that is too large; and one that wants a window of half a gigabyte before it says anything.
    let spaces = vec![b' '; LARGEST_BATCH_BYTES as usize + 1];
    for window in [None, Some(29)] {
        let mut bomb = zstd::Encoder::new(vec![REPORT_DICTIONARY], 3).unwrap();
        if let Some(window) = window {
            bomb.window_log(window).unwrap();
        }
        std::io::Write::write_all(&mut bomb, &spaces).unwrap();
        let error = ReceivedBatch::from_payload(&bomb.finish().unwrap()).unwrap_err();
        match window {
            None => assert!(matches!(error, BatchError::TooLarge), "{error}"),
            Some(_) => assert!(matches!(error, BatchError::Compression(_)), "{error}"),
        }
    }
}

#[test]
fn a_batch_against_a_dictionary_of_a_later_version_is_refused_by_its_number() {
    let error = ReceivedBatch::from_payload(&[REPORT_DICTIONARY + 1, 0, 0]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "compressed with dictionary 2; this program has dictionary 1"
    );
    assert!(ReceivedBatch::from_payload(&[]).is_err());
}

#[test]
fn every_report_of_the_dictionary_is_one_and_a_damaged_payload_is_refused() {
    let batch = include_bytes!("report/dictionary-1.json");
    let payload = compressed(batch);
    let batch = ReceivedBatch::from_payload(&payload).unwrap();
    assert_eq!((batch.first, batch.last), (1204, 1211));
    assert_eq!(batch.reports.len(), 8);
    for raw in &batch.reports {
        let report: ClipReport = read(raw.get().as_bytes()).unwrap();
        // Nothing in it is passed over in silence: each field of the message is there again.
        let again = serde_json::to_string(&report).unwrap();
        let value = |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap();
        assert_eq!(value(&again), value(raw.get()));
    }
    let batch = ReportBatch {
        v: VERSION,
        node: batch.node,
        instance: batch.instance,
        machine: batch.machine,
        first: batch.first,
        last: batch.last,
        lost: batch.lost,
        reports: (batch.reports.iter())
            .map(|raw| read(raw.get().as_bytes()).unwrap())
            .collect(),
    };
    let payload = batch.to_payload(BatchCompression::Best).unwrap();
    let middle = payload.len() / 2;
    assert!(ReceivedBatch::from_payload(&payload[..middle]).is_err());
    let mut damaged = payload;
    damaged[middle] ^= 0x10;
    assert!(ReceivedBatch::from_payload(&damaged).is_err());
}

/// A payload of any JSON. What was compressed without the dictionary can be read with it.
fn compressed(json: &[u8]) -> Vec<u8> {
    let frame = zstd::encode_all(json, 3).unwrap();
    [&[REPORT_DICTIONARY], &frame[..]].concat()
}

#[test]
fn a_report_that_cannot_be_read_does_not_make_its_batch_unreadable() {
    let json =
        br#"{"v":1,"node":"n","instance":"0123456789abcdef0123456789abcdef","first":0,"last":1,
        "reports":[{"v":1},{"whatever":[1,2]}]}"#;
    let batch = ReceivedBatch::from_payload(&compressed(json)).unwrap();
    assert_eq!(batch.reports.len(), 2);
    assert!(read::<ClipReport>(batch.reports[1].get().as_bytes()).is_err());
}

#[test]
fn a_threshold_that_cannot_be_read_is_not_taken_for_none() {
    let camera = |threshold: &str| {
        let json = format!(
            r#"{{"name":"front","state":"never_seen","threshold_source":"local"{threshold}}}"#
        );
        serde_json::from_str::<CameraStatus>(&json).map(|camera| camera.threshold)
    };
    assert_eq!(camera("").unwrap(), None);
    assert_eq!(
        camera(r#","other":1,"threshold":{"name":"u","value":3e-4}"#).unwrap(),
        Some(Threshold::new("u", 3e-4))
    );
    assert!(camera(r#","threshold":{"name":"u","value":"x"}"#).is_err());
    assert!(camera(r#","threshold":3e-4"#).is_err());
}

#[test]
fn a_batch_over_all_numbers_there_are_does_not_overflow() {
    let json = format!(
        r#"{{"v":1,"node":"n","instance":"0123456789abcdef0123456789abcdef","first":0,"last":{},"reports":[{{"v":1}}]}}"#,
        u64::MAX
    );
    assert!(ReceivedBatch::from_payload(&compressed(json.as_bytes())).is_ok());
}

#[test]
fn calls_by_cause_are_named_as_in_the_message_of_a_frame_and_survive_a_later_version() {
    let mut calls = DetectorCalls::default();
    for cause in CallCause::ALL {
        assert_eq!(CallCause::ALL[cause as usize], cause);
        assert_eq!(calls.get(cause), 0);
        calls.count(cause);
        assert_eq!(calls.get(cause), 1);
        assert_eq!(
            serde_json::to_value(cause).unwrap(),
            serde_json::Value::from(cause.as_str())
        );
    }
    let json = serde_json::to_string(&calls).unwrap();
    assert_eq!(serde_json::from_str::<DetectorCalls>(&json).unwrap(), calls);
    let later: DetectorCalls =
        serde_json::from_str(r#"{"uncertain":3,"of_a_later_version":4}"#).unwrap();
    assert_eq!((later.get(CallCause::Uncertain), later.total()), (3, 3));
}

#[test]
fn a_desired_setting_is_a_threshold_a_target_or_no_target() {
    for (setting, text) in [
        (
            DesiredSetting::Threshold(Threshold::new("u", 5e-4)),
            r#"{"v":1,"revision":7,"setting":{"threshold":{"name":"u","value":0.0005}}}"#,
        ),
        (
            DesiredSetting::Target(Some(Target::SkipRate(0.5))),
            r#"{"v":1,"revision":7,"setting":{"target":{"skip_rate":0.5}}}"#,
        ),
        (
            DesiredSetting::Target(None),
            r#"{"v":1,"revision":7,"setting":{"target":null}}"#,
        ),
    ] {
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
