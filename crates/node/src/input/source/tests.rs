//! Cameras with faults, opened with the real ffmpeg.

mod http;
mod rtsp;

use super::{LiveSource, SourceAddress, SourceEvent, SourceSettings};
use crate::config::CameraConfig;
use crate::input::arrivals::{ArrivalCounts, Arrivals};
use albireo_core::geometry::PictureSize;
use albireo_vision::picture::{EncodedPicture, FrameLimits};
use rtsp::{Camera, Faults, RATE, film};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

/// The longest wait for an event.
const PATIENCE: Duration = Duration::from_secs(90);

/// A picture that arrived.
struct Taken {
    picture: EncodedPicture,
    is_broken: bool,
}

/// Pictures per second.
struct Rates {
    /// Those that were taken.
    taken: f64,
    /// Those that came.
    came: f64,
}

/// A source that is open, and what came from it.
struct Open {
    events: UnboundedReceiver<SourceEvent>,
    arrivals: Arc<Arrivals>,
    stop: CancellationToken,
    running: JoinHandle<()>,
}

impl Open {
    async fn new(camera: CameraConfig) -> Self {
        Self::with(camera.source_settings(FrameLimits::default()).unwrap()).await
    }

    async fn with(settings: SourceSettings) -> Self {
        let found = tokio::task::spawn_blocking(move || LiveSource::find(settings));
        let arrivals = Arc::new(Arrivals::default());
        let source = found.await.unwrap().unwrap().counting(Arc::clone(&arrivals));
        let (sender, events) = unbounded_channel();
        let stop = CancellationToken::new();
        let stopped = stop.clone();
        let each = move |event| drop(sender.send(event));
        let running = tokio::spawn(async move { source.run(each, stopped).await.unwrap() });
        Self {
            events,
            arrivals,
            stop,
            running,
        }
    }

    async fn at(address: &str) -> Self {
        Self::new(camera(address)).await
    }

    async fn next(&mut self) -> SourceEvent {
        let event = tokio::time::timeout(PATIENCE, self.events.recv()).await;
        event.expect("nothing comes").unwrap()
    }

    /// The next pictures; nothing may fail.
    async fn pictures(&mut self, count: usize) -> Vec<Taken> {
        let mut pictures = Vec::new();
        while pictures.len() < count {
            match self.next().await {
                SourceEvent::Picture(picture) => pictures.push(Taken {
                    picture: picture.picture.unwrap(),
                    is_broken: picture.is_broken,
                }),
                SourceEvent::PassedOver(file) => panic!("passed over {file}"),
                SourceEvent::Failed { reason, .. } => panic!("it failed: {reason}"),
            }
        }
        pictures
    }

    /// Why it fails, and the pause after it.
    async fn failure(&mut self) -> (String, Duration) {
        loop {
            if let SourceEvent::Failed { reason, pause } = self.next().await {
                return (reason, pause);
            }
        }
    }

    /// The rates over `time`, soon after the first picture.
    async fn rates(&mut self, time: Duration) -> Rates {
        self.pictures(1).await;
        // What came while ffmpeg looked at the stream comes at once.
        let burst = Instant::now() + Duration::from_secs(3);
        while timeout_at(burst, self.events.recv()).await.is_ok() {}
        let begun = Instant::now();
        let before = self.arrivals.now();
        let mut taken = 0;
        while let Ok(event) = timeout_at(begun + time, self.events.recv()).await {
            match event.unwrap() {
                SourceEvent::Picture(_) => taken += 1,
                SourceEvent::PassedOver(file) => panic!("passed over {file}"),
                SourceEvent::Failed { reason, .. } => panic!("it failed: {reason}"),
            }
        }
        let came = self.arrivals.now().frames - before.frames;
        let seconds = begun.elapsed().as_secs_f64();
        Rates {
            taken: f64::from(taken) / seconds,
            came: came as f64 / seconds,
        }
    }

    async fn stop(self) -> ArrivalCounts {
        self.stop.cancel();
        self.running.await.unwrap();
        self.arrivals.now()
    }
}

