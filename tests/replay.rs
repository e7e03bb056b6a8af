//! `albireo replay` acts as a camera: every frame arrives, in order, with its number, time and clip.

use crate::support::{
    assert_contains, free_port, grey_jpeg, jpeg, listening_peer, script, test_video,
};
use albireo::cli::replay::{self, ReplayArguments, Sent};
use albireo_core::geometry::PictureSize;
use albireo_eval::footage::{Ffmpeg, FrameSource, Video, VideoEncoding};
use albireo_node::input::{Frame, PayloadFormat, RawSample, read_frame};
use albireo_vision::picture::FrameLimits;
use albireo_wire::{FrameAnswer, VERSION};
use clap::Parser;
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rstest::rstest;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::sync::mpsc::unbounded_channel;
use tokio_util::sync::CancellationToken;

#[derive(Parser)]
struct Command {
    #[command(flatten)]
    replay: ReplayArguments,
}

fn arguments(source: &Path, more: &str) -> ReplayArguments {
    let words = ["replay", source.to_str().unwrap()].into_iter().chain(more.split(' '));
    Command::parse_from(words).replay
}

/// Replays to a receiver that answers each frame as a node does, after `wait`, and returns all frames.
async fn replayed(source: &Path, more: &str, wait: Duration) -> (Vec<Frame>, Sent) {
    let (session, endpoint) = listening_peer().await;
    let queries = session.declare_queryable("albireo/node/front/frame");
    let queries = queries.complete(true).await.unwrap();
    let (sender, mut receiver) = unbounded_channel();
    tokio::spawn(async move {
        while let Ok(query) = queries.recv_async().await {
            let raw = RawSample::from(&query);
            let (_, frame) = read_frame(raw, PayloadFormat::Encoding, &FrameLimits::default());
            sender.send(frame.unwrap()).unwrap();
            tokio::time::sleep(wait).await;
            let answer = FrameAnswer {
                v: VERSION,
                refused: None,
            };
            let answer = serde_json::to_vec(&answer).unwrap();
            query.reply(query.key_expr(), answer).await.unwrap();
        }
    });
    let connect = format!("--connect {endpoint} --wait-for-subscriber --every {more}");
    let sent = replay::run(arguments(source, &connect), CancellationToken::new())
        .await
        .unwrap();
    let frames = std::iter::from_fn(|| receiver.try_recv().ok()).collect();
    (frames, sent)
}

/// Asserts that the frames arrived in order, have that size, and that time between them.
fn assert_in_order(frames: &[Frame], [width, height]: [u32; 2], period_ns: u64) {
    for (number, frame) in (0..).zip(frames) {
        assert_eq!(frame.sequence, number);
        assert_eq!(frame.picture.size, PictureSize::new(width, height));
        let after = frame.time_ns - frames[0].time_ns;
        assert!(after.abs_diff(number * period_ns) < 1000, "{after}");
    }
}

