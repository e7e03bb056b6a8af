//! How the own car and the others move: closed-form places along the road at any time of the clip.

use super::space::smooth_step;
use std::f32::consts::FRAC_PI_2;

/// The own car's way along the road.
#[derive(Clone, Debug)]
pub(super) struct Ego {
    /// Metres travelled, one entry every [`STEP`] seconds.
    travelled: Vec<f32>,
    /// Cruising speed, m/s.
    pub cruise: f32,
    /// Middle of its lane.
    pub across: f32,
}

const STEP: f32 = 0.05;

/// A stretch of time in which the own car drives at `factor` of its cruising speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlowDown {
    pub from: f32,
    pub to: f32,
    pub factor: f32,
}

impl Ego {
    pub(super) fn new(cruise: f32, across: f32, seconds: f32, slow: &[SlowDown]) -> Self {
        let mut travelled = vec![0.0];
        let mut at = 0.0;
        for index in 0..((seconds + 10.0) / STEP) as usize {
            let time = index as f32 * STEP;
            let mut speed = cruise * (1.0 + 0.05 * (time * 0.45).sin());
            for window in slow {
                let dip = smooth_step(window.from - 2.5, window.from, time)
                    * (1.0 - smooth_step(window.to, window.to + 2.5, time));
                speed *= 1.0 - (1.0 - window.factor) * dip;
            }
            at += speed * STEP;
            travelled.push(at);
        }
        Self {
            travelled,
            cruise,
            across,
        }
    }

    /// Metres along the road at `time`; before the start it came at cruising speed.
    pub(super) fn along(&self, time: f32) -> f32 {
        if time < 0.0 {
            return self.cruise * time;
        }
        let index = (time / STEP).min((self.travelled.len() - 2) as f32);
        let low = index.floor() as usize;
        let (from, to) = (self.travelled[low], self.travelled[low + 1]);
        from + (to - from) * (index - low as f32)
    }
}

/// Where something is on the road.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    pub along: f32,
    pub across: f32,
    /// Direction relative to the road, radians to the right.
    pub yaw: f32,
    /// Metres travelled, for turning wheels and legs.
    pub travelled: f32,
    pub braking: bool,
}

/// How something moves.
#[derive(Clone, Copy, Debug)]
pub(super) enum Motion {
    /// Stands still.
    Parked { along: f32, across: f32, yaw: f32 },
    /// Drives along the road at its own speed (negative: towards the camera).
    Steady {
        along: f32,
        across: f32,
        speed: f32,
        wander: f32,
    },
    /// Keeps a swaying distance to the own car.
    Lead {
        gap: f32,
        sway: f32,
        period: f32,
        across: f32,
    },
    /// Comes from behind in the lane `from`, passes, and changes to the lane `to`.
    Pass {
        start: f32,
        relative: f32,
        from: f32,
        to: f32,
    },
    /// Walks or drives straight across the road from `start` on.
    Cross {
        along: f32,
        from: f32,
        speed: f32,
        start: f32,
    },
    /// Drives ahead at `speed`, brakes, and leaves into a side road.
    TurnOff {
        junction: f32,
        lane: f32,
        /// 1 to the right, -1 to the left.
        side: f32,
        gap: f32,
        speed: f32,
        brake: f32,
    },
    /// Comes out of a side road on the right and drives on ahead.
    TurnIn {
        junction: f32,
        lane: f32,
        start: f32,
        speed: f32,
    },
}

/// Speed in a bend, m/s.
const BEND_SPEED: f32 = 4.5;

