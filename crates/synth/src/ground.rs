//! What lies flat: fields, the road's surface and its markings.

use super::brush::Brush;
use super::random::Random;
use super::road::{HORIZON, Road, SIDE_ROAD_HALF_WIDTH, Setting, View};
use super::scene::Scene;
use super::space::{Camera, Color, NEAR, Pixel, mix_color, point, scale_color};

const ASPHALT: Color = [0.37, 0.37, 0.38];
const MARKING: Color = [0.88, 0.88, 0.84];
const UP: super::space::Point = point(0.0, 1.0, 0.0);

/// Paints everything that nothing stands behind, over a painted sky.
pub(super) fn paint(brush: &mut Brush, scene: &Scene, view: &View, along: f32) {
    fields(brush, scene, along);
    let road = &scene.road;
    for &junction in &road.junctions {
        side_road(brush, road, view, junction);
    }
    match road.setting {
        Setting::Country => country(brush, road, view, along),
        Setting::Highway => highway(brush, road, view, along),
        Setting::Town => town(brush, road, view, along),
    }
    wear(brush, scene, view, along);
    if brush.air.headlights > 0.5 {
        let camera = brush.camera;
        let center = camera.project(point(0.3, 0.0, 10.0));
        let radii = (
            camera.size.width as f32 * 0.42,
            camera.size.height as f32 * 0.22,
        );
        brush.canvas.glow(center, radii, [0.30, 0.29, 0.25], 0.5);
    }
}

/// The ground beside the road, row by row.
fn fields(brush: &mut Brush, scene: &Scene, along: f32) {
    let camera = brush.camera;
    let mut random = Random::new(&[scene.seed, scene.index, 21]);
    let base = match scene.road.setting {
        Setting::Country => {
            random.pick([[0.34, 0.46, 0.20], [0.44, 0.45, 0.22], [0.55, 0.48, 0.28]])
        }
        Setting::Highway => random.pick([[0.34, 0.43, 0.22], [0.42, 0.42, 0.26]]),
        Setting::Town => [0.46, 0.45, 0.43],
    };
    let air = brush.air;
    let first = camera.horizon.max(0.0) as u32;
    brush.canvas.rows(first, camera.size.height, |row| {
        let below = (row as f32 + 0.5 - camera.horizon).max(0.4);
        let z = camera.focal * camera.height / below;
        let band = ((along + z) / 7.0).sin() + 0.6 * ((along + z) / 2.3).sin();
        let fade = (1.0 - z / 90.0).max(0.0);
        let color = scale_color(base, 1.0 + 0.05 * band * fade);
        air.shade(color, UP, point(5.0 + 0.12 * z, 0.0, z))
    });
}

/// Distances at which strips along the road are sampled.
fn samples() -> impl Iterator<Item = f32> {
    std::iter::successors(Some(0.9_f32), |&ahead| {
        let next = ahead * 1.13 + 0.8;
        (next < HORIZON + 30.0).then_some(next)
    })
}

/// A strip of ground between `left` and `right`, from the camera to the horizon.
fn strip(camera: &Camera, view: &View, along: f32, left: f32, right: f32) -> Vec<Pixel> {
    let mut outline = Vec::with_capacity(80);
    let mut back = Vec::with_capacity(40);
    for ahead in samples() {
        let (a, b) = (
            view.place(along + ahead, left).0,
            view.place(along + ahead, right).0,
        );
        if a.z < NEAR || b.z < NEAR {
            continue;
        }
        outline.push(camera.project(a));
        back.push(camera.project(b));
    }
    outline.extend(back.into_iter().rev());
    outline
}

/// Colour stops down the picture for flat ground of one colour.
fn grades(brush: &Brush, color: Color) -> Vec<(f32, Color)> {
    [260.0, 150.0, 90.0, 55.0, 32.0, 18.0, 10.0, 6.0, 3.4]
        .iter()
        .map(|&z| {
            let row = brush.camera.horizon + brush.camera.focal * brush.camera.height / z;
            (row, brush.air.shade(color, UP, point(0.0, 0.0, z)))
        })
        .collect()
}

