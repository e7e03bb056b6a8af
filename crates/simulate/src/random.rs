//! Draws numbers that look random from hashes, so that a seed repeats a run.

use rand_core::RngCore;
use rand_pcg::Pcg64Mcg;

/// Mixes two numbers to one (splitmix64's finalizer).
pub(crate) const fn mix(a: u64, b: u64) -> u64 {
    let mut z = a ^ b.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Maps a hash to a number from 0 to 1, by as many of its bits as such a number holds.
pub(crate) fn unit(hash: u64) -> f64 {
    (hash >> 11) as f64 / (1u64 << 53) as f64
}

/// An approximately normal number: the sum of twelve uniform numbers, less six.
pub(crate) fn normal(random: &mut Pcg64Mcg) -> f64 {
    (0..12).map(|_| unit(random.next_u64())).sum::<f64>() - 6.0
}
