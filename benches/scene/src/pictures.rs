//! Draws coloured boxes that cross a striped background, with their exact places.

use albireo_core::geometry::{Corners, PictureSize};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

/// The names of the boxes' classes, one box each. `tests/fixtures/models/boxes.onnx` finds them by their colours.
pub const CLASSES: [&str; 6] = ["person", "car", "truck", "bus", "motorcycle", "bicycle"];

/// Red, green, blue, yellow, cyan, magenta.
const COLOURS: [[f32; 3]; 6] = [
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 1.0, 0.0],
    [0.0, 1.0, 1.0],
    [1.0, 0.0, 1.0],
];

/// The width of a stripe of the boxes and of the background, in pixels at 360 rows.
const STRIPE: f32 = 6.0;

/// The minimum number of frames between two turns of a box.
const CROSSING: u64 = 60;

/// The number of different movements.
const DRAWS: u64 = 97;

/// A scene computed from the frame number. Each box moves back and forth in a separate lane, so that none hides
/// another, and is out of sight for a fifth of the time.
#[derive(Clone, Copy, Debug)]
pub struct BoxScene {
    size: PictureSize,
    seed: u64,
}

/// One frame of a [`BoxScene`].
#[derive(Clone, Debug)]
pub struct BoxFrame {
    /// The size of the picture.
    pub size: PictureSize,
    /// Three bytes per pixel: red, green, blue.
    pub rgb: Vec<u8>,
    /// The boxes in sight: the class as an index into [`CLASSES`], and the corners in pixels.
    pub boxes: Vec<(usize, Corners)>,
}

impl BoxScene {
    /// A scene with pictures of `size`. The seed determines how the boxes move.
    pub const fn new(seed: u64, size: PictureSize) -> Self {
        Self { size, seed }
    }

    /// The frame with the given number.
    pub fn frame(&self, index: u64) -> BoxFrame {
        let mut boxes = Vec::new();
        for class in 0..CLASSES.len() {
            if let Some(place) = self.place(class as u64, index) {
                boxes.push((class, place));
            }
        }
        let mut rgb = Vec::with_capacity(3 * self.size.pixels() as usize);
        for y in 0..self.size.height {
            for x in 0..self.size.width {
                let pixel = self.pixel(x, y, &boxes);
                rgb.extend(pixel.map(|plane| (255.0 * plane) as u8));
            }
        }
        BoxFrame {
            size: self.size,
            rgb,
            boxes,
        }
    }

    /// Red, green and blue of a pixel, 0 to 1.
    fn pixel(&self, x: u32, y: u32, boxes: &[(usize, Corners)]) -> [f32; 3] {
        let height = self.size.height as f32;
        let stripe = STRIPE * height / 360.0;
        // The middle of the pixel decides whether it belongs to a box.
        let within =
            |pixel: u32, low: f64, high: f64| (low..high).contains(&(f64::from(pixel) + 0.5));
        let hit = boxes
            .iter()
            .find(|(_, place)| within(x, place.x1, place.x2) && within(y, place.y1, place.y2));
        let x = x as f32;
        let y = y as f32;
        if let Some((class, place)) = hit {
            // The stripes move with the box.
            let shade = shade(x - place.x1 as f32, y - place.y1 as f32, stripe);
            COLOURS[*class].map(|plane| plane * (0.85 + 0.15 * shade))
        } else {
            // A grey that grows brighter downwards.
            let light = 0.2 + 0.5 * y / height;
            [light + 0.1 * shade(x, y, 2.0 * stripe); 3]
        }
    }

    /// The corners of the box of `class`; `None` while it is out of sight.
    fn place(&self, class: u64, index: u64) -> Option<Corners> {
        // Any value that differs between boxes and seeds: primes, so that it seldom repeats.
        let draw = (self.seed * 31 + class * 17) % DRAWS;
        let width = f64::from(self.size.width);
        let lane = f64::from(self.size.height) / CLASSES.len() as f64;
        let period = 2 * (CROSSING + draw);
        let phase = (index + 7 * draw) % period;
        // Two fifths of its period to the right, two fifths back, one fifth out of sight.
        if phase * 5 >= period * 4 {
            return None;
        }
        let crossings = phase as f64 / period as f64 * 2.5;
        let along = if crossings > 1.0 {
            2.0 - crossings
        } else {
            crossings
        };
        let side = lane * (0.5 + 0.3 * draw as f64 / DRAWS as f64);
        let long = side * (1.0 + 0.2 * class as f64);
        let x1 = along * (width - long);
        let y1 = lane * class as f64 + (lane - side) * (0.2 + 0.6 * along);
        Some(Corners {
            x1,
            y1,
            x2: x1 + long,
            y2: y1 + side,
        })
    }
}

/// Returns 0 or 1, in oblique stripes.
fn shade(x: f32, y: f32, stripe: f32) -> f32 {
    (((x + 0.5 * y) / stripe).rem_euclid(2.0)).floor()
}

impl BoxFrame {
    /// The picture as a baseline JPEG with a `quality` from 1 to 100 and halved chroma, as cameras send it.
    ///
    /// # Errors
    /// If a side exceeds 65,535 pixels.
    pub fn jpeg(&self, quality: u8) -> Result<Vec<u8>, jpeg_encoder::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, quality);
        encoder.set_sampling_factor(SamplingFactor::F_2_2);
        let PictureSize { width, height } = self.size;
        encoder.encode(&self.rgb, width as u16, height as u16, ColorType::Rgb)?;
        Ok(bytes)
    }
}
