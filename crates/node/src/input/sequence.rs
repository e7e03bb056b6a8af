//! Sequence numbers of one camera: what is new, lost, late or there twice.
//!
//! The rule. A number above the highest so far is new, and the numbers between are lost, unless it is
//! more than [`MAX_GAP`] above. A number at or below it is late or a duplicate. The camera began to number
//! anew when
//!
//! - a frame says that its number belongs to another numbering (`stream`),
//! - a number is behind and names a clip that is neither the present one nor the one before,
//! - a number is behind and was captured after all others,
//! - a number is behind, or far from the highest, after [`SILENCE`] without any frame, or after frames without numbers,
//! - two numbers that follow each other by less than [`WINDOW`] are both far from the highest: behind it by
//!   [`WINDOW`] or more, or ahead of it by more than [`MAX_GAP`], or
//! - the last [`RESTART_RUN`] arrivals were all behind and each one more than the one before, as a
//!   restarted camera counts whose numbers were still low.
//!
//! So one stray frame, delayed or replayed, changes nothing but the count of late frames. A restarted camera loses no
//! frame where it says its numbering or its capture times, or was silent for a while; else at most [`RESTART_RUN`] - 1
//! (one, when its numbers were high), and never its stream. Of two cameras on one key the later one is heard, and the
//! other's frames are late.
//!
//! A frame without a number is the next one, whatever its neighbours' numbers are.

use super::FrameOrder;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// How many numbers back it is remembered whether they came.
pub(crate) const WINDOW: u64 = 64;
/// The longest run of numbers that is believed to be lost: an hour at 30 frames a second.
pub(crate) const MAX_GAP: u64 = 108_000;
/// How many late numbers in counting order make a restart.
pub(crate) const RESTART_RUN: u32 = 8;
/// No frame is delayed so long while none overtakes it.
const SILENCE: Duration = Duration::from_secs(2);
/// Numberings that are remembered, so that what is left of them on its way is late and begins nothing.
const FORMER_STREAMS: usize = 8;

/// What a sequence number means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// A new frame.
    New {
        /// Its place in the stream, 0 for the first frame, lost frames counted: grows with every new
        /// frame, also across a restart of the camera. The `step` of a policy is the difference to the
        /// frame processed before.
        index: u64,
        /// Numbers missing between the frame before and this one.
        lost: u64,
        /// The camera began to number anew. Not set for the first frame.
        restarted: bool,
    },
    /// The number came before.
    Duplicate,
    /// A later number came before.
    Late {
        /// Whether the number was part of an earlier `lost`: it is late now instead.
        counted_lost: bool,
    },
    /// The number is far from all others: a stray frame, unless the next number follows it.
    Stray,
}

/// Follows the sequence numbers of one camera. To be asked on reception, before the ring, for every
/// sample whose number could be read, so that neither an overrun nor a rejected frame is taken for a
/// loss.
#[derive(Clone, Debug, Default)]
pub(crate) struct SequenceTracker {
    present: Option<Numbering>,
    /// Place of the newest frame.
    index: Option<u64>,
    /// Samples since the highest number that have none, or none that can be read.
    unnumbered: u64,
    /// Those of them that are frames, with places of their own.
    between: u64,
    /// When the last sample came.
    last_received: Option<Instant>,
    /// Numberings that were left.
    former_streams: VecDeque<Option<u64>>,
    /// Highest number of the numbering before, where that was left because of a capture time, and how many numbers in a
    /// row went on there.
    former: Option<(u64, u32)>,
}

/// The numbers since the camera began to count.
#[derive(Clone, Debug)]
struct Numbering {
    stream: Option<u64>,
    first: u64,
    highest: u64,
    /// Capture time of the newest frame.
    time_ns: Option<u64>,
    /// Bit `k`: whether number `highest - k` came.
    came: u64,
    clip: Option<Arc<str>>,
    clip_before: Option<Arc<str>>,
    /// The last late number, and how many came in counting order up to it.
    behind: Option<(u64, u32)>,
    /// The last number far from the highest.
    stray: Option<u64>,
}

