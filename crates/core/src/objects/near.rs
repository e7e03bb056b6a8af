//! Finds the boxes that may overlap a given one without looking at each, so that matching need not compute all pairs to
//! find the few within its gate.
//!
//! Both axes are cut into bins. For each bin there are two sets with a bit for each box: of those that begin in it or
//! before, and of those that end in it or behind. Whatever may overlap an area is in four such sets. Larger numbers
//! never have smaller bins, rounding included, so no box that overlaps is left out; some that do not are let through.

use crate::geometry::Corners;

/// Bins of an axis: with more of them fewer boxes are let through, and the sets take longer to fill.
const BINS: usize = 32;

/// Boxes in one word of a set.
const WORD: usize = u64::BITS as usize;

/// With fewer boxes it takes longer to fill the sets than to look at every box.
const WORTH_WHILE: usize = 16;

/// The sets of a frame's boxes. The buffers are reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct NearBoxes {
    boxes: Vec<(Corners, u32)>,
    horizontal: AxisSets,
    vertical: AxisSets,
}

impl NearBoxes {
    /// Replaces the boxes by `boxes`, each with its index. Their sides are numbers.
    pub(crate) fn fill(&mut self, boxes: impl Iterator<Item = (Corners, u32)>) {
        self.boxes.clear();
        self.boxes.extend(boxes);
        if self.is_selective() {
            let boxes = self.boxes.iter();
            self.horizontal.fill(boxes.clone().map(|(b, _)| (b.x1, b.x2)));
            self.vertical.fill(boxes.map(|(b, _)| (b.y1, b.y2)));
        }
    }

    /// False if there are so few boxes that [`visit`](Self::visit) looks at each of them.
    #[inline]
    pub(crate) fn is_selective(&self) -> bool {
        self.boxes.len() >= WORTH_WHILE
    }

    /// Calls `visit` with the index and the corners of each box that overlaps `area`, and of some that do not, in the order
    /// in which they were given.
    #[inline]
    pub(crate) fn visit(&self, area: Corners, mut visit: impl FnMut(u32, Corners)) {
        if !self.is_selective() {
            for (corners, index) in &self.boxes {
                if corners.meets(area) {
                    visit(*index, *corners);
                }
            }
            return;
        }
        let (left, right) = self.horizontal.sets(area.x1, area.x2);
        let (top, bottom) = self.vertical.sets(area.y1, area.y2);
        let words = left.iter().zip(right).zip(top.iter().zip(bottom));
        for (((left, right), (top, bottom)), boxes) in words.zip(self.boxes.chunks(WORD)) {
            let mut near = left & right & top & bottom;
            while near != 0 {
                let (corners, index) = boxes[near.trailing_zeros() as usize];
                visit(index, corners);
                // Clears the lowest bit.
                near &= near - 1;
            }
        }
    }
}

/// The sets of one axis.
#[derive(Clone, Debug, Default)]
struct AxisSets {
    origin: f64,
    bins_per_unit: f64,
    /// The words of a set.
    words: usize,
    /// For each bin, the boxes that begin in it or before.
    begun: Vec<u64>,
    /// For each bin, the boxes that end in it or behind.
    not_ended: Vec<u64>,
}

impl AxisSets {
    fn fill(&mut self, intervals: impl ExactSizeIterator<Item = (f64, f64)> + Clone) {
        let low = intervals.clone().fold(f64::INFINITY, |low, (begin, _)| low.min(begin));
        let high = intervals.clone().fold(f64::NEG_INFINITY, |high, (_, end)| high.max(end));
        let span = high - low;
        self.origin = low;
        self.bins_per_unit = if span > 0.0 { BINS as f64 / span } else { 0.0 };
        self.words = intervals.len().div_ceil(WORD);
        let words = self.words;
        for sets in [&mut self.begun, &mut self.not_ended] {
            sets.clear();
            sets.resize(BINS * words, 0);
        }
        for (place, (begin, end)) in intervals.enumerate() {
            let word = place / WORD;
            let bit = 1 << (place % WORD);
            let first_bin = self.bin(begin);
            let last_bin = self.bin(end);
            self.begun[first_bin * words + word] |= bit;
            self.not_ended[last_bin * words + word] |= bit;
        }
        // Until here each set has the boxes of its own bin: now it also gets those of the bins before it, or behind it.
        for place in words..BINS * words {
            self.begun[place] |= self.begun[place - words];
        }
        for place in (0..(BINS - 1) * words).rev() {
            self.not_ended[place] |= self.not_ended[place + words];
        }
    }

    /// The bin of a number. Each operation keeps the order of numbers; what lies outside is in the first bin or the last.
    #[inline]
    fn bin(&self, value: f64) -> usize {
        (((value - self.origin) * self.bins_per_unit) as usize).min(BINS - 1)
    }

    /// The boxes that begin before `end`, and those that end behind `begin`, as far as bins can tell.
    #[inline]
    fn sets(&self, begin: f64, end: f64) -> (&[u64], &[u64]) {
        let set = |value| self.bin(value) * self.words;
        (
            &self.begun[set(end)..][..self.words],
            &self.not_ended[set(begin)..][..self.words],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn boxes() -> impl Strategy<Value = Vec<(Corners, u32)>> {
        let side = || (-1e3..1e3_f64, 0.0..1e3_f64, prop::bool::weighted(0.9));
        let interval = |(begin, length, small): (f64, f64, bool)| {
            let scale = if small { 1e-3 } else { 1.0 };
            (begin * scale, (begin + length) * scale)
        };
        let corners = (side(), side()).prop_map(move |(x, y)| {
            let (x1, x2) = interval(x);
            let (y1, y2) = interval(y);
            Corners { x1, y1, x2, y2 }
        });
        prop::collection::vec(corners, 0..100)
            .prop_map(|boxes| boxes.into_iter().zip(0..).collect())
    }

    proptest! {
        #[test]
        fn no_overlapping_box_is_left_out_and_none_comes_twice(ones in boxes(), many in boxes()) {
            let mut boxes = NearBoxes::default();
            // A used one must answer as a fresh one.
            boxes.fill(ones.iter().copied());
            boxes.fill(many.iter().copied());
            for (one, _) in ones.iter().chain(&many) {
                let mut near = Vec::new();
                boxes.visit(*one, |place, _| near.push(place));
                prop_assert!(near.is_sorted_by(|a, b| a < b));
                let meets = |other: &Corners| {
                    other.x1 < one.x2 && other.x2 > one.x1 && other.y1 < one.y2 && other.y2 > one.y1
                };
                let mut overlapping = many.iter().filter(|(other, _)| meets(other));
                prop_assert!(overlapping.all(|(_, place)| near.contains(place)));
            }
        }
    }

    #[test]
    fn of_many_boxes_few_that_do_not_overlap_are_let_through() {
        let in_row = |place: u32| {
            let x1 = f64::from(place);
            Corners {
                x1,
                y1: 0.0,
                x2: x1 + 0.5,
                y2: 1.0,
            }
        };
        let mut boxes = NearBoxes::default();
        boxes.fill((0..320).map(|place| (in_row(place), place)));
        let mut near = Vec::new();
        boxes.visit(in_row(100), |place, _| near.push(place));
        assert!(
            near.contains(&100) && near.len() <= 2 * 320 / BINS + 1,
            "{near:?}"
        );
    }
}
