//! The synthetic dashcam: a seeded, deterministic scene seen from a moving car, with exact ground truth.
//!
//! A [`Dashcam`] is a function from a frame's index to a picture and the boxes of everything in it. The
//! world is cut into clips of equal length; each has its own road, weather, light and traffic, all drawn
//! from the seed. The same settings give the same bytes on the same kind of machine (sines come from
//! the platform's mathematics library). Everything is drawn in code: no recorded material is used.
//!
//! The way of a frame: `scene` and `traffic` say what there is, `motion` and `road` where it is, `render`
//! draws it back to front through a `brush` on a `canvas`, `sensor` reads the picture out, and
//! `ground_truth` reads the boxes from the canvas's object plane.

mod atmosphere;
mod bodies;
mod brush;
mod buildings;
mod canvas;
mod ground;
mod ground_truth;
mod kind;
mod motion;
mod paint;
mod people;
mod plants;
mod random;
mod render;
mod road;
mod roadside;
mod scene;
mod scenery;
mod sensor;
mod sky;
mod space;
mod traffic;
mod vehicles;

#[cfg(test)]
mod tests;

#[cfg(test)]
use atmosphere::{Light, Weather};
pub use ground_truth::GroundTruthBox;
pub use road::Setting;

use albireo_core::geometry::PictureSize;
use canvas::Canvas;
use random::Random;
use scene::Scene;
use sensor::Sensor;

/// What a [`Dashcam`] films.
#[derive(Clone, Debug, PartialEq)]
pub struct DashcamSettings {
    /// Number of the world.
    pub seed: u64,
    /// Size of its pictures; made for 16:9.
    pub size: PictureSize,
    /// Frames a second.
    pub frame_rate: f64,
    /// Length of a clip, seconds.
    pub clip_seconds: f64,
}

impl Default for DashcamSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            size: PictureSize::new(1280, 720),
            frame_rate: 10.0,
            clip_seconds: 20.0,
        }
    }
}

/// Why a dashcam cannot be built or a frame cannot be encoded.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// The picture is too small or too large to draw.
    #[error("picture size {0}: both sides must be between 64 and 7680 pixels")]
    Size(PictureSize),
    /// The frame rate is not usable.
    #[error("frame rate {0}: must be between 0.1 and 240 frames a second")]
    FrameRate(f64),
    /// The clip length is not usable.
    #[error("clip length {0} s: must be between 1 and 600 seconds")]
    ClipSeconds(f64),
    /// The JPEG encoder refused the picture.
    #[error("the picture could not be encoded as JPEG")]
    Jpeg(#[from] jpeg_encoder::EncodingError),
}

/// One frame with its ground truth.
#[derive(Clone, Debug)]
pub struct SyntheticFrame {
    /// Number of the frame since the start, from 0.
    pub index: u64,
    /// Seconds since the start.
    pub time_seconds: f64,
    /// Name of the clip, such as `seed-7-clip-3`.
    pub clip: String,
    /// Size of the picture.
    pub size: PictureSize,
    /// The picture: rows from the top, three bytes a pixel in the order red, green, blue.
    pub rgb: Vec<u8>,
    /// Every object of which at least a pixel is seen, in drawing order (far to near).
    pub ground_truth: Vec<GroundTruthBox>,
}

impl SyntheticFrame {
    /// The picture as a baseline JPEG of `quality` 1 to 100 with halved chroma, as cameras send it.
    pub fn encode_jpeg(&self, quality: u8) -> Result<Vec<u8>, SynthError> {
        let mut bytes = Vec::with_capacity(self.rgb.len() / 12);
        let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, quality.clamp(1, 100));
        encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::F_2_2);
        let (width, height) = (self.size.width as u16, self.size.height as u16);
        encoder.encode(&self.rgb, width, height, jpeg_encoder::ColorType::Rgb)?;
        Ok(bytes)
    }

    /// The objects a detector is expected to find.
    pub fn expected(&self) -> impl Iterator<Item = &GroundTruthBox> {
        self.ground_truth.iter().filter(|object| !object.ignore)
    }
}

/// What a clip shows.
#[cfg(test)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClipDescription {
    /// What the road runs through.
    pub setting: Setting,
    /// Time of day.
    pub light: Light,
    /// Weather.
    pub weather: Weather,
    /// From and to, seconds of the clip, between which nobody is on the road; none in a busy clip.
    pub quiet: Option<(f32, f32)>,
}

