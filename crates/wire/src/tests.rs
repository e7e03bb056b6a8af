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
    for compression in [BatchCompression::Gzip, BatchCompression::Dictionary] {
        let payload = batch.to_payload(compression).unwrap();
        let error = ReceivedBatch::from_payload(&payload).unwrap_err();
        assert_eq!(error.to_string(), "no reports");
    }

    use std::io::Write;
    let mut bomb = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    bomb.write_all(&vec![b' '; LARGEST_BATCH_BYTES as usize + 1])
        .unwrap();
    let error = ReceivedBatch::from_payload(&bomb.finish().unwrap()).unwrap_err();
    assert!(matches!(error, BatchError::TooLarge), "{error}");

    // The same without gzip; and one that wants a window of half a gigabyte before it says anything.
    let spaces = vec![b' '; LARGEST_BATCH_BYTES as usize + 1];
    for window in [None, Some(29)] {
        let mut bomb = zstd::Encoder::new(vec![REPORT_DICTIONARY], 3).unwrap();
        if let Some(window) = window {
            bomb.window_log(window).unwrap();
        }
        bomb.write_all(&spaces).unwrap();
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
        "compressed with dictionary 2; this program has those up to 1"
    );
    assert!(ReceivedBatch::from_payload(&[]).is_err());
    for (known, wanted) in [
        (None, BatchCompression::Gzip),
        (Some(0), BatchCompression::Gzip),
        (Some(1), BatchCompression::Dictionary),
        (Some(7), BatchCompression::Dictionary),
    ] {
        assert_eq!(BatchCompression::for_hub(known), wanted);
    }
}

/// As a node sent it when the dictionary was new: it must be read for ever.
#[test]
fn a_batch_of_the_first_dictionary_is_read_and_a_spoilt_one_is_refused() {
    let sent = include_bytes!("report/batch-1.zst");
    let batch = ReceivedBatch::from_payload(sent).unwrap();
    assert_eq!((batch.first, batch.last, batch.reports.len()), (1, 2, 2));
    for raw in &batch.reports {
        let report: ClipReport = read(raw.get().as_bytes()).unwrap();
        assert_eq!(report.node, "demo");
    }
    let mut spoilt = sent.to_vec();
    let middle = spoilt.len() / 2;
    spoilt[middle] ^= 0x10;
    assert!(ReceivedBatch::from_payload(&spoilt).is_err());
    assert!(ReceivedBatch::from_payload(&sent[..middle]).is_err());
}

#[test]
fn a_report_that_cannot_be_read_does_not_make_its_batch_unreadable() {
    use std::io::Write;
    let json =
        br#"{"v":1,"node":"n","instance":"0123456789abcdef0123456789abcdef","first":0,"last":1,
        "reports":[{"v":1},{"whatever":[1,2]}]}"#;
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gzip.write_all(json).unwrap();
    let batch = ReceivedBatch::from_payload(&gzip.finish().unwrap()).unwrap();
    assert_eq!(batch.reports.len(), 2);
    assert!(read::<ClipReport>(batch.reports[1].get().as_bytes()).is_err());
}

#[test]
fn a_knob_that_cannot_be_read_is_not_taken_for_none() {
    let camera = |knob: &str| {
        let json =
            format!(r#"{{"name":"front","state":"never_seen","knob_source":"local"{knob}}}"#);
        serde_json::from_str::<CameraStatus>(&json).map(|camera| camera.knob.map(|knob| knob.value))
    };
    assert_eq!(camera("").unwrap(), None);
    assert_eq!(camera(r#","other":1,"u":3e-4"#).unwrap(), Some(3e-4));
    assert!(camera(r#","u":"x""#).is_err());
    let error = camera(r#","u":1e-4,"lambda":0.3"#).unwrap_err();
    assert!(
        error.to_string().starts_with("more than one knob"),
        "{error}"
    );
}

#[test]
fn a_batch_over_all_numbers_there_are_does_not_overflow() {
    use std::io::Write;
    let json = format!(
        r#"{{"v":1,"node":"n","instance":"0123456789abcdef0123456789abcdef","first":0,"last":{},"reports":[{{"v":1}}]}}"#,
        u64::MAX
    );
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gzip.write_all(json.as_bytes()).unwrap();
    assert!(ReceivedBatch::from_payload(&gzip.finish().unwrap()).is_ok());
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
fn what_is_desired_has_three_forms_and_a_program_that_knows_one_finds_no_value_in_the_others() {
    /// As 0.1.0 reads it.
    #[derive(serde::Deserialize)]
    struct Before {
        generation: u64,
        #[serde(default)]
        knob: Option<KnobValue>,
    }
    let u = KnobValue {
        name: "u",
        value: 5e-4,
    };
    let desired = |change: &dyn Fn(&mut Desired)| {
        let mut desired = Desired {
            generation: 7,
            ..Desired::nothing()
        };
        change(&mut desired);
        desired
    };
    for (desired, text, knob) in [
        (
            desired(&|d| d.knob = Some(u)),
            r#"{"v":1,"generation":7,"knob":{"u":0.0005}}"#,
            Some(u),
        ),
        (
            desired(&|d| d.target = Some(Target::SkipRate(0.5))),
            r#"{"v":1,"generation":7,"target":{"skip_rate":0.5}}"#,
            None,
        ),
        (
            desired(&|d| d.hold_nothing = true),
            r#"{"v":1,"generation":7,"hold_nothing":true}"#,
            None,
        ),
    ] {
        assert_eq!(serde_json::to_string(&desired).unwrap(), text);
        assert_eq!(read::<Desired>(text.as_bytes()).unwrap(), desired);
        let before: Before = read(text.as_bytes()).unwrap();
        assert_eq!((before.generation, before.knob), (7, knob));
    }
}

#[test]
fn a_status_tells_what_is_held_and_one_of_the_version_before_that_it_knows_no_targets() {
    let text = include_str!("../../../tests/fixtures/messages/0.1.0/status-full.json");
    let mut status: StatusMessage = read(text.as_bytes()).unwrap();
    let full = status.full.as_mut().unwrap();
    assert_eq!((full.takes_targets, full.target), (false, None));
    let before = serde_json::to_value(&*full).unwrap();
    full.takes_targets = true;
    full.target_off = Some("the knob was set by hand".to_owned());
    full.target = Some(TargetStatus {
        target: Target::Recall(0.9),
        source: KnobSource::Hub,
        standing: Some(Standing::CannotBeMet),
        actual: Some(0.8),
    });
    let now = serde_json::to_value(&*full).unwrap();
    let mut added: Vec<_> = (now.as_object().unwrap().iter())
        .filter(|(name, _)| before.get(name.as_str()).is_none())
        .map(|(name, value)| format!("{name} {value}"))
        .collect();
    // Whether a map keeps its order is a feature of the library that others may switch on.
    added.sort_unstable();
    assert_eq!(
        added,
        [
            "takes_targets true",
            r#"target {"actual":0.8,"source":"hub","standing":"cannot_be_met","target":{"recall":0.9}}"#,
            r#"target_off "the knob was set by hand""#,
        ]
    );
}
