//! What an intake promises of the order and the numbering of frames.

use super::*;
use crate::config::{CameraConfig, NodeConfig};
use crate::input::{FrameOrder, RingReceiver, frame_ring};
use crate::state::board::{Board, BoardSetup};
use albireo_core::geometry::PictureSize;
use albireo_vision::detector::DetectorStatus;
use albireo_vision::picture::{EncodedPicture, FrameFault, PictureFormat};
use std::thread;
use tokio::sync::watch;

/// An intake whose ring holds `capacity` frames, and the ring's other end.
fn intake(capacity: usize) -> (Arc<Intake>, RingReceiver<Incoming>) {
    let config = NodeConfig {
        cameras: vec![CameraConfig::named("front")],
        ..NodeConfig::default()
    };
    let (_, status) = watch::channel(DetectorStatus::Starting);
    let board = Board::new(BoardSetup::from_config(&config, status).unwrap());
    let camera = Arc::clone(board.camera("front").unwrap());
    let drops = Arc::new(DropCounts::new(Arc::clone(&camera)));
    let (sender, ring) = frame_ring(capacity);
    let limits = FrameLimits::default();
    let intake = Intake::new(camera, drops, sender, PayloadFormat::Encoding, limits);
    (Arc::new(intake), ring)
}

fn frame(sequence: u64) -> Frame {
    Frame {
        sequence,
        order: FrameOrder {
            numbered: true,
            ..FrameOrder::default()
        },
        time_ns: 0,
        clip: None,
        picture: EncodedPicture {
            format: PictureFormat::Jpeg,
            bytes: bytes::Bytes::new(),
            size: PictureSize::new(64, 36),
        },
        received: Instant::now(),
        payload_bytes: 0,
    }
}

fn rejected(sequence: Option<u64>) -> RejectedFrame {
    RejectedFrame {
        sequence,
        order: FrameOrder::default(),
        clip: None,
        fault: FrameFault::Undecodable {
            reason: "half a picture".to_owned(),
        },
    }
}

impl Intake {
    fn give(&self, read: Result<Frame, RejectedFrame>) {
        self.place(|_, _, _| read);
    }
}

/// Index and stream of what waits in the ring.
async fn waiting(ring: &mut RingReceiver<Incoming>) -> Vec<(u64, u64)> {
    ring.close();
    let mut found = Vec::new();
    while let Some(incoming) = ring.next().await {
        found.push((incoming.index, incoming.epoch));
    }
    found
}

#[tokio::test]
async fn a_restart_is_not_forgotten_when_its_first_frame_is_broken_or_pushed_out() {
    let (intake, mut ring) = intake(8);
    intake.give(Ok(frame(1000)));
    intake.give(Ok(frame(0)));
    intake.give(Err(rejected(Some(1))));
    intake.give(Ok(frame(2)));
    assert_eq!(waiting(&mut ring).await, [(0, 0), (2, 1)]);

    let (intake, mut ring) = self::intake(1);
    for sequence in [1000, 0, 1, 2] {
        intake.give(Ok(frame(sequence)));
    }
    assert_eq!(waiting(&mut ring).await, [(2, 1)]);
    let dropped = intake.board.snapshot().dropped;
    assert_eq!((dropped.overrun, dropped.late), (2, 1));
}

#[tokio::test]
async fn a_stray_old_frame_is_counted_late_and_nothing_is_counted_lost() {
    let (intake, mut ring) = intake(8);
    for sequence in [1000, 1001, 900, 1002] {
        intake.give(Ok(frame(sequence)));
    }
    assert_eq!(waiting(&mut ring).await, [(0, 0), (1, 0), (2, 0)]);
    let dropped = intake.board.snapshot().dropped;
    assert_eq!((dropped.late, dropped.lost, dropped.total()), (1, 0, 1));
}

#[tokio::test]
async fn a_frame_whose_number_cannot_be_read_is_counted_once() {
    let (intake, mut ring) = intake(8);
    intake.give(Ok(frame(5)));
    intake.give(Err(rejected(None)));
    intake.give(Ok(frame(7)));
    assert_eq!(waiting(&mut ring).await.len(), 2);
    let dropped = intake.board.snapshot().dropped;
    assert_eq!((dropped.undecodable, dropped.lost), (1, 0));
}

#[tokio::test]
async fn two_receiving_threads_cannot_swap_frames() {
    const FRAMES: u64 = 40_000;
    let (intake, mut ring) = intake(FRAMES as usize);
    let numbers = Arc::new(std::sync::atomic::AtomicU64::new(0));
    let threads: Vec<_> = (0..4)
        .map(|_| {
            let (intake, numbers) = (Arc::clone(&intake), Arc::clone(&numbers));
            thread::spawn(move || {
                loop {
                    let number = numbers.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    if number >= FRAMES {
                        return;
                    }
                    intake.give(Ok(frame(number)));
                }
            })
        })
        .collect();
    for thread in threads {
        thread.join().unwrap();
    }
    let waiting = waiting(&mut ring).await;
    assert!(waiting.len() > 100, "{}", waiting.len());
    assert!(waiting.is_sorted_by(|a, b| a.0 < b.0));
}
