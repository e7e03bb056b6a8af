//! What is far away: the sky, the sun, clouds, stars, and hills on the horizon.

use super::atmosphere::{Light, Weather};
use super::brush::Brush;
use super::random::Random;
use super::road::Setting;
use super::scene::Scene;
use super::space::{Pixel, mix_color, point};

const UP: super::space::Point = point(0.0, 1.0, 0.0);

/// Paints everything above the horizon.
pub(super) fn paint(brush: &mut Brush, scene: &Scene, along: f32) {
    let camera = brush.camera;
    let (width, height) = (camera.size.width as f32, camera.size.height as f32);
    let (top, bottom) = (brush.air.sky_top, brush.air.sky_horizon);
    let horizon = camera.horizon.clamp(1.0, height);
    brush.canvas.rows(0, horizon as u32 + 1, |row| {
        let share = (row as f32 / horizon).powi(2);
        mix_color(top, bottom, share)
    });
    let heading = scene.road.heading(along);
    let mut random = Random::new(&[scene.seed, scene.index, 20]);
    if brush.air.light == Light::Night && brush.air.weather == Weather::Clear {
        let stars: Vec<Vec<Pixel>> = (0..60)
            .map(|_| {
                let x =
                    (random.unit() * 2.0 - heading * camera.focal / width).rem_euclid(1.2) * width;
                let (y, s) = (random.unit() * horizon * 0.8, width / 1600.0);
                vec![(x, y), (x + s, y), (x + s, y + s), (x, y + s)]
            })
            .collect();
        brush
            .canvas
            .overlays(stars.iter().map(Vec::as_slice), [0.9, 0.9, 1.0], 0.5);
    }
    if brush.air.sun[0] > 0.2 && brush.air.sun_direction.z > 0.2 {
        let sun = brush.air.sun_direction;
        let x = camera.center_x + camera.focal * (sun.x / sun.z - heading);
        let y = horizon - camera.focal * 0.55 * sun.y / sun.z.max(0.4);
        brush
            .canvas
            .glow((x, y), (width * 0.16, width * 0.16), [1.0, 0.92, 0.72], 0.9);
    }
    let clouds = match brush.air.weather {
        Weather::Clear => 7,
        Weather::Fog => 0,
        _ => 12,
    };
    let cloud = mix_color(
        bottom,
        [1.0, 1.0, 1.0],
        if brush.air.light == Light::Day {
            0.45
        } else {
            0.04
        },
    );
    for _ in 0..clouds {
        let x = (random.unit() * 3.0 - heading * camera.focal / width).rem_euclid(2.0) - 0.5;
        let (y, w) = (
            random.range(0.05, 0.8) * horizon,
            random.range(0.08, 0.26) * width,
        );
        let puffs = [-0.55, -0.1, 0.4].map(|shift: f32| {
            let lift = -w * 0.09 * (1.0 - (2.2 * shift).powi(2));
            flat_blob((x * width + shift * w, y + lift), (w * 0.5, w * 0.11))
        });
        // Mixed here and drawn opaque: blending large areas is what costs time.
        let behind = mix_color(top, bottom, (y / horizon).powi(2));
        let color = mix_color(behind, cloud, 0.45);
        brush
            .canvas
            .overlays(puffs.iter().map(Vec::as_slice), color, 1.0);
    }
    hills(brush, scene, heading, &mut random);
}

fn flat_blob(center: Pixel, radii: (f32, f32)) -> Vec<Pixel> {
    (0..12)
        .map(|index| {
            let angle = std::f32::consts::TAU * index as f32 / 12.0;
            (
                center.0 + radii.0 * angle.cos(),
                center.1 + radii.1 * angle.sin(),
            )
        })
        .collect()
}

fn hills(brush: &mut Brush, scene: &Scene, heading: f32, random: &mut Random) {
    let camera = brush.camera;
    let width = camera.size.width as f32;
    let green = match scene.road.setting {
        Setting::Town => [0.40, 0.40, 0.43],
        _ => [0.26, 0.36, 0.28],
    };
    for (layer, distance) in [(0, 900.0_f32), (1, 480.0)] {
        let air = 1.0 - (-distance * brush.air.haze_density * 0.9).exp();
        let lit = brush.air.shade(green, UP, point(60.0, 0.0, 40.0));
        let color = mix_color(lit, brush.air.haze, 0.25 + 0.75 * air);
        let (a, b, c) = (
            random.range(0.0, 6.0),
            random.range(2.0, 4.0),
            random.range(6.0, 9.0),
        );
        let rise = camera.focal * random.range(0.02, 0.045) * if layer == 0 { 1.3 } else { 0.7 };
        let mut outline = vec![(0.0, camera.horizon + 2.0)];
        for step in 0..=48 {
            let x = width * step as f32 / 48.0;
            let angle = (x - camera.center_x) / camera.focal + heading;
            let wave = 0.5 + 0.3 * (angle * b + a).sin() + 0.2 * (angle * c + 2.0 * a).sin();
            outline.push((x, camera.horizon - rise * wave));
        }
        outline.push((width, camera.horizon + 2.0));
        brush.canvas.overlay(&outline, color, 1.0);
    }
}
