use super::super::tests::parse;
use super::*;
use albireo_core::geometry::PictureSize;
use albireo_eval::footage::Pictures;
use bytes::Bytes;
use std::path::Path;
use std::sync::Mutex;

/// Pictures of one byte, numbered.
fn numbers(length: u8) -> Box<dyn FrameSource> {
    let picture = |number| EncodedPicture {
        format: PictureFormat::Gray8,
        bytes: Bytes::from(vec![number]),
        size: PictureSize::new(1, 1),
        mount: None,
    };
    let pictures = (0..length).map(picture).collect();
    Box::new(Pictures::in_memory("numbers".to_owned(), pictures, 10.0))
}

fn options(arguments: &str) -> PublishOptions {
    parse(arguments).unwrap().options
}

struct Arrived {
    /// The time since the start.
    after: Duration,
    frame: OutgoingFrame,
}

/// Plays a source to a node that takes `slow` for each frame.
async fn played(
    source: Box<dyn FrameSource>,
    options: PublishOptions,
    slow: impl Fn(u64) -> Duration,
) -> (Vec<Arrived>, Sent) {
    let frames = Mutex::new(Vec::new());
    let start = Instant::now();
    let send = |frame: OutgoingFrame| {
        let frames = &frames;
        let wait = slow(frame.attachment.seq.unwrap());
        async move {
            tokio::time::sleep(wait).await;
            let after = start.elapsed();
            frames.lock().unwrap().push(Arrived { after, frame });
            Ok(None)
        }
    };
    let unwatched = |_: &Sent| {};
    let never = CancellationToken::new();
    let sent = publish(source, send, &options, unwatched, &never).await.unwrap();
    (frames.into_inner().unwrap(), sent)
}

