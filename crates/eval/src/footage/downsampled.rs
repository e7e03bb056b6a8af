//! Lowers the frame rate of footage by keeping only some frames, as evenly spaced as possible.

use super::source::{FrameSource, Stopper};
use crate::error::EvalError;
use albireo_vision::picture::EncodedPicture;

/// Selects the frames to keep when the frame rate is lowered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FrameSelection {
    /// The share of frames that are kept, at most 1.
    share: f64,
}

impl FrameSelection {
    /// Lowers `rate` frames per second to `wanted`; keeps all frames if `rate` is not higher.
    pub(crate) fn new(rate: f64, wanted: f64) -> Self {
        let share = wanted / rate;
        // Written so that NaN keeps all frames.
        let is_lower = share > 0.0 && share < 1.0;
        Self {
            share: if is_lower { share } else { 1.0 },
        }
    }

    /// Returns true if frame `index` is kept; frame 0 always is.
    pub(crate) fn takes(&self, index: u64) -> bool {
        // A rounding error must not put a product just below the whole number that it should be.
        let due = |index: u64| (index as f64 * self.share + 1e-9).floor();
        index == 0 || due(index) > due(index - 1)
    }
}

/// A source of which only some frames per second are taken.
pub struct Downsampled<'a> {
    source: &'a mut dyn FrameSource,
    selection: FrameSelection,
    rate: f64,
    passed: u64,
}

impl<'a> Downsampled<'a> {
    /// Lowers `source` to `rate` frames per second, unless its own rate is lower.
    pub fn new(source: &'a mut dyn FrameSource, rate: f64) -> Self {
        let own = source.rate();
        Self {
            selection: FrameSelection::new(own, rate),
            rate: own.min(rate),
            source,
            passed: 0,
        }
    }
}

impl FrameSource for Downsampled<'_> {
    fn name(&self) -> &str {
        self.source.name()
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        let frames = self.source.frames()?;
        let taken = (0..frames).filter(|index| self.selection.takes(*index)).count();
        Some(taken as u64)
    }

    fn clip(&self) -> Option<&str> {
        self.source.clip()
    }

    fn picture_name(&self) -> Option<String> {
        self.source.picture_name()
    }

    fn time_ns(&self) -> Option<u64> {
        self.source.time_ns()
    }

    fn remarks(&self) -> Vec<String> {
        self.source.remarks()
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        loop {
            let next = self.source.next();
            let index = self.passed;
            self.passed += 1;
            let Ok(Some(_)) = &next else {
                // The end; or a fault, which is told even in the place of a picture that would be left out.
                return next;
            };
            if self.selection.takes(index) {
                return next;
            }
        }
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.passed = 0;
        self.source.rewind()
    }

    fn stopper(&self) -> Option<Stopper> {
        self.source.stopper()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::footage::Pictures;
    use std::path::Path;

    fn road() -> Pictures {
        let road = concat!(env!("CARGO_MANIFEST_DIR"), "/../../demo/road.tar");
        Pictures::of_archive(Path::new(road), 10.0).unwrap()
    }

    fn taken(kept: FrameSelection, frames: u64) -> Vec<u64> {
        (0..frames).filter(|index| kept.takes(*index)).collect()
    }

    #[test]
    fn frames_are_selected_as_evenly_as_possible() {
        assert_eq!(taken(FrameSelection::new(25.0, 5.0), 20), [0, 5, 10, 15]);
        assert_eq!(taken(FrameSelection::new(25.0, 10.0), 11), [0, 3, 5, 8, 10]);
        for wanted in [1.0, 3.0, 7.0, 24.9] {
            let frames = taken(FrameSelection::new(25.0, wanted), 2500);
            let gaps: Vec<_> = frames.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let least = gaps.iter().min().unwrap();
            let most = gaps.iter().max().unwrap();
            assert!(most - least <= 1, "{wanted}: {least} to {most}");
        }
    }

    #[test]
    fn as_many_frames_are_kept_as_the_rates_say() {
        let broadcast = FrameSelection::new(30_000.0 / 1001.0, 5.0);
        assert_eq!(taken(broadcast, 300).len(), 50);
        for wanted in [1.0, 3.0, 7.0, 24.9] {
            let count = taken(FrameSelection::new(25.0, wanted), 2500).len() as f64;
            assert!((count - 100.0 * wanted).abs() <= 1.0, "{wanted}: {count}");
        }
    }

    #[test]
    fn a_slower_source_keeps_all_its_frames() {
        assert_eq!(taken(FrameSelection::new(12.5, 25.0), 3), [0, 1, 2]);
    }

    #[test]
    fn a_downsampled_source_gives_evenly_spaced_pictures_at_the_lower_rate() {
        let mut source = road();
        let pictures: Vec<_> = (0..5).map(|_| source.next().unwrap().unwrap()).collect();
        source.rewind().unwrap();
        let mut downsampled = Downsampled::new(&mut source, 5.0);
        assert_eq!(downsampled.rate(), 5.0);
        for index in [0, 2, 4] {
            let picture = downsampled.next().unwrap().unwrap();
            assert_eq!(picture.bytes, pictures[index].bytes, "{index}");
        }
    }

    #[test]
    fn a_downsampled_source_that_is_rewound_begins_with_its_first_picture() {
        let mut source = road();
        let mut downsampled = Downsampled::new(&mut source, 3.0);
        let first = downsampled.next().unwrap().unwrap();
        let second = downsampled.next().unwrap().unwrap();
        downsampled.rewind().unwrap();
        assert_eq!(downsampled.next().unwrap().unwrap().bytes, first.bytes);
        assert_eq!(downsampled.next().unwrap().unwrap().bytes, second.bytes);
    }

    #[test]
    fn a_picture_that_cannot_be_read_is_told_even_where_it_would_be_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let picture = road().next().unwrap().unwrap();
        for name in ["1.jpg", "3.jpg"] {
            std::fs::write(folder.path().join(name), &picture.bytes).unwrap();
        }
        std::fs::write(folder.path().join("2.jpg"), "not a picture").unwrap();
        let mut source = Pictures::of_folder(folder.path(), 10.0).unwrap();
        let mut downsampled = Downsampled::new(&mut source, 5.0);
        assert!(downsampled.next().unwrap().is_some());
        let fault = downsampled.next().unwrap_err().to_string();
        assert!(fault.contains("2.jpg"), "{fault}");
        assert!(downsampled.next().unwrap().is_some());
        assert!(downsampled.next().unwrap().is_none());
    }
}