impl Numbering {
    fn starting(sequence: u64, clip: Option<&Arc<str>>, order: &FrameOrder) -> Self {
        Self {
            stream: order.stream,
            first: sequence,
            highest: sequence,
            time_ns: order.time_ns,
            came: 1,
            clip: clip.cloned(),
            clip_before: None,
            behind: None,
            stray: None,
        }
    }

    /// Whether `sequence` is too far from the highest to be a late number or the end of a gap.
    fn is_far(&self, sequence: u64) -> bool {
        match sequence.checked_sub(self.highest) {
            Some(ahead) => ahead > MAX_GAP,
            None => self.highest - sequence >= WINDOW,
        }
    }

    /// Whether `sequence`, far from the highest, follows another such number. Remembers it.
    fn follows_stray(&mut self, sequence: u64) -> bool {
        let before = self.stray.replace(sequence);
        before
            .and_then(|before| sequence.checked_sub(before))
            .is_some_and(|step| (1..WINDOW).contains(&step))
    }

    /// Whether `sequence`, not above the highest, shows that the camera counts anew. Keeps the books on
    /// late numbers.
    fn fell_back(&mut self, sequence: u64) -> bool {
        let run = match self.behind {
            Some((before, run)) if before.checked_add(1) == Some(sequence) => run + 1,
            _ => 1,
        };
        self.behind = Some((sequence, run));
        run >= RESTART_RUN
    }

    fn is_of_an_unknown_clip(&self, clip: Option<&Arc<str>>) -> bool {
        clip.is_some() && clip != self.clip.as_ref() && clip != self.clip_before.as_ref()
    }

    /// Whether a frame was captured after all of this numbering.
    fn is_before(&self, time_ns: Option<u64>) -> bool {
        matches!((self.time_ns, time_ns), (Some(newest), Some(time)) if time > newest)
    }

    fn advance(&mut self, sequence: u64, clip: Option<&Arc<str>>, order: &FrameOrder) {
        let step = sequence - self.highest;
        self.came = if step < WINDOW {
            (self.came << step) | 1
        } else {
            1
        };
        self.highest = sequence;
        self.time_ns = order.time_ns.or(self.time_ns);
        self.behind = None;
        self.stray = None;
        if clip != self.clip.as_ref() {
            self.clip_before = std::mem::replace(&mut self.clip, clip.cloned());
        }
    }
}

impl SequenceTracker {
    /// Takes the next number in the order of arrival, of a usable frame or not, with the clip the camera
    /// names and what else tells its place.
    pub(crate) fn arrive(
        &mut self,
        sequence: u64,
        clip: Option<&Arc<str>>,
        order: &FrameOrder,
    ) -> Arrival {
        let before = std::mem::replace(&mut self.last_received, order.received);
        let silent = matches!(
            (before, order.received),
            (Some(before), Some(now)) if now.saturating_duration_since(before) >= SILENCE
        );
        let Some(present) = &mut self.present else {
            // Frames without numbers may have come before.
            return self.begin(sequence, clip, order);
        };
        if present.stream != order.stream {
            if !silent && self.former_streams.contains(&order.stream) {
                return Arrival::Late {
                    counted_lost: false,
                };
            }
            return self.begin(sequence, clip, order);
        }
        let is_behind = sequence <= present.highest;
        let is_far = present.is_far(sequence);
        if is_behind && self.between == 0 && !silent && present.is_before(order.time_ns) {
            // What goes on in the numbering that is left now is late.
            let former = Some((present.highest, 0));
            let began = self.begin(sequence, clip, order);
            self.former = former;
            return began;
        }
        let restarted = (is_behind && present.is_of_an_unknown_clip(clip))
            || ((is_behind || is_far) && (silent || self.between > 0))
            || (is_far && present.follows_stray(sequence))
            || (is_behind && present.fell_back(sequence));
        if restarted {
            return self.begin(sequence, clip, order);
        }
        if is_far {
            return Arrival::Stray;
        }
        if !is_behind {
            let step = sequence - present.highest;
            if step > 1 && self.goes_on_before(sequence) {
                return match self.former {
                    Some((_, 1)) => Arrival::Late {
                        counted_lost: false,
                    },
                    _ => self.begin(sequence, clip, order),
                };
            }
            return self.advance(sequence, clip, order);
        }
        let bit = 1 << (present.highest - sequence);
        if present.came & bit != 0 {
            return Arrival::Duplicate;
        }
        present.came |= bit;
        Arrival::Late {
            counted_lost: sequence > present.first,
        }
    }

