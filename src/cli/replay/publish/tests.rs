//! Pacing and clips under paused time.

use super::*;
use albireo_core::geometry::PictureSize;
use albireo_eval::error::EvalError;
use bytes::Bytes;
use std::sync::Mutex;

/// Pictures of one byte, numbered; with `halves`, cut into two clips.
struct Numbers {
    length: u8,
    at: u8,
    halves: bool,
}

impl FrameSource for Numbers {
    fn name(&self) -> &str {
        "numbers"
    }
    fn clip(&self) -> Option<&str> {
        let first = self.at <= self.length / 2;
        self.halves.then_some(if first { "day" } else { "night" })
    }
    fn rate(&self) -> f64 {
        10.0
    }
    fn frames(&self) -> Option<u64> {
        Some(u64::from(self.length))
    }
    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        if self.at == self.length {
            return Ok(None);
        }
        self.at += 1;
        Ok(Some(EncodedPicture {
            format: PictureFormat::Gray8,
            bytes: Bytes::from(vec![self.at - 1]),
            size: PictureSize::new(1, 1),
        }))
    }
    fn rewind(&mut self) -> Result<(), EvalError> {
        self.at = 0;
        Ok(())
    }
}

fn numbers(length: u8) -> Box<dyn FrameSource> {
    Box::new(Numbers {
        length,
        at: 0,
        halves: false,
    })
}

/// Everything sent, with the time since the start.
async fn played(
    length: u8,
    options: PublishOptions,
    slow: impl Fn(u64) -> Duration,
) -> (Vec<(Duration, OutgoingFrame)>, Sent) {
    let frames = Mutex::new(Vec::new());
    let start = Instant::now();
    let sent = play(
        numbers(length),
        &options,
        |frame: OutgoingFrame| {
            let (frames, wait) = (&frames, slow(frame.attachment.seq.unwrap()));
            async move {
                tokio::time::sleep(wait).await;
                frames.lock().unwrap().push((start.elapsed(), frame));
                Ok(None)
            }
        },
        |_| {},
        &CancellationToken::new(),
    )
    .await
    .unwrap();
    (frames.into_inner().unwrap(), sent)
}

fn at_once(_: u64) -> Duration {
    Duration::ZERO
}

#[tokio::test(start_paused = true)]
async fn frames_go_out_at_the_source_s_rate_or_a_given_one() {
    for (rate, period) in [(None, 100), (Some(Rate::PerSecond(4.0)), 250)] {
        let options = PublishOptions {
            rate,
            no_clip: true,
            first_sequence: 7,
            ..PublishOptions::default()
        };
        let (frames, sent) = played(5, options, at_once).await;
        assert_eq!((sent.frames, sent.bytes, sent.behind), (5, 5, 0));
        let first_time = frames[0].1.attachment.t_ns.unwrap();
        for (number, (when, frame)) in frames.iter().enumerate() {
            let expected = Duration::from_millis(period) * number as u32;
            assert!(
                when.abs_diff(expected) < Duration::from_millis(5),
                "{when:?}"
            );
            assert_eq!(frame.picture.bytes[0] as usize, number);
            assert_eq!(frame.attachment.seq, Some(7 + number as u64));
            let after = frame.attachment.t_ns.unwrap() - first_time;
            assert!(after.abs_diff(expected.as_nanos() as u64) < 1000);
            assert_eq!(frame.attachment.clip, None);
            // A raw picture gives its size.
            assert_eq!(frame.attachment.width, Some(1));
        }
    }
}

#[tokio::test(start_paused = true)]
async fn what_was_missed_is_not_made_up_for_in_a_burst() {
    // Frame 2 takes 450 ms at ten frames per second.
    let slow = |number| Duration::from_millis(if number == 2 { 450 } else { 0 });
    let (frames, sent) = played(6, PublishOptions::default(), slow).await;
    let when: Vec<u128> = frames
        .iter()
        .map(|(when, _)| (when.as_millis() + 5) / 10 * 10)
        .collect();
    assert_eq!(when, [0, 100, 650, 650, 750, 850]);
    assert_eq!(sent.behind, 1);
}

