use super::*;
use crate::PreparedNode;
use crate::camera::tests::{answer, picture};
use crate::config::NodeConfig;
use albireo_core::policy::FrameState;
use futures_util::FutureExt;
use parking_lot::Mutex;
use tokio::sync::oneshot;

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
    let mut config = NodeConfig::default();
    config.audit.share = 1.0;
    let board = Arc::clone(PreparedNode::new(&config).unwrap().board());
    let camera = Arc::clone(&board.cameras[0]);
    let examined = Arc::new(Mutex::new(VecDeque::new()));
    let started = Arc::clone(&examined);
    let mut audit = CameraAudit::new(config.audit, camera, move |_, _, _| {
        let (result, examination) = oneshot::channel();
        started.lock().push_back(result);
        async { examination.await.unwrap() }.boxed()
    });
    let done = |found| {
        let result = examined.lock().pop_front().unwrap();
        result.send(found).is_ok()
    };
    let counts = |audit: &AuditReport| {
        let drawn = audit.sums.drawn();
        let missed = audit.sums.missed;
        let examined = audit.calls;
        format!("{drawn} drawn, {missed} missed, {examined} examined")
    };
    let taken = || counts(&board.cameras[0].take_unreported().audit);
    let answer = Arc::new(answer(0, FrameState::P));
    let offer = |audit: &mut CameraAudit| audit.offer(0, &picture(0), &[], &answer);
    for _ in 0..5 {
        offer(&mut audit);
    }
    // One frame is examined and two wait; there is no room for the others.
    assert_eq!(taken(), "2 drawn, 2 missed, 0 examined");
    for found in [Some(compared()), None, Some(compared())] {
        assert!(audit.run().now_or_never().is_none());
        assert!(done(found));
    }
    assert!(audit.run().now_or_never().is_none());
    assert_eq!(taken(), "3 drawn, 1 missed, 2 examined");

    // When the camera ends, one frame is being examined and one waits; neither result is counted.
    for _ in 0..2 {
        offer(&mut audit);
    }
    assert!(audit.run().now_or_never().is_none());
    audit.give_up();
    for _ in 0..2 {
        assert!(!done(Some(compared())), "nobody waits for it");
    }
    assert!(audit.run().now_or_never().is_none());
    assert_eq!(taken(), "2 drawn, 2 missed, 0 examined");

    // Frames are examined afterwards as before.
    offer(&mut audit);
    assert!(audit.run().now_or_never().is_none());
    assert!(done(Some(compared())));
    assert!(audit.run().now_or_never().is_none());
    let total = board.cameras[0].snapshot().audit.unwrap();
    assert_eq!(counts(&total), "8 drawn, 5 missed, 3 examined");
}

#[test]
fn a_share_of_zero_is_no_audit_and_every_start_draws_other_frames() {
    let off = AuditConfig { share: 0.0 };
    assert!(off.draw().is_off());
    let half = AuditConfig { share: 0.5 };
    let draws = [half.draw(), half.draw()];
    assert!((0..100).any(|frame| draws[0].draw(frame) != draws[1].draw(frame)));
}