    /// Takes a frame that has no number: it is the next one.
    pub(crate) fn arrive_without_number(&mut self) -> Arrival {
        self.unnumbered = self.unnumbered.saturating_add(1);
        self.between = self.between.saturating_add(1);
        Arrival::New {
            index: self.place(1),
            lost: 0,
            restarted: false,
        }
    }

    /// Takes a sample whose number cannot be read: so many of the numbers that are missing next are not
    /// lost.
    pub(crate) fn arrive_unreadable(&mut self) {
        self.unnumbered = self.unnumbered.saturating_add(1);
    }

    /// The place `step` behind the newest frame.
    fn place(&mut self, step: u64) -> u64 {
        let index = self.index.map_or(0, |newest| newest.saturating_add(step));
        self.index = Some(index);
        index
    }

    /// The camera begins to count.
    fn begin(&mut self, sequence: u64, clip: Option<&Arc<str>>, order: &FrameOrder) -> Arrival {
        let restarted = self.index.is_some();
        let left = self
            .present
            .replace(Numbering::starting(sequence, clip, order));
        if let Some(left) = left.filter(|left| left.stream != order.stream) {
            self.former_streams.retain(|stream| *stream != order.stream);
            self.former_streams.push_back(left.stream);
            if self.former_streams.len() > FORMER_STREAMS {
                self.former_streams.pop_front();
            }
        }
        self.former = None;
        (self.unnumbered, self.between) = (0, 0);
        Arrival::New {
            index: self.place(1),
            lost: 0,
            restarted,
        }
    }

    /// A number above the highest.
    fn advance(&mut self, sequence: u64, clip: Option<&Arc<str>>, order: &FrameOrder) -> Arrival {
        let highest = self
            .present
            .as_ref()
            .map_or(sequence, |present| present.highest);
        let step = sequence.saturating_sub(highest).max(1);
        if let Some(present) = &mut self.present {
            present.advance(sequence, clip, order);
            self.former = self.former.map(|(number, _)| (number, 0));
        }
        // What came without a number was one of those that are missing.
        let lost = (step - 1).saturating_sub(std::mem::take(&mut self.unnumbered));
        let between = std::mem::take(&mut self.between).min(step - 1);
        Arrival::New {
            index: self.place(step - between),
            lost,
            restarted: false,
        }
    }

