//! How a camera's frames flow over the last ten seconds: the rate at which they come, how many are broken, and how many are
//! dropped. From that follows what is wrong with a camera that still sends something.

use crate::input::ArrivalCounts;
use albireo_wire::DroppedFrames;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// The span that is looked at. Samples come once a second.
const SPAN: Duration = Duration::from_secs(10);
/// A camera that sends fewer frames for this long is known to have changed.
const GETS_USED_TO: Duration = Duration::from_secs(600);
/// One part in so many of each second's rate goes into what is usual.
const SLOWNESS: f64 = 60.0;
/// Too few frames in [`SPAN`] to judge which share is dropped.
const FEW: u64 = 10;

/// Counts at one moment.
#[derive(Clone, Debug)]
struct Sample {
    at: Instant,
    arrived: ArrivalCounts,
    dropped: DroppedFrames,
}

/// The flow of a camera's frames.
#[derive(Debug, Default)]
pub(super) struct Flow {
    /// The newest last; the oldest is the last one that is at least [`SPAN`] old.
    samples: VecDeque<Sample>,
    /// The rate that the stream has shown, frames per second.
    usual: Option<f64>,
    /// Since when the rate is below half of that.
    low_since: Option<Instant>,
}

impl Flow {
    /// Adds the present counts. Call it about once a second.
    pub(super) fn sample(&mut self, at: Instant, arrived: ArrivalCounts, dropped: DroppedFrames) {
        self.samples.push_back(Sample {
            at,
            arrived,
            dropped,
        });
        while self.samples.get(1).is_some_and(|second| at - second.at >= SPAN) {
            self.samples.pop_front();
        }
        if !self.is_full() {
            return;
        }
        let Some(rate) = self.rate() else { return };
        let usual = *self.usual.get_or_insert(rate);
        if rate >= usual / 2.0 {
            self.low_since = None;
            self.usual = Some(usual + (rate - usual) / SLOWNESS);
        } else {
            let low_since = *self.low_since.get_or_insert(at);
            if at - low_since >= GETS_USED_TO {
                self.low_since = None;
                self.usual = Some(rate);
            }
        }
    }

    /// The frames per second that come; `None` until there are two samples.
    pub(super) fn rate(&self) -> Option<f64> {
        let first = self.samples.front()?;
        let last = self.samples.back()?;
        let seconds = (last.at - first.at).as_secs_f64();
        if seconds == 0.0 {
            return None;
        }
        let frames = last.arrived.frames - first.arrived.frames;
        Some(frames as f64 / seconds)
    }

    /// True once the samples cover [`SPAN`].
    fn is_full(&self) -> bool {
        let ends = self.samples.front().zip(self.samples.back());
        ends.is_some_and(|(first, last)| last.at - first.at >= SPAN)
    }

    /// What is wrong with the frames of the last ten seconds. `complaint` is the last one of the decoder.
    pub(super) fn fault(&self, complaint: Option<&str>) -> Option<String> {
        if !self.is_full() {
            return None;
        }
        self.broken(complaint).or_else(|| self.slow()).or_else(|| self.dropping())
    }

    /// Says that more than half of the frames are broken.
    fn broken(&self, complaint: Option<&str>) -> Option<String> {
        let first = self.samples.front()?;
        let last = self.samples.back()?;
        let came = last.arrived.frames - first.arrived.frames;
        let broken = last.arrived.broken - first.arrived.broken;
        if broken * 2 <= came {
            return None;
        }
        let complaint = complaint.unwrap_or("they cannot be decoded");
        Some(format!(
            "its pictures are broken: {broken} of {came} in the last 10 s ({complaint}); check its network"
        ))
    }

    /// Says that more than half of the frames are dropped, and which kind of drop is the most frequent.
    fn dropping(&self) -> Option<String> {
        let first = self.samples.front()?;
        let last = self.samples.back()?;
        let mut all = 0;
        let mut most = 0;
        let mut most_frequent = "";
        let both = last.dropped.by_kind().into_iter().zip(first.dropped.by_kind());
        for ((kind, now), (_, before)) in both {
            let dropped = now - before;
            all += dropped;
            if dropped >= most {
                most = dropped;
                most_frequent = kind;
            }
        }
        let arrived = last.arrived.frames - first.arrived.frames;
        // Lost frames never arrived. Some that are dropped arrived before the ten seconds.
        let lost = last.dropped.lost - first.dropped.lost;
        let came = (arrived + lost).max(all);
        if all <= FEW || all * 2 <= came {
            return None;
        }
        Some(format!(
            "most of its frames are dropped: {all} of {came} in the last 10 s, {most} of them {most_frequent}{}",
            remedy(most_frequent)
        ))
    }

