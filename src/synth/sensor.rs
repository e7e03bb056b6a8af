//! The camera's glass and sensor: blur, smear, noise, wandering exposure.

use super::random::Random;
use crate::geometry::PictureSize;

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
            for ((out, pixel), grain) in line
                .chunks_exact_mut(3)
                .zip(source.chunks_exact(4))
                .zip(noise.chunks_exact(3))
            {
                out[0] = curve[pixel[0] as usize].saturating_add_signed(grain[0]);
                out[1] = curve[pixel[1] as usize].saturating_add_signed(grain[1]);
                out[2] = curve[pixel[2] as usize].saturating_add_signed(grain[2]);
            }
        }
        rgb
    }
}

/// The bytewise mean of two groups of bytes, rounded down.
fn mean(a: u64, b: u64) -> u64 {
    (((a ^ b) & 0xfefe_fefe_fefe_fefe) >> 1) + (a & b)
}

fn word(bytes: &[u8], at: usize) -> u64 {
    let mut word = [0; 8];
    word.copy_from_slice(&bytes[at..at + 8]);
    u64::from_ne_bytes(word)
}

/// Blurs RGBA rows and columns with the weights 1, 2, 1 (roughly: means of means round down).
pub(super) fn blur(rgba: &mut [u8], size: PictureSize) {
    let stride = size.width as usize * 4;
    if stride < 24 || rgba.len() < stride * 3 {
        return;
    }
    let mut above = rgba[..stride].to_vec();
    let mut here = above.clone();
    for row in 0..size.height as usize {
        let start = row * stride;
        let (head, tail) = rgba.split_at_mut(start + stride);
        let line = &mut head[start..];
        here.copy_from_slice(line);
        let below = if tail.is_empty() {
            &here[..]
        } else {
            &tail[..stride]
        };
        let mut at = 8;
        while at + 16 <= stride {
            let center = word(&here, at);
            let sideways = mean(word(&here, at - 4), word(&here, at + 4));
            let upright = mean(word(&above, at), word(below, at));
            let value = mean(center, mean(sideways, upright));
            line[at..at + 8].copy_from_slice(&value.to_ne_bytes());
            at += 8;
        }
        std::mem::swap(&mut above, &mut here);
    }
}

/// Smears RGBA downwards: every row becomes the mean of itself and the one `rows` below.
pub(super) fn smear(rgba: &mut [u8], size: PictureSize, rows: usize) {
    let stride = size.width as usize * 4;
    let shift = rows * stride;
    if rows == 0 || shift >= rgba.len() {
        return;
    }
    for start in (0..rgba.len() - shift).step_by(8) {
        if start + shift + 8 > rgba.len() {
            break;
        }
        let value = mean(word(rgba, start), word(rgba, start + shift));
        rgba[start..start + 8].copy_from_slice(&value.to_ne_bytes());
    }
}
