//! Promises of the ledger of shares.

use super::*;
use proptest::prelude::*;

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn ledger() -> (EnergyShares, Instant) {
    let ledger = EnergyShares::new(Duration::ZERO);
    let epoch = lock(&ledger.books).epoch;
    (ledger, epoch)
}

#[test]
fn one_camera_has_all_of_it() {
    let (ledger, epoch) = ledger();
    let camera = ledger.camera("front");
    let slices = camera.slices(epoch, epoch + ms(5500));
    assert_eq!(slices.len(), 1);
    assert_eq!((slices[0].share, slices[0].end), (1.0, epoch + ms(5500)));
}

#[test]
fn detector_time_divides_a_second_and_frames_divide_one_without() {
    let (ledger, epoch) = ledger();
    let (front, rear) = (ledger.camera("front"), ledger.camera("rear"));
    front.detector(epoch + ms(100), epoch + ms(400));
    rear.detector(epoch + ms(500), epoch + ms(600));
    for i in 0..9 {
        front.frame(epoch + ms(1000 + i * 100));
    }
    rear.frame(epoch + ms(1500));
    let share = |camera: &CameraShare, from, to| {
        let slices = camera.slices(epoch + ms(from), epoch + ms(to));
        assert_eq!(slices.len(), 1, "{slices:?}");
        slices[0].share
    };
    assert!((share(&front, 0, 1000) - 0.75).abs() < 1e-9);
    assert!((share(&rear, 0, 1000) - 0.25).abs() < 1e-9);
    assert!((share(&front, 1000, 2000) - 0.9).abs() < 1e-9);
    assert!(
        (share(&front, 2000, 3000) - 0.9).abs() < 1e-9,
        "as the second before"
    );
}

#[test]
fn a_detector_run_across_a_second_is_divided_between_both() {
    let (ledger, epoch) = ledger();
    let (front, rear) = (ledger.camera("front"), ledger.camera("rear"));
    front.detector(epoch + ms(900), epoch + ms(1300));
    rear.detector(epoch + ms(500), epoch + ms(600));
    rear.detector(epoch + ms(1500), epoch + ms(1600));
    let slices = front.slices(epoch, epoch + ms(2000));
    let shares: Vec<_> = slices.iter().map(|s| s.share).collect();
    assert!((shares[0] - 0.5).abs() < 1e-9 && (shares[1] - 0.75).abs() < 1e-9);
}

#[test]
fn cameras_that_did_nothing_share_equally() {
    let (ledger, epoch) = ledger();
    let (front, _rear) = (ledger.camera("front"), ledger.camera("rear"));
    assert_eq!(front.slices(epoch, epoch + ms(1))[0].share, 0.5);
    assert_eq!(ledger.camera("front").camera, front.camera);
}

#[test]
fn memory_is_bounded_over_days_and_long_silences() {
    let (ledger, epoch) = ledger();
    let (front, rear) = (ledger.camera("front"), ledger.camera("rear"));
    for second in (0..200_000).chain([100_000_000]) {
        front.frame(epoch + Duration::from_secs(second));
    }
    assert!(lock(&ledger.books).pieces.len() <= 600);
    rear.detector(epoch, epoch + ms(500));
    let end = epoch + Duration::from_secs(100_000_000);
    assert_eq!(front.slices(end, end + ms(500))[0].share, 1.0);
}

proptest! {
    #[test]
    fn the_shares_of_all_cameras_add_up_to_one_at_every_moment(
        work in prop::collection::vec((0..3_usize, 0..20_000_u64, 0..700_u64, any::<bool>()), 0..80),
        from in 0..10_000_u64,
        length in 1..10_000_u64,
    ) {
        let (ledger, epoch) = ledger();
        let cameras: Vec<_> = ["a", "b", "c"].iter().map(|n| ledger.camera(n)).collect();
        for (camera, at, busy, detector) in work {
            cameras[camera].frame(epoch + ms(at));
            if detector {
                cameras[camera].detector(epoch + ms(at), epoch + ms(at + busy));
            }
        }
        let (start, end) = (epoch + ms(from), epoch + ms(from + length));
        let all: Vec<_> = cameras.iter().map(|c| c.slices(start, end)).collect();
        for slices in &all {
            prop_assert_eq!(slices[0].start, start);
            prop_assert_eq!(slices[slices.len() - 1].end, end);
            for pair in slices.windows(2) {
                prop_assert_eq!(pair[0].end, pair[1].start);
            }
        }
        for step in 0..length / 50 {
            let at = start + ms(step * 50);
            let sum: f64 = all
                .iter()
                .filter_map(|s| s.iter().find(|s| s.start <= at && at < s.end))
                .map(|s| s.share)
                .sum();
            prop_assert!((sum - 1.0).abs() < 1e-9, "{}", sum);
        }
    }
}
