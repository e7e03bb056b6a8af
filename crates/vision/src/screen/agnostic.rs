//! A screen that needs no training: it learns per camera, while it runs, from the detector's own verdicts.
//!
//! It knows the camera's pictures in which the detector found nothing, by mean and variance of brightness
//! and texture in 16x9 tiles (`thumbnail`, `novelty`). A picture is called empty when it is less unlike
//! those than nearly all pictures were in which the detector did find something (`calibration`): at most
//! the share `false_empty` of the latter may be called empty. Where the two kinds cannot be told apart,
//! that threshold is so low that nearly every picture goes to the detector, so a camera that this screen
//! does not suit costs little accuracy and saves little.
//!
//! To learn what it misses, one picture of so many that it would call empty goes to the detector all the
//! same, and so does any after too many in a row ([`EmptyRun`](super::EmptyRun)).

mod calibration;
mod novelty;
mod thumbnail;

use calibration::Calibration;
use novelty::EmptyScenes;
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
pub use thumbnail::Thumbnail;

/// Settings of the agnostic screen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AgnosticSettings {
    /// Share of the pictures with something in view that may be called empty.
    pub false_empty: f64,
    /// Share of the pictures called empty that the detector looks at all the same.
    pub audit: f64,
}

impl Default for AgnosticSettings {
    fn default() -> Self {
        Self {
            false_empty: 0.05,
            audit: 0.2,
        }
    }
}

impl AgnosticSettings {
    /// Everything that cannot be used: the key within `[screen]`, and what its value should be.
    pub fn problems(&self) -> Vec<(&'static str, String)> {
        [
            ("agnostic.false_empty", self.false_empty, 0.001, 0.5),
            ("agnostic.audit", self.audit, 0.01, 1.0),
        ]
        .into_iter()
        .filter(|(_, value, least, most)| !(least..=most).contains(&value))
        .map(|(key, value, least, most)| {
            (key, format!("must be from {least} to {most}, not {value}"))
        })
        .collect()
    }
}

/// The picture in hand.
#[derive(Clone, Debug)]
struct InHand {
    thumbnail: Thumbnail,
    novelty: f32,
    /// It was, or would have been, called empty.
    empty: bool,
    /// It is one of those that are looked at all the same, by chance.
    audited: bool,
}

/// The screen of one camera.
#[derive(Clone, Debug)]
pub struct AgnosticScreen {
    audit: f64,
    scenes: EmptyScenes,
    calibration: Calibration,
    random: Pcg64Mcg,
    in_hand: Option<InHand>,
    counters: AgnosticCounters,
}

/// What a camera's agnostic screen has counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AgnosticCounters {
    /// Pictures it would have called empty that the detector looked at.
    pub audited: u64,
    /// Those of them in which the detector found something.
    pub false_empty: u64,
}

impl AgnosticScreen {
    /// A screen that knows nothing yet. `seed` decides which pictures are looked at by chance.
    pub fn new(settings: &AgnosticSettings, seed: u64) -> Self {
        Self {
            audit: settings.audit,
            scenes: EmptyScenes::new(),
            calibration: Calibration::new(settings.false_empty),
            random: Pcg64Mcg::seed_from_u64(seed),
            in_hand: None,
            counters: AgnosticCounters::default(),
        }
    }

    /// Another frame begins: what was seen of the last one is of no more use.
    pub fn next_frame(&mut self) {
        self.in_hand = None;
    }