fn surface(brush: &mut Brush, view: &View, along: f32, edges: (f32, f32), color: Color) {
    let outline = strip(&brush.camera, view, along, edges.0, edges.1);
    let color = mix_color(color, brush.air.sky_horizon, brush.air.wetness * 0.45);
    let stops = grades(brush, color);
    brush.canvas.graded(&outline, &stops);
}

/// A line along the road, dashed where `dash` is (length, gap).
fn line(
    brush: &mut Brush,
    view: &View,
    along: f32,
    across: f32,
    width: f32,
    dash: Option<(f32, f32)>,
    color: Color,
) {
    let (left, right) = (across - width / 2.0, across + width / 2.0);
    let Some((length, gap)) = dash else {
        let outline = strip(&brush.camera, view, along, left, right);
        let stops = grades(brush, color);
        brush.canvas.graded(&outline, &stops);
        return;
    };
    let period = length + gap;
    let mut start = ((along / period).floor() - 1.0) * period;
    let mut pixels = Vec::with_capacity(6);
    while start < along + 170.0 {
        let corners = [
            view.place(start, left).0,
            view.place(start, right).0,
            view.place(start + length, right).0,
            view.place(start + length, left).0,
        ];
        let middle = corners[0].lerp(corners[2], 0.5);
        brush.camera.project_polygon(&corners, &mut pixels);
        let color = brush.air.shade(color, UP, middle);
        brush.canvas.overlay(&pixels, color, 0.9);
        start += period;
    }
}

fn side_road(brush: &mut Brush, road: &Road, view: &View, junction: f32) {
    let ahead = view.ahead(junction);
    if !(-20.0..HORIZON).contains(&ahead) {
        return;
    }
    let half = SIDE_ROAD_HALF_WIDTH;
    let mut pixels = Vec::with_capacity(8);
    for (from, to) in [(road.edges().1 - 1.0, 90.0), (road.edges().0 + 1.0, -90.0)] {
        let flare = 3.0;
        let corners = [
            view.place(junction - half - flare, from).0,
            view.place(junction - half, from + (to - from) * 0.04).0,
            view.place(junction - half, to).0,
            view.place(junction + half, to).0,
            view.place(junction + half, from + (to - from) * 0.04).0,
            view.place(junction + half + flare, from).0,
        ];
        brush.camera.project_polygon(&corners, &mut pixels);
        let color = brush
            .air
            .shade(ASPHALT, UP, point(4.0, 0.0, ahead.max(3.0)));
        brush.canvas.overlay(&pixels, color, 1.0);
    }
}

fn country(brush: &mut Brush, road: &Road, view: &View, along: f32) {
    let edges = road.edges();
    surface(
        brush,
        view,
        along,
        (edges.0 - 0.7, edges.1 + 0.7),
        [0.44, 0.40, 0.33],
    );
    surface(brush, view, along, edges, ASPHALT);
    line(brush, view, along, edges.0 + 0.35, 0.14, None, MARKING);
    line(brush, view, along, edges.1 - 0.35, 0.14, None, MARKING);
    line(brush, view, along, 0.0, 0.14, Some((4.0, 8.0)), MARKING);
}

fn highway(brush: &mut Brush, road: &Road, view: &View, along: f32) {
    let (left, right) = road.edges();
    surface(brush, view, along, (-right, right), ASPHALT);
    surface(brush, view, along, (-left, left), [0.36, 0.38, 0.28]);
    for side in [-1.0, 1.0] {
        line(
            brush,
            view,
            along,
            side * 1.5,
            0.18,
            None,
            [0.85, 0.72, 0.28],
        );
        line(brush, view, along, side * 12.3, 0.18, None, MARKING);
        for across in [5.1, 8.7] {
            line(
                brush,
                view,
                along,
                side * across,
                0.15,
                Some((4.0, 8.0)),
                MARKING,
            );
        }
    }
}

