//! Sequence numbers of one camera: what is new, lost, late or there twice.
//!
//! The rule. A number above the highest so far is new, and the numbers between are lost, unless it is
//! more than [`MAX_GAP`] above. A number at or below it is late or a duplicate, unless the camera began
//! to number anew, which is taken to be so when
//!
//! - it falls back by [`WINDOW`] or more,
//! - it falls back and names a clip that is neither the present one nor the one before,
//! - it jumps ahead by more than [`MAX_GAP`], or
//! - the last [`RESTART_RUN`] arrivals were all behind and each one more than the one before, as a
//!   restarted camera counts whose numbers were still low.
//!
//! So a restarted camera loses at most [`RESTART_RUN`] - 1 frames, never its stream.

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
        /// Its place in the stream, lost frames counted: grows with every new frame, also across a
        /// restart of the camera. The `step` of a policy is the difference to the frame processed
        /// before.
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
}

/// Follows the sequence numbers of one camera. To be asked on reception, before the ring, for every
/// sample whose number could be read, so that neither an overrun nor a rejected frame is taken for a
/// loss.
#[derive(Clone, Debug, Default)]
pub(crate) struct SequenceTracker {
    present: Option<Numbering>,
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
        }
    }

    /// Whether `sequence`, not above the highest, shows that the camera counts anew. Keeps the books on
    /// late numbers.
    fn fell_back(&mut self, sequence: u64, clip: Option<&Arc<str>>) -> bool {
        let unknown_clip =
            clip.is_some() && clip != self.clip.as_ref() && clip != self.clip_before.as_ref();
        let run = match self.behind {
            Some((before, run)) if before.checked_add(1) == Some(sequence) => run + 1,
            _ => 1,
        };
        self.behind = Some((sequence, run));
        unknown_clip || self.highest - sequence >= WINDOW || run >= RESTART_RUN
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
            self.present = Some(Numbering::starting(sequence, sequence, clip));
            return Arrival::New {
                index: sequence,
                lost: 0,
                restarted: false,
            };
        };
        let restarted = if sequence > present.highest {
            sequence - present.highest > MAX_GAP
        } else {
            present.fell_back(sequence, clip)
        };
        if restarted {
            let index = present.index.saturating_add(1);
            *present = Numbering::starting(sequence, index, clip);
            return Arrival::New {
                index,
                lost: 0,
                restarted: true,
            };
        }
        if sequence > present.highest {
            let lost = sequence - present.highest - 1;
            present.advance(sequence, clip);
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
                new(5, 0),
                new(6, 0),
                new(9, 2),
                Arrival::Late { counted_lost: true },
                Arrival::Duplicate,
                Arrival::Duplicate,
                new(10, 0),
                Arrival::Late { counted_lost: true },
                Arrival::Late {
                    counted_lost: false
                },
                new(11, 0),
            ]
        );
    }

    #[test]
    fn a_camera_that_restarts_from_zero_goes_on_at_once() {
        let restarted = Arrival::New {
            index: 1001,
            lost: 0,
            restarted: true,
        };
        assert_eq!(
            arrivals([1000, 0, 1]),
            [new(1000, 0), restarted, new(1002, 0)]
        );
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
        let first = tracker.arrive(0, Some(&b));
        assert_eq!(
            first,
            Arrival::New {
                index: 10,
                lost: 0,
                restarted: true
            }
        );
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
        let seen = arrivals([3, u64::MAX, 0]);
        for (arrival, expected) in seen[1..].iter().zip([4, 5]) {
            assert_eq!(
                *arrival,
                Arrival::New {
                    index: expected,
                    lost: 0,
                    restarted: true
                }
            );
        }
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
            for (_, number) in &arriving {
                match tracker.arrive(*number, None) {
                    Arrival::New { index, lost: missing, restarted } => {
                        prop_assert!(!restarted);
                        prop_assert_eq!(index, *number);
                        prop_assert!(last_index < Some(index));
                        last_index = Some(index);
                        lost += missing;
                        prop_assert!(fresh.insert(*number));
                    }
                    Arrival::Duplicate => duplicate += 1,
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
