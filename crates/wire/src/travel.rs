//! Where frames were taken, and what a clip's report tells of it.

use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// The maximum number of points of a clip's track.
pub const MOST_TRACK_POINTS: usize = 60;
/// The fastest speed that is believed, metres per second: faster than any train.
pub const FASTEST_M_S: f64 = 200.0;
/// The longest way of a clip that is believed, metres: at that speed for eight weeks.
const MOST_DISTANCE_M: f64 = 1e9;

/// A place on the Earth (WGS 84), and the speed there.
#[skip_serializing_none]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Position {
    /// Degrees north of the equator, -90 to 90.
    pub latitude: f64,
    /// Degrees east of Greenwich, -180 to 180.
    pub longitude: f64,
    /// Speed over ground, metres per second.
    pub speed_m_s: Option<f64>,
}

impl Position {
    /// Checks that it can be a place on the Earth and a speed there.
    ///
    /// # Errors
    /// The figure that cannot be right, and its range.
    pub fn check(&self) -> Result<(), String> {
        within("latitude", self.latitude, -90.0, 90.0)?;
        within("longitude", self.longitude, -180.0, 180.0)?;
        within("speed_m_s", self.speed_m_s.unwrap_or(0.0), 0.0, FASTEST_M_S)
    }
}

/// Refuses a figure out of its range, in words with its name.
fn within(name: &str, value: f64, least: f64, most: f64) -> Result<(), String> {
    if (least..=most).contains(&value) {
        Ok(())
    } else {
        Err(format!("{name} is {value}, not from {least} to {most}"))
    }
}

/// The way of a clip, if positions are known.
#[skip_serializing_none]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ClipTravel {
    /// Distance from the first to the last position of the clip along its way, metres. Where no position is known for a
    /// while, it is the straight line.
    pub distance_m: f64,
    /// The highest speed that a position had, metres per second; absent if none had one.
    pub fastest_m_s: Option<f64>,
    /// The box around all positions: west, south, east, north, degrees (RFC 7946). West is greater than east if it
    /// crosses the antimeridian.
    #[serde(rename = "box")]
    pub bounds: [f64; 4],
    /// The way, simplified to at most 60 points: longitude and latitude of each, degrees, to about a metre.
    pub track: Vec<[f64; 2]>,
}

impl ClipTravel {
    /// Checks that each figure can be right.
    ///
    /// # Errors
    /// The figure that cannot be right, and its range.
    pub fn check(&self) -> Result<(), String> {
        let points = self.track.len();
        if !(1..=MOST_TRACK_POINTS).contains(&points) {
            return Err(format!(
                "travel.track has {points} points, not 1 to {MOST_TRACK_POINTS}"
            ));
        }
        let fastest_m_s = self.fastest_m_s.unwrap_or(0.0);
        within("travel.distance_m", self.distance_m, 0.0, MOST_DISTANCE_M)?;
        within("travel.fastest_m_s", fastest_m_s, 0.0, FASTEST_M_S)?;
        let [west, south, east, north] = self.bounds;
        for longitude in [west, east] {
            within("a longitude of travel.box", longitude, -180.0, 180.0)?;
        }
        for latitude in [south, north] {
            within("a latitude of travel.box", latitude, -90.0, 90.0)?;
        }
        for &[longitude, latitude] in &self.track {
            within("a longitude of travel.track", longitude, -180.0, 180.0)?;
            within("a latitude of travel.track", latitude, -90.0, 90.0)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each figure of a travel is checked, and the one that is wrong is named.
    #[test]
    fn a_figure_that_cannot_be_right_is_refused_by_its_name() {
        let right = ClipTravel {
            distance_m: 12.0,
            fastest_m_s: Some(3.0),
            bounds: [8.0, 47.0, 8.1, 47.1],
            track: vec![[8.0, 47.0], [8.1, 47.1]],
        };
        assert_eq!(right.check(), Ok(()));
        let refused = |change: fn(&mut ClipTravel)| {
            let mut travel = right.clone();
            change(&mut travel);
            travel.check().expect_err("the figure is out of its range")
        };
        assert_eq!(
            refused(|travel| travel.distance_m = -1.0),
            "travel.distance_m is -1, not from 0 to 1000000000"
        );
        assert_eq!(
            refused(|travel| travel.fastest_m_s = Some(201.0)),
            "travel.fastest_m_s is 201, not from 0 to 200"
        );
        assert_eq!(
            refused(|travel| travel.bounds[0] = 181.0),
            "a longitude of travel.box is 181, not from -180 to 180"
        );
        assert_eq!(
            refused(|travel| travel.track[1][1] = f64::NAN),
            "a latitude of travel.track is NaN, not from -90 to 90"
        );
    }
}
