//! One clip of the dashcam: a road, its weather and light, the own car's way and everybody else on it.

use super::atmosphere::{Atmosphere, Light, Weather};
use super::motion::Ego;
use super::random::Random;
use super::road::{Road, Setting};
use super::space::Camera;
use super::traffic::{self, Actor, Quiet};
use albireo_core::geometry::PictureSize;

/// Everything that is drawn from chance once a clip.
pub(super) struct Scene {
    pub seed: u64,
    pub index: u64,
    pub road: Road,
    pub air: Atmosphere,
    pub ego: Ego,
    pub actors: Vec<Actor>,
    #[cfg(test)]
    pub quiet: Quiet,
    /// How strongly the camera shakes, 1 usual.
    shaking: f32,
    /// Focal length over picture width.
    focal: f32,
    /// How far the optical axis is off the middle, and the horizon's row, as shares of the picture.
    mounting: (f32, f32),
    /// Colour of the own bonnet.
    pub bonnet: [f32; 3],
    /// How blurred the lens is: 0 sharp, 1 or 2.
    pub blur: u8,
}

impl Scene {
    /// Clip `index` of the world of `seed`, `seconds` long.
    pub(super) fn draw(seed: u64, index: u64, seconds: f32) -> Self {
        let key = |purpose: u64| Random::new(&[seed, index, purpose]);
        // Every three clips show the three settings, in an order that belongs to the seed and the triple.
        let orders = [
            [Setting::Town, Setting::Highway, Setting::Country],
            [Setting::Town, Setting::Country, Setting::Highway],
            [Setting::Highway, Setting::Town, Setting::Country],
            [Setting::Highway, Setting::Country, Setting::Town],
            [Setting::Country, Setting::Town, Setting::Highway],
            [Setting::Country, Setting::Highway, Setting::Town],
        ];
        let setting = Random::new(&[seed, index / 3, 1]).pick(orders)[(index % 3) as usize];
        let mut random = key(2);
        let cruise = match setting {
            Setting::Country => random.range(14.0, 22.0),
            Setting::Highway => random.range(24.0, 31.0),
            Setting::Town => random.range(7.5, 11.5),
        };
        let road = Road::draw(setting, cruise * seconds, &mut random);
        let air = Atmosphere::draw(&mut key(3));
        let mut random = key(4);
        let slow = traffic::slow_downs(setting, seconds, &mut random);
        let ego = Ego::new(cruise, road.own_lane(), seconds, &slow);
        let quiet = quiet_stretch(setting, seconds, &mut random);
        let density = random.pick([0.5, 0.8, 1.0, 1.0, 1.3]);
        let actors = traffic::draw(&road, &ego, &slow, seconds, quiet, density, &mut random);
        let mut random = key(5);
        let blur = match air.weather {
            Weather::Rain => 1 + u8::from(random.chance(0.3)),
            _ if air.light == Light::Night => 1,
            _ => u8::from(random.chance(0.3)),
        };
        Self {
            seed,
            index,
            road,
            air,
            ego,
            actors,
            #[cfg(test)]
            quiet,
            shaking: random.range(0.5, 1.5),
            focal: random.range(0.72, 0.86),
            mounting: (random.range(-0.02, 0.02), random.range(0.45, 0.50)),
            bonnet: random.pick([
                [0.10, 0.11, 0.13],
                [0.30, 0.31, 0.33],
                [0.36, 0.07, 0.07],
                [0.08, 0.14, 0.28],
            ]),
            blur,
        }
    }

    /// The camera at `time`, shaken by the road.
    pub(super) fn camera(&self, size: PictureSize, time: f32) -> Camera {
        let (width, height) = (size.width as f32, size.height as f32);
        let speed = (self.ego.along(time + 0.1) - self.ego.along(time - 0.1)) / 0.2;
        let roughness = match self.road.setting {
            Setting::Country => 1.5,
            Setting::Highway => 0.8,
            Setting::Town => 1.0,
        } * self.shaking
            * (speed / self.ego.cruise).clamp(0.15, 1.2);
        let phase = self.index as f32;
        let sway =
            |hertz: f32, shift: f32| (std::f32::consts::TAU * hertz * time + shift + phase).sin();
        let mut jolt = Random::new(&[self.seed, self.index, 6, u64::from(time.to_bits())]);
        let pitch = roughness
            * (0.0016 * sway(0.7, 0.0)
                + 0.0012 * sway(1.9, 1.3)
                + 0.0007 * sway(4.7, 2.1)
                + 0.0005 * jolt.normal());
        let yaw = roughness
            * (0.0010 * sway(0.45, 0.6) + 0.0006 * sway(3.1, 0.2) + 0.0003 * jolt.normal());
        let focal = self.focal * width;
        Camera {
            focal,
            center_x: width * (0.5 + self.mounting.0) + focal * yaw,
            horizon: height * self.mounting.1 + focal * pitch,
            height: 1.36 + 0.004 * roughness * sway(2.6, 0.9),
            size,
        }
    }

    /// Rows, at 720, that the horizon moves while the shutter is open (1/120 s).
    pub(super) fn smear(&self, size: PictureSize, time: f32) -> f32 {
        let step = 1.0 / 120.0;
        let (now, then) = (self.camera(size, time), self.camera(size, time + step));
        (now.horizon - then.horizon).abs() * 720.0 / size.height as f32
    }
}

/// Some seconds in which nobody is on the road.
fn quiet_stretch(setting: Setting, seconds: f32, random: &mut Random) -> Quiet {
    let share = match setting {
        Setting::Country => 0.75,
        Setting::Highway => 0.6,
        Setting::Town => 0.4,
    };
    if seconds < 6.0 || !random.chance(share) {
        return None;
    }
    let length = (seconds * random.range(0.22, 0.42)).min(9.0);
    let from = random.range(0.0, seconds - length);
    Some((from, from + length))
}
