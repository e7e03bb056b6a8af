//! How a camera is mounted: how its pictures are turned and cropped, and which parts of them nobody sees.

use super::orientation::{Orientation, Part};
use super::{EncodedPicture, Picture};
use albireo_core::geometry::{BoundingBox, Corners, PictureSize};
use serde::{Deserialize, Deserializer, Serialize};
use std::ops::Range;
use std::sync::Arc;

/// The grey of what is masked, that of a letterbox: networks have learnt that nothing is there.
const MASKED: u8 = 114;
/// A box is looked at in so many places across and down.
const PLACES: u32 = 16;
/// So many find a strip that a mask leaves free, if it is wider than 0.4 % of the picture.
const PLACES_OF_PICTURE: u32 = 256;
/// The smallest width and height of what a crop leaves, shares of the picture.
const LEAST_PART: f64 = 0.01;

/// How a picture is mirrored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Flip {
    /// Left becomes right.
    Horizontal,
    /// Top becomes bottom.
    Vertical,
}

/// The parts of a picture that nobody sees: polygons of points, each across and down, shares of the picture.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Mask(pub Vec<Vec<[f64; 2]>>);

impl<'de> Deserialize<'de> for Mask {
    /// A single polygon needs no list around it.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(
            untagged,
            expecting = "must be a list of polygons, each a list of points from 0 to 1, such as \
                         [[[0.0, 0.9], [1.0, 0.9], [1.0, 1.0], [0.0, 1.0]]]"
        )]
        enum WrittenPolygons {
            Several(Vec<Vec<[f64; 2]>>),
            One(Vec<[f64; 2]>),
        }
        Ok(match WrittenPolygons::deserialize(deserializer)? {
            WrittenPolygons::Several(polygons) => Self(polygons),
            WrittenPolygons::One(polygon) => Self(vec![polygon]),
        })
    }
}

/// How a camera is mounted. Its pictures are turned, mirrored, cropped and masked, in this order; each step is in the
/// picture that the one before has left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mount {
    /// Degrees clockwise: 0, 90, 180 or 270.
    pub rotate: i64,
    /// How it is mirrored.
    pub flip: Option<Flip>,
    /// Left, top, right and bottom of the part that is kept, shares of the turned picture.
    pub crop: Option<[f64; 4]>,
    /// What is painted grey in the part that is kept, and in which nothing is reported.
    pub mask: Mask,
}

/// The mount of the camera that sent a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Mounted {
    mount: Arc<Mount>,
    /// The picture's size as it was sent.
    sent: PictureSize,
}

impl EncodedPicture {
    /// The picture as its camera is mounted. From now on its size is the one after turning and cropping, and whoever
    /// decodes it gets it turned, cropped and masked.
    #[must_use]
    pub fn mounted(self, mount: Option<&Arc<Mount>>) -> Self {
        let Some(mount) = mount else { return self };
        let turned = mount.turn().turned(self.size);
        let kept = mount.part(turned);
        Self {
            size: kept.size,
            mount: Some(Mounted {
                mount: Arc::clone(mount),
                sent: self.size,
            }),
            ..self
        }
    }

    /// True if its camera's mask hides that box.
    pub fn hides(&self, bounding_box: BoundingBox) -> bool {
        self.mount.as_ref().is_some_and(|mounted| mounted.mount.hides(bounding_box))
    }

    /// The size as it was sent.
    pub(super) fn sent_size(&self) -> PictureSize {
        self.mount.as_ref().map_or(self.size, |mounted| mounted.sent)
    }

    pub(super) fn mount(&self) -> Option<&Mount> {
        self.mount.as_ref().map(|mounted| &*mounted.mount)
    }
}

impl Mount {
    /// True if pictures stay as they are sent.
    pub fn is_plain(&self) -> bool {
        *self == Self::default()
    }

    /// What is wrong: the keys, each with its fault.
    pub fn problems(&self) -> Vec<(&'static str, String)> {
        let mut problems = Vec::new();
        if ![0, 90, 180, 270].contains(&self.rotate) {
            let reason = format!(
                "must be 0, 90, 180 or 270, degrees clockwise, not {}",
                self.rotate
            );
            problems.push(("rotate", reason));
        }
        if let Some(reason) = self.crop.and_then(fault_of_crop) {
            problems.push(("crop", reason));
        }
        for (place, polygon) in self.mask.0.iter().enumerate() {
            if let Some(fault) = fault_of_polygon(polygon) {
                problems.push(("mask", format!("polygon {} {fault}", place + 1)));
            }
        }
        let all = BoundingBox::new(0.5, 0.5, 1.0, 1.0);
        let places = PLACES_OF_PICTURE;
        if problems.is_empty() && self.hidden_places(all, places) == places * places {
            let reason = "covers the whole picture, so nothing would ever be reported";
            problems.push(("mask", reason.to_owned()));
        }
        problems
    }

    /// True if the mask hides the box: if more than half of what the picture shows of it lies in the mask.
    pub fn hides(&self, bounding_box: BoundingBox) -> bool {
        let half = PLACES * PLACES / 2;
        !self.mask.0.is_empty() && self.hidden_places(bounding_box, PLACES) > half
    }

    /// In how many of `places` x `places` places, spread evenly over the box, the mask lies.
    fn hidden_places(&self, bounding_box: BoundingBox, places: u32) -> u32 {
        let Corners { x1, y1, x2, y2 } = bounding_box.corners().clipped();
        let place = |from: f64, to: f64, number: u32| {
            from + (to - from) * (f64::from(number) + 0.5) / f64::from(places)
        };
        let mut hidden = 0;
        for row in 0..places {
            let y = place(y1, y2, row);
            for column in 0..places {
                let x = place(x1, x2, column);
                if self.mask.0.iter().any(|polygon| contains(polygon, x, y)) {
                    hidden += 1;
                }
            }
        }
        hidden
    }

