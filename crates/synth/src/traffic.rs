//! Who is on the road in a clip: drawn from chance, kept clear of each other, of the own car, and of the
//! quiet stretches.

use super::kind::Kind;
use super::motion::{Ego, Motion, Pose, SlowDown, braked};
use super::random::Random;
use super::road::{HORIZON, Road, Setting};
use super::vehicles::Model;

/// One participant: a vehicle, a pedestrian, or a two-wheeler with its rider.
#[derive(Clone, Debug)]
pub(super) struct Actor {
    /// Unique in the clip. A rider on a two-wheeler is the object that follows it.
    pub object: u64,
    pub kind: Kind,
    pub motion: Motion,
    pub model: Model,
}

/// A quiet stretch: from and to, seconds of the clip.
pub(super) type Quiet = Option<(f32, f32)>;

struct Cast<'a> {
    actors: Vec<Actor>,
    ego: &'a Ego,
    road: &'a Road,
    quiet: Quiet,
    seconds: f32,
}

/// Distance beyond which nobody is drawn, metres.
pub(super) const SIGHT: f32 = HORIZON - 40.0;

impl Cast<'_> {
    fn in_sight(&self, pose: &Pose, time: f32, reach: f32) -> bool {
        let ahead = pose.along - self.ego.along(time);
        ahead > -8.0 && ahead < reach
    }

    /// Adds an actor unless it would be seen in the quiet stretch or touch somebody.
    fn add(&mut self, kind: Kind, motion: Motion, random: &mut Random) -> bool {
        let (length, width, _) = kind.size();
        let steps = (self.seconds / 0.25) as usize + 1;
        let mut seen = false;
        for step in 0..=steps {
            let time = step as f32 * 0.25;
            let Some(pose) = motion.pose(time, self.ego) else {
                continue;
            };
            if !self.in_sight(&pose, time, SIGHT) {
                continue;
            }
            seen = true;
            if self
                .quiet
                .is_some_and(|(from, to)| time >= from - 0.3 && time <= to + 0.3)
            {
                return false;
            }
            let turned = pose.yaw.sin().abs();
            let (along, across) = (
                length + (width - length) * turned,
                width + (length - width) * turned,
            );
            let touches = |other: (f32, f32), size: (f32, f32), gap: f32| {
                (pose.along - other.0).abs() < (along + size.0) / 2.0 + gap
                    && (pose.across - other.1).abs() < (across + size.1) / 2.0 + 0.25
            };
            let own = (self.ego.along(time), self.ego.across);
            if touches(own, (5.0, 1.8), 3.0) {
                return false;
            }
            for other in &self.actors {
                let size = other.kind.size();
                let gap = if other.kind.walks() && kind.walks() {
                    0.1
                } else {
                    1.5
                };
                if let Some(place) = other.motion.pose(time, self.ego) {
                    let turned = place.yaw.sin().abs();
                    let size = (
                        size.0 + (size.1 - size.0) * turned,
                        size.1 + (size.0 - size.1) * turned,
                    );
                    if touches((place.along, place.across), size, gap) {
                        return false;
                    }
                }
            }
        }
        if seen {
            self.actors.push(Actor {
                object: 0,
                kind,
                motion,
                model: Model::draw(kind, random),
            });
        }
        seen
    }
}

/// Slow-downs of the own car in a clip, and where somebody will walk over the road before it.
pub(super) fn slow_downs(setting: Setting, seconds: f32, random: &mut Random) -> Vec<SlowDown> {
    let mut slow = Vec::new();
    if setting == Setting::Town && seconds > 8.0 {
        let mut at = random.range(2.0, 6.0);
        while at < seconds - 4.0 {
            let stop = random.range(2.0, 4.5);
            slow.push(SlowDown {
                from: at,
                to: at + stop,
                factor: random.range(0.12, 0.4),
            });
            at += stop + random.range(6.0, 14.0);
        }
    }
    slow
}

/// Draws the actors of a clip.
pub(super) fn draw(
    road: &Road,
    ego: &Ego,
    slow: &[SlowDown],
    seconds: f32,
    quiet: Quiet,
    density: f32,
    random: &mut Random,
) -> Vec<Actor> {
    let mut cast = Cast {
        actors: Vec::new(),
        ego,
        road,
        quiet,
        seconds,
    };
    match road.setting {
        Setting::Highway => highway(&mut cast, density, random),
        Setting::Country => country(&mut cast, density, random),
        Setting::Town => town(&mut cast, slow, density, random),
    }
    let mut next = 1;
    for actor in &mut cast.actors {
        actor.object = next;
        next += if actor.kind.ridden() { 2 } else { 1 };
    }
    cast.actors
}

