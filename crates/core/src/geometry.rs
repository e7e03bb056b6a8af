//! Boxes in normalised centre form and in pixel corners, picture sizes, and intersection over union.

use serde::{Deserialize, Serialize};

/// Size of a picture in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PictureSize {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
}

impl PictureSize {
    /// Creates a size of `width` columns and `height` rows.
    pub const fn new(width: u32, height: u32) -> Self {
        Self { width, height }
    }

    /// Number of pixels; cannot overflow.
    pub const fn pixels(self) -> u64 {
        self.width as u64 * self.height as u64
    }
}

impl std::fmt::Display for PictureSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// A box in normalised centre form: `center_x` and `width` divided by the picture's width, `center_y` and `height`
/// divided by its height (paper, section on the state vector). In JSON, a list of these four numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "[f64; 4]", into = "[f64; 4]")]
pub struct BoundingBox {
    /// Horizontal centre, 0 at the left edge and 1 at the right.
    pub center_x: f64,
    /// Vertical centre, 0 at the top edge and 1 at the bottom.
    pub center_y: f64,
    /// Width as a share of the picture's width.
    pub width: f64,
    /// Height as a share of the picture's height.
    pub height: f64,
}

impl From<[f64; 4]> for BoundingBox {
    fn from([center_x, center_y, width, height]: [f64; 4]) -> Self {
        Self::new(center_x, center_y, width, height)
    }
}

impl From<BoundingBox> for [f64; 4] {
    fn from(own: BoundingBox) -> Self {
        [own.center_x, own.center_y, own.width, own.height]
    }
}

/// A box as the coordinates of its top-left and bottom-right corners, in pixels unless stated otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Corners {
    /// Left edge.
    pub x1: f64,
    /// Top edge.
    pub y1: f64,
    /// Right edge.
    pub x2: f64,
    /// Bottom edge.
    pub y2: f64,
}

impl BoundingBox {
    /// Creates a box from its centre and sides, all normalised.
    pub const fn new(center_x: f64, center_y: f64, width: f64, height: f64) -> Self {
        Self {
            center_x,
            center_y,
            width,
            height,
        }
    }

    /// Returns the corners in normalised coordinates.
    #[inline]
    pub fn corners(self) -> Corners {
        Corners {
            x1: self.center_x - self.width / 2.0,
            y1: self.center_y - self.height / 2.0,
            x2: self.center_x + self.width / 2.0,
            y2: self.center_y + self.height / 2.0,
        }
    }

    /// Returns the corners in pixels of a picture of `size`, neither rounded nor clipped.
    pub fn pixel_corners(self, size: PictureSize) -> Corners {
        let (width, height) = (f64::from(size.width), f64::from(size.height));
        let corners = self.corners();
        Corners {
            x1: corners.x1 * width,
            y1: corners.y1 * height,
            x2: corners.x2 * width,
            y2: corners.y2 * height,
        }
    }

    /// Returns the intersection over union with `other`. Normalising scales both areas alike, so this equals the value
    /// for pixel boxes. Zero if the boxes do not overlap or both are empty.
    pub fn intersection_over_union(self, other: Self) -> f64 {
        self.corners().intersection_over_union(other.corners())
    }

    /// True if all four numbers are finite.
    pub fn is_finite(self) -> bool {
        self.center_x.is_finite()
            && self.center_y.is_finite()
            && self.width.is_finite()
            && self.height.is_finite()
    }
}

impl Corners {
    /// Returns the normalised centre form of these pixel corners in a picture of `size`.
    pub fn normalise(self, size: PictureSize) -> BoundingBox {
        let (width, height) = (f64::from(size.width), f64::from(size.height));
        BoundingBox {
            center_x: (self.x1 + self.x2) / 2.0 / width,
            center_y: (self.y1 + self.y2) / 2.0 / height,
            width: (self.x2 - self.x1) / width,
            height: (self.y2 - self.y1) / height,
        }
    }

    /// Clips normalised corners to the picture.
    pub fn clipped(self) -> Self {
        Self {
            x1: self.x1.clamp(0.0, 1.0),
            y1: self.y1.clamp(0.0, 1.0),
            x2: self.x2.clamp(0.0, 1.0),
            y2: self.y2.clamp(0.0, 1.0),
        }
    }

    /// Returns the area; zero for an inverted box.
    #[inline]
    pub fn area(self) -> f64 {
        larger(self.x2 - self.x1, 0.0) * larger(self.y2 - self.y1, 0.0)
    }

    /// Returns an area that overlaps every box whose intersection over union with this one is at least `gate`. With I
    /// and U the areas of intersection and union, and w, h the sides: the shared part of w is at least
    /// I/h ≥ gate·U/h ≥ gate·w. So the other box begins before `x2 − gate·w` and ends after `x1 + gate·w`, and
    /// likewise along y. With a gate above one half these two change order, and the bounds still hold.
    pub(crate) fn core(self, gate: f64) -> Self {
        // Slightly less, so that rounding excludes no box.
        let share = (gate - 1e-6).max(0.0);
        let (x, y) = (share * (self.x2 - self.x1), share * (self.y2 - self.y1));
        Self {
            x1: self.x1 + x,
            y1: self.y1 + y,
            x2: self.x2 - x,
            y2: self.y2 - y,
        }
    }

    /// True if `other`, in the same coordinates, overlaps this box or touches it.
    #[inline]
    pub(crate) fn meets(self, other: Self) -> bool {
        self.x1 <= other.x2 && self.x2 >= other.x1 && self.y1 <= other.y2 && self.y2 >= other.y1
    }

    /// Returns the area shared with `other`, in the same coordinates.
    #[inline]
    pub fn shared_area(self, other: Self) -> f64 {
        let shared = Self {
            x1: larger(self.x1, other.x1),
            y1: larger(self.y1, other.y1),
            x2: smaller(self.x2, other.x2),
            y2: smaller(self.y2, other.y2),
        };
        shared.area()
    }

    /// Returns the intersection over union with `other` in the same coordinates; zero if the union is empty.
    #[inline]
    pub fn intersection_over_union(self, other: Self) -> f64 {
        let overlap = self.shared_area(other);
        let union = self.area() + other.area() - overlap;
        if union > 0.0 { overlap / union } else { 0.0 }
    }
}

/// The larger of two numbers that are not NaN: one instruction, where `f64::max` takes several to see to NaN.
fn larger(one: f64, other: f64) -> f64 {
    if one > other { one } else { other }
}

/// The smaller of two numbers that are not NaN.
fn smaller(one: f64, other: f64) -> f64 {
    if one < other { one } else { other }
}
