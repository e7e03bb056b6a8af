//! What the agnostic screen sees of a picture: contrast-normalised brightness and texture of its
//! tiles.

use crate::picture::{Picture, PixelLayout};
use albireo_core::geometry::PictureSize;

/// Cells of the thumbnail, in a row and in a column.
const CELLS: [usize; 2] = [64, 36];
/// Cells of a tile, in each direction.
const TILE: usize = 4;
const TILES: [usize; 2] = [CELLS[0] / TILE, CELLS[1] / TILE];
/// Pixels looked at in a cell, in each direction, at most: a sample of a large cell is mean enough.
const SAMPLES: usize = 6;
/// Added to the picture's contrast, in grey levels, so that noise in the dark is not blown up.
const LEAST_CONTRAST: f32 = 8.0;

/// Number of features of a picture.
pub(super) const FEATURES: usize = 2 * TILES[0] * TILES[1];

/// For each tile its mean, then for each tile its standard deviation, of grey values that have mean zero
/// and about unit variance over the picture. So light that changes everywhere alike changes nothing here.
pub(super) type Features = [f32; FEATURES];

/// What the agnostic screen sees of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Thumbnail(pub(super) Box<Features>);

impl Thumbnail {
    /// Pictures that are larger are only looked at here and there.
    pub const TARGET: PictureSize =
        PictureSize::new((CELLS[0] * SAMPLES) as u32, (CELLS[1] * SAMPLES) as u32);

    /// That of `picture`; `None` for one that is too small.
    pub fn of(picture: &Picture) -> Option<Self> {
        cells(picture).map(|cells| Self(features(&cells)))
    }
}

fn features(cells: &[f32]) -> Box<Features> {
    let count = cells.len() as f32;
    let mean = cells.iter().sum::<f32>() / count;
    let variance = cells.iter().map(|cell| (cell - mean).powi(2)).sum::<f32>() / count;
    let contrast = variance.sqrt() + LEAST_CONTRAST;
    let mut features = Box::new([0.0; FEATURES]);
    let (means, deviations) = features.split_at_mut(FEATURES / 2);
    for (tile, (tile_mean, deviation)) in means.iter_mut().zip(deviations).enumerate() {
        let (row, column) = (tile / TILES[0] * TILE, tile % TILES[0] * TILE);
        let (mut sum, mut squares) = (0.0, 0.0);
        for y in row..row + TILE {
            for cell in &cells[y * CELLS[0] + column..][..TILE] {
                let value = (cell - mean) / contrast;
                sum += value;
                squares += value * value;
            }
        }
        let count = (TILE * TILE) as f32;
        *tile_mean = sum / count;
        *deviation = (squares / count - *tile_mean * *tile_mean).max(0.0).sqrt();
    }
    features
}

/// Mean grey value of each cell, row by row.
fn cells(picture: &Picture) -> Option<Vec<f32>> {
    let (width, height) = (picture.size.width as usize, picture.size.height as usize);
    let channels = picture.layout.channels();
    if width < CELLS[0] || height < CELLS[1] || picture.pixels.len() < width * height * channels {
        return None;
    }
    let mut cells = Vec::with_capacity(CELLS[0] * CELLS[1]);
    for row in 0..CELLS[1] {
        let rows = row * height / CELLS[1]..(row + 1) * height / CELLS[1];
        for column in 0..CELLS[0] {
            let columns = column * width / CELLS[0]..(column + 1) * width / CELLS[0];
            let (mut sum, mut count) = (0u32, 0u32);
            for y in rows.clone().step_by(rows.len().div_ceil(SAMPLES)) {
                for x in columns.clone().step_by(columns.len().div_ceil(SAMPLES)) {
                    let pixel = &picture.pixels[(y * width + x) * channels..][..channels];
                    sum += match picture.layout {
                        PixelLayout::Gray8 => u32::from(pixel[0]) * 3,
                        PixelLayout::Rgb8 => pixel.iter().map(|&value| u32::from(value)).sum(),
                    };
                    count += 3;
                }
            }
            cells.push(sum as f32 / count as f32);
        }
    }
    Some(cells)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::screen) fn picture(paint: impl Fn(usize, usize) -> u8) -> Picture {
        let size = PictureSize::new(128, 72);
        let pixels = (0..72).flat_map(|y| (0..128).map(move |x| (x, y)));
        Picture {
            size,
            source_size: size,
            layout: PixelLayout::Gray8,
            pixels: pixels.map(|(x, y)| paint(x, y)).collect(),
        }
    }

    #[test]
    fn light_that_changes_everywhere_alike_changes_little() {
        let scene = |x: usize, y: usize| (x + y) as u8 / 2 + 20;
        let dark = Thumbnail::of(&picture(scene)).unwrap();
        let light = Thumbnail::of(&picture(|x, y| scene(x, y) + 60)).unwrap();
        assert!(
            dark.0
                .iter()
                .zip(&*light.0)
                .all(|(a, b)| (a - b).abs() < 1e-4)
        );
    }

    #[test]
    fn a_patch_shows_in_its_own_tiles() {
        let flat = Thumbnail::of(&picture(|_, _| 100)).unwrap();
        // Columns 64 to 71 and rows 32 to 39 are the tile in column 8 and row 4.
        let patch = |x: usize, y: usize| (64..72).contains(&x) && (32..40).contains(&y);
        let patched = Thumbnail::of(&picture(|x, y| if patch(x, y) { 200 } else { 100 })).unwrap();
        let difference = |tile: usize| (flat.0[tile] - patched.0[tile]).abs();
        let most = (0..FEATURES).max_by(|&a, &b| difference(a).total_cmp(&difference(b)));
        assert_eq!(most, Some(4 * TILES[0] + 8));
    }

    #[test]
    fn a_picture_that_is_too_small_has_no_features() {
        assert!(Thumbnail::of(&Picture::default()).is_none());
    }
}