fn motor_vehicle(random: &mut Random) -> Kind {
    let draw = random.unit();
    match draw {
        d if d < 0.62 => Kind::Car,
        d if d < 0.78 => Kind::Truck,
        d if d < 0.88 => Kind::Bus,
        _ => Kind::Motorcycle { ridden: true },
    }
}

fn highway(cast: &mut Cast, density: f32, random: &mut Random) {
    let cruise = cast.ego.cruise;
    for _ in 0..(9.0 * density) as usize {
        let kind = motor_vehicle(random);
        let motion = match random.below(3) {
            0 => Motion::Lead {
                gap: random.range(14.0, 70.0),
                sway: random.range(1.0, 5.0),
                period: random.range(9.0, 16.0),
                across: random.pick([3.3, 6.9, 10.5]),
            },
            1 => Motion::Pass {
                start: random.range(-4.0, cast.seconds - 2.0),
                relative: random.range(2.5, 7.0),
                from: 3.3,
                to: random.pick([3.3, 3.3, 6.9]),
            },
            _ => Motion::Steady {
                along: random.range(25.0, 160.0),
                across: 10.5,
                speed: cruise - random.range(2.0, 7.0),
                wander: 0.12,
            },
        };
        cast.add(kind, motion, random);
    }
    for _ in 0..(14.0 * density) as usize {
        let kind = motor_vehicle(random);
        let motion = oncoming(cast, cruise * random.range(0.9, 1.1), random);
        cast.add(kind, motion, random);
    }
}

/// Somebody who meets the own car at a time drawn from the clip.
fn oncoming(cast: &Cast, speed: f32, random: &mut Random) -> Motion {
    let meets = random.range(-0.5, cast.seconds + 6.0);
    Motion::Steady {
        along: cast.ego.along(meets) + speed * meets,
        across: cast.road.oncoming_lane(random),
        speed: -speed,
        wander: 0.1,
    }
}

fn country(cast: &mut Cast, density: f32, random: &mut Random) {
    let cruise = cast.ego.cruise;
    turners(cast, random);
    if random.chance(0.45 * density) {
        let kind = motor_vehicle(random);
        let motion = Motion::Lead {
            gap: random.range(16.0, 60.0),
            sway: random.range(1.0, 5.0),
            period: random.range(9.0, 16.0),
            across: 1.85,
        };
        cast.add(kind, motion, random);
    }
    if random.chance(0.4 * density) {
        let motion = Motion::Pass {
            start: random.range(0.0, cast.seconds * 0.7),
            relative: random.range(4.0, 8.0),
            from: -1.85,
            to: 1.85,
        };
        let kind = random.pick([Kind::Car, Kind::Car, Kind::Motorcycle { ridden: true }]);
        cast.add(kind, motion, random);
    }
    for _ in 0..(7.0 * density) as usize {
        let kind = motor_vehicle(random);
        let motion = oncoming(cast, cruise * random.range(0.75, 1.1), random);
        cast.add(kind, motion, random);
    }
    for _ in 0..(4.0 * density) as usize {
        let kind = random.pick([
            Kind::Bicycle { ridden: true },
            Kind::Bicycle { ridden: true },
            Kind::Pedestrian,
        ]);
        let side = if kind.walks() { random.sign() } else { 1.0 };
        let speed = if kind.walks() {
            random.range(1.0, 1.6) * random.sign()
        } else {
            random.range(4.0, 7.0)
        };
        let passes = random.range(0.5, cast.seconds + 3.0);
        let motion = Motion::Steady {
            along: cast.ego.along(passes) - speed * passes,
            across: side * if kind.walks() { 5.2 } else { 4.0 },
            speed,
            wander: 0.08,
        };
        cast.add(kind, motion, random);
    }
}

