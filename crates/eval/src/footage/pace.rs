//! The rate of recorded frames by their capture times, of which some jump: at the loop of a replay, between two drives.

/// An interval that is longer than this many usual ones is no interval between two frames: it is a pause.
const LONGEST: u64 = 10;

/// How recorded frames follow each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pace {
    /// Frames per second where the times do not jump.
    pub rate: f64,
    /// The number of times that go back, or ahead over a pause.
    pub jumps: usize,
}

impl Pace {
    /// The pace of frames with these capture times, nanoseconds, in the order of the frames; `None` if none is later
    /// than the one before.
    pub(crate) fn of(times_ns: &[u64]) -> Option<Self> {
        let neighbours = times_ns.iter().zip(times_ns.iter().skip(1));
        let intervals = neighbours.map(|(earlier, later)| later.checked_sub(*earlier));
        let forward: Vec<u64> = intervals.flatten().collect();
        // A coarse clock gives several frames one time: such intervals do not say which one is usual.
        let mut positive: Vec<u64> = forward.iter().copied().filter(|ns| *ns > 0).collect();
        positive.sort_unstable();
        let median = positive.get(positive.len() / 2)?;
        let longest = median.saturating_mul(LONGEST);
        let usual: Vec<u64> = forward.into_iter().filter(|ns| *ns <= longest).collect();
        let seconds = usual.iter().sum::<u64>() as f64 / 1e9;
        Some(Self {
            rate: usual.len() as f64 / seconds,
            jumps: times_ns.len() - 1 - usual.len(),
        })
    }

    /// True if there is no such interval between two frames of this pace, one recorded after the other.
    pub(crate) fn is_jump(&self, earlier_ns: u64, later_ns: u64) -> bool {
        let longest_ns = LONGEST as f64 * 1e9 / self.rate;
        match later_ns.checked_sub(earlier_ns) {
            Some(interval) => interval as f64 > longest_ns,
            None => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pace of frames at these milliseconds.
    fn pace(ms: impl IntoIterator<Item = u64>) -> Option<Pace> {
        let times: Vec<u64> = ms.into_iter().map(|ms| ms * 1_000_000).collect();
        Pace::of(&times)
    }

    #[test]
    fn the_rate_is_that_between_jumps_whether_they_go_back_or_ahead() {
        let drive = |start: u64| (0..30).map(move |frame| start + 40 * frame);
        let steady = Pace {
            rate: 25.0,
            jumps: 0,
        };
        assert_eq!(pace(drive(5_000)), Some(steady));
        // A loop of a replay, and the drive of the next day.
        let looped = drive(5_000).chain(drive(5_000)).chain(drive(5_000));
        let jumping = looped.chain(drive(90_000_000));
        assert_eq!(pace(jumping), Some(Pace { jumps: 3, ..steady }));
    }

    #[test]
    fn dropped_frames_lower_the_rate() {
        // One frame of three is missing.
        let dropping = (0..300).filter(|frame| frame % 3 > 0).map(|frame| frame * 40);
        let rate = pace(dropping).unwrap().rate;
        assert!((rate - 50.0 / 3.0).abs() < 0.1, "{rate}");
    }

    #[test]
    fn frames_of_one_time_by_a_coarse_clock_all_count_for_the_rate() {
        let seconds = (0..50).map(|frame| frame / 10 * 1000);
        let rate = pace(seconds).unwrap().rate;
        assert!((rate - 10.0).abs() < 2.5, "{rate}");
    }

    #[test]
    fn a_jump_goes_back_or_ahead_over_a_pause() {
        let pace = pace((0..30).map(|frame| 40 * frame)).unwrap();
        let is_jump = |earlier_ms: u64, later_ms: u64| {
            pace.is_jump(earlier_ms * 1_000_000, later_ms * 1_000_000)
        };
        assert!(!is_jump(1000, 1000) && !is_jump(1000, 1040) && !is_jump(1000, 1390));
        assert!(is_jump(1000, 999) && is_jump(1000, 1500));
    }

    #[test]
    fn frames_of_which_none_is_later_than_the_one_before_have_no_pace() {
        assert_eq!(pace([]), None);
        assert_eq!(pace([7]), None);
        assert_eq!(pace([7, 7]), None);
        assert_eq!(pace([9, 3]), None);
    }
}
