//! The picture under construction: polygons drawn by tiny-skia, and beside it a plane that records
//! which object each pixel shows.

use super::space::{Color, Pixel, mix_color};
use albireo_core::geometry::{Corners, PictureSize};
use tiny_skia::{
    BlendMode, FillRule, GradientStop, Paint, PathBuilder, Pixmap, Point, RadialGradient, Shader,
    SpreadMode, Transform,
};

/// Shapes no wider or no higher than this, pixels, are not drawn by tiny-skia (its `SCALAR_NEARLY_ZERO`).
const FLAT: f32 = 1.0 / 4096.0;

/// What is known of one object after the picture is complete.
#[derive(Clone, Copy, Debug)]
pub(super) struct Silhouette {
    /// Bounds of everything drawn for it, pixels, not clipped.
    pub whole: Corners,
    /// Pixels inside the picture it would show if nothing stood before it.
    pub pixels: u32,
}

/// The picture and its object plane.
pub(super) struct Canvas {
    pixmap: Pixmap,
    size: PictureSize,
    objects: Vec<u16>,
    current: Option<usize>,
    silhouettes: Vec<Silhouette>,
    builder: Option<PathBuilder>,
}

fn channel(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// A tiny-skia colour from ours.
pub(super) fn skia(color: Color, alpha: f32) -> tiny_skia::Color {
    tiny_skia::Color::from_rgba8(
        channel(color[0]),
        channel(color[1]),
        channel(color[2]),
        channel(alpha),
    )
}

impl Canvas {
    /// A black picture; none when a side is zero or the size is beyond what tiny-skia can hold.
    pub(super) fn new(size: PictureSize) -> Option<Self> {
        let pixmap = Pixmap::new(size.width, size.height)?;
        let objects = vec![0; pixmap.pixels().len()];
        Some(Self {
            pixmap,
            size,
            objects,
            current: None,
            silhouettes: Vec::new(),
            builder: Some(PathBuilder::new()),
        })
    }

    /// Forgets the objects of the last picture. The pixels stay until they are drawn over.
    pub(super) fn begin(&mut self) {
        self.objects.fill(0);
        self.silhouettes.clear();
        self.current = None;
    }

    /// What is drawn from here on belongs to a new object, whose number is returned (1, 2, …).
    pub(super) fn begin_object(&mut self) -> u16 {
        self.silhouettes.push(Silhouette {
            whole: Corners {
                x1: f64::MAX,
                y1: f64::MAX,
                x2: f64::MIN,
                y2: f64::MIN,
            },
            pixels: 0,
        });
        self.current = Some(self.silhouettes.len() - 1);
        self.silhouettes.len() as u16
    }

    /// What is drawn from here on belongs to no object.
    pub(super) fn end_object(&mut self) {
        self.current = None;
    }

    /// The pixels, RGBA.
    pub(super) fn pixels(&mut self) -> &mut [u8] {
        self.pixmap.data_mut()
    }

    /// The picture's size.
    pub(super) fn size(&self) -> PictureSize {
        self.size
    }

    /// Fills whole rows with one colour each.
    pub(super) fn rows(&mut self, from: u32, to: u32, color: impl Fn(u32) -> Color) {
        let width = self.size.width as usize;
        let rows = self.pixmap.pixels_mut();
        for row in from..to.min(self.size.height) {
            let color = skia(color(row), 1.0).premultiply().to_color_u8();
            let start = row as usize * width;
            rows[start..start + width].fill(color);
        }
    }

    fn outside(&self, pixels: &[Pixel]) -> bool {
        let (width, height) = (self.size.width as f32, self.size.height as f32);
        pixels.iter().all(|p| p.0 < 0.0)
            || pixels.iter().all(|p| p.0 > width)
            || pixels.iter().all(|p| p.1 < 0.0)
            || pixels.iter().all(|p| p.1 > height)
    }

    /// Draws convex polygons of one colour; they hide what lies behind them.
    pub(super) fn solid<'a>(
        &mut self,
        polygons: impl IntoIterator<Item = &'a [Pixel]>,
        color: Color,
    ) {
        let mut builder = self.builder.take().unwrap_or_default();
        for polygon in polygons {
            if polygon.len() < 3 {
                continue;
            }
            self.mark(polygon);
            if !self.outside(polygon) {
                push(&mut builder, polygon);
            }
        }
        self.fill(builder, &paint(Shader::SolidColor(skia(color, 1.0))));
    }

    /// Draws one polygon that hides nothing: ground, shadows, glass reflections.
    pub(super) fn overlay(&mut self, polygon: &[Pixel], color: Color, alpha: f32) {
        self.overlays([polygon], color, alpha);
    }

    /// Draws polygons of one colour that hide nothing.
    pub(super) fn overlays<'a>(
        &mut self,
        polygons: impl IntoIterator<Item = &'a [Pixel]>,
        color: Color,
        alpha: f32,
    ) {
        let mut builder = self.builder.take().unwrap_or_default();
        for polygon in polygons {
            if polygon.len() >= 3 && !self.outside(polygon) {
                push(&mut builder, polygon);
            }
        }
        self.fill(builder, &paint(Shader::SolidColor(skia(color, alpha))));
    }

    /// Draws one polygon, coloured from row to row by `stops` of (row, colour). It is cut into bands of
    /// whole rows with one colour each: several times faster than a gradient, and the steps stay below
    /// what eight bits a channel can show.
    pub(super) fn graded(&mut self, polygon: &[Pixel], stops: &[(f32, Color)]) {
        let (Some(first), Some(last)) = (stops.first(), stops.last()) else {
            return;
        };
        if polygon.len() < 3 || self.outside(polygon) {
            return;
        }
        let rows = polygon
            .iter()
            .fold((f32::MAX, f32::MIN), |b, p| (b.0.min(p.1), b.1.max(p.1)));
        let bottom = rows.1.min(self.size.height as f32).ceil();
        let mut top = rows.0.max(0.0).floor();
        let (mut above, mut band) = (Vec::new(), Vec::new());
        while top < bottom {
            let at = top.clamp(first.0, last.0);
            let next = stops.windows(2).find(|pair| at < pair[1].0);
            let (color, height) = match next {
                Some(pair) => {
                    let span = (pair[1].0 - pair[0].0).max(0.01);
                    let step = (0..3)
                        .map(|c| (pair[1].1[c] - pair[0].1[c]).abs())
                        .fold(0.0, f32::max);
                    let height = (span * 0.008 / step.max(1e-4)).ceil().clamp(1.0, 48.0);
                    let share = (at + height * 0.5 - pair[0].0) / span;
                    (mix_color(pair[0].1, pair[1].1, share), height)
                }
                None => (last.1, bottom - top),
            };
            cut(polygon, top, false, &mut above);
            cut(&above, top + height, true, &mut band);
            self.overlay(&band, color, 1.0);
            top += height;
        }
    }

    /// Adds light: a soft ellipse around `center`, strongest there.
    pub(super) fn glow(&mut self, center: Pixel, radii: (f32, f32), color: Color, strength: f32) {
        let (radius, squash) = (radii.0, radii.1 / radii.0.max(0.01));
        let corners = [
            (center.0 - radii.0, center.1 - radii.1),
            (center.0 + radii.0, center.1 - radii.1),
            (center.0 + radii.0, center.1 + radii.1),
            (center.0 - radii.0, center.1 + radii.1),
        ];
        if radius < 0.5 || radii.1 < 0.5 || strength <= 0.004 || self.outside(&corners) {
            return;
        }
        let gradient = RadialGradient::new(
            Point::from_xy(0.0, 0.0),
            0.0,
            Point::from_xy(0.0, 0.0),
            radius,
            vec![
                GradientStop::new(0.0, skia(color, strength)),
                GradientStop::new(0.35, skia(color, strength * 0.4)),
                GradientStop::new(1.0, skia(color, 0.0)),
            ],
            SpreadMode::Pad,
            Transform::from_row(1.0, 0.0, 0.0, squash, center.0, center.1),
        );
        let Some(shader) = gradient else { return };
        let mut paint = paint(shader);
        paint.blend_mode = BlendMode::Plus;
        paint.anti_alias = false;
        let mut builder = self.builder.take().unwrap_or_default();
        push(&mut builder, &corners);
        self.fill(builder, &paint);
    }

    fn fill(&mut self, builder: PathBuilder, paint: &Paint) {
        let Some(path) = builder.finish() else {
            self.builder = Some(PathBuilder::new());
            return;
        };
        // A shape so flat has no inside; tiny-skia would leave it out too, with a warning.
        let bounds = path.bounds();
        if bounds.width().min(bounds.height()) <= FLAT {
            self.builder = Some(path.clear());
            return;
        }
        self.pixmap
            .fill_path(&path, paint, FillRule::Winding, Transform::identity(), None);
        self.builder = Some(path.clear());
    }

    /// Writes a polygon into the object plane: a pixel is its own when its centre is inside.
    fn mark(&mut self, polygon: &[Pixel]) {
        let number = self.current.map_or(0, |index| index as u16 + 1);
        if number == 0 && self.silhouettes.is_empty() {
            return;
        }
        let width = self.size.width as f32;
        let mut bounds = (f32::MAX, f32::MIN);
        for pixel in polygon {
            bounds = (bounds.0.min(pixel.1), bounds.1.max(pixel.1));
        }
        if let Some(silhouette) = self.current.and_then(|i| self.silhouettes.get_mut(i)) {
            let whole = &mut silhouette.whole;
            for pixel in polygon {
                whole.x1 = whole.x1.min(f64::from(pixel.0));
                whole.y1 = whole.y1.min(f64::from(pixel.1));
                whole.x2 = whole.x2.max(f64::from(pixel.0));
                whole.y2 = whole.y2.max(f64::from(pixel.1));
            }
        }
        let first = (bounds.0 - 0.5).ceil().max(0.0) as usize;
        let last = (bounds.1 + 0.5).floor().clamp(0.0, self.size.height as f32) as usize;
        let mut fresh = 0;
        for row in first..last {
            let y = row as f32 + 0.5;
            let (mut left, mut right) = (f32::MAX, f32::MIN);
            let mut from = polygon[polygon.len() - 1];
            for &to in polygon {
                if (from.1 <= y) != (to.1 <= y) {
                    let x = from.0 + (to.0 - from.0) * (y - from.1) / (to.1 - from.1);
                    left = left.min(x);
                    right = right.max(x);
                }
                from = to;
            }
            let start = (left - 0.5).ceil().clamp(0.0, width) as usize;
            let end = (right + 0.5).floor().clamp(0.0, width) as usize;
            if start >= end {
                continue;
            }
            let offset = row * self.size.width as usize;
            let span = &mut self.objects[offset + start..offset + end];
            if number == 0 {
                span.fill(0);
            } else {
                for pixel in span {
                    fresh += u32::from(*pixel != number);
                    *pixel = number;
                }
            }
        }
        if let Some(silhouette) = self.current.and_then(|i| self.silhouettes.get_mut(i)) {
            silhouette.pixels += fresh;
        }
    }

    /// What was drawn for object `number`.
    pub(super) fn silhouette(&self, number: u16) -> Option<Silhouette> {
        self.silhouettes
            .get(usize::from(number).checked_sub(1)?)
            .copied()
    }

    /// How many pixels object `number` still shows inside `within`, and their bounds.
    pub(super) fn visible(&self, number: u16, within: Corners) -> (u32, Corners) {
        let (width, height) = (self.size.width as usize, self.size.height as usize);
        let columns = (within.x1.floor().max(0.0) as usize).min(width)
            ..(within.x2.ceil().max(0.0) as usize).min(width);
        let rows = (within.y1.floor().max(0.0) as usize).min(height)
            ..(within.y2.ceil().max(0.0) as usize).min(height);
        let mut count = 0;
        let (mut left, mut right, mut top, mut bottom) = (usize::MAX, 0, usize::MAX, 0);
        for row in rows {
            let line = &self.objects
                [row * width + columns.start..row * width + columns.end.max(columns.start)];
            let here = line.iter().filter(|&&pixel| pixel == number).count() as u32;
            if here == 0 {
                continue;
            }
            count += here;
            top = top.min(row);
            bottom = row + 1;
            if let Some(first) = line.iter().position(|&pixel| pixel == number) {
                left = left.min(columns.start + first);
            }
            if let Some(last) = line.iter().rposition(|&pixel| pixel == number) {
                right = right.max(columns.start + last + 1);
            }
        }
        if count == 0 {
            return (0, Corners::default());
        }
        let bounds = Corners {
            x1: left as f64,
            y1: top as f64,
            x2: right as f64,
            y2: bottom as f64,
        };
        (count, bounds)
    }
}