/// One vehicle that turns off and one that turns in, where side roads allow it.
fn turners(cast: &mut Cast, random: &mut Random) {
    let cruise = cast.ego.cruise;
    let lane = cast.road.own_lane();
    let junctions = cast.road.junctions.clone();
    for junction in junctions {
        if random.chance(0.5) {
            let gap = random.range(40.0, 58.0);
            // The moment it must brake to have the bend's speed where the bend begins.
            let side = random.pick([1.0, 1.0, -1.0]);
            let start = junction - if side > 0.0 { 7.0 } else { 9.0 };
            let mut brake = 0.0;
            while brake < cast.seconds && gap + braked(cruise, brake, brake + 4.0) < start {
                brake += 0.1;
            }
            let motion = Motion::TurnOff {
                junction,
                lane,
                side,
                gap,
                speed: cruise,
                brake,
            };
            let kind = random.pick([Kind::Car, Kind::Car, Kind::Truck]);
            cast.add(kind, motion, random);
        } else {
            let mut start = 0.0;
            let distance = random.range(45.0, 80.0);
            while start < cast.seconds && cast.ego.along(start) + distance < junction {
                start += 0.1;
            }
            let motion = Motion::TurnIn {
                junction,
                lane,
                start,
                speed: cruise + random.range(0.0, 2.0),
            };
            let kind = random.pick([Kind::Car, Kind::Car, Kind::Bus]);
            cast.add(kind, motion, random);
        }
    }
}

fn town(cast: &mut Cast, slow: &[SlowDown], density: f32, random: &mut Random) {
    let length = cast.ego.along(cast.seconds) + 150.0;
    let cruise = cast.ego.cruise;
    for window in slow {
        if random.chance(0.75 * density.min(1.2)) {
            let along = cast.ego.along(window.to) + random.range(7.0, 14.0);
            let count = 1 + random.below(3);
            for index in 0..count {
                let from = 7.4 * random.sign();
                let kind = if random.chance(0.8) {
                    Kind::Pedestrian
                } else {
                    Kind::Bicycle { ridden: true }
                };
                let motion = Motion::Cross {
                    along: along + index as f32 * random.range(0.7, 1.4),
                    from,
                    speed: random.range(1.2, 2.0),
                    start: window.from - random.range(0.5, 4.0),
                };
                cast.add(kind, motion, random);
            }
        }
    }
    turners(cast, random);
    if random.chance(0.5 * density) {
        let motion = Motion::Lead {
            gap: random.range(10.0, 28.0),
            sway: 2.0,
            period: random.range(8.0, 14.0),
            across: 1.75,
        };
        let kind = motor_vehicle(random);
        cast.add(kind, motion, random);
    }
    for _ in 0..(7.0 * density) as usize {
        let kind = motor_vehicle(random);
        let motion = oncoming(cast, cruise * random.range(0.8, 1.1), random);
        cast.add(kind, motion, random);
    }
    let mut along = random.range(5.0, 20.0);
    while along < length {
        for side in [1.0, -1.0] {
            if cast.road.near_junction(along, 11.0) || !random.chance(0.45 * density) {
                continue;
            }
            let kind = match random.unit() {
                d if d < 0.76 => Kind::Car,
                d if d < 0.84 => Kind::Truck,
                d if d < 0.90 => Kind::Motorcycle { ridden: false },
                _ => Kind::Bicycle { ridden: false },
            };
            let yaw = if side > 0.0 {
                0.0
            } else {
                std::f32::consts::PI
            };
            let across = side * if kind.walks() { 6.6 } else { 4.75 };
            cast.add(kind, Motion::Parked { along, across, yaw }, random);
        }
        along += random.range(7.0, 14.0);
    }
    for _ in 0..(16.0 * density) as usize {
        let (kind, across, speed) = match random.unit() {
            d if d < 0.72 => (
                Kind::Pedestrian,
                random.range(6.6, 8.6) * random.sign(),
                random.range(0.9, 1.7) * random.sign(),
            ),
            d if d < 0.9 => (Kind::Bicycle { ridden: true }, 3.35, random.range(3.5, 5.5)),
            _ => (
                Kind::Bicycle { ridden: true },
                -3.35,
                -random.range(3.5, 6.0),
            ),
        };
        let passes = random.range(0.0, cast.seconds + 6.0);
        let motion = Motion::Steady {
            along: cast.ego.along(passes) - speed * passes,
            across,
            speed,
            wander: 0.1,
        };
        cast.add(kind, motion, random);
    }
}
