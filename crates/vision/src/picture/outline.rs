//! Draws boxes into a picture.

use super::format::Picture;

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineStyle {
    /// Without gaps.
    Solid,
    /// With gaps.
    Dashed,
}

/// Draws the outline of a box, `[x1, y1, x2, y2]` in pixels, into an RGB picture; parts outside the picture are cut off.
/// It is two pixels wide in a picture of 640 columns.
pub fn outline(picture: &mut Picture, corners: [f64; 4], colour: [u8; 3], style: LineStyle) {
    let width = i64::from(picture.size.width);
    let height = i64::from(picture.size.height);
    let thick = (width / 320).max(1);
    let dash = 4 * thick;
    let [x1, y1, x2, y2] = corners.map(|place| place.round() as i64);
    for y in y1.max(0)..y2.min(height) {
        let is_on_row = y - y1 < thick || y2 - y <= thick;
        for x in x1.max(0)..x2.min(width) {
            let is_on_line = is_on_row || x - x1 < thick || x2 - x <= thick;
            let is_gap = style == LineStyle::Dashed && ((x - x1) + (y - y1)) / dash % 2 == 1;
            if is_on_line && !is_gap {
                let at = 3 * (y * width + x) as usize;
                picture.pixels[at..at + 3].copy_from_slice(&colour);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_core::geometry::PictureSize;

    #[test]
    fn a_box_is_outlined_and_cut_off_at_the_border_of_the_picture() {
        let mut picture = Picture::black(PictureSize::new(8, 6));
        outline(
            &mut picture,
            [2.0, 1.0, 20.0, 5.0],
            [9, 9, 9],
            LineStyle::Solid,
        );
        let lit = |x: usize, y: usize| picture.pixels[3 * (8 * y + x)] == 9;
        for (x, y) in [(2, 1), (7, 1), (2, 4), (7, 4)] {
            assert!(lit(x, y), "column {x}, row {y}");
        }
        for (x, y) in [(3, 2), (7, 2), (1, 1), (2, 5)] {
            assert!(!lit(x, y), "column {x}, row {y}");
        }
    }

    #[test]
    fn a_dashed_outline_has_gaps() {
        let mut picture = Picture::black(PictureSize::new(64, 8));
        outline(
            &mut picture,
            [0.0, 0.0, 64.0, 8.0],
            [9, 9, 9],
            LineStyle::Dashed,
        );
        let lit = (0..64).filter(|x| picture.pixels[3 * x] == 9).count();
        assert_eq!(lit, 32);
    }
}