    /// Whether `sequence` goes on in the numbering before this one: another camera sends on the same key, or what it
    /// sent is still on its way. Remembers it.
    fn goes_on_before(&mut self, sequence: u64) -> bool {
        let Some((highest, run)) = &mut self.former else {
            return false;
        };
        let step = sequence.checked_sub(*highest);
        if !step.is_some_and(|step| (1..=WINDOW).contains(&step)) {
            return false;
        }
        *highest = sequence;
        *run += 1;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn new(index: u64, lost: u64) -> Arrival {
        Arrival::New {
            index,
            lost,
            restarted: false,
        }
    }

    fn arrivals(numbers: impl IntoIterator<Item = u64>) -> Vec<Arrival> {
        let mut tracker = SequenceTracker::default();
        numbers
            .into_iter()
            .map(|number| tracker.arrive(number, None, &FrameOrder::default()))
            .collect()
    }

    #[test]
    fn a_gap_is_lost_and_what_comes_of_it_later_is_late_once() {
        assert_eq!(
            arrivals([5, 6, 9, 7, 7, 9, 10, 8, 4, 11]),
            [
                new(0, 0),
                new(1, 0),
                new(4, 2),
                Arrival::Late { counted_lost: true },
                Arrival::Duplicate,
                Arrival::Duplicate,
                new(5, 0),
                Arrival::Late { counted_lost: true },
                Arrival::Late {
                    counted_lost: false
                },
                new(6, 0),
            ]
        );
    }

    fn restarted(index: u64) -> Arrival {
        Arrival::New {
            index,
            lost: 0,
            restarted: true,
        }
    }

    #[test]
    fn a_camera_that_restarts_from_zero_goes_on_with_its_second_frame() {
        assert_eq!(
            arrivals([1000, 0, 1, 2]),
            [new(0, 0), Arrival::Stray, restarted(1), new(2, 0)]
        );
        assert_eq!(
            arrivals([1000, 0, 3])[1..],
            [Arrival::Stray, restarted(1)],
            "also when some of its frames are lost"
        );
    }

    #[test]
    fn one_stray_old_frame_neither_restarts_the_stream_nor_loses_frames() {
        for stray in [0, 900, 5_000_000] {
            assert_eq!(
                arrivals([1000, 1001, stray, 1002, 1003]),
                [new(0, 0), new(1, 0), Arrival::Stray, new(2, 0), new(3, 0)]
            );
        }
        let mixed = arrivals((1000..1100).flat_map(|number| [number, 5 * (number - 1000)]));
        let strays = mixed.iter().filter(|seen| **seen == Arrival::Stray).count();
        assert_eq!(strays, 100, "a second camera on the key");
    }

    #[test]
    fn a_sample_without_a_readable_number_is_not_lost_as_well() {
        let mut tracker = SequenceTracker::default();
        tracker.arrive(0, None, &FrameOrder::default());
        tracker.arrive_unreadable();
        tracker.arrive_unreadable();
        assert_eq!(tracker.arrive(5, None, &FrameOrder::default()), new(5, 2));
        assert_eq!(
            tracker.arrive(8, None, &FrameOrder::default()),
            new(8, 2),
            "the count begins anew"
        );
        tracker.arrive_unreadable();
        assert_eq!(tracker.arrive(9, None, &FrameOrder::default()), new(9, 0));
    }

    #[test]
    fn a_camera_that_restarts_early_goes_on_after_a_few_frames() {
        let seen = arrivals((0..20).chain(0..30));
        let (dropped, went_on) = seen[20..].split_at(RESTART_RUN as usize - 1);
        assert!(dropped.iter().all(|arrival| *arrival == Arrival::Duplicate));
        assert!(matches!(
            went_on[0],
            Arrival::New {
                restarted: true,
                lost: 0,
                ..
            }
        ));
        assert!(went_on[1..].iter().all(|arrival| matches!(
            arrival,
            Arrival::New {
                restarted: false,
                lost: 0,
                ..
            }
        )));
    }

    #[test]
    fn a_new_clip_may_count_from_the_start_and_the_clip_before_may_be_late() {
        let [a, b]: [Arc<str>; 2] = ["a".into(), "b".into()];
        let mut tracker = SequenceTracker::default();
        for number in 0..10 {
            tracker.arrive(number, Some(&a), &FrameOrder::default());
        }
        assert_eq!(
            tracker.arrive(0, Some(&b), &FrameOrder::default()),
            restarted(10)
        );
        assert_eq!(
            tracker.arrive(1, Some(&b), &FrameOrder::default()),
            new(11, 0)
        );

        let mut tracker = SequenceTracker::default();
        tracker.arrive(9, Some(&a), &FrameOrder::default());
        tracker.arrive(11, Some(&b), &FrameOrder::default());
        assert_eq!(
            tracker.arrive(10, Some(&a), &FrameOrder::default()),
            Arrival::Late { counted_lost: true }
        );
    }

    fn at(seconds: f64) -> FrameOrder {
        FrameOrder {
            time_ns: Some((seconds * 1e9) as u64),
            ..FrameOrder::default()
        }
    }

    fn losses(seen: &[Arrival]) -> (usize, u64) {
        let dropped = seen
            .iter()
            .filter(|seen| !matches!(seen, Arrival::New { .. }));
        let lost = seen.iter().map(|seen| match seen {
            Arrival::New { lost, .. } => *lost,
            _ => 0,
        });
        (dropped.count(), lost.sum())
    }

    #[test]
    fn a_restart_costs_no_frame_where_the_camera_says_its_numbering() {
        let order = |stream| FrameOrder {
            stream: Some(stream),
            ..FrameOrder::default()
        };
        let mut tracker = SequenceTracker::default();
        let mut send = |numbers: std::ops::Range<u64>, stream| -> Vec<_> {
            numbers
                .map(|number| tracker.arrive(number, None, &order(stream)))
                .collect()
        };
        send(0..50, 1);
        for (round, numbers) in [0..50, 20..60, 500..520, 5_000_000..5_000_005]
            .into_iter()
            .enumerate()
        {
            let seen = send(numbers, 2 + round as u64);
            assert_eq!(losses(&seen), (0, 0));
            assert!(matches!(
                seen[0],
                Arrival::New {
                    restarted: true,
                    ..
                }
            ));
            assert!(matches!(
                seen[1],
                Arrival::New {
                    restarted: false,
                    ..
                }
            ));
        }
        let late = send(50..52, 1);
        assert_eq!(losses(&late).0, 2, "what is left of the first is late");
        assert_eq!(losses(&send(5_000_005..5_000_009, 5)), (0, 0));
    }

    #[test]
    fn a_restart_costs_no_frame_where_capture_times_go_on() {
        for sent in [5, 50, 1000] {
            let mut tracker = SequenceTracker::default();
            for number in 0..sent {
                tracker.arrive(number, None, &at(number as f64 / 10.0));
            }
            let seen: Vec<_> = (0..sent + 20)
                .map(|number| tracker.arrive(number, None, &at(200.0 + number as f64 / 10.0)))
                .collect();
            assert_eq!(losses(&seen), (0, 0), "{sent}");
            assert!(matches!(
                seen[0],
                Arrival::New {
                    restarted: true,
                    ..
                }
            ));
            let again = tracker.arrive(sent + 19, None, &at(200.0 + (sent + 19) as f64 / 10.0));
            assert_eq!(again, Arrival::Duplicate);
        }
    }

    #[test]
    fn a_restart_costs_no_frame_after_a_silence() {
        let start = Instant::now();
        let order = |milliseconds| FrameOrder {
            received: Some(start + Duration::from_millis(milliseconds)),
            ..FrameOrder::default()
        };
        let mut tracker = SequenceTracker::default();
        for number in 0..50 {
            tracker.arrive(number, None, &order(number * 20));
        }
        let seen: Vec<_> = (0..50)
            .map(|number| tracker.arrive(number, None, &order(3500 + number * 20)))
            .collect();
        assert_eq!(losses(&seen), (0, 0));
        assert_eq!(tracker.arrive(7, None, &order(4600)), Arrival::Duplicate);
    }

    #[test]
    fn frames_without_numbers_are_never_lost_whatever_came_before_and_after() {
        let mut tracker = SequenceTracker::default();
        for number in 0..100 {
            tracker.arrive(number, None, &FrameOrder::default());
        }
        for place in 100..453 {
            assert_eq!(tracker.arrive_without_number(), new(place, 0));
        }
        assert_eq!(
            tracker.arrive(0, None, &FrameOrder::default()),
            restarted(453)
        );
        assert_eq!(tracker.arrive(1, None, &FrameOrder::default()), new(454, 0));
        // One of a camera's frames came without its number.
        assert_eq!(tracker.arrive_without_number(), new(455, 0));
        assert_eq!(tracker.arrive(3, None, &FrameOrder::default()), new(456, 0));
        assert_eq!(tracker.arrive_without_number(), new(457, 0));
        assert_eq!(tracker.arrive(6, None, &FrameOrder::default()), new(459, 1));
    }

    #[test]
    fn two_cameras_on_one_key_make_late_frames_and_no_lost_ones() {
        let mut tracker = SequenceTracker::default();
        let seen: Vec<_> = (0..200_u64)
            .flat_map(|n| [(1000 + n, n as f64), (n, n as f64 + 0.5)])
            .map(|(number, time)| tracker.arrive(number, None, &at(time)))
            .collect();
        let (dropped, lost) = losses(&seen);
        assert_eq!(lost, 0);
        assert!((190..=210).contains(&dropped), "{dropped}");
    }

    #[test]
    fn an_absurd_jump_is_a_restart_and_not_a_loss() {
        assert_eq!(
            arrivals([3, u64::MAX - 1, u64::MAX, 0, 1]),
            [
                new(0, 0),
                Arrival::Stray,
                restarted(1),
                Arrival::Stray,
                restarted(2)
            ]
        );
        assert_eq!(arrivals([u64::MAX, 0, 1])[2], restarted(1));
    }

    proptest! {
        /// Frames are lost, repeated and delayed by less than the window: every one is told what it is.
        #[test]
        fn the_books_balance(
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
            let mut tracker = SequenceTracker::default();
            let (mut fresh, mut late, mut duplicate) = (BTreeSet::new(), BTreeSet::new(), 0_usize);
            let (mut lost, mut found, mut last_index) = (0, 0, None);
            let begin = arriving.first().map_or(0, |(_, number)| *number);
            for (_, number) in &arriving {
                match tracker.arrive(*number, None, &FrameOrder::default()) {
                    Arrival::New { index, lost: missing, restarted } => {
                        prop_assert!(!restarted);
                        prop_assert_eq!(index, *number - begin);
                        prop_assert!(last_index < Some(index));
                        last_index = Some(index);
                        lost += missing;
                        prop_assert!(fresh.insert(*number));
                    }
                    Arrival::Duplicate => duplicate += 1,
                    Arrival::Stray => prop_assert!(false, "nothing strays"),
                    Arrival::Late { counted_lost } => {
                        found += u64::from(counted_lost);
                        prop_assert!(late.insert(*number));
                    }
                }
            }
            let distinct: BTreeSet<u64> = arriving.iter().map(|(_, number)| *number).collect();
            prop_assert!(fresh.is_disjoint(&late));
            prop_assert_eq!(fresh.len() + late.len(), distinct.len());
            prop_assert_eq!(duplicate, arriving.len() - distinct.len());
            if let (Some(first), Some(last)) = (fresh.first(), fresh.last()) {
                let missing = (*first..=*last).filter(|number| !distinct.contains(number)).count();
                prop_assert_eq!(lost - found, missing as u64);
            }
        }

        /// Whatever came before, a camera that counts up is heard again within a few frames.
        #[test]
        fn no_history_silences_a_camera(
            history in prop::collection::vec(prop_oneof![0_u64..200, any::<u64>()], 0..50),
            start in prop_oneof![0_u64..200, 0..u64::MAX - 100],
        ) {
            let mut tracker = SequenceTracker::default();
            let mut last_index = None;
            for number in history {
                if let Arrival::New { index, .. } = tracker.arrive(number, None, &FrameOrder::default()) {
                    prop_assert!(last_index.is_none_or(|last| last < index || index == u64::MAX));
                    last_index = Some(index);
                }
            }
            let heard: Vec<bool> = (start..start + 20)
                .map(|number| matches!(tracker.arrive(number, None, &FrameOrder::default()), Arrival::New { .. }))
                .collect();
            let from = heard.iter().position(|heard| *heard).unwrap();
            prop_assert!(from < RESTART_RUN as usize);
            prop_assert!(heard[from..].iter().all(|heard| *heard));
        }
    }
}
