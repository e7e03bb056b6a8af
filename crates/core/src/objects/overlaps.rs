//! Which of many rectangles may overlap one, without looking at each: so that an association need not compute all
//! pairs to find the few within its gate.
//!
//! Both axes are cut into bins. For each bin there are two sets, of the rectangles that begin at or before it and of
//! those that end at or behind it, a bit a rectangle. What may overlap is in four such sets, whatever the sizes are.
//! Numbers go to bins in order, so no rectangle that overlaps is ever left out; some that do not are let through.

use crate::geometry::Corners;

/// Bins an axis.
const BINS: usize = 64;
/// Rectangles a word of a set.
const WORD: usize = u64::BITS as usize;

/// The index with its buffers, which are kept from call to call.
#[derive(Clone, Debug, Default)]
pub(crate) struct OverlapIndex {
    words: usize,
    horizontal: Axis,
    vertical: Axis,
}

impl OverlapIndex {
    /// How many rectangles it takes for the index to pay.
    pub(crate) const WORTH_WHILE: usize = 24;

    /// Takes `rectangles` instead of the previous ones. Their sides are numbers.
    pub(crate) fn fill(&mut self, rectangles: impl Iterator<Item = Corners> + Clone) {
        let number = rectangles.clone().count();
        self.words = number.div_ceil(WORD);
        let horizontal = rectangles.clone().map(|r| (r.x1, r.x2));
        self.horizontal.fill(self.words, horizontal);
        self.vertical
            .fill(self.words, rectangles.map(|r| (r.y1, r.y2)));
    }

    /// Calls `visit` for the place of each rectangle that may overlap `one`, in order.
    #[inline]
    pub(crate) fn visit(&self, one: Corners, mut visit: impl FnMut(usize)) {
        let (left, right) = self.horizontal.sets(self.words, one.x1, one.x2);
        let (top, bottom) = self.vertical.sets(self.words, one.y1, one.y2);
        let words = left.iter().zip(right).zip(top.iter().zip(bottom));
        for (word, ((left, right), (top, bottom))) in words.enumerate() {
            let mut bits = left & right & top & bottom;
            while bits != 0 {
                visit(word * WORD + bits.trailing_zeros() as usize);
                bits &= bits - 1;
            }
        }
    }
}

#[derive(Clone, Debug, Default)]
struct Axis {
    origin: f64,
    bins_a_unit: f64,
    /// Of each bin, those that begin in it or before.
    begun: Vec<u64>,
    /// Of each bin, those that end in it or behind.
    not_ended: Vec<u64>,
}

impl Axis {
    fn fill(&mut self, words: usize, intervals: impl Iterator<Item = (f64, f64)> + Clone) {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (begin, end) in intervals.clone() {
            low = low.min(begin);
            high = high.max(end);
        }
        let span = high - low;
        self.origin = low;
        self.bins_a_unit = if span > 0.0 { BINS as f64 / span } else { 0.0 };
        for sets in [&mut self.begun, &mut self.not_ended] {
            sets.clear();
            sets.resize(BINS * words, 0);
        }
        for (place, (begin, end)) in intervals.enumerate() {
            let (word, bit) = (place / WORD, 1 << (place % WORD));
            let (begin, end) = (self.bin(begin), self.bin(end));
            self.begun[begin * words + word] |= bit;
            self.not_ended[end * words + word] |= bit;
        }
        for place in words..BINS * words {
            self.begun[place] |= self.begun[place - words];
        }
        for place in (0..(BINS - 1) * words).rev() {
            self.not_ended[place] |= self.not_ended[place + words];
        }
    }

    /// Larger numbers never have smaller bins: each of the operations keeps the order, rounding included.
    #[inline]
    fn bin(&self, value: f64) -> usize {
        (((value - self.origin) * self.bins_a_unit) as usize).min(BINS - 1)
    }

    /// Those that begin before `end`, and those that end behind `begin`, as far as bins can tell.
    #[inline]
    fn sets(&self, words: usize, begin: f64, end: f64) -> (&[u64], &[u64]) {
        let (begin, end) = (self.bin(begin) * words, self.bin(end) * words);
        (
            &self.begun[end..end + words],
            &self.not_ended[begin..begin + words],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rectangles(most: usize) -> impl Strategy<Value = Vec<Corners>> {
        // Fine and coarse numbers, so that edges often coincide; a few giants; sides of nothing.
        let number = prop_oneof![
            (0u8..20).prop_map(|step| f64::from(step) / 16.0),
            -0.2..1.2,
            -900.0..900.0
        ];
        let side = prop_oneof![
            (0u8..4).prop_map(|step| f64::from(step) / 16.0),
            0.0..0.3,
            0.0..1000.0
        ];
        let one = (number.clone(), number, side.clone(), side);
        let one = one.prop_map(|(x1, y1, width, height)| Corners {
            x1,
            y1,
            x2: x1 + width,
            y2: y1 + height,
        });
        prop::collection::vec(one, 0..most)
    }

    proptest! {
        #[test]
        fn whatever_overlaps_is_visited_once_and_in_order(many in rectangles(200), ones in rectangles(20)) {
            let mut index = OverlapIndex::default();
            // A used index must answer as a fresh one.
            index.fill(ones.iter().copied());
            index.fill(many.iter().copied());
            for one in ones.iter().chain(&many) {
                let mut visited = Vec::new();
                index.visit(*one, |place| visited.push(place));
                prop_assert!(visited.is_sorted_by(|a, b| a < b));
                prop_assert!(visited.iter().all(|&place| place < many.len()));
                for (place, other) in many.iter().enumerate() {
                    let apart = other.x1 >= one.x2
                        || other.x2 <= one.x1
                        || other.y1 >= one.y2
                        || other.y2 <= one.y1;
                    prop_assert!(apart || visited.contains(&place));
                }
            }
        }
    }

    #[test]
    fn most_of_a_crowd_is_not_examined() {
        let crowd = (0..400).map(|number| {
            let (x1, y1) = (f64::from(number % 20) / 20.0, f64::from(number / 20) / 20.0);
            Corners {
                x1,
                y1,
                x2: x1 + 0.04,
                y2: y1 + 0.04,
            }
        });
        let mut index = OverlapIndex::default();
        index.fill(crowd.clone());
        let mut visited = 0;
        for one in crowd {
            index.visit(one, |_| visited += 1);
        }
        assert!(
            (400..=400 * 9).contains(&visited),
            "{visited} of {}",
            400 * 400
        );
    }
}
