//! The ways of simulated nodes: each drives its own rounds in a made-up town.

use crate::node::DRAW_WAY;
use crate::random::{mix, unit};
use albireo_wire::{ClipTravel, significant};
use std::f64::consts::TAU;

/// The middle of the town, in the Atlantic: longitude and latitude, degrees.
const MIDDLE: [f64; 2] = [-30.0, 40.0];
/// Metres in a degree of latitude.
const DEGREE_M: f64 = 111_194.9;
/// Points of a clip's track.
const POINTS: u32 = 12;

/// The way of clip `number` of a node, which drives around a circle of its own.
pub(crate) fn travel(seed: u64, number: u64, clip_s: f64) -> ClipTravel {
    let drawn = |what: u64| unit(mix(seed, DRAW_WAY + what));
    // The middle of its circle is up to a tenth of a degree from the town's.
    let [east, north] = [drawn(0), drawn(1)].map(|share| (share - 0.5) * 0.2);
    let radius_m = 200.0 + 1_800.0 * drawn(2);
    let speed_m_s = 5.0 + 10.0 * drawn(3);
    let distance_m = speed_m_s * clip_s;
    let begun = number as f64 * distance_m / radius_m + drawn(4) * TAU;
    let point = |at: u32| {
        let along = f64::from(at) / f64::from(POINTS - 1) * distance_m / radius_m;
        let angle = (begun + along) % TAU;
        let latitude = MIDDLE[1] + north + radius_m * angle.sin() / DEGREE_M;
        // A degree of longitude is shorter, the farther from the equator.
        let width = MIDDLE[1].to_radians().cos();
        let longitude = MIDDLE[0] + east + radius_m * angle.cos() / DEGREE_M / width;
        [longitude, latitude].map(|degrees| (degrees * 1e5).round() / 1e5)
    };
    let track: Vec<_> = (0..POINTS).map(point).collect();
    let least = |axis: usize| track.iter().map(|point| point[axis]).fold(f64::MAX, f64::min);
    let most = |axis: usize| track.iter().map(|point| point[axis]).fold(f64::MIN, f64::max);
    ClipTravel {
        distance_m: significant(distance_m, 6),
        fastest_m_s: Some(significant(speed_m_s, 4)),
        bounds: [least(0), least(1), most(0), most(1)],
        track,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clip_begins_where_the_one_before_it_ended() {
        for seed in 0..20 {
            let first = travel(seed, 4, 40.0);
            let second = travel(seed, 5, 40.0);
            assert_eq!(first.check(), Ok(()));
            let [end_longitude, end_latitude] = *first.track.last().unwrap();
            let [longitude, latitude] = second.track[0];
            // Both are rounded to five decimals.
            assert!((end_longitude - longitude).abs() < 2e-5);
            assert!((end_latitude - latitude).abs() < 2e-5);
        }
    }
}
