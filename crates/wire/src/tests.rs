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

/// The batch that batches are compressed against.
const EXAMPLE: &[u8] = include_bytes!("report/dictionary-1.json");

fn example() -> ReportBatch {
    read(EXAMPLE).unwrap()
}

#[test]
fn a_batch_comes_back_as_it_was_sent() {
    let batch = example();
    assert_eq!(batch.reports.len(), 8);
    assert_eq!(batch.reports[0].id.get_version_num(), 7);
    for compression in [BatchCompression::Best, BatchCompression::Quick] {
        let payload = batch.to_payload(compression).unwrap();
        assert!(payload.len() < 1000, "{}", payload.len());
        assert_eq!(ReportBatch::from_payload(&payload).unwrap(), batch);
    }
    // Nothing in the example is passed over in silence: each field of it is there again.
    let value = |json: &[u8]| serde_json::from_slice::<serde_json::Value>(json).unwrap();
    assert_eq!(value(&serde_json::to_vec(&batch).unwrap()), value(EXAMPLE));
}

#[test]
fn a_bomb_is_refused() {
    use std::io::Write;
    // And one that wants a window of half a gigabyte before it says anything.
    let spaces = vec![b' '; LARGEST_BATCH_BYTES + 1];
    for window in [None, Some(29)] {
        let mut bomb = zstd::Encoder::new(vec![REPORT_DICTIONARY], 3).unwrap();
        if let Some(window) = window {
            bomb.window_log(window).unwrap();
        }
        bomb.write_all(&spaces).unwrap();
        let error = decompress_batch(&bomb.finish().unwrap()).unwrap_err();
        match window {
            None => assert!(matches!(error, BatchError::TooLarge), "{error}"),
            Some(_) => assert!(matches!(error, BatchError::Compression(_)), "{error}"),
        }
    }
}

#[test]
fn a_corrupt_batch_and_one_of_another_dictionary_are_rejected() {
    let error = ReportBatch::from_payload(&[REPORT_DICTIONARY + 1, 0, 0]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "compressed with dictionary 2; this program has dictionary 1"
    );
    assert!(ReportBatch::from_payload(&[]).is_err());
    let sent = example().to_payload(BatchCompression::Best).unwrap();
    let mut corrupt = sent.clone();
    let middle = corrupt.len() / 2;
    corrupt[middle] ^= 0x10;
    assert!(ReportBatch::from_payload(&corrupt).is_err());
    assert!(ReportBatch::from_payload(&sent[..middle]).is_err());
}

#[test]
fn a_report_of_a_later_version_is_read_as_far_as_it_is_known() {
    let report = &example().reports[0];
    let mut json = serde_json::to_value(report).unwrap();
    json["ended_by"] = "eclipse".into();
    json["energy"]["quality"] = "guessed".into();
    json["of_a_later_version"] = 7.into();
    let read: ClipReport = serde_json::from_value(json).unwrap();
    assert_eq!(read.ended_by, ClipEnd::Other);
    assert_eq!(read.energy.quality, EnergyQuality::Unavailable);
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
