//! The rate of recorded frames by their capture times, of which some jump: at the loop of a replay, between two drives.

use std::collections::VecDeque;

/// An interval that is longer than this many usual ones is no interval between two frames: it is a pause.
const LONGEST: u64 = 10;

/// A time that is so many usual intervals before the last one is from another drive. One by fewer came late.
const FURTHEST_BACK: u64 = 5;

/// So many of the last intervals say which one is usual now.
const RECENT: usize = 20;

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
}

/// Finds the jumps in the times of frames that are read one after the other.
#[derive(Clone, Debug)]
pub(super) struct Jumps {
    /// The mean interval, nanoseconds.
    mean_ns: u64,
    /// The last intervals since the last jump.
    recent: VecDeque<u64>,
    last_ns: Option<u64>,
}

impl Jumps {
    /// Those of frames that follow each other at this pace.
    pub(super) fn at(pace: Pace) -> Self {
        Self {
            mean_ns: (1e9 / pace.rate) as u64,
            recent: VecDeque::new(),
            last_ns: None,
        }
    }

    /// Notes the time of the next frame, and returns true if it jumps: far back, or ahead over a pause. Where the rate
    /// falls, the times jump once and not with each frame.
    pub(super) fn arrive(&mut self, time_ns: u64) -> bool {
        let Some(before_ns) = self.last_ns.replace(time_ns) else {
            return false;
        };
        let mut sorted: Vec<u64> = self.recent.iter().copied().collect();
        sorted.sort_unstable();
        let median_ns = sorted.get(sorted.len() / 2);
        let usual_ns = self.mean_ns.max(median_ns.copied().unwrap_or(0));
        let is_jump = match time_ns.checked_sub(before_ns) {
            // Nothing tells a pause from the first interval of a lower rate.
            Some(ahead_ns) => median_ns.is_some() && ahead_ns > usual_ns.saturating_mul(LONGEST),
            None => before_ns - time_ns > usual_ns.saturating_mul(FURTHEST_BACK),
        };
        if is_jump {
            self.recent.clear();
        } else if time_ns > before_ns {
            self.recent.push_back(time_ns - before_ns);
            if self.recent.len() > RECENT {
                self.recent.pop_front();
            }
        }
        is_jump
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

    /// The numbers of the frames at these milliseconds that jump, at 25 frames per second.
    fn jumps(ms: impl IntoIterator<Item = u64>) -> Vec<usize> {
        let mut jumps = Jumps::at(Pace {
            rate: 25.0,
            jumps: 0,
        });
        let mut found = Vec::new();
        for (number, ms) in ms.into_iter().enumerate() {
            if jumps.arrive(ms * 1_000_000) {
                found.push(number);
            }
        }
        found
    }

    #[test]
    fn a_jump_goes_far_back_or_ahead_over_a_pause() {
        assert_eq!(jumps([1000, 1040, 1040, 1430]), [0; 0]);
        assert_eq!(jumps([1000, 1040, 1540, 1580, 1370, 1410]), [2, 4]);
    }

    #[test]
    fn a_time_that_came_late_is_no_jump() {
        assert_eq!(jumps([1000, 1040, 1080, 1039, 1160, 1200]), [0; 0]);
    }

    #[test]
    fn times_jump_once_where_the_rate_falls() {
        let fast = (0..60).map(|frame| frame * 40);
        let slow = (1..20).map(|frame| 2360 + frame * 500);
        assert_eq!(jumps(fast.chain(slow)), [60]);
    }

    #[test]
    fn frames_of_which_none_is_later_than_the_one_before_have_no_pace() {
        assert_eq!(pace([]), None);
        assert_eq!(pace([7]), None);
        assert_eq!(pace([7, 7]), None);
        assert_eq!(pace([9, 3]), None);
    }
}