    /// How pictures are turned and mirrored.
    pub(super) fn turn(&self) -> Orientation {
        let turned = Orientation::clockwise(self.rotate);
        match self.flip {
            Some(flip) => turned.then(Orientation::mirrored(flip)),
            None => turned,
        }
    }

    /// The part that is kept of a turned picture of `size`: whole pixels, and at least one.
    pub(super) fn part(&self, size: PictureSize) -> Part {
        let [left, top, right, bottom] = self.crop.unwrap_or([0.0, 0.0, 1.0, 1.0]);
        let columns = pixels_between(left, right, size.width);
        let rows = pixels_between(top, bottom, size.height);
        Part {
            left: columns.start,
            top: rows.start,
            size: PictureSize::new(columns.end - columns.start, rows.end - rows.start),
        }
    }

    /// The size at which a turned picture must be decoded so that what is kept of it is at least `part`.
    pub(super) fn whole(&self, part: PictureSize) -> PictureSize {
        let [left, top, right, bottom] = self.crop.unwrap_or([0.0, 0.0, 1.0, 1.0]);
        let side = |kept: u32, share: f64| (f64::from(kept) / share).ceil() as u32;
        PictureSize::new(
            side(part.width, right - left),
            side(part.height, bottom - top),
        )
    }

    /// Paints the mask into a picture that is turned and cropped. A row is masked where its middle lies in a polygon, outwards
    /// to whole pixels.
    pub(super) fn paint(&self, picture: &mut Picture) {
        let width = picture.size.width as usize;
        let height = picture.size.height as usize;
        let columns = width as f64;
        let channels = picture.layout.channels();
        let mut crossings = Vec::new();
        let rows = picture.pixels.chunks_exact_mut((width * channels).max(1));
        for (row, pixels) in rows.enumerate() {
            let y = (row as f64 + 0.5) / height as f64;
            for polygon in &self.mask.0 {
                crossings.clear();
                crossings.extend(crossed(polygon, y));
                crossings.sort_by(f64::total_cmp);
                // What lies between two crossings is inside.
                let (inside, _) = crossings.as_chunks::<2>();
                for [enters, leaves] in inside {
                    let from = (enters * columns).floor().clamp(0.0, columns) as usize;
                    let to = (leaves * columns).ceil().clamp(0.0, columns) as usize;
                    pixels[from * channels..to * channels].fill(MASKED);
                }
            }
        }
    }
}

/// The pixels of a side of `length` between two shares of it, at least one if it has any.
fn pixels_between(from: f64, to: f64, length: u32) -> Range<u32> {
    if length == 0 {
        return 0..0;
    }
    let pixel = |share: f64| (share * f64::from(length)).round() as u32;
    let start = pixel(from).min(length - 1);
    let end = pixel(to).clamp(start + 1, length);
    start..end
}

/// Where the edges of a polygon cross the height `y`, an even number of times.
fn crossed(polygon: &[[f64; 2]], y: f64) -> impl Iterator<Item = f64> {
    let ends = polygon.iter().cycle().skip(1);
    let edges = polygon.iter().zip(ends);
    // An end on the height itself belongs to one of its two edges only.
    let crossing = edges.filter(move |([_, y1], [_, y2])| (*y1 <= y) != (*y2 <= y));
    crossing.map(move |([x1, y1], [x2, y2])| x1 + (y - y1) / (y2 - y1) * (x2 - x1))
}

fn contains(polygon: &[[f64; 2]], x: f64, y: f64) -> bool {
    crossed(polygon, y).filter(|crossing| *crossing <= x).count() % 2 == 1
}

fn is_share(share: f64) -> bool {
    (0.0..=1.0).contains(&share)
}

fn fault_of_crop(crop: [f64; 4]) -> Option<String> {
    let [left, top, right, bottom] = crop;
    if !crop.into_iter().all(is_share) {
        return Some(format!(
            "must be left, top, right and bottom as shares of the turned picture, from 0 to 1, not {crop:?}"
        ));
    }
    for (first, begin, second, end) in [
        ("left", left, "right", right),
        ("top", top, "bottom", bottom),
    ] {
        // 0.35 - 0.34 is a little less than 0.01.
        if end - begin < LEAST_PART - 1e-9 {
            return Some(format!(
                "leaves nothing: {first} is {begin} and {second} {end}; the order is left, top, right, bottom"
            ));
        }
    }
    None
}

fn fault_of_polygon(polygon: &[[f64; 2]]) -> Option<String> {
    if let Some(point) = polygon.iter().find(|point| !point.iter().copied().all(is_share)) {
        return Some(format!(
            "has the point {point:?}: points are shares of the picture, across and down, from 0 to 1, and [0.5, 0.5] is \
             its middle"
        ));
    }
    if polygon.len() < 3 {
        return Some(format!("has {} points: an area needs three", polygon.len()));
    }
    if are_on_one_line(polygon) {
        return Some("has no area: its points lie on one line".to_owned());
    }
    None
}

fn are_on_one_line(polygon: &[[f64; 2]]) -> bool {
    let first = polygon[0];
    let from_first: Vec<[f64; 2]> =
        polygon.iter().map(|point| [point[0] - first[0], point[1] - first[1]]).collect();
    for [x1, y1] in &from_first {
        for [x2, y2] in &from_first {
            // Twice the area of the triangle between the first point and these two.
            if (x1 * y2 - y1 * x2).abs() > 1e-9 {
                return false;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests;