impl Motion {
    /// Where it is at `time`; none while it is not there.
    pub(super) fn pose(&self, time: f32, ego: &Ego) -> Option<Pose> {
        match *self {
            Self::Parked { along, across, yaw } => Some(Pose {
                along,
                across,
                yaw,
                travelled: 0.0,
                braking: false,
            }),
            Self::Steady {
                along,
                across,
                speed,
                wander,
            } => Some(Pose {
                along: along + speed * time,
                across: across + wander * (time * 0.9 + along).sin(),
                yaw: if speed < 0.0 {
                    std::f32::consts::PI
                } else {
                    0.0
                },
                travelled: speed.abs() * time,
                braking: false,
            }),
            Self::Lead {
                gap,
                sway,
                period,
                across,
            } => {
                let phase = std::f32::consts::TAU * time / period;
                let along = ego.along(time) + gap + sway * phase.sin();
                Some(Pose {
                    along,
                    across: across + 0.18 * (0.7 * time + gap).sin(),
                    yaw: 0.006 * (0.7 * time + gap).cos(),
                    travelled: along,
                    braking: phase.cos() < -0.6,
                })
            }
            Self::Pass {
                start,
                relative,
                from,
                to,
            } => {
                let gap = -14.0 + relative * (time - start);
                let along = ego.along(time) + gap;
                let share = |gap: f32| smooth_step(14.0, 14.0 + relative * 3.5, gap);
                let slope = (share(gap + 0.5) - share(gap - 0.5)) * (to - from) * relative;
                (gap > -30.0).then_some(Pose {
                    along,
                    across: from + (to - from) * share(gap),
                    yaw: (slope / (ego.cruise + relative)).atan(),
                    travelled: along,
                    braking: false,
                })
            }
            Self::Cross {
                along,
                from,
                speed,
                start,
            } => {
                // Waits at one kerb, crosses, and stays at the other.
                let walked = (speed * (time - start)).clamp(0.0, 2.0 * from.abs());
                Some(Pose {
                    along,
                    across: from - from.signum() * walked,
                    yaw: -from.signum() * FRAC_PI_2,
                    travelled: walked,
                    braking: false,
                })
            }
            Self::TurnOff {
                junction,
                lane,
                side,
                gap,
                speed,
                brake,
            } => {
                let radius = if side > 0.0 { 7.0 } else { 9.0 };
                let travelled = gap + braked(speed, brake, time);
                let past = travelled - (junction - radius);
                let braking = time > brake && past < 0.0;
                let pose = |along, across, yaw| Pose {
                    along,
                    across,
                    yaw,
                    travelled,
                    braking,
                };
                let bend = radius * FRAC_PI_2;
                if past < 0.0 {
                    Some(pose(travelled, lane, 0.0))
                } else if past < bend {
                    let angle = past / radius;
                    let across = lane + side * radius * (1.0 - angle.cos());
                    let along = junction - radius + radius * angle.sin();
                    Some(pose(along, across, side * angle))
                } else {
                    let across = lane + side * (radius + past - bend);
                    (past - bend < 70.0).then_some(pose(junction, across, side * FRAC_PI_2))
                }
            }
            Self::TurnIn {
                junction,
                lane,
                start,
                speed,
            } => {
                let radius = 7.0;
                let since = time - start;
                let bend = radius * FRAC_PI_2;
                let to_cruise = ((speed - BEND_SPEED) / 2.0).max(0.1);
                let gone = since - bend / BEND_SPEED;
                let past = if gone < 0.0 {
                    BEND_SPEED * since
                } else if gone < to_cruise {
                    bend + BEND_SPEED * gone + gone * gone
                } else {
                    bend + BEND_SPEED * to_cruise
                        + to_cruise * to_cruise
                        + speed * (gone - to_cruise)
                };
                let pose = |along, across, yaw| Pose {
                    along,
                    across,
                    yaw,
                    travelled: past,
                    braking: false,
                };
                if past < 0.0 {
                    (past > -60.0).then_some(pose(junction, lane + radius - past, -FRAC_PI_2))
                } else if past < bend {
                    let angle = past / radius;
                    Some(pose(
                        junction + radius * (1.0 - angle.cos()),
                        lane + radius * (1.0 - angle.sin()),
                        angle - FRAC_PI_2,
                    ))
                } else {
                    Some(pose(junction + radius + past - bend, lane, 0.0))
                }
            }
        }
    }
}

/// Metres gone at `time` by a car that brakes at 2.5 m/s² from `brake` on, down to the speed of a bend.
pub(super) fn braked(speed: f32, brake: f32, time: f32) -> f32 {
    let slope = 2.5;
    let slowing = ((speed - BEND_SPEED) / slope).max(0.0);
    let since = time - brake;
    if since < 0.0 {
        speed * time
    } else if since < slowing {
        speed * time - 0.5 * slope * since * since
    } else {
        speed * (brake + slowing) - 0.5 * slope * slowing * slowing + BEND_SPEED * (since - slowing)
    }
}