    /// Says that frames come at less than half of the usual rate, in both halves of the time: a stream that begins or
    /// ends is not slow.
    fn slow(&self) -> Option<String> {
        let rate = self.rate()?;
        let usual = self.usual?;
        let first = self.samples.front()?;
        let last = self.samples.back()?;
        let middle = self.samples.get(self.samples.len() / 2)?;
        let is_slow = |from: &Sample, to: &Sample| {
            let frames = to.arrived.frames - from.arrived.frames;
            let usually = usual * (to.at - from.at).as_secs_f64();
            frames > 0 && (frames as f64) < usually / 2.0
        };
        if !is_slow(first, middle) || !is_slow(middle, last) {
            return None;
        }
        Some(format!(
            "{rate:.1} frames per second come; {usual:.1} came before"
        ))
    }
}

/// What to do about frames that are dropped for that reason.
fn remedy(kind: &str) -> &'static str {
    match kind {
        "overrun" => " (the node is slower than the camera: set max_rate)",
        "lost" => " (their numbers never came: check the network, or how the camera numbers)",
        "stray" => " (two senders use one key)",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Camera {
        flow: Flow,
        now: Instant,
        arrived: ArrivalCounts,
        dropped: DroppedFrames,
    }

    impl Camera {
        fn new() -> Self {
            Self {
                flow: Flow::default(),
                now: Instant::now(),
                arrived: ArrivalCounts::default(),
                dropped: DroppedFrames::default(),
            }
        }

        /// Sends whole frames, all of which are processed. Returns what is wrong afterwards.
        fn send(&mut self, seconds: u64, frames: u64) -> Option<String> {
            self.send_some_bad(seconds, frames, Bad::default())
        }

        fn send_some_bad(&mut self, seconds: u64, frames: u64, bad: Bad) -> Option<String> {
            for _ in 0..seconds {
                self.now += Duration::from_secs(1);
                self.arrived.frames += frames;
                self.arrived.broken += bad.broken;
                self.dropped.overrun += bad.overrun;
                self.dropped.lost += bad.lost;
                self.flow.sample(self.now, self.arrived.clone(), self.dropped);
            }
            self.flow.fault(Some("error while decoding MB 3 4"))
        }
    }

    /// Frames of each second that are broken, that are dropped, and that never arrive.
    #[derive(Clone, Copy, Default)]
    struct Bad {
        broken: u64,
        overrun: u64,
        lost: u64,
    }

    #[test]
    fn a_camera_that_slows_down_says_so_after_ten_seconds_and_is_believed_after_ten_minutes() {
        let mut camera = Camera::new();
        assert_eq!(camera.send(60, 15), None);
        assert_eq!(camera.send(4, 3), None);
        let said = camera.send(7, 3).unwrap();
        assert_eq!(said, "3.0 frames per second come; 14.6 came before");
        assert_eq!(camera.flow.rate(), Some(3.0));
        assert!(camera.send(560, 3).is_some());
        assert_eq!(camera.send(60, 3), None);
        assert_eq!(camera.send(60, 15), None);
    }

    #[test]
    fn a_stream_that_ends_and_one_that_begins_again_are_not_slow() {
        let mut camera = Camera::new();
        camera.send(60, 15);
        for _ in 0..15 {
            assert_eq!(camera.send(1, 0), None);
        }
        for _ in 0..15 {
            assert_eq!(camera.send(1, 15), None);
        }
    }

    #[test]
    fn broken_and_dropped_frames_are_a_fault_once_they_are_most() {
        let mut camera = Camera::new();
        let fewer_than_half = Bad {
            broken: 7,
            overrun: 7,
            ..Bad::default()
        };
        assert_eq!(camera.send_some_bad(20, 15, fewer_than_half), None);
        let broken = Bad {
            broken: 8,
            ..Bad::default()
        };
        let said = camera.send_some_bad(10, 15, broken).unwrap();
        let begin =
            "its pictures are broken: 80 of 150 in the last 10 s (error while decoding MB 3 4)";
        assert!(said.starts_with(begin), "{said}");
        let dropped = Bad {
            overrun: 10,
            ..Bad::default()
        };
        let said = camera.send_some_bad(10, 15, dropped).unwrap();
        let begin =
            "most of its frames are dropped: 100 of 150 in the last 10 s, 100 of them overrun";
        assert!(said.starts_with(begin), "{said}");
    }

    #[test]
    fn lost_frames_are_counted_among_those_that_were_sent() {
        let lost = |lost| Bad {
            lost,
            ..Bad::default()
        };
        let mut camera = Camera::new();
        // Six of sixteen.
        assert_eq!(camera.send_some_bad(20, 10, lost(6)), None);
        let said = camera.send_some_bad(11, 10, lost(30)).unwrap();
        let begin = "most of its frames are dropped: 300 of 400 in the last 10 s, 300 of them lost";
        assert!(said.starts_with(begin), "{said}");
    }
}
