//! Classifies each frame of a camera as new, late, a duplicate, or part of another stream.
//!
//! - Frames with the same `stream` number (or none) form one stream if all have sequence numbers, or none has.
//! - A stream's numbers grow by one, by another constant step, or irregularly as times do ([`Numbering`], learnt from the
//!   numbers themselves). Between constant steps frames can be lost; between times nobody can tell.
//! - In a stream, a number at most [`NEAR`] steps above the highest is new; a number less than [`WINDOW`] steps below it
//!   is late or a duplicate. A frame without a number is the next one.
//! - A number further ahead is accepted once the next frame continues from it, by one step or by about the same distance
//!   again; until then it is stray.
//! - Every other frame is stray: it is counted but not processed, and changes nothing.
//! - Once the present stream has brought nothing new for the longer of [`SILENCE`] and five of its periods, or its
//!   publisher is gone, the next frame that is not part of it begins a new stream.

use std::time::Duration;
use tokio::time::Instant;

/// The number of past steps for which the tracker remembers whether their numbers arrived.
const WINDOW: i128 = 64;
/// The largest number of steps ahead that is accepted at once.
const NEAR: i128 = 8;
/// The largest number of frames accepted as lost: an hour at 30 frames per second.
const MAX_GAP: i128 = 108_000;
/// A stream that brings nothing new for this long, and for five of its periods, may be replaced by another.
const SILENCE: Duration = Duration::from_secs(1);
/// The number of distances between numbers by which a running stream's numbering is judged.
const RECENT: usize = 8;
/// The number of distances by which a new stream's numbering is judged.
const FIRST: usize = 3;
/// Distances from here on, all about equal, are times and not numbers of a link that loses most frames.
const LEAST_TIME: i128 = 4;

/// A camera's number of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameNumber {
    /// The sequence number, if the camera sends one.
    pub seq: Option<u64>,
    /// The numbering it belongs to, if the camera names it.
    pub stream: Option<u64>,
}

/// The relation of a frame to its camera's stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// A new frame.
    New {
        /// Its place: 0 for the first frame, counting lost frames. Grows with every new frame, also across streams.
        index: u64,
        /// The number of frames missing before it that were not told before.
        lost: u64,
        /// True if it begins a new stream. False for the very first frame.
        restarted: bool,
    },
    /// Its number has already arrived.
    Duplicate,
    /// A later number has already arrived.
    Late,
    /// It belongs to another stream.
    Stray,
}

/// Follows the numbers of one camera. It is called on reception, before the ring, for every sample with a readable
/// number, so that neither an overrun nor a rejected frame counts as a loss.
#[derive(Clone, Debug, Default)]
pub(crate) struct SequenceTracker {
    present: Option<Stream>,
    /// The place of the newest frame.
    index: Option<u64>,
}

/// How the numbers of a stream grow from one frame to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Numbering {
    /// By this step: by one, or by ten if the sender takes every tenth picture and keeps its number.
    Step(i128),
    /// Irregularly, by about this distance: times, such as milliseconds.
    Times(i128),
}

impl Numbering {
    /// The usual distance of two numbers.
    const fn distance(self) -> i128 {
        match self {
            Self::Step(distance) | Self::Times(distance) => distance,
        }
    }

    /// The number of frames from one number to another one, this far ahead.
    fn frames(self, step: i128) -> i128 {
        match self {
            Self::Step(by) => (step / by).max(1),
            Self::Times(_) => 1,
        }
    }
}

#[derive(Clone, Debug)]
struct Stream {
    id: Option<u64>,
    /// The highest number; `None` if its frames have no numbers.
    highest: Option<u64>,
    numbering: Numbering,
    /// The distances between its newest numbers, the newest last.
    recent: Vec<i128>,
    /// Until the numbering is known: the frames that would be lost if it counted by ones.
    opening: Option<u64>,
    /// Bit `k` is set if the number `k` steps below the highest has arrived.
    came: u64,
    /// The distance above the highest number of the last number that was too far ahead.
    ahead: Option<i128>,
    /// The distance by which its first number was ahead of the stream before it.
    began_ahead: Option<i128>,
    /// Unusable samples since the highest number: that many of the missing numbers do not count as lost.
    unusable: u64,
    newest: Instant,
    /// The mean time between its frames, once there are two.
    period: Option<Duration>,
    /// True once its publisher has left.
    ended: bool,
}

