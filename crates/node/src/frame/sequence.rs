//! Sequence numbers of one camera: what is new, lost, late or there twice.
//!
//! The rule. A number above the highest so far is new, and the numbers between are lost, unless it is
//! more than [`MAX_GAP`] above. A number at or below it is late or a duplicate. The camera began to number
//! anew when
//!
//! - a number is behind and names a clip that is neither the present one nor the one before,
//! - two numbers that follow each other by less than [`WINDOW`] are both far from the highest: behind it by
//!   [`WINDOW`] or more, or ahead of it by more than [`MAX_GAP`], or
//! - the last [`RESTART_RUN`] arrivals were all behind and each one more than the one before, as a
//!   restarted camera counts whose numbers were still low.
//!
//! So one stray frame, delayed or replayed, changes nothing but the count of late frames, and a restarted
//! camera loses at most [`RESTART_RUN`] - 1 frames (one, when its numbers were high), never its stream.

use std::sync::Arc;

/// How many numbers back it is remembered whether they came.
pub(crate) const WINDOW: u64 = 64;
/// The longest run of numbers that is believed to be lost: an hour at 30 frames a second.
pub(crate) const MAX_GAP: u64 = 108_000;
/// How many late numbers in counting order make a restart.
pub(crate) const RESTART_RUN: u32 = 8;

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
    /// Samples since the highest number whose own number could not be read.
    unnumbered: u64,
}

/// The numbers since the camera began to count.
#[derive(Clone, Debug)]
struct Numbering {
    first: u64,
    highest: u64,
    index: u64,
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
    fn starting(sequence: u64, index: u64, clip: Option<&Arc<str>>) -> Self {
        Self {
            first: sequence,
            highest: sequence,
            index,
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

    fn advance(&mut self, sequence: u64, clip: Option<&Arc<str>>) {
        let step = sequence - self.highest;
        self.came = if step < WINDOW {
            (self.came << step) | 1
        } else {
            1
        };
        self.highest = sequence;
        self.index = self.index.saturating_add(step);
        self.behind = None;
        self.stray = None;
        if clip != self.clip.as_ref() {
            self.clip_before = std::mem::replace(&mut self.clip, clip.cloned());
        }
    }
}

impl SequenceTracker {
    /// Takes the next number in the order of arrival, of a usable frame or not, with the clip the camera
    /// names.
    pub(crate) fn arrive(&mut self, sequence: u64, clip: Option<&Arc<str>>) -> Arrival {
        let Some(present) = &mut self.present else {
            self.present = Some(Numbering::starting(sequence, 0, clip));
            self.unnumbered = 0;
            return Arrival::New {
                index: 0,
                lost: 0,
                restarted: false,
            };
        };
        let is_behind = sequence <= present.highest;
        let is_far = present.is_far(sequence);
        let restarted = (is_behind && present.is_of_an_unknown_clip(clip))
            || (is_far && present.follows_stray(sequence))
            || (is_behind && present.fell_back(sequence));
        if restarted {
            let index = present.index.saturating_add(1);
            *present = Numbering::starting(sequence, index, clip);
            self.unnumbered = 0;
            return Arrival::New {
                index,
                lost: 0,
                restarted: true,
            };
        }
        if is_far {
            return Arrival::Stray;
        }
        if !is_behind {
            let missing = sequence - present.highest - 1;
            present.advance(sequence, clip);
            // What came without a number was one of those that are missing.
            let lost = missing.saturating_sub(std::mem::take(&mut self.unnumbered));
            return Arrival::New {
                index: present.index,
                lost,
                restarted: false,
            };
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

    /// Takes a sample whose number cannot be read: so many of the numbers that are missing next are not
    /// lost.
    pub(crate) fn arrive_unnumbered(&mut self) {
        self.unnumbered = self.unnumbered.saturating_add(1);
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
            .map(|number| tracker.arrive(number, None))
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
        tracker.arrive(0, None);
        tracker.arrive_unnumbered();
        tracker.arrive_unnumbered();
        assert_eq!(tracker.arrive(5, None), new(5, 2));
        assert_eq!(tracker.arrive(8, None), new(8, 2), "the count begins anew");
        tracker.arrive_unnumbered();
        assert_eq!(tracker.arrive(9, None), new(9, 0));
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
            tracker.arrive(number, Some(&a));
        }
        assert_eq!(tracker.arrive(0, Some(&b)), restarted(10));
        assert_eq!(tracker.arrive(1, Some(&b)), new(11, 0));

        let mut tracker = SequenceTracker::default();
        tracker.arrive(9, Some(&a));
        tracker.arrive(11, Some(&b));
        assert_eq!(
            tracker.arrive(10, Some(&a)),
            Arrival::Late { counted_lost: true }
        );
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
                match tracker.arrive(*number, None) {
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
                if let Arrival::New { index, .. } = tracker.arrive(number, None) {
                    prop_assert!(last_index.is_none_or(|last| last < index || index == u64::MAX));
                    last_index = Some(index);
                }
            }
            let heard: Vec<bool> = (start..start + 20)
                .map(|number| matches!(tracker.arrive(number, None), Arrival::New { .. }))
                .collect();
            let from = heard.iter().position(|heard| *heard).unwrap();
            prop_assert!(from < RESTART_RUN as usize);
            prop_assert!(heard[from..].iter().all(|heard| *heard));
        }
    }
}
