use super::*;
use crate::config::NodeConfig;
use crate::state::board::Board;
use albireo_core::geometry::PictureSize;
use albireo_vision::picture::{EncodedPicture, PictureFormat};
use albireo_wire::AuditReport;
use std::sync::Arc;

fn audit() -> (Arc<Board>, CameraAudit) {
    let config = NodeConfig::default();
    let board = Board::open(&config).unwrap();
    let camera = Arc::clone(board.camera("front").unwrap());
    let audit = CameraAudit::new(config.audit, camera);
    (board, audit)
}

fn frame() -> DrawnFrame {
    DrawnFrame {
        picture: EncodedPicture {
            format: PictureFormat::Jpeg,
            bytes: Vec::new().into(),
            size: PictureSize::new(640, 360),
        },
        shown: Vec::new(),
    }
}

fn compared() -> AuditReport {
    let mut count = AuditReport {
        calls: 1,
        detector_us: 30_000,
        ..AuditReport::default()
    };
    count.sums.add(&[], &[]);
    count
}

#[tokio::test]
async fn every_drawn_frame_is_compared_or_missed_and_counted_once() {
    let (board, audit) = audit();
    let taken = || board.camera("front").unwrap().take_unreported().1;
    for _ in 0..4 {
        audit.offer(frame());
    }
    // Two frames wait; there is no room for the others.
    assert_eq!(taken().sums.missed, 2);
    audit.next().await;
    audit.done(Some(compared()));
    audit.next().await;
    audit.done(None);
    let found = taken();
    assert_eq!(
        (found.sums.drawn(), found.sums.missed, found.calls),
        (2, 1, 1)
    );

    // When the camera ends, one frame is being examined and one waits; neither result is counted.
    audit.offer(frame());
    audit.offer(frame());
    audit.next().await;
    audit.give_up();
    audit.done(Some(compared()));
    let found = taken();
    assert_eq!((found.sums.drawn(), found.sums.missed), (2, 2));

    // Counting continues after the camera's loop restarts.
    audit.offer(frame());
    audit.next().await;
    audit.done(Some(compared()));
    let total = board.camera("front").unwrap().snapshot().audit.unwrap();
    assert_eq!(
        (total.sums.drawn(), total.sums.missed, total.calls),
        (7, 5, 2)
    );
}

#[test]
fn a_share_of_zero_is_no_audit_and_every_start_draws_other_frames() {
    let off = AuditConfig { share: 0.0 };
    assert!(off.draw().is_off());
    let half = AuditConfig { share: 0.5 };
    let draws = [half.draw(), half.draw()];
    assert!((0..100).any(|frame| draws[0].draw(frame) != draws[1].draw(frame)));
}
