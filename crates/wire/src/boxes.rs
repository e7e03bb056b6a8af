//! Converts boxes of a policy to those of messages.

use crate::BoxMessage;
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::OutputBox;

/// Returns the boxes of a picture of `size` for the wire, with the `names` of their classes: corners to a hundredth of a
/// pixel, confidence to four digits. Boxes are clipped to the picture; those entirely outside are left out.
pub fn box_messages(boxes: &[OutputBox], size: PictureSize, names: &[String]) -> Vec<BoxMessage> {
    let message = |output: &OutputBox| {
        let class = usize::from(output.class.0);
        Some(BoxMessage {
            corners: clipped_corners(output.bounding_box, size)?,
            class: names.get(class).cloned().unwrap_or_else(|| format!("class-{class}")),
            confidence: ((output.confidence * 1e4).round() / 1e4) as f32,
            source: output.source,
            object: output.object,
            confirmed: output.confirmed,
        })
    };
    boxes.iter().filter_map(message).collect()
}

/// Left, top, right and bottom in pixels, to a hundredth of a pixel; `None` if the box is entirely outside
/// the picture.
fn clipped_corners(bounding_box: BoundingBox, size: PictureSize) -> Option<[f32; 4]> {
    let width = f64::from(size.width);
    let height = f64::from(size.height);
    let corners = bounding_box.pixel_corners(size);
    let x1 = corners.x1.clamp(0.0, width);
    let x2 = corners.x2.clamp(0.0, width);
    let y1 = corners.y1.clamp(0.0, height);
    let y2 = corners.y2.clamp(0.0, height);
    // NaN fails the comparison and is also left out.
    let is_visible = x2 > x1 && y2 > y1;
    if !is_visible {
        return None;
    }
    Some([x1, y1, x2, y2].map(|edge| ((edge * 100.0).round() / 100.0) as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_clipped_to_the_picture_and_one_outside_is_dropped() {
        let size = PictureSize::new(200, 100);
        let edge = BoundingBox::new(0.0, 0.5, 0.2, 0.2);
        assert_eq!(clipped_corners(edge, size), Some([0.0, 40.0, 20.0, 60.0]));
        let outside = BoundingBox::new(-0.2, 0.5, 0.2, 0.2);
        assert_eq!(clipped_corners(outside, size), None);
        let broken = BoundingBox::new(f64::NAN, 0.5, 0.2, 0.2);
        assert_eq!(clipped_corners(broken, size), None);
    }
}
