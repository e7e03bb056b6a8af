//! Shares fixtures between benches and tests: slowly moving boxes with noise and some misses, as a detector reports
//! them; a camera whose frames a policy decides; pictures of boxes with their exact places; the processor clock, and
//! the quartiles of many rounds.

mod camera;
mod pictures;

pub use camera::Camera;
pub use pictures::{BoxFrame, BoxScene, CLASSES};

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::time::{ClockId, clock_gettime};

/// The size of the picture in which the boxes move.
pub const PICTURE: PictureSize = PictureSize::new(1280, 720);

/// A scene with a fixed number of objects, the same in every run.
#[derive(Debug)]
pub struct Scene {
    objects: Vec<Moving>,
    random: Pcg64Mcg,
}

/// An object, whose centre stays between these shares of the picture.
#[derive(Debug)]
struct Moving {
    place: BoundingBox,
    /// Shift of the centre per frame, along x and y.
    velocity: [f64; 2],
}

const LEAST_CENTER: f64 = 0.05;
const MOST_CENTER: f64 = 0.95;

impl Moving {
    /// Moves on by one frame; turns back at the edges.
    fn advance(&mut self) {
        let place = &mut self.place;
        let axes = [&mut place.center_x, &mut place.center_y];
        for (center, step) in axes.into_iter().zip(&mut self.velocity) {
            if !(LEAST_CENTER..MOST_CENTER).contains(&(*center + *step)) {
                *step = -*step;
            }
            *center += *step;
        }
    }
}

impl Scene {
    /// A scene of `objects` objects.
    pub fn new(objects: usize) -> Self {
        let mut scene = Self {
            objects: Vec::new(),
            random: Pcg64Mcg::seed_from_u64(11),
        };
        for _ in 0..objects {
            let x = scene.between(LEAST_CENTER, MOST_CENTER);
            let y = scene.between(LEAST_CENTER, MOST_CENTER);
            let side = scene.between(0.03, 0.12);
            let velocity = [scene.between(-2e-3, 2e-3), scene.between(-2e-3, 2e-3)];
            let place = BoundingBox::new(x, y, side, side);
            scene.objects.push(Moving { place, velocity });
        }
        scene
    }

    /// Returns a uniformly distributed number from `low` up to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// The next `frames` frames. Each misses `missed` objects and has the others in random order.
    pub fn film(&mut self, frames: usize, missed: usize) -> Vec<Vec<Detection>> {
        (0..frames).map(|_| self.frame(missed)).collect()
    }

    fn frame(&mut self, missed: usize) -> Vec<Detection> {
        let mut seen = Vec::new();
        for index in 0..self.objects.len() {
            let object = &mut self.objects[index];
            object.advance();
            let mut noisy = object.place;
            noisy.center_x += self.between(-1e-3, 1e-3);
            noisy.center_y += self.between(-1e-3, 1e-3);
            noisy.width += self.between(-1e-3, 1e-3);
            noisy.height += self.between(-1e-3, 1e-3);
            seen.push(Detection {
                bounding_box: noisy,
                class: ClassId((index % 7) as u16),
                confidence: 0.9,
            });
        }
        // Shuffled, so that the last ones, which are dropped, are any.
        for index in (1..seen.len()).rev() {
            let other = (self.random.next_u64() % (index as u64 + 1)) as usize;
            seen.swap(index, other);
        }
        seen.truncate(seen.len() - missed);
        seen
    }
}

/// The processor time of this thread so far, in seconds. The load of other processes does not count.
pub fn processor_seconds() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// The lower quartile, the median and the upper quartile of `values`.
pub fn quartiles(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [1, 2, 3].map(|quarter| values[(values.len() - 1) * quarter / 4])
}