fn camera(address: &str) -> CameraConfig {
    CameraConfig {
        source: Some(SourceAddress::new(address)),
        ..CameraConfig::named("gate")
    }
}

const BOXES: [&str; 4] = [
    "-f",
    "lavfi",
    "-i",
    "testsrc2=size=320x180:rate=15:duration=8",
];

/// The seconds that a camera stamps on a frame.
type Stamp = fn(u64) -> f64;

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn the_rate_is_the_one_asked_for_whatever_a_camera_stamps_on_its_frames() {
    let film = Arc::new(film(&BOXES, "30"));
    let stamps: [(&str, Stamp); 6] = [
        ("right", |frame| frame as f64 / RATE),
        ("equal", |_| 1.0),
        ("one in thirty far back", |frame| {
            let back = if frame % 30 == 29 { 9_800.0 } else { 0.0 };
            frame as f64 / RATE - back
        }),
        ("too fast", |frame| frame as f64 / 45.0),
        ("too slow", |frame| frame as f64 / 5.0),
        ("an hour back after two seconds", |frame| {
            let back = if frame > 30 { 3_600.0 } else { 0.0 };
            frame as f64 / RATE - back
        }),
    ];
    let runs = stamps.map(|(name, stamp)| {
        let faults = Faults {
            stamp,
            ..Faults::default()
        };
        let server = Camera::start(&film, faults);
        tokio::spawn(async move {
            let config = CameraConfig {
                max_rate: Some(5.0),
                ..camera(&server.address)
            };
            let mut source = Open::new(config).await;
            let rates = source.rates(Duration::from_secs(12)).await;
            source.stop().await;
            (name, rates)
        })
    });
    for run in runs {
        let (name, Rates { taken, came }) = run.await.unwrap();
        println!("{name}: {taken:.2} of {came:.2} frames per second");
        // On a busy machine fewer come; a camera that is misread gives less than one.
        assert!((5.0..=16.5).contains(&came), "{name}: {came} per second");
        let share = taken / came.min(15.0);
        assert!(taken <= 5.5, "{name}: {taken} of {came} per second");
        assert!(share >= 0.3, "{name}: {taken} of {came} per second");
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn lost_packets_break_pictures_until_the_next_whole_key_frame() {
    let film = Arc::new(film(&BOXES, "15"));
    let whole = Camera::start(&film, Faults::default());
    let faults = Faults {
        lost: 30,
        ..Faults::default()
    };
    let lossy = Camera::start(&film, faults);
    let mut whole = Open::at(&whole.address).await;
    let mut lossy = Open::at(&lossy.address).await;
    let pictures = whole.pictures(90).await;
    assert!(pictures.iter().all(|picture| !picture.is_broken));
    let pictures = lossy.pictures(150).await;
    let runs = pictures.chunk_by(|one, next| one.is_broken == next.is_broken).count();
    let broken = pictures.iter().filter(|picture| picture.is_broken).count();
    println!("{broken} of 150 broken, in {runs} runs");
    assert!(runs > 3, "it breaks and recovers");
    assert!((15..150).contains(&broken), "{broken}");
    assert_eq!(whole.stop().await.broken, 0);
    let arrived = lossy.stop().await;
    assert!(arrived.complaints > 0, "{arrived:?}");
    assert!(arrived.broken >= broken as u64, "{arrived:?}");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn key_frames_far_apart_are_waited_for() {
    let film = Arc::new(film(&BOXES, "30"));
    let faults = Faults {
        no_key_frame: Duration::from_secs(20),
        ..Faults::default()
    };
    let camera = Camera::start(&film, faults);
    let mut source = Open::at(&camera.address).await;
    source.pictures(5).await;
    source.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_camera_without_pictures_is_told_by_what_it_does_instead() {
    let film = Arc::new(film(&BOXES, "30"));
    let silent_at = |silent_at| Faults {
        silent_at,
        ..Faults::default()
    };
    let only_sound = Faults {
        only_sound: true,
        ..Faults::default()
    };
    for (faults, said) in [
        (
            silent_at("OPTIONS"),
            "it accepts the connection, but says nothing for 15 s",
        ),
        (
            silent_at("media"),
            "it answers, but sends no picture for more than 15 s",
        ),
        (only_sound, "it sends sound, but no pictures"),
    ] {
        let camera = Camera::start(&film, faults);
        let mut source = Open::at(&camera.address).await;
        let (reason, _) = source.failure().await;
        assert!(reason.starts_with(said), "{said}: {reason}");
        source.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_refused_login_is_tried_twice_and_then_left_alone_for_minutes() {
    let film = Arc::new(film(&BOXES, "30"));
    let faults = Faults {
        refuses: Some("Digest realm=\"cam\", nonce=\"abc\""),
        ..Faults::default()
    };
    let camera = Camera::start(&film, faults);
    let address = camera.address.replace("rtsp://", "rtsp://viewer:wrong@");
    let mut source = Open::at(&address).await;
    let (reason, _) = source.failure().await;
    assert_eq!(reason, "401 Unauthorized");
    let (reason, pause) = source.failure().await;
    assert!(reason.contains("left alone for 10 minutes"), "{reason}");
    assert_eq!(pause, Duration::from_mins(10));
    assert_eq!(camera.logins.load(std::sync::atomic::Ordering::Relaxed), 2);
    source.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_login_that_ffmpeg_does_not_know_has_its_own_words() {
    let film = Arc::new(film(&BOXES, "30"));
    let faults = Faults {
        refuses: Some("Digest realm=\"cam\", nonce=\"abc\", algorithm=SHA-256, qop=\"auth\""),
        ..Faults::default()
    };
    let camera = Camera::start(&film, faults);
    let address = camera.address.replace("rtsp://", "rtsp://viewer:right@");
    let mut source = Open::at(&address).await;
    let (reason, pause) = source.failure().await;
    let expected =
        "401 Unauthorized: it asks for a digest login by SHA-256, and ffmpeg knows only MD5";
    assert!(reason.starts_with(expected), "{reason}");
    assert!(!reason.contains("check user"), "{reason}");
    assert_eq!(pause, Duration::from_mins(10));
    // No wrong login was sent.
    assert_eq!(camera.logins.load(std::sync::atomic::Ordering::Relaxed), 0);
    source.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn video_of_more_than_eight_bits_is_a_source() {
    let folder = tempfile::tempdir().unwrap();
    for (name, encoder, pixels) in [
        ("main10.mp4", "libx265", "yuv420p10le"),
        ("high10.mp4", "libx264", "yuv420p10le"),
        ("grey10.mkv", "ffv1", "gray10le"),
        ("grey16.mkv", "ffv1", "gray16le"),
    ] {
        let file = folder.path().join(name);
        let status = Command::new("ffmpeg")
            .args(["-v", "error"])
            .args(BOXES)
            .args(["-t", "1", "-c:v", encoder, "-pix_fmt", pixels])
            .arg(&file)
            .status()
            .unwrap();
        assert!(status.success(), "{name}");
        let mut source = Open::at(file.to_str().unwrap()).await;
        let second = source.pictures(2).await.remove(1);
        assert_eq!(second.picture.size, PictureSize::new(320, 180), "{name}");
        source.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn pictures_that_change_their_size_are_read_on_decoded_and_encoded_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut film = Vec::new();
    for size in ["320x180", "160x90"] {
        let part = folder.path().join(format!("{size}.ts"));
        let input = format!("testsrc2=size={size}:rate=15:duration=1");
        let status = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi", "-i", &input])
            .args(["-c:v", "libx264", "-pix_fmt", "yuv420p"])
            .arg(&part)
            .status()
            .unwrap();
        assert!(status.success(), "{size}");
        film.extend(std::fs::read(&part).unwrap());
    }
    let file = folder.path().join("changes.ts");
    std::fs::write(&file, film).unwrap();
    for as_jpeg in [false, true] {
        let config = camera(file.to_str().unwrap());
        let mut settings = config.source_settings(FrameLimits::default()).unwrap();
        settings.as_jpeg = as_jpeg;
        let mut source = Open::with(settings).await;
        // More than once through the film.
        source.pictures(40).await;
        source.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_file_that_is_cut_short_is_told_and_played_once_it_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("drive.mp4");
    let status = Command::new("ffmpeg")
        .args(["-v", "error"])
        .args(BOXES)
        .args(["-c:v", "libx264", "-movflags", "faststart"])
        .arg(&file)
        .status()
        .unwrap();
    assert!(status.success());
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    let mut source = Open::at(file.to_str().unwrap()).await;
    let SourceEvent::Failed { reason, .. } = source.next().await else {
        panic!("a picture came");
    };
    assert!(reason.starts_with("it is cut short"), "{reason}");
    std::fs::write(&file, &whole).unwrap();
    source.pictures(5).await;
    source.stop().await;
}

/// Makes a video of a second, with ten pictures.
fn second(file: &Path) {
    let status = Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi"])
        .args(["-i", "testsrc2=size=64x36:rate=10:duration=1"])
        .args(["-c:v", "libx264"])
        .arg(file)
        .status()
        .unwrap();
    assert!(status.success());
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_dashcams_folder_is_one_stream_of_drives_and_begins_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Written in another order.
    for name in ["080100", "080001", "080000"] {
        second(&at(&format!("2026_1120_{name}_F.MP4")));
    }
    let cut = at("2026_1120_080002_F.MP4");
    second(&cut);
    let half = std::fs::read(&cut).unwrap();
    std::fs::write(&cut, &half[..half.len() / 2]).unwrap();

    let mut source = Open::at(folder.path().to_str().unwrap()).await;
    let mut told = Vec::new();
    let mut times = Vec::new();
    while times.len() < 35 {
        match source.next().await {
            SourceEvent::Picture(taken) => {
                assert_eq!(taken.picture.unwrap().size, PictureSize::new(64, 36));
                let recorded = taken.recorded.unwrap();
                if taken.is_reopened {
                    told.push(recorded.drive.to_string());
                }
                times.push(recorded.time_ns.unwrap());
            }
            SourceEvent::PassedOver(file) => told.push(file.to_string()),
            SourceEvent::Failed { reason, .. } => panic!("it failed: {reason}"),
        }
    }
    let first = "2026_1120_080000_F";
    let second = "2026_1120_080100_F";
    let passed_over = format!(
        "{}: it has no index (moov atom), as a power cut leaves a recording",
        cut.display()
    );
    assert_eq!(told, [first, &passed_over, second, &format!("{first}-2")]);
    // The two files of the first drive are one stream; the other begins a minute after it.
    let whole = |at: usize| (times[at] - times[0]) / 1_000_000_000;
    assert_eq!(whole(10), 1);
    assert_eq!(whole(20), 60);
    assert!(times[..30].is_sorted(), "{times:?}");
    assert_eq!(times[30], times[0]);
    let arrived = source.stop().await;
    assert_eq!(arrived.passed_over, 1);
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_folder_that_cannot_be_played_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_str().unwrap();
    let find = async |path: String| {
        let settings = camera(&path).source_settings(FrameLimits::default()).unwrap();
        tokio::task::spawn_blocking(move || LiveSource::find(settings))
            .await
            .unwrap()
            .err()
    };
    let none = find(path.to_owned()).await.unwrap();
    assert!(none.contains("no video files in it"), "{none}");
    for name in ["2026_1120_080000_F.MP4", "2026_1120_080000_R.MP4"] {
        std::fs::write(folder.path().join(name), "").unwrap();
    }
    let both = find(path.to_owned()).await.unwrap();
    assert!(
        both.contains("1 front (2026_1120_080000_F.MP4), 1 rear ("),
        "{both}"
    );
    let mut source = Open::at(&format!("{path}/*_r.mp4")).await;
    assert!(matches!(source.next().await, SourceEvent::PassedOver(_)));
    let (reason, _) = source.failure().await;
    let expected = "none of its files can be played: ";
    assert!(reason.starts_with(expected), "{reason}");
    assert!(reason.contains("it is empty"), "{reason}");
    source.stop().await;
}