    /// Whether nothing is in view. Follow it with [`detected`](Self::detected) when the detector looks at the
    /// same frame.
    pub fn empty(&mut self, thumbnail: Thumbnail) -> bool {
        let mut in_hand = self.judged(thumbnail);
        let chance = (self.random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        in_hand.audited = in_hand.empty && chance < self.audit;
        let empty = in_hand.empty && !in_hand.audited;
        self.in_hand = Some(in_hand);
        empty
    }

    /// Whether the picture in hand goes to the detector by chance, though it would be called empty.
    pub fn audits(&self) -> bool {
        self.in_hand.as_ref().is_some_and(|in_hand| in_hand.audited)
    }

    /// The detector looked at the frame and did or did not find something. `thumbnail` is asked for when the
    /// screen itself was not asked about this frame.
    pub fn detected(
        &mut self,
        found_something: bool,
        thumbnail: impl FnOnce() -> Option<Thumbnail>,
    ) {
        if self.in_hand.is_none() {
            self.in_hand = thumbnail().map(|thumbnail| self.judged(thumbnail));
        }
        self.learn(found_something);
    }

    fn judged(&self, thumbnail: Thumbnail) -> InHand {
        let novelty = self.scenes.novelty(&thumbnail.0);
        InHand {
            thumbnail,
            novelty,
            empty: novelty < self.calibration.threshold(),
            audited: false,
        }
    }

    /// Takes the detector's verdict on the picture in hand, once.
    fn learn(&mut self, found_something: bool) {
        let Some(in_hand) = self.in_hand.take() else {
            return;
        };
        self.counters.audited += u64::from(in_hand.empty);
        self.counters.false_empty += u64::from(in_hand.empty && found_something);
        if found_something {
            let weight = if in_hand.audited {
                1.0 / self.audit
            } else {
                1.0
            };
            self.calibration
                .learn(in_hand.novelty, in_hand.empty, weight);
        } else {
            self.scenes.learn(&in_hand.thumbnail.0);
        }
    }

    /// What it has counted.
    pub const fn counters(&self) -> AgnosticCounters {
        self.counters
    }
}

#[cfg(test)]
mod tests {
    use super::thumbnail::tests::picture;
    use super::*;
    use crate::picture::Picture;

    /// A camera over a road: noise, and now and then a bright car.
    struct Road {
        random: Pcg64Mcg,
    }

    impl Road {
        fn film(&mut self, car: bool) -> Picture {
            let at = (self.random.next_u32() % 100) as usize;
            let noise: Vec<u8> = (0..128 * 72)
                .map(|_| (self.random.next_u32() % 9) as u8)
                .collect();
            picture(|x, y| {
                let inside = car && (at..at + 20).contains(&x) && (30..42).contains(&y);
                noise[y * 128 + x] + if inside { 200 } else { 60 + (x as u8) / 2 }
            })
        }
    }

    /// Runs the screen as a node does; empty pictures skipped, occupied ones missed, of so many each.
    fn watch(occupied: impl Fn(u32) -> bool, frames: u32) -> ([u32; 2], [u32; 2]) {
        let mut road = Road {
            random: Pcg64Mcg::seed_from_u64(3),
        };
        let mut screen = AgnosticScreen::new(&AgnosticSettings::default(), 1);
        let (mut skipped, mut total) = ([0; 2], [0; 2]);
        for frame in 0..frames {
            let car = occupied(frame);
            total[usize::from(car)] += 1;
            if screen.empty(Thumbnail::of(&road.film(car)).unwrap()) {
                skipped[usize::from(car)] += 1;
            } else {
                screen.learn(car);
            }
        }
        (skipped, total)
    }

    #[test]
    fn empty_stretches_are_skipped_and_cars_are_not_missed() {
        let (skipped, total) = watch(|frame| frame % 50 < 10, 1000);
        assert!(skipped[0] > total[0] / 2, "{skipped:?} of {total:?}");
        assert!(skipped[1] <= total[1] / 20, "{skipped:?} of {total:?}");
    }

    #[test]
    fn a_camera_that_never_saw_anything_goes_to_the_detector_every_time() {
        let (skipped, _) = watch(|_| false, 300);
        assert_eq!(skipped, [0, 0]);
    }

    #[test]
    fn where_the_two_kinds_look_alike_few_are_missed() {
        let mut road = Road {
            random: Pcg64Mcg::seed_from_u64(5),
        };
        let mut screen = AgnosticScreen::new(&AgnosticSettings::default(), 1);
        let mut missed = 0;
        for frame in 0..2000 {
            let occupied = frame % 3 == 0;
            // The verdict has nothing to do with the picture.
            if screen.empty(Thumbnail::of(&road.film(false)).unwrap()) {
                missed += u32::from(occupied);
            } else {
                screen.learn(occupied);
            }
        }
        assert!(missed <= 2000 / 3 / 15, "{missed}");
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let mut settings = AgnosticSettings::default();
        assert_eq!(settings.problems(), []);
        settings.audit = 0.0;
        settings.false_empty = f64::NAN;
        let keys: Vec<_> = settings.problems().iter().map(|(key, _)| *key).collect();
        assert_eq!(keys, ["agnostic.false_empty", "agnostic.audit"]);
    }
}
