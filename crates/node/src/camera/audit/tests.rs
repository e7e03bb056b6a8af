use super::*;
use crate::camera::tests::picture;
use crate::config::NodeConfig;
use crate::state::board::Board;
use futures_util::FutureExt;
use parking_lot::Mutex;
use tokio::sync::oneshot;

fn frame() -> DrawnFrame {
    DrawnFrame {
        picture: picture(0),
        shown: Vec::new(),
    }
}

fn compared() -> AuditReport {
    let mut count = AuditReport {
        calls: 1,
        ..AuditReport::default()
    };
    count.sums.add(&[], &[]);
    count
}

#[test]
fn every_drawn_frame_is_compared_or_missed_and_counted_once() {
    let config = NodeConfig::default();
    let board = Board::open(&config).unwrap();
    let camera = Arc::clone(&board.cameras[0]);
    let examined = Arc::new(Mutex::new(VecDeque::new()));
    let started = Arc::clone(&examined);
    let mut audit = CameraAudit::new(config.audit, camera, move |_| {
        let (result, examination) = oneshot::channel();
        started.lock().push_back(result);
        async { examination.await.unwrap() }.boxed()
    });
    let done = |found| examined.lock().pop_front().unwrap().send(found).is_ok();
    let counts = |audit: &AuditReport| (audit.sums.drawn(), audit.sums.missed, audit.calls);
    let taken = || counts(&board.cameras[0].take_unreported().1);
    for _ in 0..4 {
        audit.offer(frame());
    }
    // Two frames wait; there is no room for the others.
    assert_eq!(taken(), (2, 2, 0));
    assert!(audit.run().now_or_never().is_none());
    assert!(done(Some(compared())));
    assert!(audit.run().now_or_never().is_none());
    assert!(done(None));
    assert!(audit.run().now_or_never().is_none());
    assert_eq!(taken(), (2, 1, 1));

    // When the camera ends, one frame is being examined and one waits; neither result is counted.
    audit.offer(frame());
    audit.offer(frame());
    assert!(audit.run().now_or_never().is_none());
    audit.give_up();
    assert!(!done(Some(compared())), "nobody waits for it");
    assert!(audit.run().now_or_never().is_none());
    assert_eq!(taken(), (2, 2, 0));

    // Frames are examined afterwards as before.
    audit.offer(frame());
    assert!(audit.run().now_or_never().is_none());
    assert!(done(Some(compared())));
    assert!(audit.run().now_or_never().is_none());
    let total = board.cameras[0].snapshot().audit.unwrap();
    assert_eq!(counts(&total), (7, 5, 2));
}

#[test]
fn a_share_of_zero_is_no_audit_and_every_start_draws_other_frames() {
    let off = AuditConfig { share: 0.0 };
    assert!(off.draw().is_off());
    let half = AuditConfig { share: 0.5 };
    let draws = [half.draw(), half.draw()];
    assert!((0..100).any(|frame| draws[0].draw(frame) != draws[1].draw(frame)));
}