impl Stream {
    /// The distance of a frame's number above the highest; `None` if it belongs to another stream.
    fn distance(&self, number: &FrameNumber) -> Option<i128> {
        match (self.highest, number.seq) {
            _ if self.id != number.stream => None,
            (None, None) => Some(1),
            (Some(highest), Some(seq)) => Some(i128::from(seq) - i128::from(highest)),
            _ => None,
        }
    }

    fn is_over(&self, now: Instant) -> bool {
        let patience = self.period.unwrap_or_default().saturating_mul(5);
        self.ended || now.saturating_duration_since(self.newest) >= patience.max(SILENCE)
    }

    /// True for a number within reach of the highest, in this stream's steps.
    fn is_near(&self, step: i128) -> bool {
        (1..=NEAR * self.numbering.distance()).contains(&step)
    }

    /// True if the number `step` ahead follows one that was too far ahead to be accepted.
    fn goes_on(&self, step: i128) -> bool {
        self.ahead.is_some_and(|ahead| self.is_near(step - ahead))
    }

    /// The numbering in which a number `step` ahead is the next but one, if the last number that was too far ahead, or
    /// that began this stream after a silence, was ahead by about the same distance.
    fn wider(&self, step: i128) -> Option<Numbering> {
        let (first, second) = match (self.ahead, self.began_ahead) {
            (Some(ahead), _) => (ahead, step - ahead),
            (None, Some(before)) => (before, step),
            (None, None) => return None,
        };
        numbering_of(&[first, second])
    }

    /// Accepts the frame with this number, `step` ahead, and returns its distance in frames and how many were lost.
    fn advance(&mut self, number: &FrameNumber, step: i128, now: Instant) -> (i128, u64) {
        self.learn(step);
        let frames = self.numbering.frames(step);
        self.highest = number.seq;
        self.came = match frames {
            1..WINDOW => self.came << frames | 1,
            _ => 1,
        };
        self.ahead = None;
        self.began_ahead = None;
        let since = now.saturating_duration_since(self.newest) / u32::try_from(frames).unwrap_or(1);
        self.period = Some(match self.period {
            Some(period) => period.saturating_mul(7).saturating_add(since) / 8,
            None => since,
        });
        self.newest = now;
        // Frames that came, but could not be used, are counted already.
        let unusable = std::mem::take(&mut self.unusable);
        let missing = (frames as u64 - 1).saturating_sub(unusable);
        let lost = self.losses_to_report(step, missing);
        (frames, lost)
    }

    /// Classifies a number this far below the highest, or the highest itself.
    fn behind(&mut self, distance: i128) -> Arrival {
        let by = self.numbering.distance();
        if distance >= WINDOW * by {
            return Arrival::Stray;
        }
        let is_known = matches!(self.numbering, Numbering::Step(_)) && distance % by == 0;
        if distance == 0 || is_known {
            let bit = 1 << (distance / by);
            let has_come = self.came & bit != 0;
            self.came |= bit;
            if has_come {
                return Arrival::Duplicate;
            }
        }
        // The numbers between were sent: frames that change places in pairs do not show a step of two.
        self.recent.clear();
        Arrival::Late
    }

