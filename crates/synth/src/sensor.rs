//! The camera's glass and sensor: blur, smear, noise, wandering exposure.

use super::random::Random;
use albireo_core::geometry::PictureSize;

/// Noise that is drawn once and read at random offsets.
pub(super) struct Sensor {
    noise: Vec<i8>,
}

const NOISE: usize = 1 << 18;

impl Sensor {
    /// A sensor whose noise has the given deviation in grey levels.
    pub(super) fn new(deviation: f32, random: &mut Random) -> Self {
        let noise = (0..NOISE)
            .map(|_| (random.normal() * deviation).clamp(-100.0, 100.0) as i8)
            .collect();
        Self { noise }
    }

    /// Reads the picture out: RGB from RGBA, times `exposure`, with noise.
    pub(super) fn read(
        &self,
        rgba: &[u8],
        size: PictureSize,
        exposure: f32,
        random: &mut Random,
    ) -> Vec<u8> {
        let mut curve = [0_u8; 256];
        for (level, entry) in curve.iter_mut().enumerate() {
            *entry = (level as f32 * exposure + 0.5).clamp(0.0, 255.0) as u8;
        }
        let width = size.width as usize;
        let mut rgb = vec![0; width * size.height as usize * 3];
        for (row, line) in rgb.chunks_exact_mut(width * 3).enumerate() {
            let source = &rgba[row * width * 4..(row + 1) * width * 4];
            let offset = random.below(NOISE - width * 3);
            let noise = &self.noise[offset..offset + width * 3];
            let (out, _) = line.as_chunks_mut::<3>();
            let (pixels, _) = source.as_chunks::<4>();
            let (grains, _) = noise.as_chunks::<3>();
            // A plain loop over arrays: iterators cost several times as much in the development profile.
            let mut column = 0;
            while column < width {
                let ([red, green, blue, _], grain) = (pixels[column], grains[column]);
                out[column] = [
                    curve[red as usize].saturating_add_signed(grain[0]),
                    curve[green as usize].saturating_add_signed(grain[1]),
                    curve[blue as usize].saturating_add_signed(grain[2]),
                ];
                column += 1;
            }
        }
        rgb
    }
}

/// The bytewise mean of two groups of bytes, rounded down.
fn mean(a: u64, b: u64) -> u64 {
    (((a ^ b) & 0xfefe_fefe_fefe_fefe) >> 1) + (a & b)
}

/// Blurs RGBA rows and columns with the weights 1, 2, 1 (roughly: means of means round down).
pub(super) fn blur(rgba: &mut [u8], size: PictureSize) {
    let stride = size.width as usize * 4;
    let mut above = rgba[..stride].to_vec();
    let mut here = above.clone();
    for row in 0..size.height as usize {
        let (head, tail) = rgba.split_at_mut((row + 1) * stride);
        let line = &mut head[row * stride..];
        here.copy_from_slice(line);
        let below = if tail.is_empty() {
            &here[..]
        } else {
            &tail[..stride]
        };
        let (out, _) = line.as_chunks_mut::<4>();
        let (upper, _) = above.as_chunks::<4>();
        let (lower, _) = below.as_chunks::<4>();
        let (middle, _) = here.as_chunks::<4>();
        let mut column = 1;
        let mut left = u32::from_ne_bytes(middle[0]);
        let mut center = u32::from_ne_bytes(middle[1]);
        while column + 1 < middle.len() {
            let right = u32::from_ne_bytes(middle[column + 1]);
            let upright = mean(
                u32::from_ne_bytes(upper[column]).into(),
                u32::from_ne_bytes(lower[column]).into(),
            );
            let sideways = mean(left.into(), right.into());
            let value = mean(center.into(), mean(sideways, upright)) as u32;
            out[column] = value.to_ne_bytes();
            (left, center) = (center, right);
            column += 1;
        }
        std::mem::swap(&mut above, &mut here);
    }
}

/// Smears RGBA downwards: every row becomes the mean of itself and the one `rows` below.
pub(super) fn smear(rgba: &mut [u8], size: PictureSize, rows: usize) {
    let stride = size.width as usize * 4;
    for row in 0..(size.height as usize).saturating_sub(rows) {
        let (head, tail) = rgba.split_at_mut((row + rows) * stride);
        let (line, _) = head[row * stride..(row + 1) * stride].as_chunks_mut::<8>();
        let (below, _) = tail[..stride].as_chunks::<8>();
        let mut at = 0;
        while at < line.len() {
            let value = mean(u64::from_ne_bytes(line[at]), u64::from_ne_bytes(below[at]));
            line[at] = value.to_ne_bytes();
            at += 1;
        }
    }
}
