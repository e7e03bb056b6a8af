//! Pacing and clips under paused time.

use super::*;
use albireo_core::geometry::PictureSize;
use albireo_eval::error::EvalError;
use bytes::Bytes;
use clap::Parser;
use std::sync::Mutex;

/// Pictures of one byte, numbered. Eight of them are cut into two clips.
struct Numbers {
    length: u8,
    at: u8,
}

impl FrameSource for Numbers {
    fn name(&self) -> &str {
        "numbers"
    }
    fn clip(&self) -> Option<&str> {
        let first = self.at <= self.length / 2;
        (self.length == 8).then_some(if first { "day" } else { "night" })
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
    Box::new(Numbers { length, at: 0 })
}

#[derive(Parser)]
struct Command {
    #[command(flatten)]
    options: PublishOptions,
}

fn options(arguments: &str) -> PublishOptions {
    let words = arguments.split_whitespace();
    Command::parse_from(["play"].into_iter().chain(words)).options
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
    for (rate, period) in [("", 100), ("--rate 4", 250)] {
        let options = PublishOptions {
            first_sequence: 7,
            ..options(rate)
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

/// The length of the source, the options, and the number of frames in each clip.
const CLIPS: &str = "
3 --loop --frames 7 --clip drive: 3 drive-0001, 3 drive-0002, 1 drive-0003
7 --clip c --clip-seconds 0.3: 3 c-0001, 3 c-0002, 1 c-0003
7 --clip c --clip-seconds 0.3 --rate max: 3 c-0001, 3 c-0002, 1 c-0003
2 --clip c: 2 c
8 --frames 10: 4 day, 4 night
8 --frames 10 --loop: 4 day-0001, 4 night-0002, 2 day-0003
8 --frames 10 --clip drive: 4 drive-0001, 4 drive-0002
8 --frames 10 --loop --no-clip: 10 none
";

#[tokio::test(start_paused = true)]
async fn clips_are_passes_lengths_of_time_or_those_of_the_source() {
    for case in CLIPS.trim().lines() {
        let (played_with, expected) = case.split_once(": ").unwrap();
        let (length, arguments) = played_with.split_once(' ').unwrap();
        let length = length.parse().unwrap();
        let (frames, sent) = played(length, options(arguments), at_once).await;
        let sequence = frames.iter().map(|(_, frame)| frame.attachment.seq);
        assert!(sequence.eq((0..sent.frames).map(Some)), "{case}");
        let clips: Vec<_> = (frames.iter())
            .map(|(_, frame)| frame.attachment.clip.as_deref())
            .collect();
        let found: Vec<_> = clips
            .chunk_by(|a, b| a == b)
            .map(|clip| format!("{} {}", clip.len(), clip[0].unwrap_or("none")))
            .collect();
        assert_eq!(found.join(", "), expected);
        let begun = clips[0].map_or(0, |_| found.len() as u64);
        assert_eq!(sent.clips, begun, "{case}");
    }
}

#[tokio::test(start_paused = true)]
async fn shutdown_ends_a_play_that_would_never_end() {
    let shutdown = CancellationToken::new();
    let sent = play(
        numbers(3),
        &options("--loop"),
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
    let shutdown = CancellationToken::new();
    let error = play(
        numbers(0),
        &options("--loop"),
        |_| async { Ok(None) },
        |_| {},
        &shutdown,
    )
    .await
    .unwrap_err();
    assert!(error.to_string().contains("no frames"));
}