#[tokio::test(start_paused = true)]
async fn a_loop_begins_a_clip_with_each_pass_and_stops_when_enough_is_sent() {
    let options = PublishOptions {
        repeat: true,
        frames: Some(7),
        clip: Some("drive".to_owned()),
        ..PublishOptions::default()
    };
    let (frames, sent) = played(3, options, at_once).await;
    let clips: Vec<_> = frames
        .iter()
        .map(|(_, frame)| frame.attachment.clip.as_deref().unwrap())
        .collect();
    let [one, two, three] = ["drive-0001", "drive-0002", "drive-0003"];
    assert_eq!(clips, [one, one, one, two, two, two, three]);
    assert_eq!(sent.clips, 3);
    let sequence: Vec<_> = frames.iter().map(|(_, f)| f.attachment.seq).collect();
    assert_eq!(sequence, (0..7).map(Some).collect::<Vec<_>>());
}

#[tokio::test(start_paused = true)]
async fn a_clip_has_the_seconds_asked_for_at_any_speed() {
    for rate in [None, Some(Rate::Unpaced)] {
        let options = PublishOptions {
            rate,
            clip: Some("c".to_owned()),
            clip_seconds: Some(0.3),
            ..PublishOptions::default()
        };
        let (frames, sent) = played(7, options, at_once).await;
        let lengths: Vec<usize> = frames
            .chunk_by(|a, b| a.1.attachment.clip == b.1.attachment.clip)
            .map(<[_]>::len)
            .collect();
        assert_eq!(lengths, [3, 3, 1]);
        assert_eq!(sent.clips, 3);
    }
    let one = PublishOptions {
        clip: Some("c".to_owned()),
        ..PublishOptions::default()
    };
    let (frames, _) = played(2, one, at_once).await;
    assert_eq!(frames[1].1.attachment.clip.as_deref(), Some("c"));
}

#[tokio::test(start_paused = true)]
async fn the_clips_of_a_source_are_kept_apart() {
    for (clip, no_clip, repeat, expected) in [
        (None, false, false, ["day", "night", ""]),
        (None, false, true, ["day-0001", "night-0002", "day-0003"]),
        (
            Some("drive"),
            false,
            false,
            ["drive-0001", "drive-0002", ""],
        ),
        (None, true, true, ["", "", ""]),
    ] {
        let options = PublishOptions {
            repeat,
            frames: Some(10),
            clip: clip.map(str::to_owned),
            no_clip,
            ..PublishOptions::default()
        };
        let source = Box::new(Numbers {
            length: 8,
            at: 0,
            halves: true,
        });
        let clips = Mutex::new(Vec::new());
        let send = |frame: OutgoingFrame| {
            let clip = frame.attachment.clip.unwrap_or_default();
            clips.lock().unwrap().push(clip);
            async { Ok(None) }
        };
        let running = CancellationToken::new();
        let played = play(source, &options, send, |_| {}, &running);
        played.await.unwrap();
        let [one, two, three] = expected;
        let rest = if repeat { vec![three; 2] } else { Vec::new() };
        assert_eq!(
            clips.into_inner().unwrap(),
            [vec![one; 4], vec![two; 4], rest].concat()
        );
    }
}

#[tokio::test(start_paused = true)]
async fn shutdown_ends_a_play_that_would_never_end() {
    let shutdown = CancellationToken::new();
    let options = PublishOptions {
        repeat: true,
        ..PublishOptions::default()
    };
    let sent = play(
        numbers(3),
        &options,
        |_| async { Ok(None) },
        |sent| {
            if sent.frames == 20 {
                shutdown.cancel();
            }
        },
        &shutdown,
    )
    .await
    .unwrap();
    assert_eq!(sent.frames, 20);
}

#[tokio::test(start_paused = true)]
async fn an_empty_source_is_no_endless_loop() {
    let options = PublishOptions {
        repeat: true,
        ..PublishOptions::default()
    };
    let shutdown = CancellationToken::new();
    let error = play(
        numbers(0),
        &options,
        |_| async { Ok(None) },
        |_| {},
        &shutdown,
    )
    .await
    .unwrap_err();
    assert!(error.to_string().contains("no frames"));
}