    /// Judges the numbering by the newest distances.
    ///
    /// A smaller step is believed sooner than a larger one, because a link that loses frames makes large steps, and nothing
    /// makes small ones.
    fn learn(&mut self, step: i128) {
        if self.recent.len() == RECENT {
            self.recent.remove(0);
        }
        self.recent.push(step);
        let newest = &self.recent[self.recent.len().saturating_sub(FIRST)..];
        let all_equal = newest.len() == FIRST && newest.iter().all(|one| *one == step);
        self.numbering = match self.numbering {
            Numbering::Times(_) if all_equal => Numbering::Step(step),
            Numbering::Times(usual) => Numbering::Times(((usual * 7 + step) / 8).max(1)),
            Numbering::Step(by) if all_equal && step < by => Numbering::Step(step),
            Numbering::Step(by) if by > 1 && step % by != 0 => Numbering::Times(by),
            Numbering::Step(by) if self.recent.len() == RECENT => numbering_of(&self.recent)
                .filter(|wider| wider.distance() > by)
                .unwrap_or(self.numbering),
            Numbering::Step(_) => self.numbering,
        };
    }

    /// The lost frames to tell now, `missing` of them new. In the opening they are kept until the numbering is known, so
    /// that a camera that numbers by fives does not begin with losses.
    fn losses_to_report(&mut self, step: i128, missing: u64) -> u64 {
        let Some(kept) = self.opening else {
            return missing;
        };
        let kept = kept.saturating_add(missing);
        if step != 1 && self.numbering == Numbering::Step(1) {
            if self.recent.len() < FIRST {
                self.opening = Some(kept);
                return 0;
            }
            if let Some(wider) = numbering_of(&self.recent) {
                self.numbering = wider;
                self.came = 1;
            }
        }
        self.opening = None;
        match self.numbering {
            Numbering::Step(1) => kept,
            _ => 0,
        }
    }
}

/// The numbering that these distances show: all the same, or all about the same and too far apart for counts.
fn numbering_of(distances: &[i128]) -> Option<Numbering> {
    let least = *distances.iter().min()?;
    let most = *distances.iter().max()?;
    if least < 1 {
        None
    } else if least == most {
        Some(Numbering::Step(least))
    } else if least >= LEAST_TIME && most <= 2 * least {
        Some(Numbering::Times(least))
    } else {
        None
    }
}

impl SequenceTracker {
    /// Classifies the next number in the order of arrival, of a usable frame or not.
    pub(crate) fn arrive(&mut self, number: &FrameNumber, now: Instant) -> Arrival {
        let Some(present) = &mut self.present else {
            return self.begin(number, None, now);
        };
        let is_over = present.is_over(now);
        let step = match present.distance(number) {
            Some(step) if present.is_near(step) => step,
            Some(step) if step > 0 => {
                if let Some(wider) = present.wider(step) {
                    // The frame between arrived, too: nothing is lost.
                    present.numbering = wider;
                    present.opening = None;
                    let (frames, _) = present.advance(number, step, now);
                    return self.new_frame(frames, 0, false);
                }
                let is_gap = step <= MAX_GAP * present.numbering.distance();
                if is_gap && (is_over || present.goes_on(step)) {
                    step
                } else if is_over {
                    return self.begin(number, Some(step), now);
                } else {
                    present.ahead = Some(step);
                    present.unusable = present.unusable.saturating_add(u64::from(is_gap));
                    return Arrival::Stray;
                }
            }
            _ if is_over => return self.begin(number, None, now),
            Some(step) => return present.behind(-step),
            None => return Arrival::Stray,
        };
        let (frames, lost) = present.advance(number, step, now);
        self.new_frame(frames, lost, false)
    }

    /// Counts a sample with an unreadable number.
    pub(crate) fn arrive_unreadable(&mut self) {
        if let Some(present) = &mut self.present {
            present.unusable = present.unusable.saturating_add(1);
        }
    }

    /// Records that the publisher of a stream appeared or left.
    pub(crate) fn publisher_changed(&mut self, stream: u64, gone: bool) {
        let present = self.present.as_mut();
        if let Some(present) = present.filter(|present| present.id == Some(stream)) {
            present.ended = gone;
        }
    }

