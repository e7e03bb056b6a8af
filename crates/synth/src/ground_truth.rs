//! Where the objects of a frame really are: exact boxes from the object plane of the canvas.

use super::canvas::Canvas;
use super::render::Drawn;
use albireo_core::detection::ClassId;
use albireo_core::geometry::{BoundingBox, Corners, PictureSize};

/// One object of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundTruthBox {
    /// Identity; the same object keeps it for the whole clip, and no other clip uses it.
    pub object: u64,
    /// Its class, a number in [`albireo_core::detection::BDD100K_CLASSES`].
    pub class: ClassId,
    /// Bounds of the part that can be seen, pixels, within the picture.
    pub corners: Corners,
    /// Share of the object's silhouette inside the picture that something nearer hides, 0 to 1.
    pub occlusion: f64,
    /// Share of the object's bounds that lies outside the picture, 0 to 1.
    pub truncation: f64,
    /// Whether a detector need not find it: lower than 12 pixels at 720 rows, narrower than 4, more than
    /// 80 % hidden, or more than 80 % outside. Finding it is no mistake either.
    pub ignore: bool,
}

impl GroundTruthBox {
    /// The box in normalised centre form for a picture of `size`.
    pub fn bounding_box(&self, size: PictureSize) -> BoundingBox {
        self.corners.normalise(size)
    }
}

/// Reads the boxes of the objects `drawn`; objects of which nothing is seen are left out. `offset` is
/// added to each identity.
pub(super) fn boxes(canvas: &Canvas, drawn: &[Drawn], offset: u64) -> Vec<GroundTruthBox> {
    let size = canvas.size();
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let unit = height / 720.0;
    let mut found = Vec::with_capacity(drawn.len());
    for object in drawn {
        let Some(silhouette) = canvas.silhouette(object.number) else {
            continue;
        };
        let whole = silhouette.whole;
        let inside = Corners {
            x1: whole.x1.clamp(0.0, width),
            y1: whole.y1.clamp(0.0, height),
            x2: whole.x2.clamp(0.0, width),
            y2: whole.y2.clamp(0.0, height),
        };
        let (pixels, seen) = canvas.visible(object.number, inside);
        if pixels == 0 || silhouette.pixels == 0 {
            continue;
        }
        // Where nothing hides an edge the polygon's own edge is finer than whole pixels.
        let edge = |fine: f64, coarse: f64| {
            if (fine - coarse).abs() <= 1.5 {
                fine
            } else {
                coarse
            }
        };
        let corners = Corners {
            x1: edge(inside.x1, seen.x1),
            y1: edge(inside.y1, seen.y1),
            x2: edge(inside.x2, seen.x2),
            y2: edge(inside.y2, seen.y2),
        };
        let occlusion = 1.0 - f64::from(pixels) / f64::from(silhouette.pixels);
        let truncation = 1.0 - inside.area() / whole.area().max(1e-9);
        let ignore = corners.y2 - corners.y1 < 12.0 * unit
            || corners.x2 - corners.x1 < 4.0 * unit
            || occlusion > 0.8
            || truncation > 0.8;
        found.push(GroundTruthBox {
            object: object.object + offset,
            class: object.class,
            corners,
            occlusion,
            truncation,
            ignore,
        });
    }
    found
}