/// A camera behind the windscreen of a car in a world that is drawn from a seed.
pub struct Dashcam {
    settings: DashcamSettings,
    frames_per_clip: u64,
    canvas: Canvas,
    current: Option<(Scene, Sensor)>,
    next: u64,
}

/// Identities of one clip's objects lie below those of the next by this much.
const OBJECTS_PER_CLIP: u64 = 10_000;

impl Dashcam {
    /// A dashcam at its first frame.
    pub fn new(settings: DashcamSettings) -> Result<Self, SynthError> {
        let size = settings.size;
        if !(64..=7680).contains(&size.width) || !(64..=7680).contains(&size.height) {
            return Err(SynthError::Size(size));
        }
        if !(0.1..=240.0).contains(&settings.frame_rate) {
            return Err(SynthError::FrameRate(settings.frame_rate));
        }
        if !(1.0..=600.0).contains(&settings.clip_seconds) {
            return Err(SynthError::ClipSeconds(settings.clip_seconds));
        }
        let canvas = Canvas::new(size).ok_or(SynthError::Size(size))?;
        let frames = (settings.clip_seconds * settings.frame_rate).round();
        Ok(Self {
            settings,
            frames_per_clip: (frames as u64).max(1),
            canvas,
            current: None,
            next: 0,
        })
    }

    /// What it films.
    pub fn settings(&self) -> &DashcamSettings {
        &self.settings
    }

    /// Frames in a clip.
    #[cfg(test)]
    pub(crate) fn frames_per_clip(&self) -> u64 {
        self.frames_per_clip
    }

    /// What clip `clip` (from 0) shows.
    #[cfg(test)]
    pub(crate) fn describe_clip(&mut self, clip: u64) -> ClipDescription {
        let (scene, _) = self.enter(clip);
        ClipDescription {
            setting: scene.road.setting,
            light: scene.air.light,
            weather: scene.air.weather,
            quiet: scene.quiet,
        }
    }

    /// The frame after the last one asked for; the first to begin with.
    pub fn next_frame(&mut self) -> SyntheticFrame {
        self.frame(self.next)
    }

    /// Frame `index`, from 0. Any order is allowed; going through them in order is fastest.
    pub fn frame(&mut self, index: u64) -> SyntheticFrame {
        self.next = index.saturating_add(1);
        self.draw(index, None)
    }

    fn enter(&mut self, clip: u64) -> &(Scene, Sensor) {
        if self
            .current
            .as_ref()
            .is_none_or(|(scene, _)| scene.index != clip)
        {
            self.current = None;
        }
        let settings = &self.settings;
        self.current.get_or_insert_with(|| {
            let scene = Scene::draw(settings.seed, clip, settings.clip_seconds as f32);
            let mut random = Random::new(&[settings.seed, clip, 8]);
            let sensor = Sensor::new(scene.air.noise, &mut random);
            (scene, sensor)
        })
    }

    fn draw(&mut self, index: u64, hidden: Option<u64>) -> SyntheticFrame {
        let clip = index / self.frames_per_clip;
        let rate = self.settings.frame_rate;
        let time = ((index % self.frames_per_clip) as f64 / rate) as f32;
        let (seed, size) = (self.settings.seed, self.settings.size);
        self.enter(clip);
        let mut rgb = Vec::new();
        let mut ground_truth = Vec::new();
        if let Some((scene, sensor)) = &self.current {
            let drawn = render::paint(&mut self.canvas, scene, time, hidden);
            ground_truth = ground_truth::boxes(&self.canvas, &drawn, clip * OBJECTS_PER_CLIP);
            let pixels = self.canvas.pixels();
            let fine = size.height >= 480;
            for _ in 0..scene.blur * u8::from(fine) {
                sensor::blur(pixels, size);
            }
            let jolt = scene.smear(size, time);
            if jolt > 0.3 && fine {
                sensor::smear(pixels, size, if jolt > 0.6 { 2 } else { 1 });
            }
            let mut random = Random::new(&[seed, index, 9]);
            let exposure = 1.0 + 0.03 * (time * 0.8).sin() + 0.01 * random.normal();
            rgb = sensor.read(pixels, size, exposure, &mut random);
        }
        SyntheticFrame {
            index,
            time_seconds: index as f64 / rate,
            clip: format!("seed-{seed}-clip-{clip}"),
            size,
            rgb,
            ground_truth,
        }
    }
}