    fn begin(&mut self, number: &FrameNumber, ahead: Option<i128>, now: Instant) -> Arrival {
        let restarted = self.present.is_some();
        self.present = Some(Stream {
            id: number.stream,
            highest: number.seq,
            numbering: Numbering::Step(1),
            recent: Vec::with_capacity(RECENT),
            opening: Some(0),
            came: 1,
            ahead: None,
            began_ahead: ahead,
            unusable: 0,
            newest: now,
            period: None,
            ended: false,
        });
        self.new_frame(1, 0, restarted)
    }

    fn new_frame(&mut self, frames: i128, lost: u64, restarted: bool) -> Arrival {
        let frames = u64::try_from(frames).unwrap_or(u64::MAX);
        let index = self.index.map_or(0, |newest| newest.saturating_add(frames));
        self.index = Some(index);
        Arrival::New {
            index,
            lost,
            restarted,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    const PERIOD: Duration = Duration::from_millis(100);

    struct Camera {
        tracker: SequenceTracker,
        now: Instant,
    }

    impl Camera {
        fn new() -> Self {
            Self {
                tracker: SequenceTracker::default(),
                now: Instant::now(),
            }
        }

        fn arrive(
            &mut self,
            seq: impl Into<Option<u64>>,
            stream: impl Into<Option<u64>>,
        ) -> Arrival {
            let (seq, stream) = (seq.into(), stream.into());
            self.tracker.arrive(&FrameNumber { seq, stream }, self.now)
        }

        fn pass(&mut self, time: Duration) -> &mut Self {
            self.now += time;
            self
        }

        /// Frames of one stream, a period apart.
        fn send(
            &mut self,
            numbers: impl IntoIterator<Item = u64>,
            stream: Option<u64>,
        ) -> Vec<Arrival> {
            let arrive = |number| self.pass(PERIOD).arrive(number, stream);
            numbers.into_iter().map(arrive).collect()
        }
    }

    fn new(index: u64, lost: u64) -> Arrival {
        Arrival::New {
            index,
            lost,
            restarted: false,
        }
    }

    fn restarted(index: u64) -> Arrival {
        Arrival::New {
            index,
            lost: 0,
            restarted: true,
        }
    }

    /// Frames that are not new, and numbers counted as lost.
    fn losses(arrivals: &[Arrival]) -> (usize, u64) {
        let lost = arrivals.iter().map(|arrival| match arrival {
            Arrival::New { lost, .. } => Some(*lost),
            _ => None,
        });
        let dropped = lost.clone().filter(Option::is_none).count();
        (dropped, lost.flatten().sum())
    }

    #[test]
    fn a_long_gap_costs_one_more_frame_unless_a_silence_explains_it() {
        let mut camera = Camera::new();
        camera.send(0..12, None);
        let expected = [Arrival::Stray, new(1002, 989), new(1003, 0)];
        assert_eq!(camera.send([1000, 1002, 1003], None), expected);
        camera.pass(SILENCE);
        assert_eq!(camera.arrive(1043, None), new(1043, 39));
    }

    #[test]
    fn a_sample_with_an_unreadable_number_does_not_also_count_as_lost() {
        let mut camera = Camera::new();
        for (unreadable, seq, lost) in [(0, 0, 0), (0, 1, 0), (2, 6, 2), (0, 9, 2), (1, 10, 0)] {
            (0..unreadable).for_each(|_| camera.tracker.arrive_unreadable());
            assert_eq!(camera.send([seq], None), [new(seq, lost)]);
        }
    }

    #[test]
    fn one_stray_frame_costs_a_camera_no_frame_and_no_count() {
        for own in [None, Some(9)] {
            for stray in [
                (Some(5), Some(77)),
                (Some(0), own),
                (Some(900), own),
                (Some(1500), own),
                (Some(5_000_000), own),
                (Some(u64::MAX), own),
                (Some(1002), Some(77)),
                (None, own),
                (None, Some(77)),
            ] {
                let mut camera = Camera::new();
                assert_eq!(losses(&camera.send(1000..1050, own)), (0, 0));
                assert_eq!(camera.arrive(stray.0, stray.1), Arrival::Stray, "{stray:?}");
                let after = camera.send(1050..1450, own);
                assert_eq!(losses(&after), (0, 0), "{own:?} {stray:?}");
                assert!(!after.contains(&restarted(50)));
            }
        }
    }

    #[test]
    fn another_stream_takes_over_after_a_second_and_five_periods_of_silence() {
        for (period, silence) in [(20, 1000), (200, 1000), (2000, 10_000)] {
            let [period, silence] = [period, silence].map(Duration::from_millis);
            let mut camera = Camera::new();
            for number in 0..10 {
                camera.pass(period).arrive(number, 1);
            }
            camera.pass(silence - Duration::from_millis(1));
            assert_eq!(camera.arrive(0, 2), Arrival::Stray, "{period:?}");
            camera.pass(Duration::from_millis(1));
            assert_eq!(camera.arrive(1, 2), restarted(10), "{period:?}");
            let after = camera.send(2..9, Some(2));
            assert_eq!(after, Vec::from_iter((11..18).map(|place| new(place, 0))));
            assert_eq!(camera.arrive(10, 1), Arrival::Stray, "left of the first");
        }
    }

    #[test]
    fn a_restart_after_a_visible_departure_costs_no_frame() {
        let mut camera = Camera::new();
        camera.send(0..50, Some(1));
        let mut place = 50;
        for (stream, numbers) in [(2, 0..50), (3, 20..60), (4, 500..520), (5, 0..5)] {
            camera.tracker.publisher_changed(stream - 1, true);
            // What was still on its way is processed.
            let arrivals = camera.send(numbers, Some(stream));
            assert_eq!(arrivals[0], restarted(place));
            for arrival in &arrivals[1..] {
                place += 1;
                assert_eq!(*arrival, new(place, 0));
            }
            place += 1;
        }
        camera.tracker.publisher_changed(4, true);
        assert_eq!(camera.arrive(0, 6), Arrival::Stray, "an old one is gone");
        camera.tracker.publisher_changed(5, true);
        assert_eq!(losses(&camera.send([5], Some(5))), (0, 0), "its last frame");
        camera.tracker.publisher_changed(5, false);
        assert_eq!(camera.arrive(0, 6), Arrival::Stray, "it is back");
    }

    #[test]
    fn a_silent_restart_costs_only_the_frames_of_one_second() {
        for sent in [20, 1000] {
            let mut camera = Camera::new();
            camera.send(0..sent, None);
            let arrivals = camera.send(0..30, None);
            let (dropped, lost) = losses(&arrivals);
            assert_eq!(lost, 0, "{sent}");
            assert!((9..=10).contains(&dropped), "{sent}: {dropped}");
            assert_eq!(losses(&arrivals[dropped..]), (0, 0));
            assert_eq!(arrivals[dropped], restarted(sent));
            camera.pass(SILENCE);
            let after_a_silence = camera.send(0..30, None);
            assert_eq!(losses(&after_a_silence), (0, 0));
            assert_eq!(camera.arrive(7, None), Arrival::Duplicate);
        }
    }

    #[test]
    fn frames_without_numbers_are_never_lost() {
        let mut camera = Camera::new();
        camera.send(0..100, None);
        camera.pass(SILENCE);
        assert_eq!(camera.arrive(None, None), restarted(100));
        for place in 101..453 {
            assert_eq!(camera.pass(PERIOD).arrive(None, None), new(place, 0));
        }
        camera.pass(SILENCE);
        assert_eq!(camera.arrive(0, None), restarted(453));
        assert_eq!(camera.arrive(1, None), new(454, 0));
    }

    #[test]
    fn of_two_cameras_on_one_key_the_first_wins_and_loses_no_frame() {
        for (first, second) in [
            ((0, Some(1)), (0, Some(2))),
            ((0, None), (0, Some(2))),
            ((1000, None), (0, None)),
        ] {
            let mut camera = Camera::new();
            for number in 0..200 {
                let heard = camera.pass(PERIOD / 2).arrive(first.0 + number, first.1);
                assert_eq!(heard, new(number, 0));
                // The second one sends more often.
                for half in [0, 1] {
                    let other = second.0 + 2 * number + half;
                    let other = camera.pass(PERIOD / 4).arrive(other, second.1);
                    assert_eq!(other, Arrival::Stray);
                }
            }
        }
    }

    proptest! {
        /// Frames are lost, repeated and delayed by less than the window: every one is counted as what it is.
        #[test]
        fn all_frames_are_accounted_for(
            sent in prop::collection::vec((0_u8..10, 0_u64..20), 1..400),
            start in 0_u64..1_000_000,
        ) {
            // Fate 0: lost; 1: sent twice; else once. The second number delays the arrival.
            let mut arriving = Vec::new();
            for (number, (fate, delay)) in sent.iter().enumerate() {
                let number = number as u64;
                let delay = if *delay < 15 { 0 } else { *delay - 14 };
                let copies = match fate { 0 => 0, 1 => 2, _ => 1 };
                arriving.extend(std::iter::repeat_n((number + delay, start + number), copies));
            }
            // Stable, so two frames on the same place keep their order.
            arriving.sort_by_key(|(place, _)| *place);
            // It begins with a step of one: what the first steps mean is tried below.
            let first = arriving.first().map_or(start, |(_, number)| *number) + 2;
            for (place, number) in &mut arriving {
                *place += 2;
                *number += 2;
            }
            arriving.splice(0..0, [(0, first - 2), (1, first - 1)]);
            let mut camera = Camera::new();
            let (mut fresh, mut late, mut duplicate) = (BTreeSet::new(), BTreeSet::new(), 0_usize);
            let (mut lost, mut last_index) = (0, None);
            let begin = arriving.first().map_or(0, |(_, number)| *number);
            let mut stray = BTreeSet::new();
            for (_, number) in &arriving {
                match camera.pass(PERIOD / 50).arrive(*number, None) {
                    Arrival::New { index, lost: missing, restarted } => {
                        prop_assert!(!restarted);
                        prop_assert_eq!(index, *number - begin);
                        prop_assert!(last_index < Some(index));
                        last_index = Some(index);
                        lost += missing;
                        prop_assert!(fresh.insert(*number));
                    }
                    Arrival::Duplicate => duplicate += 1,
                    Arrival::Late => prop_assert!(late.insert(*number)),
                    // Behind a long gap.
                    Arrival::Stray => prop_assert!(stray.insert(*number)),
                }
            }
            prop_assume!(stray.is_empty());
            let distinct: BTreeSet<u64> = arriving.iter().map(|(_, number)| *number).collect();
            prop_assert!(fresh.is_disjoint(&late));
            prop_assert_eq!(fresh.len() + late.len(), distinct.len());
            prop_assert_eq!(duplicate, arriving.len() - distinct.len());
            if let (Some(first), Some(last)) = (fresh.first(), fresh.last()) {
                let found = late.iter().filter(|number| *number > first).count() as u64;
                let missing = (*first..=*last).filter(|number| !distinct.contains(number)).count();
                prop_assert_eq!(lost - found, missing as u64);
            }
        }

        #[test]
        fn no_history_silences_a_camera(
            history in prop::collection::vec((prop_oneof![0_u64..200, any::<u64>()], 0_u64..3), 0..50),
            start in prop_oneof![0_u64..200, 0..u64::MAX - 200],
            stream in 0_u64..3,
        ) {
            let mut camera = Camera::new();
            let mut last_index = None;
            for (number, stream) in history {
                if let Arrival::New { index, .. } = camera.pass(PERIOD).arrive(number, stream) {
                    prop_assert!(last_index.is_none_or(|last| last < index || index == u64::MAX));
                    last_index = Some(index);
                }
            }
            let arrivals = camera.send(start..start + 200, Some(stream));
            let is_new = |arrival: &Arrival| matches!(arrival, Arrival::New { .. });
            let from = arrivals.iter().position(is_new).unwrap();
            prop_assert!(from < 100, "{from}");
            prop_assert!(arrivals[from..].iter().all(is_new));
        }
    }

    /// What a camera at 30 frames/s may send as numbers: one by one, every tenth, milliseconds, nanoseconds.
    fn numberings() -> impl Strategy<Value = Vec<u64>> {
        let steps = prop_oneof![
            (1_u64..20, Just(0_u64)),
            (Just(10_u64), Just(0_u64)),
            (33_u64..200, 0_u64..12),
            (33_333_333_u64..40_000_000, 0_u64..5_000_000),
        ];
        (
            steps,
            0..1_u64 << 40,
            prop::collection::vec(any::<u64>(), 60..200),
        )
            .prop_map(|((step, jitter), start, noise)| {
                let mut number = start;
                let next = noise.into_iter().map(|noise| {
                    number += step + noise % (jitter + 1);
                    number
                });
                next.collect()
            })
    }

    proptest! {
        #[test]
        fn whatever_a_camera_counts_its_frames_are_answered_and_no_loss_is_invented(
            numbers in numberings(),
            period_ms in prop_oneof![Just(33_u64), Just(100), Just(1000), Just(5000)],
        ) {
            let mut camera = Camera::new();
            let period = Duration::from_millis(period_ms);
            let arrivals: Vec<Arrival> = numbers
                .iter()
                .map(|number| camera.pass(period).arrive(*number, None))
                .collect();
            let (dropped, lost) = losses(&arrivals);
            prop_assert!(dropped <= 2, "{dropped} of {}", arrivals.len());
            prop_assert_eq!(lost, 0);
            let restarts = |arrival: &&Arrival| matches!(arrival, Arrival::New { restarted: true, .. });
            prop_assert!(arrivals.iter().filter(restarts).count() <= 1);
        }

        #[test]
        fn a_constant_step_still_tells_what_is_lost(
            step in 2_u64..1000,
            // Up to seven frames in a row are lost: one more, and the next frame has to confirm the jump.
            ahead in prop::collection::vec(prop_oneof![8 => Just(1_u64), 2 => 2_u64..=8], 20..200),
        ) {
            let steps = [1; 4].into_iter().chain(ahead);
            let places: Vec<u64> = steps
                .scan(0, |place, ahead| {
                    *place += ahead;
                    Some(*place)
                })
                .collect();
            let arrivals = Camera::new().send(places.iter().map(|place| place * step), None);
            let (dropped, lost) = losses(&arrivals);
            prop_assert!(dropped <= 1, "{dropped}");
            prop_assert_eq!(lost, places[places.len() - 1] - places.len() as u64);
        }
    }

    #[test]
    fn a_camera_that_changes_its_step_loses_one_frame_at_most() {
        let mut camera = Camera::new();
        camera.send((0..50).map(|n| n * 10), None);
        let every = camera.send(491..600, None);
        assert_eq!(losses(&every), (0, 0), "from tens to ones");
        let tens = camera.send((61..100).map(|n| n * 10), None);
        let (dropped, lost) = losses(&tens);
        assert!(
            dropped <= 1 && lost <= 10,
            "back to tens: {dropped}, {lost}"
        );
    }

    #[test]
    fn times_tell_late_frames_and_duplicates() {
        let mut camera = Camera::new();
        camera.send([0, 33, 67, 100, 134], None);
        assert_eq!(camera.arrive(134, None), Arrival::Duplicate);
        assert_eq!(camera.arrive(110, None), Arrival::Late);
        assert_eq!(losses(&camera.send([167, 201], None)), (0, 0));
    }
}
