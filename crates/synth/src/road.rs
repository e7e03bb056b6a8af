//! The road: its kind, its lanes, its curves, and where a place along it lies before the camera.

use super::random::Random;
use super::space::{Point, point};

/// What the road runs through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Setting {
    /// Two lanes between fields and trees.
    Country,
    /// Three lanes each way with a median.
    Highway,
    /// Two lanes, parked cars, pavements and houses.
    Town,
}

/// Places on the road are (`along`, `across`): metres along its centre line from the clip's start, and
/// metres to the right of it.
#[derive(Clone, Debug)]
pub(super) struct Road {
    pub setting: Setting,
    /// Curves: amplitude (1/m), wave length (m) and phase of the curvature.
    curve: (f32, f32, f32),
    /// Places of side roads.
    pub junctions: Vec<f32>,
    /// Whether guard rails stand beside a country road.
    pub rails: bool,
}

/// Half the width of a side road, metres.
pub(super) const SIDE_ROAD_HALF_WIDTH: f32 = 3.6;

impl Road {
    pub(super) fn draw(setting: Setting, length: f32, random: &mut Random) -> Self {
        let amplitude = match setting {
            Setting::Country => random.range(0.0005, 0.0035),
            Setting::Highway => random.range(0.0001, 0.0010),
            Setting::Town => random.range(0.0, 0.0012),
        } * random.sign();
        let curve = (
            amplitude,
            random.range(350.0, 900.0),
            random.range(0.0, std::f32::consts::TAU),
        );
        let mut junctions = Vec::new();
        let (first, last) = match setting {
            Setting::Country => (180.0, 420.0),
            Setting::Highway => (f32::MAX, f32::MAX),
            Setting::Town => (70.0, 150.0),
        };
        if first < f32::MAX {
            let mut at = random.range(50.0, first);
            while at < length + 250.0 {
                junctions.push(at);
                at += random.range(first, last);
            }
        }
        let rails = setting == Setting::Country && random.chance(0.35);
        Self {
            setting,
            curve,
            junctions,
            rails,
        }
    }

    /// Direction of the road at `along`, radians to the right of its direction at the start.
    pub(super) fn heading(&self, along: f32) -> f32 {
        let (amplitude, wave, phase) = self.curve;
        let turn = std::f32::consts::TAU / wave;
        amplitude / turn * (phase.cos() - (turn * along + phase).cos())
    }

    /// Edges of the asphalt, `across`.
    pub(super) fn edges(&self) -> (f32, f32) {
        match self.setting {
            Setting::Country => (-4.1, 4.1),
            Setting::Highway => (1.0, 15.2),
            Setting::Town => (-5.9, 5.9),
        }
    }

    /// Middle of the lane the camera's car drives in.
    pub(super) fn own_lane(&self) -> f32 {
        match self.setting {
            Setting::Country => 1.85,
            Setting::Highway => 6.9,
            Setting::Town => 1.75,
        }
    }

    /// Middle of a lane of the oncoming traffic.
    pub(super) fn oncoming_lane(&self, random: &mut Random) -> f32 {
        match self.setting {
            Setting::Country => -1.85,
            Setting::Highway => random.pick([-3.3, -6.9, -10.5]),
            Setting::Town => -1.75,
        }
    }

    /// Whether a side road is within `margin` metres of `along`.
    pub(super) fn near_junction(&self, along: f32, margin: f32) -> bool {
        self.junctions
            .iter()
            .any(|junction| (junction - along).abs() < margin)
    }
}

const STEP: f32 = 3.0;
const BEHIND: f32 = 30.0;
/// Nothing farther than this is drawn, metres.
pub(super) const HORIZON: f32 = 260.0;

/// The road as seen from one place on it.
pub(super) struct View {
    /// (x, z, heading) of the centre line, every [`STEP`] metres from [`BEHIND`] behind the camera.
    line: Vec<(f32, f32, f32)>,
    across: f32,
    along: f32,
}

impl View {
    /// The road seen by a camera at (`along`, `across`) that looks along it.
    pub(super) fn new(road: &Road, along: f32, across: f32) -> Self {
        let straight = road.heading(along);
        let count = ((HORIZON + 60.0 + BEHIND) / STEP) as usize;
        let mut line = Vec::with_capacity(count);
        let (mut x, mut z) = (0.0_f32, 0.0_f32);
        let behind = (BEHIND / STEP) as usize;
        for index in 0..behind {
            let middle = road.heading(along - (index as f32 + 0.5) * STEP) - straight;
            x -= STEP * middle.sin();
            z -= STEP * middle.cos();
        }
        for index in 0..count {
            let ahead = (index as f32 - behind as f32) * STEP;
            line.push((x, z, road.heading(along + ahead) - straight));
            let middle = road.heading(along + ahead + STEP / 2.0) - straight;
            x += STEP * middle.sin();
            z += STEP * middle.cos();
        }
        Self {
            line,
            across,
            along,
        }
    }

    /// Metres from the camera along the road.
    pub(super) fn ahead(&self, along: f32) -> f32 {
        along - self.along
    }

    /// Position and heading, in the camera's axes, of a place on the ground.
    pub(super) fn place(&self, along: f32, across: f32) -> (Point, f32) {
        let index = ((along - self.along + BEHIND) / STEP).clamp(0.0, (self.line.len() - 2) as f32);
        let (low, share) = (index.floor() as usize, index.fract());
        let (from, to) = (self.line[low], self.line[low + 1]);
        let heading = from.2 + (to.2 - from.2) * share;
        let (sin, cos) = heading.sin_cos();
        let x = from.0 + (to.0 - from.0) * share + across * cos - self.across;
        let z = from.1 + (to.1 - from.1) * share - across * sin;
        (point(x, 0.0, z), heading)
    }

    /// As [`View::place`], at a height above the ground.
    pub(super) fn lift(&self, along: f32, across: f32, height: f32) -> Point {
        let (mut at, _) = self.place(along, across);
        at.y = height;
        at
    }
}