/// A folder of `count` JPEG files of 64x48 pixels.
fn pictures(count: u32) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for number in 0..count {
        let file = folder.path().join(format!("{number}.jpg"));
        std::fs::write(file, grey_jpeg(number as u8, [64, 48])).unwrap();
    }
    folder
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_folder_arrives_complete_in_order_and_with_its_clips() {
    let folder = pictures(12);
    let more = "--rate 200 --clip drive --clip-seconds 0.025";
    let (frames, sent) = replayed(folder.path(), more, Duration::ZERO).await;
    assert_eq!((sent.frames, sent.clips, frames.len()), (12, 3, 12));
    let bytes: usize = frames.iter().map(|frame| frame.picture.bytes.len()).sum();
    assert_eq!(sent.bytes, bytes as u64);
    assert_in_order(&frames, [64, 48], 5_000_000);
    for (number, frame) in frames.iter().enumerate() {
        assert_eq!(frame.picture.bytes, grey_jpeg(number as u8, [64, 48]));
        let clip = format!("drive-{:04}", number / 5 + 1);
        assert_eq!(frame.clip.as_deref(), Some(clip.as_str()));
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_slow_receiver_slows_down_the_sender_and_loses_nothing() {
    // 300 frames of several 100 kB: far more than the rings, queues and sockets hold.
    let folder = tempfile::tempdir().unwrap();
    let mut noise = vec![0_u8; 3 * 640 * 480];
    Pcg64Mcg::seed_from_u64(1).fill_bytes(&mut noise);
    std::fs::write(folder.path().join("noise.jpg"), jpeg(&noise, [640, 480])).unwrap();
    let more = "--rate max --loop --frames 300";
    let wait = Duration::from_millis(2);
    let (frames, sent) = replayed(folder.path(), more, wait).await;
    assert_eq!(sent.frames, 300);
    let sequence: Vec<u64> = frames.iter().map(|frame| frame.sequence).collect();
    assert_eq!(sequence, (0..300).collect::<Vec<_>>());
}

/// The error of a replay of that many frames.
async fn refusal(frames: u32, more: &str) -> String {
    let folder = pictures(frames);
    let error = replay::run(arguments(folder.path(), more), CancellationToken::new()).await;
    format!("{:#}", error.unwrap_err())
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_missing_subscriber_or_node_is_a_clear_error() {
    let (session, endpoint) = listening_peer().await;
    let error = refusal(1, &format!("--connect {endpoint} --wait-for-subscriber=1")).await;
    let nobody = "no node takes frames on `albireo/node/front/frame`";
    assert_contains(&error, &[nobody]);
    let _other = session.declare_subscriber("albireo/node/front/frame").await;
    let fast = format!("--connect {endpoint} --rate max");
    let error = refusal(3, &format!("{fast} --camera frnt")).await;
    assert_contains(&error, &["no node subscribed to `albireo/node/frnt/frame`"]);
    let folder = pictures(3);
    let sent = replay::run(arguments(folder.path(), &fast), CancellationToken::new()).await;
    assert_eq!(sent.unwrap().frames, 3);

    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let error = refusal(1, &format!("--connect {endpoint}")).await;
    assert_contains(&error, &[&endpoint, "is the node running"]);
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn frames_that_are_sent_after_the_node_has_left_are_counted() {
    let (session, endpoint) = listening_peer().await;
    let node = session.declare_subscriber("albireo/node/front/frame").await.unwrap();
    let folder = pictures(1);
    // Three seconds, of which the network needs a moment to tell the sender.
    let paced = "--wait-for-subscriber --rate 200 --loop --frames 600";
    let more = format!("--connect {endpoint} {paced}");
    let replay = replay::run(arguments(folder.path(), &more), CancellationToken::new());
    let leaving = async {
        for _ in 0..10 {
            node.recv_async().await.unwrap();
        }
        node.undeclare().await.unwrap();
    };
    let (sent, ()) = tokio::join!(replay, leaving);
    let sent = sent.unwrap();
    assert_eq!(sent.frames, 600);
    assert!((1..600).contains(&sent.lost), "{sent:?}");
}

/// Fake ffprobe and ffmpeg; `answer` is the script of ffmpeg.
fn stand_ins(folder: &Path, answer: &str) -> Ffmpeg {
    let stream = r#"{"streams":[{"avg_frame_rate":"0/0","r_frame_rate":"25/2","nb_frames":"2"}]}"#;
    Ffmpeg {
        ffprobe: script(folder, "ffprobe", &format!("echo '{stream}'")),
        ffmpeg: script(folder, "ffmpeg", answer),
    }
}

#[test]
fn video_frames_are_cut_from_the_output_of_ffmpeg_and_can_be_rewound() {
    let folder = tempfile::tempdir().unwrap();
    let pictures = [50, 200].map(|value| grey_jpeg(value, [64, 48]));
    let mut stream = Vec::new();
    for file in &pictures {
        let head = "--ffmpeg\r\nContent-type: image/jpeg\r\nContent-length: ";
        let head = format!("{head}{}\r\n\r\n", file.len());
        stream.extend([head.as_bytes(), file, b"\r\n"].concat());
    }
    let output = folder.path().join("stream");
    std::fs::write(&output, stream).unwrap();
    let programs = stand_ins(folder.path(), &format!("cat '{}'", output.display()));
    let mut video = Video::open("day/drive 1.mp4", None, VideoEncoding::Jpeg, programs).unwrap();
    assert_eq!(video.name(), "drive_1");
    assert_eq!((video.rate(), video.frames()), (12.5, Some(2)));
    for _ in 0..2 {
        for file in &pictures {
            assert_eq!(video.next().unwrap().unwrap().bytes, *file);
        }
        assert_eq!(video.next().unwrap(), None);
        video.rewind().unwrap();
    }
}

#[test]
fn a_video_of_which_frames_are_missing_says_how_many_were_read() {
    let folder = tempfile::tempdir().unwrap();
    let picture = grey_jpeg(50, [64, 48]);
    let head = format!(
        "--ffmpeg\r\nContent-type: image/jpeg\r\nContent-length: {}\r\n\r\n",
        picture.len()
    );
    let output = folder.path().join("stream");
    std::fs::write(&output, [head.as_bytes(), &picture, b"\r\n"].concat()).unwrap();
    let file = folder.path().join("a.avi");
    std::fs::write(&file, "half of a video").unwrap();
    for (said, expected) in [
        ("", "1 of 2 frames could be read"),
        (
            "echo 'partial file' >&2",
            "1 of 2 frames could be read; ffmpeg said: partial file",
        ),
    ] {
        let programs = tempfile::tempdir().unwrap();
        let answer = format!("cat '{}'\n{said}", output.display());
        let programs = stand_ins(programs.path(), &answer);
        let name = file.to_str().unwrap();
        let mut video = Video::open(name, None, VideoEncoding::Jpeg, programs).unwrap();
        assert!(video.next().unwrap().is_some());
        assert_eq!(video.next().unwrap(), None);
        assert_eq!(video.remarks(), [format!("{name}: {expected}")]);
        video.rewind().unwrap();
        assert_eq!(video.remarks(), [""; 0]);
    }
}

#[test]
fn a_failing_ffmpeg_is_quoted_and_a_missing_one_comes_with_how_to_install_it() {
    let folder = tempfile::tempdir().unwrap();
    let programs = stand_ins(folder.path(), "echo 'moov atom not found' >&2; exit 1");
    let mut video = Video::open("a.mp4", None, VideoEncoding::Jpeg, programs).unwrap();
    let text = format!("{:#}", video.next().unwrap_err());
    assert_contains(&text, &["a.mp4", "moov atom not found"]);

    let missing = Ffmpeg {
        ffprobe: folder.path().join("no-such-program"),
        ..Ffmpeg::default()
    };
    let error = Video::open("a.mp4", None, VideoEncoding::Jpeg, missing).unwrap_err();
    assert_contains(&error.to_string(), &["apt-get install ffmpeg"]);
}

#[test]
fn ffmpeg_is_killed_with_the_program_even_while_it_is_silent() {
    let folder = tempfile::tempdir().unwrap();
    let note = folder.path().join("pid");
    let answer = format!(
        "echo $$ > '{0}.new'; mv '{0}.new' '{0}'; exec tail -f /dev/null",
        note.display()
    );
    for is_stopped in [true, false] {
        let programs = stand_ins(folder.path(), &answer);
        let mut video = Video::open("a.mp4", None, VideoEncoding::Jpeg, programs).unwrap();
        let pid = loop {
            match std::fs::read_to_string(&note) {
                Ok(pid) => break pid.trim().to_owned(),
                Err(_) => std::thread::yield_now(),
            }
        };
        let process = PathBuf::from("/proc").join(&pid);
        assert!(process.exists());
        if is_stopped {
            let stop = video.stopper().unwrap();
            let reading = std::thread::spawn(move || video.next().unwrap());
            drop(stop);
            assert_eq!(reading.join().unwrap(), None);
        } else {
            drop(video);
        }
        assert!(!process.exists(), "process {pid} still runs");
        std::fs::remove_file(&note).unwrap();
    }
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_real_video_arrives_frame_by_frame() {
    let folder = tempfile::tempdir().unwrap();
    let file = test_video(folder.path(), "test.mp4", "rate=24:duration=2");
    for encoding in ["jpeg", "png"] {
        let more = format!("--rate max --encoding {encoding}");
        let (frames, sent) = replayed(&file, &more, Duration::ZERO).await;
        assert_eq!((sent.frames, sent.clips, frames.len()), (48, 1, 48));
        assert_in_order(&frames, [320, 180], 1_000_000_000 / 24);
        for frame in frames {
            assert_eq!(frame.picture.format.as_str(), encoding);
            assert_eq!(frame.clip.as_deref(), Some("test"));
        }
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_video_whose_pictures_change_their_size_loses_none() {
    let folder = tempfile::tempdir().unwrap();
    let mut stream = Vec::new();
    for (name, size) in [("1.ts", "320x180"), ("2.ts", "160x90"), ("3.ts", "320x180")] {
        let file = folder.path().join(name);
        let picture = format!("testsrc=size={size}:rate=10:duration=2");
        let mut ffmpeg = std::process::Command::new("ffmpeg");
        ffmpeg.args([
            "-v", "error", "-f", "lavfi", "-i", &picture, "-c:v", "libx264",
        ]);
        assert!(ffmpeg.arg(&file).status().unwrap().success());
        stream.extend(std::fs::read(file).unwrap());
    }
    let file = folder.path().join("changing.ts");
    std::fs::write(&file, stream).unwrap();
    for encoding in [VideoEncoding::Jpeg, VideoEncoding::Png] {
        let file = file.to_str().unwrap();
        let mut video = Video::open(file, None, encoding, Ffmpeg::default()).unwrap();
        let mut pictures = 0;
        while let Some(picture) = video.next().unwrap() {
            assert_eq!(picture.size, PictureSize::new(320, 180));
            pictures += 1;
        }
        assert_eq!(pictures, 60);
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_video_that_is_cut_short_says_so_and_one_that_leaves_out_frames_by_its_index_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let whole = test_video(folder.path(), "whole.mp4", "rate=10:duration=3");
    let remade = |name: &str, options: &[&str]| {
        let file = folder.path().join(name);
        let mut ffmpeg = std::process::Command::new("ffmpeg");
        ffmpeg.args(["-v", "error"]).args(options);
        ffmpeg.arg("-i").arg(&whole).args(["-c", "copy", "-movflags", "faststart"]);
        assert!(ffmpeg.arg(&file).status().unwrap().success());
        file
    };
    let remarks = |file: &Path| {
        let file = file.to_str().unwrap();
        let encoding = VideoEncoding::Jpeg;
        let mut video = Video::open(file, None, encoding, Ffmpeg::default()).unwrap();
        while video.next().unwrap().is_some() {}
        video.remarks()
    };
    let cut = remade("cut.mp4", &[]);
    let bytes = std::fs::read(&cut).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let said = remarks(&cut).join("");
    assert_contains(&said, &[" of 30 frames could be read; it is cut short: "]);
    assert_eq!(remarks(&remade("trimmed.mp4", &["-ss", "1"])), [""; 0]);
    assert_eq!(remarks(&whole), [""; 0]);
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_dashcams_folder_is_replayed_in_order_with_its_times_and_drives() {
    let folder = tempfile::tempdir().unwrap();
    for minute in ["080100", "080001", "080000"] {
        let name = format!("2026_1120_{minute}_F.MP4");
        test_video(folder.path(), &name, "rate=5:duration=1");
    }
    std::fs::write(folder.path().join("2026_1120_080002_F.MP4"), "").unwrap();
    let (frames, sent) = replayed(folder.path(), "--rate max", Duration::ZERO).await;
    assert_eq!((frames.len(), sent.clips, sent.left_out), (15, 2, 1));
    for (number, frame) in (0..).zip(&frames) {
        let (drive, begins) = if number < 10 {
            ("080000", 0)
        } else {
            ("080100", 60_000)
        };
        assert_eq!(
            frame.clip.as_deref(),
            Some(&*format!("2026_1120_{drive}_F"))
        );
        let after = (frame.time_ns - frames[0].time_ns) / 1_000_000;
        let expected = begins + number % 10 * 200;
        assert_eq!((frame.sequence, after), (number, expected));
    }
    // Front and rear are two cameras.
    test_video(folder.path(), "2026_1120_080000_R.MP4", "rate=5:duration=1");
    let both = replay::run(
        arguments(folder.path(), "--rate max"),
        CancellationToken::new(),
    );
    let refused = both.await.unwrap_err().to_string();
    assert_contains(&refused, &["4 front (", "1 rear (", "/*F.MP4"]);
    let rear = folder.path().join("*_r.mp4");
    let (frames, _) = replayed(&rear, "--rate max", Duration::ZERO).await;
    assert_eq!(frames.len(), 5);
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_picture_that_cannot_be_read_is_left_out_of_a_replay_and_counted() {
    let folder = pictures(3);
    std::fs::write(folder.path().join("1.jpg"), "no picture").unwrap();
    let (frames, sent) = replayed(folder.path(), "--rate max", Duration::ZERO).await;
    assert_eq!((frames.len(), sent.left_out), (2, 1));
}

#[rstest]
#[tokio::test(flavor = "multi_thread")]
async fn a_replay_of_which_nothing_can_be_sent_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("1.jpg"), "no picture").unwrap();
    let (_session, endpoint) = listening_peer().await;
    let more = format!("--connect {endpoint}");
    let ended = replay::run(arguments(folder.path(), &more), CancellationToken::new()).await;
    let error = ended.unwrap_err().to_string();
    assert_contains(&error, &["no picture in it can be sent"]);
}
