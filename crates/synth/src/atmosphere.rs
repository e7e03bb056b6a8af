//! Weather and light of a clip, and how they colour a surface: sun, headlights, mist, exposure.

use super::random::Random;
use super::space::{Color, Point, mix_color, point, scale_color};

/// Time of day.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Light {
    /// The sun is up.
    Day,
    /// Low sun, warm sky.
    Dusk,
    /// Headlights and lamps.
    Night,
}

/// Weather.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Weather {
    /// Blue sky, hard shadows.
    Clear,
    /// Grey sky, no shadows.
    Overcast,
    /// Rain and a wet road.
    Rain,
    /// Low contrast beyond some tens of metres.
    Fog,
}

/// Light and air of one clip.
#[derive(Clone, Debug)]
pub(super) struct Atmosphere {
    pub light: Light,
    pub weather: Weather,
    pub sky_top: Color,
    pub sky_horizon: Color,
    /// What everything fades to with distance.
    pub haze: Color,
    /// Share of contrast lost a metre.
    pub haze_density: f32,
    pub ambient: Color,
    pub sun: Color,
    /// Towards the sun.
    pub sun_direction: Point,
    /// Strength of the own headlights; 0 by day.
    pub headlights: f32,
    /// Darkness of shadows on the ground.
    pub shadow: f32,
    /// How much the road mirrors, 0 dry.
    pub wetness: f32,
    /// Deviation of the sensor's noise, grey levels.
    pub noise: f32,
    /// Whether lamps, windows and vehicle lights are lit.
    pub lamps_lit: bool,
}

impl Atmosphere {
    /// Draws weather and light.
    pub(super) fn draw(random: &mut Random) -> Self {
        use Light::{Day, Dusk, Night};
        use Weather::{Clear, Fog, Overcast, Rain};
        let light = random.pick([Day, Day, Day, Day, Dusk, Dusk, Night, Night]);
        let weather = random.pick([Clear, Clear, Clear, Overcast, Overcast, Rain, Rain, Fog]);
        Self::new(light, weather, random)
    }

    /// The given weather and light, its details drawn.
    pub(super) fn new(light: Light, weather: Weather, random: &mut Random) -> Self {
        let grey = match weather {
            Weather::Clear => 0.0,
            Weather::Overcast => 0.75,
            Weather::Rain => 0.9,
            Weather::Fog => 1.0,
        };
        let (top, horizon, cloud, ambient, sun, height) = match light {
            Light::Day => (
                [0.30, 0.52, 0.82],
                [0.72, 0.84, 0.93],
                [0.80, 0.83, 0.86],
                [0.70, 0.72, 0.76],
                [0.62, 0.57, 0.47],
                random.range(0.5, 0.9),
            ),
            Light::Dusk => (
                [0.22, 0.25, 0.44],
                [0.93, 0.62, 0.42],
                [0.46, 0.44, 0.50],
                [0.44, 0.41, 0.46],
                [0.58, 0.36, 0.20],
                random.range(0.12, 0.25),
            ),
            Light::Night => (
                [0.015, 0.02, 0.05],
                [0.07, 0.075, 0.11],
                [0.05, 0.05, 0.065],
                [0.10, 0.10, 0.13],
                [0.0, 0.0, 0.0],
                0.5,
            ),
        };
        let exposure = random.range(0.88, 1.12);
        let sky_top = scale_color(mix_color(top, cloud, grey * 0.9), exposure);
        let sky_horizon = scale_color(mix_color(horizon, cloud, grey), exposure);
        let around = random.range(0.0, std::f32::consts::TAU);
        Self {
            light,
            weather,
            sky_top,
            sky_horizon,
            haze: mix_color(sky_horizon, sky_top, 0.15),
            haze_density: match weather {
                Weather::Clear => random.range(0.0008, 0.0022),
                Weather::Overcast => random.range(0.0015, 0.004),
                Weather::Rain => random.range(0.005, 0.010),
                Weather::Fog => random.range(0.011, 0.022),
            },
            ambient: scale_color(ambient, exposure * (1.0 + 0.18 * grey)),
            sun: scale_color(sun, exposure * (1.0 - 0.92 * grey)),
            sun_direction: point(around.sin(), height, around.cos()).normalised(),
            headlights: match light {
                Light::Day => 0.0,
                Light::Dusk => 0.22,
                Light::Night => 0.95,
            } * exposure,
            shadow: match (light, weather) {
                (Light::Night, _) => 0.5,
                (_, Weather::Clear) => 0.45,
                _ => 0.28,
            },
            wetness: if weather == Weather::Rain { 0.6 } else { 0.0 },
            noise: match light {
                Light::Day => random.range(1.5, 3.5),
                Light::Dusk => random.range(3.0, 5.0),
                Light::Night => random.range(5.0, 9.0),
            },
            lamps_lit: light != Light::Day,
        }
    }

    /// How strongly the own headlights light a point, 0 to 1.
    fn headlight(&self, at: Point) -> f32 {
        let forward = at.z.max(1.0);
        let reach = (1.0 - (forward - 12.0).max(0.0) / 62.0).clamp(0.0, 1.0);
        let side = at.x / (2.6 + 0.16 * forward);
        let above = (at.y - 0.7).max(0.0) / (0.5 + 0.035 * forward);
        self.headlights * reach * reach / (1.0 + side * side * side * side + above * above)
    }

    /// The colour of a surface of colour `albedo` at `at` with the outward `normal`.
    pub(super) fn shade(&self, albedo: Color, normal: Point, at: Point) -> Color {
        let sun = normal.dot(self.sun_direction).max(0.0);
        let sky = 0.82 + 0.18 * normal.y;
        let beam = if self.headlights > 0.0 {
            self.headlight(at) * (0.35 + 0.65 * (-normal.z).max(normal.y * 0.8).max(0.0))
        } else {
            0.0
        };
        let mut color = [0.0; 3];
        for channel in 0..3 {
            let light = self.ambient[channel] * sky + self.sun[channel] * sun + beam;
            color[channel] = albedo[channel] * light;
        }
        self.through_air(color, at.z)
    }

    /// A colour seen through `distance` metres of air.
    pub(super) fn through_air(&self, color: Color, distance: f32) -> Color {
        mix_color(color, self.haze, self.air(distance))
    }

    /// Share of contrast lost over `distance` metres.
    pub(super) fn air(&self, distance: f32) -> f32 {
        1.0 - (-distance.max(0.0) * self.haze_density).exp()
    }
}
