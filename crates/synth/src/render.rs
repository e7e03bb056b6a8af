//! A frame: everything of a scene at one moment, drawn back to front.

use super::brush::Brush;
use super::canvas::Canvas;
use super::ground;
use super::kind::RIDER;
use super::motion::Pose;
use super::random::Random;
use super::road::{Setting, View};
use super::roadside;
use super::scene::Scene;
use super::scenery::{self, Placed};
use super::sky;
use super::space::{Color, Pixel, Placement, Point, mix_color, point, scale_color};
use super::traffic::{Actor, SIGHT};
use albireo_core::detection::ClassId;

/// An object that was drawn: its identity and its number in the canvas.
pub(super) struct Drawn {
    pub object: u64,
    pub class: ClassId,
    pub number: u16,
}

enum Thing<'a> {
    Scenery(&'a Placed),
    Actor(&'a Actor, Pose),
}

/// Draws `scene` at `time` and lists the objects drawn. `hidden` is left out (for tests).
pub(super) fn paint(
    canvas: &mut Canvas,
    scene: &Scene,
    time: f32,
    hidden: Option<u64>,
) -> Vec<Drawn> {
    canvas.begin();
    let along = scene.ego.along(time);
    let view = View::new(&scene.road, along, scene.ego.across);
    let camera = scene.camera(canvas.size(), time);
    let mut brush = Brush {
        canvas,
        camera,
        air: &scene.air,
    };
    sky::paint(&mut brush, scene, along);
    ground::paint(&mut brush, scene, &view, along);

    let seed = super::random::mix(&[scene.seed, scene.index, 30]);
    let items = scenery::items(&scene.road, seed, along - 8.0, along + SIGHT + 20.0);
    let mut things: Vec<(f32, Thing)> = Vec::with_capacity(items.len() + scene.actors.len());
    for placed in &items {
        let ahead = view.ahead(placed.along);
        if ahead < scenery::reach(placed.item) {
            let (at, _) = view.place(placed.along, placed.across);
            let depth = match placed.item {
                // A row of houses is nearest where it faces the road.
                scenery::Item::Building => at.z + 5.0,
                // Traffic is always on this side of a rail, except beyond a median.
                scenery::Item::Rail(length) => at.z + length + 6.0,
                _ => at.z,
            };
            things.push((depth, Thing::Scenery(placed)));
        }
    }
    for actor in &scene.actors {
        let Some(pose) = actor.motion.pose(time, &scene.ego) else {
            continue;
        };
        let ahead = view.ahead(pose.along);
        if hidden == Some(actor.object) || !(-9.0..SIGHT).contains(&ahead) {
            continue;
        }
        let (at, _) = view.place(pose.along, pose.across);
        // Whoever drives beyond the median stands behind all of its rail.
        let beyond = scene.road.setting == Setting::Highway && pose.across < 0.0;
        things.push((
            at.z + if beyond { 24.0 } else { 0.0 },
            Thing::Actor(actor, pose),
        ));
    }
    things.sort_by(|a, b| b.0.total_cmp(&a.0));

    // Shadows lie on the ground, below everything that stands on it.
    for (_, thing) in &things {
        if let Thing::Actor(actor, pose) = thing {
            let placement = placement(&view, pose);
            actor.model.paint_shadow(&mut brush, &placement);
        }
    }
    let mut drawn = Vec::new();
    let mut lamps = Vec::new();
    for (_, thing) in &things {
        match thing {
            Thing::Scenery(placed) => {
                roadside::paint(&mut brush, &view, placed, &mut lamps);
                for (at, strength) in lamps.drain(..) {
                    street_lamp(&mut brush, at, strength);
                }
            }
            Thing::Actor(actor, pose) => paint_actor(&mut brush, &view, actor, pose, &mut drawn),
        }
    }
    bonnet(&mut brush, scene);
    rain(&mut brush, scene, time);
    drawn
}

fn placement(view: &View, pose: &Pose) -> Placement {
    let (origin, heading) = view.place(pose.along, pose.across);
    Placement::new(origin, heading + pose.yaw)
}

fn paint_actor(brush: &mut Brush, view: &View, actor: &Actor, pose: &Pose, drawn: &mut Vec<Drawn>) {
    let placement = placement(view, pose);
    drawn.push(Drawn {
        object: actor.object,
        class: actor.kind.class(),
        number: brush.canvas.begin_object(),
    });
    let rider = |brush: &mut Brush| {
        drawn.push(Drawn {
            object: actor.object + 1,
            class: RIDER,
            number: brush.canvas.begin_object(),
        });
    };
    let model = &actor.model;
    model.paint(
        actor.kind,
        brush,
        &placement,
        pose.travelled,
        pose.braking,
        rider,
    );
    brush.canvas.end_object();
    model.paint_lamps(actor.kind, brush, &placement, pose.braking);
}

fn street_lamp(brush: &mut Brush, at: Point, strength: f32) {
    if at.z < 2.0 {
        return;
    }
    let color = [1.0, 0.82, 0.52];
    let fade = strength * (1.0 - brush.air.air(at.z) * 0.6);
    let night = if brush.air.headlights > 0.5 { 1.0 } else { 0.5 };
    let scale = brush.camera.scale(at.z);
    let unit = brush.camera.focal / 985.0;
    let radius = (0.8 * scale).clamp(2.5 * unit, 40.0 * unit);
    let center = brush.camera.project(at);
    brush
        .canvas
        .glow(center, (radius, radius), color, 0.85 * fade * night);
    // The pool of light below it.
    let ground = brush.camera.project(point(at.x, 0.0, at.z));
    let pool = (5.0 * scale).min(420.0 * unit);
    let flat = pool * (brush.camera.height / at.z).min(0.5);
    brush
        .canvas
        .glow(ground, (pool, flat), color, 0.22 * fade * night);
}

/// The own car's bonnet at the lower edge.
fn bonnet(brush: &mut Brush, scene: &Scene) {
    let (width, height) = (
        brush.camera.size.width as f32,
        brush.camera.size.height as f32,
    );
    let curve = |level: f32, sag: f32| -> Vec<Pixel> {
        let mut outline: Vec<Pixel> = (0..=16)
            .map(|index| {
                let share = index as f32 / 8.0 - 1.0;
                (
                    width * index as f32 / 16.0,
                    height * (level + sag * share * share),
                )
            })
            .collect();
        outline.push((width, height + 1.0));
        outline.push((0.0, height + 1.0));
        outline
    };
    let up = point(0.0, 1.0, -0.2).normalised();
    let lit: Color = brush.air.shade(scene.bonnet, up, point(0.0, 1.0, 0.0));
    let reflected = mix_color(lit, brush.air.sky_horizon, 0.28);
    brush
        .canvas
        .solid([curve(0.945, 0.035).as_slice()], scale_color(lit, 0.75));
    brush.canvas.overlay(&curve(0.952, 0.038), reflected, 1.0);
    brush
        .canvas
        .overlay(&curve(0.978, 0.05), scale_color(lit, 0.85), 1.0);
}

fn rain(brush: &mut Brush, scene: &Scene, time: f32) {
    if brush.air.wetness == 0.0 {
        return;
    }
    let (width, height) = (
        brush.camera.size.width as f32,
        brush.camera.size.height as f32,
    );
    let unit = height / 720.0;
    let pale = mix_color(brush.air.sky_horizon, [1.0, 1.0, 1.0], 0.35);
    let mut random = Random::new(&[scene.seed, scene.index, 31, u64::from(time.to_bits())]);
    let streaks: Vec<[Pixel; 4]> = (0..110)
        .map(|_| {
            let (x, y) = (random.unit() * width, random.unit() * height);
            let length = random.range(12.0, 42.0) * unit;
            let slant = (x / width - 0.5) * 0.5 * length;
            let half = random.range(0.4, 0.9) * unit;
            [
                (x - half, y),
                (x + half, y),
                (x + half + slant, y + length),
                (x - half + slant, y + length),
            ]
        })
        .collect();
    brush
        .canvas
        .overlays(streaks.iter().map(|s| s.as_slice()), pale, 0.22);
    for drop in 0..34_u64 {
        // Each drop sits on the glass for a second or two, then another takes its turn elsewhere.
        let phase = Random::new(&[scene.seed, scene.index, 32, drop]).unit();
        let turn = (time * 0.6 + phase).floor() as u64;
        let mut random = Random::new(&[scene.seed, scene.index, 33, drop, turn]);
        let (x, y) = (random.unit() * width, random.unit() * height * 0.93);
        let radius = random.range(2.5, 8.0) * unit;
        let ring = |share: f32, lift: f32| -> Vec<Pixel> {
            (0..9)
                .map(|index| {
                    let angle = std::f32::consts::TAU * index as f32 / 9.0;
                    (
                        x + radius * share * angle.cos(),
                        y + lift * radius + radius * share * 1.15 * angle.sin(),
                    )
                })
                .collect()
        };
        brush
            .canvas
            .overlay(&ring(1.0, 0.0), scale_color(pale, 0.55), 0.30);
        brush.canvas.overlay(&ring(0.62, 0.25), pale, 0.30);
    }
}
