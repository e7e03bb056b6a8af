//! Points in metres and the camera that projects them: x to the right, y up, z forward.

use albireo_core::geometry::PictureSize;

/// A colour, red, green and blue, 0 to 1.
pub(super) type Color = [f32; 3];

/// A point on the picture, pixels.
pub(super) type Pixel = (f32, f32);

/// A point or direction, metres. The origin is on the road below the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Point {
    pub x: f32,
    pub y: f32,
    pub z: f32,
}

/// A point from its coordinates.
pub(super) const fn point(x: f32, y: f32, z: f32) -> Point {
    Point { x, y, z }
}

impl Point {
    pub(super) fn minus(self, other: Self) -> Self {
        point(self.x - other.x, self.y - other.y, self.z - other.z)
    }

    pub(super) fn plus(self, other: Self) -> Self {
        point(self.x + other.x, self.y + other.y, self.z + other.z)
    }

    pub(super) fn times(self, factor: f32) -> Self {
        point(self.x * factor, self.y * factor, self.z * factor)
    }

    pub(super) fn dot(self, other: Self) -> f32 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    pub(super) fn cross(self, other: Self) -> Self {
        point(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    pub(super) fn length(self) -> f32 {
        self.dot(self).sqrt()
    }

    pub(super) fn normalised(self) -> Self {
        self.times(1.0 / self.length().max(1e-6))
    }

    pub(super) fn lerp(self, other: Self, share: f32) -> Self {
        self.plus(other.minus(self).times(share))
    }
}

/// Where an object stands: its place and the direction it looks (radians to the right of forward).
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub origin: Point,
    sin: f32,
    cos: f32,
}

impl Placement {
    pub(super) fn new(origin: Point, yaw: f32) -> Self {
        let (sin, cos) = yaw.sin_cos();
        Self { origin, sin, cos }
    }

    /// A direction of the object (x to its right, z ahead) in the camera's axes.
    pub(super) fn turn(&self, local: Point) -> Point {
        point(
            local.x * self.cos + local.z * self.sin,
            local.y,
            local.z * self.cos - local.x * self.sin,
        )
    }

    /// A point of the object in the camera's axes.
    pub(super) fn place(&self, local: Point) -> Point {
        self.turn(local).plus(self.origin)
    }
}

/// A pinhole camera. Small pitch and yaw are shifts of the picture, which is all that a shaking
/// dashcam needs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    /// Focal length, pixels.
    pub focal: f32,
    /// Column of the straight-ahead direction.
    pub center_x: f32,
    /// Row of the horizon.
    pub horizon: f32,
    /// Height above the road, metres.
    pub height: f32,
    /// The picture it takes.
    pub size: PictureSize,
}

/// Nothing nearer than this is drawn, metres.
pub(super) const NEAR: f32 = 0.6;

impl Camera {
    /// Where a point at least [`NEAR`] ahead appears.
    pub(super) fn project(&self, at: Point) -> Pixel {
        let scale = self.focal / at.z.max(NEAR);
        (
            self.center_x + at.x * scale,
            self.horizon - (at.y - self.height) * scale,
        )
    }

    /// Pixels a metre takes at distance `z`.
    pub(super) fn scale(&self, z: f32) -> f32 {
        self.focal / z.max(NEAR)
    }

    /// The eye.
    pub(super) fn eye(&self) -> Point {
        point(0.0, self.height, 0.0)
    }

    /// Projects a convex polygon, cut at the near plane, into `pixels`. Fewer than three points: nothing
    /// of it lies ahead.
    pub(super) fn project_polygon(&self, corners: &[Point], pixels: &mut Vec<Pixel>) {
        pixels.clear();
        for (index, &from) in corners.iter().enumerate() {
            let to = corners[(index + 1) % corners.len()];
            if from.z >= NEAR {
                pixels.push(self.project(from));
            }
            if (from.z >= NEAR) != (to.z >= NEAR) {
                let share = (NEAR - from.z) / (to.z - from.z);
                pixels.push(self.project(from.lerp(to, share)));
            }
        }
        if pixels.len() < 3 {
            pixels.clear();
        }
    }
}

/// `a` at share 0, `b` at share 1.
pub(super) fn mix_color(a: Color, b: Color, share: f32) -> Color {
    let share = share.clamp(0.0, 1.0);
    [
        a[0] + (b[0] - a[0]) * share,
        a[1] + (b[1] - a[1]) * share,
        a[2] + (b[2] - a[2]) * share,
    ]
}

/// Every channel times `factor`.
pub(super) fn scale_color(color: Color, factor: f32) -> Color {
    [color[0] * factor, color[1] * factor, color[2] * factor]
}

/// 0 before `from`, 1 after `to`, smooth between.
pub(super) fn smooth_step(from: f32, to: f32, at: f32) -> f32 {
    let share = ((at - from) / (to - from)).clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}
