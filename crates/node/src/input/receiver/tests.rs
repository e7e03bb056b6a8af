use super::*;
use albireo_core::geometry::PictureSize;
use albireo_vision::picture::{EncodedPicture, FrameFault, PictureFormat};
use futures_util::FutureExt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

fn receiver(capacity: usize) -> Arc<FrameReceiver> {
    let settings = ReceiverSettings {
        camera: "front".to_owned(),
        format: PayloadFormat::default(),
        delivery: Delivery::default(),
        ring: capacity,
        limits: FrameLimits::default(),
        mount: None,
    };
    Arc::new(FrameReceiver::new(settings, Arc::default()))
}

impl FrameReceiver {
    fn give(&self, sequence: u64, stream: impl Into<Option<u64>>) {
        let number = FrameNumber {
            seq: Some(sequence),
            stream: stream.into(),
        };
        let frame = Frame {
            sequence,
            time_ns: 0,
            clip: None,
            position: None,
            picture: EncodedPicture {
                format: PictureFormat::Jpeg,
                bytes: bytes::Bytes::new(),
                size: PictureSize::new(64, 36),
                mount: None,
            },
            received: Instant::now(),
        };
        self.place(Origin::PUT, |_| (number, Ok(frame)));
    }

    fn give_broken(&self, seq: Option<u64>) {
        let number = FrameNumber { seq, stream: None };
        let fault = FrameFault::undecodable("half a picture");
        self.place(Origin::PUT, |_| (number, Err(fault)));
    }
}

/// Index and stream of each frame waiting in the ring.
fn waiting(ring: &Ring<SequencedFrame>) -> Vec<(u64, u64)> {
    std::iter::from_fn(|| ring.next().now_or_never())
        .map(|frame| (frame.index, frame.epoch))
        .collect()
}

#[tokio::test]
async fn a_restart_is_not_forgotten_if_its_first_frame_is_broken_or_displaced() {
    let receiver = receiver(8);
    receiver.give(1000, 1);
    receiver.publisher_left(1);
    receiver.give_broken(Some(0));
    receiver.give(1, None);
    assert_eq!(waiting(&receiver.ring), [(0, 0), (2, 1)]);

    let receiver = self::receiver(1);
    receiver.give(1000, 1);
    receiver.publisher_left(1);
    for seq in [0, 1, 2] {
        receiver.give(seq, 2);
    }
    assert_eq!(waiting(&receiver.ring), [(3, 1)]);
    let (dropped, _) = receiver.counter.counts();
    assert_eq!(dropped.overrun, 3);
    assert_eq!(dropped.total(), 3);
}

#[tokio::test]
async fn a_frame_with_an_unreadable_number_is_counted_once() {
    let receiver = receiver(8);
    receiver.give(5, None);
    receiver.give_broken(None);
    receiver.give(7, None);
    assert_eq!(waiting(&receiver.ring).len(), 2);
    let (dropped, _) = receiver.counter.counts();
    assert_eq!(dropped.undecodable, 1);
    assert_eq!(dropped.lost, 0);
}

#[tokio::test]
async fn two_receiving_threads_cannot_swap_frames() {
    const FRAMES: u64 = 40_000;
    let receiver = receiver(FRAMES as usize);
    let numbers = AtomicU64::new(0);
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                loop {
                    let seq = numbers.fetch_add(1, Ordering::Relaxed);
                    if seq >= FRAMES {
                        break;
                    }
                    receiver.give(seq, None);
                }
            });
        }
    });
    let waiting = waiting(&receiver.ring);
    assert!(waiting.len() > 100, "{}", waiting.len());
    let indices = waiting.iter().map(|(index, _)| index);
    assert!(indices.is_sorted_by(|before, after| before < after));
}
