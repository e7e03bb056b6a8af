//! Draws the frames to audit.

/// Draws frames at random by a seed and the frame's number, independently of their content.
///
/// It keeps no state: the same seed draws the same numbers. A stream whose numbers restart at 0 needs another seed;
/// otherwise the same numbers are drawn each time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AuditDraw {
    seed: u64,
    /// Hashes below this value are drawn: all of them at 2⁶⁴.
    below: u128,
}

impl AuditDraw {
    /// Draws `share` of all frames, 0 to 1. A share outside that range counts as its nearest end, NaN as 0.
    pub fn new(share: f64, seed: u64) -> Self {
        Self {
            seed,
            // NaN becomes 0.
            below: (share.clamp(0.0, 1.0) * 2f64.powi(64)) as u128,
        }
    }

    /// True if the frame with this number is drawn.
    pub const fn draw(&self, frame: u64) -> bool {
        (mix(mix(self.seed) ^ frame) as u128) < self.below
    }

    /// True if no frame is ever drawn.
    pub const fn is_off(&self) -> bool {
        self.below == 0
    }
}

/// The output function of SplitMix64 (S. Vigna's reference code, in the public domain).
const fn mix(number: u64) -> u64 {
    let mut z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
