//! Footage at a lower frame rate: some frames are taken, the others left out, as evenly as can be.

use super::source::{FrameSource, Stopper};
use crate::error::EvalError;
use albireo_vision::picture::EncodedPicture;

/// Which frames are taken of footage that is thinned from one frame rate to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sieve {
    /// Frames taken for each frame there is, 1 at most.
    share: f64,
}

impl Sieve {
    /// From `rate` frames per second to `wanted`; all of them if there are no more than that.
    pub fn new(rate: f64, wanted: f64) -> Self {
        let share = wanted / rate;
        Self {
            // Written so that NaN takes them all.
            share: if share > 0.0 && share < 1.0 {
                share
            } else {
                1.0
            },
        }
    }

    /// Whether frame `index` is taken, counted from the first one taken.
    pub fn takes(&self, index: u64) -> bool {
        // A product of 3 · 0.2 or the like must not fall short of the whole number that it is.
        let due = |index: u64| (index as f64 * self.share + 1e-9).floor();
        index == 0 || due(index) > due(index - 1)
    }
}

/// A source of which only some frames per second are taken.
pub struct Thinned<'a> {
    source: &'a mut dyn FrameSource,
    sieve: Sieve,
    rate: f64,
    passed: u64,
}

impl<'a> Thinned<'a> {
    /// `source` at `rate` frames per second, or at its own if that is lower.
    pub fn new(source: &'a mut dyn FrameSource, rate: f64) -> Self {
        let own = source.rate();
        Self {
            sieve: Sieve::new(own, rate),
            rate: own.min(rate),
            source,
            passed: 0,
        }
    }
}

impl FrameSource for Thinned<'_> {
    fn name(&self) -> &str {
        self.source.name()
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        let frames = self.source.frames()?;
        Some((0..frames).filter(|index| self.sieve.takes(*index)).count() as u64)
    }

    fn clip(&self) -> Option<&str> {
        self.source.clip()
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        loop {
            let Some(picture) = self.source.next()? else {
                return Ok(None);
            };
            let index = self.passed;
            self.passed += 1;
            if self.sieve.takes(index) {
                return Ok(Some(picture));
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

    fn taken(sieve: Sieve, frames: u64) -> Vec<u64> {
        (0..frames).filter(|index| sieve.takes(*index)).collect()
    }

    #[test]
    fn frames_are_taken_as_evenly_as_can_be() {
        assert_eq!(taken(Sieve::new(25.0, 5.0), 20), [0, 5, 10, 15]);
        assert_eq!(taken(Sieve::new(25.0, 10.0), 11), [0, 3, 5, 8, 10]);
        assert_eq!(taken(Sieve::new(12.5, 25.0), 3), [0, 1, 2]);
        assert_eq!(taken(Sieve::new(30_000.0 / 1001.0, 5.0), 300).len(), 50);
        for wanted in [1.0, 3.0, 7.0, 24.9] {
            let frames = taken(Sieve::new(25.0, wanted), 2500);
            let count = frames.len() as f64;
            assert!((count - 100.0 * wanted).abs() <= 1.0, "{wanted}: {count}");
            let gaps: Vec<_> = frames.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let (least, most) = (gaps.iter().min().unwrap(), gaps.iter().max().unwrap());
            assert!(most - least <= 1, "{wanted}: {least} to {most}");
        }
    }

    #[test]
    fn a_thinned_source_gives_the_pictures_between_which_the_others_lie() {
        let road = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../demo/road.tar"));
        let mut source = Pictures::of_archive(road, 10.0).unwrap();
        let pictures: Vec<_> = (0..5).map(|_| source.next().unwrap().unwrap()).collect();
        source.rewind().unwrap();
        let mut thinned = Thinned::new(&mut source, 5.0);
        assert_eq!(thinned.rate(), 5.0);
        for _ in 0..2 {
            for index in [0, 2, 4] {
                let picture = thinned.next().unwrap().unwrap();
                assert_eq!(picture.bytes, pictures[index].bytes, "{index}");
            }
            thinned.rewind().unwrap();
        }
    }
}