fn paint(shader: Shader<'static>) -> Paint<'static> {
    Paint {
        shader,
        ..Paint::default()
    }
}

/// Adds a polygon to a path, always turning the same way, so that polygons of one path never cancel
/// each other.
fn push(builder: &mut PathBuilder, polygon: &[Pixel]) {
    let mut doubled_area = 0.0;
    let mut from = polygon[polygon.len() - 1];
    for &to in polygon {
        doubled_area += from.0 * to.1 - to.0 * from.1;
        from = to;
    }
    let at = |index: usize| {
        let index = if doubled_area < 0.0 {
            polygon.len() - 1 - index
        } else {
            index
        };
        polygon[index]
    };
    builder.move_to(at(0).0, at(0).1);
    for index in 1..polygon.len() {
        builder.line_to(at(index).0, at(index).1);
    }
    builder.close();
}

/// Keeps what of `polygon` lies above (`upper`) or below `row`.
fn cut(polygon: &[Pixel], row: f32, upper: bool, kept: &mut Vec<Pixel>) {
    kept.clear();
    let inside = |pixel: &Pixel| {
        if upper {
            pixel.1 <= row
        } else {
            pixel.1 >= row
        }
    };
    for (index, from) in polygon.iter().enumerate() {
        let to = &polygon[(index + 1) % polygon.len()];
        if inside(from) {
            kept.push(*from);
        }
        if inside(from) != inside(to) {
            let share = (row - from.1) / (to.1 - from.1);
            kept.push((from.0 + (to.0 - from.0) * share, row));
        }
    }
}