fn town(brush: &mut Brush, road: &Road, view: &View, along: f32) {
    let (left, right) = road.edges();
    surface(
        brush,
        view,
        along,
        (left - 3.6, right + 3.6),
        [0.58, 0.57, 0.55],
    );
    surface(
        brush,
        view,
        along,
        (left - 0.22, right + 0.22),
        [0.70, 0.69, 0.67],
    );
    surface(brush, view, along, (left, right), ASPHALT);
    for side in [-1.0, 1.0] {
        line(
            brush,
            view,
            along,
            side * 3.65,
            0.12,
            Some((5.0, 1.2)),
            MARKING,
        );
    }
    line(brush, view, along, 0.0, 0.14, Some((3.0, 4.0)), MARKING);
    // The mouths of side roads and the crossings beside them.
    let mut pixels = Vec::with_capacity(6);
    for &junction in &road.junctions {
        let ahead = view.ahead(junction);
        if !(-16.0..140.0).contains(&ahead) {
            continue;
        }
        let half = SIDE_ROAD_HALF_WIDTH;
        let mut quad = |brush: &mut Brush, along: (f32, f32), across: (f32, f32), color: Color| {
            let corners = [
                view.place(along.0, across.0).0,
                view.place(along.0, across.1).0,
                view.place(along.1, across.1).0,
                view.place(along.1, across.0).0,
            ];
            let middle = corners[0].lerp(corners[2], 0.5);
            brush.camera.project_polygon(&corners, &mut pixels);
            let color = brush.air.shade(color, UP, middle);
            brush.canvas.overlay(&pixels, color, 1.0);
        };
        for (from, to) in [(right - 0.1, right + 4.0), (left - 4.0, left + 0.1)] {
            quad(
                brush,
                (junction - half, junction + half),
                (from, to),
                ASPHALT,
            );
        }
        for bar in 0..10 {
            let across = -5.0 + bar as f32 * 1.05;
            let at = junction - half - 4.2;
            quad(brush, (at, at + 2.8), (across, across + 0.55), MARKING);
        }
    }
}

/// Tyre tracks, patches and cracks, so that the surface is seen to move.
fn wear(brush: &mut Brush, scene: &Scene, view: &View, along: f32) {
    let lane = scene.ego.across;
    for side in [-0.8, 0.8] {
        let outline = strip(
            &brush.camera,
            view,
            along,
            lane + side - 0.22,
            lane + side + 0.22,
        );
        brush.canvas.overlay(&outline, [0.0, 0.0, 0.0], 0.06);
    }
    let (left, right) = scene.road.edges();
    let mut pixels = Vec::with_capacity(6);
    let first = (along / 6.0).floor() as i64;
    for cell in first..first + 10 {
        let mut random = Random::new(&[scene.seed, scene.index, 22, cell as u64]);
        if !random.chance(0.7) {
            continue;
        }
        let start = cell as f32 * 6.0 + random.range(0.0, 3.0);
        let across = random.range(left + 0.5, right - 1.5);
        let (length, width) =
            random.pick([(3.5, 1.2), (1.5, 0.7), (5.0, 0.08), (0.6, 0.6), (0.15, 3.0)]);
        let dark = random.chance(0.7);
        let corners = [
            view.place(start, across).0,
            view.place(start, across + width).0,
            view.place(start + length, across + width).0,
            view.place(start + length, across).0,
        ];
        brush.camera.project_polygon(&corners, &mut pixels);
        let fade = (1.0 - view.ahead(start) / 60.0).clamp(0.0, 1.0);
        let tone = if dark {
            [0.0, 0.0, 0.0]
        } else {
            brush.air.sky_horizon
        };
        brush.canvas.overlay(&pixels, tone, 0.13 * fade);
    }
}