#[tokio::test(start_paused = true)]
async fn frames_go_out_at_the_source_s_rate_or_a_given_one() {
    for (rate, period_ms) in [("", 100), ("--rate 4", 250)] {
        let (frames, sent) = played(numbers(5), options(rate), |_| Duration::ZERO).await;
        assert_eq!(sent.frames, 5);
        assert_eq!(sent.bytes, 5);
        assert_eq!(sent.behind, 0);
        for (number, Arrived { after, .. }) in (0_u32..).zip(&frames) {
            let expected = Duration::from_millis(period_ms) * number;
            let off = after.abs_diff(expected);
            assert!(off < Duration::from_millis(5), "{after:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_frame_has_its_time_in_the_recording_and_not_the_time_at_which_it_was_sent() {
    for (rate, period_ms) in [("", 100), ("--rate 4", 250)] {
        let (frames, _) = played(numbers(5), options(rate), |_| Duration::ZERO).await;
        let began_ns = frames[0].frame.attachment.t_ns.unwrap();
        for (number, Arrived { frame, .. }) in (0_u64..).zip(&frames) {
            let captured_ns = number * period_ms * 1_000_000;
            let found_ns = frame.attachment.t_ns.unwrap() - began_ns;
            assert!(found_ns.abs_diff(captured_ns) <= 1, "{found_ns}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_frame_has_its_picture_number_and_clip_and_a_raw_one_its_size() {
    let options = PublishOptions {
        first_sequence: 7,
        ..PublishOptions::default()
    };
    let (frames, _) = played(numbers(5), options, |_| Duration::ZERO).await;
    for (number, Arrived { frame, .. }) in (0_u8..).zip(&frames) {
        assert_eq!(&*frame.picture.bytes, [number]);
        assert_eq!(frame.attachment.seq, Some(7 + u64::from(number)));
        assert_eq!(frame.attachment.clip.as_deref(), Some("numbers"));
        assert_eq!(frame.attachment.width, Some(1));
        assert_eq!(frame.attachment.height, Some(1));
    }
}

#[tokio::test(start_paused = true)]
async fn what_was_missed_is_not_made_up_for_in_a_burst() {
    // At ten frames per second the node takes 450 ms for frame 2 alone.
    let slow = |number| {
        if number == 2 {
            Duration::from_millis(450)
        } else {
            Duration::ZERO
        }
    };
    let (frames, sent) = played(numbers(6), PublishOptions::default(), slow).await;
    let rounded_ms = |arrived: &Arrived| (arrived.after.as_millis() + 5) / 10 * 10;
    let times_ms: Vec<u128> = frames.iter().map(rounded_ms).collect();
    // Frame 2 arrives 450 ms after its time, 200 ms. Frame 3 is late by 350 ms and follows at once; the rest keep their
    // distance from it instead of following at once, too.
    assert_eq!(times_ms, [0, 100, 650, 650, 750, 850]);
    assert_eq!(sent.behind, 1);
}

/// The number of pictures, or the demonstration, whose folders are clips; the options; and the frames in each clip.
const CLIPS_OF_PLAYS: &str = "
3 --loop --frames 7 --clip drive: 3 drive-0001, 3 drive-0002, 1 drive-0003
7 --clip c --clip-seconds 0.3: 3 c-0001, 3 c-0002, 1 c-0003
7 --clip c --clip-seconds 0.3 --rate max: 3 c-0001, 3 c-0002, 1 c-0003
2 --clip c: 2 c
road --frames 230: 221 busy, 9 sparse
road --frames 1100 --loop: 221 busy-0001, 681 sparse-0002, 116 two-near-0003, 76 empty-then-car-0004, 6 busy-0005
road --frames 230 --clip drive: 221 drive-0001, 9 drive-0002
road --frames 90 --loop --no-clip: 90 none
";

#[tokio::test(start_paused = true)]
async fn clips_are_passes_lengths_of_time_or_those_of_the_source() {
    for case in CLIPS_OF_PLAYS.trim().lines() {
        let (played_with, expected) = case.split_once(": ").unwrap();
        let (pictures, arguments) = played_with.split_once(' ').unwrap();
        let source: Box<dyn FrameSource> = match pictures {
            "road" => Box::new(Pictures::of_archive(Path::new("demo/road.tar"), 10.0).unwrap()),
            count => numbers(count.parse().unwrap()),
        };
        let (frames, sent) = played(source, options(arguments), |_| Duration::ZERO).await;
        let sequence = frames.iter().map(|arrived| arrived.frame.attachment.seq);
        assert!(sequence.eq((0..sent.frames).map(Some)), "{case}");
        let clips: Vec<_> =
            frames.iter().map(|arrived| arrived.frame.attachment.clip.as_deref()).collect();
        let found: Vec<_> = clips
            .chunk_by(|a, b| a == b)
            .map(|clip| format!("{} {}", clip.len(), clip[0].unwrap_or("none")))
            .collect();
        assert_eq!(found.join(", "), expected, "{case}");
        let has_clips = clips[0].is_some();
        let expected_clips = if has_clips { found.len() as u64 } else { 0 };
        assert_eq!(sent.clips, expected_clips, "{case}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_loop_ends_at_the_shutdown() {
    let unheard = |_: OutgoingFrame| async { Ok(None) };
    let shutdown = CancellationToken::new();
    let stop = |sent: &Sent| {
        if sent.frames == 20 {
            shutdown.cancel();
        }
    };
    let sent = publish(numbers(3), unheard, &options("--loop"), stop, &shutdown).await;
    assert_eq!(sent.unwrap().frames, 20);
}

#[tokio::test(start_paused = true)]
async fn a_loop_without_frames_is_refused() {
    let unheard = |_: OutgoingFrame| async { Ok(None) };
    let unwatched = |_: &Sent| {};
    let never = CancellationToken::new();
    let nothing = publish(numbers(0), unheard, &options("--loop"), unwatched, &never).await;
    assert!(nothing.unwrap_err().to_string().contains("no frames"));
}

#[test]
fn what_is_left_out_for_one_reason_is_named_at_first_and_then_counted() {
    let mut told = Told::default();
    let mut named = 0;
    for number in 1..=300 {
        let name = format!("a.mcap:/front, picture {number}");
        let fault = format!("{name}: it is H.264");
        let Some(ReadItem::LeftOut(said)) = told.left_out(&name, &fault) else {
            panic!("{name} is not left out");
        };
        named += u64::from(said.is_some());
        assert!(told.left_out(&name, &fault).is_none());
    }
    assert_eq!(named, NAMED);
    let other = told.left_out("b.jpg", "b.jpg: it is empty");
    assert!(matches!(other, Some(ReadItem::LeftOut(Some(_)))));
}

#[test]
fn a_remark_is_told_once_and_only_a_few_are() {
    let mut told = Told::default();
    let mut remarks = Vec::new();
    for number in 0..100 {
        let said = format!("a.mp4: {} of 30 frames could be read", number / 2);
        if let Some(ReadItem::Remark(remark)) = told.remark(said) {
            remarks.push(remark);
        }
    }
    assert_eq!(remarks.len() as u64, NAMED);
    assert!(remarks[0].starts_with("a.mp4: 0 of 30"), "{remarks:?}");
    assert!(remarks[4].ends_with("are not told)"), "{remarks:?}");
}

#[tokio::test(start_paused = true)]
async fn a_broken_picture_is_counted_once_however_often_the_folder_is_played() {
    let folder = tempfile::tempdir().unwrap();
    let mut road = Pictures::of_archive(Path::new("demo/road.tar"), 10.0).unwrap();
    let picture = road.next().unwrap().unwrap();
    std::fs::write(folder.path().join("1.jpg"), &picture.bytes).unwrap();
    std::fs::write(folder.path().join("2.jpg"), "not a picture").unwrap();
    let source = Box::new(Pictures::of_folder(folder.path(), 10.0).unwrap());
    let (_, sent) = played(source, options("--loop --frames 4"), |_| Duration::ZERO).await;
    assert_eq!(sent.frames, 4);
    assert_eq!(sent.left_out, 1);
}
