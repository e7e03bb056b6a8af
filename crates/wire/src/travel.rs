//! Where frames were taken, and what a clip's report tells of it.

use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;
use utoipa::ToSchema;

/// The maximum number of points of a clip's track.
pub const MOST_TRACK_POINTS: usize = 60;
/// The fastest speed that is believed, metres per second: faster than any train.
pub const FASTEST_M_S: f64 = 200.0;

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
        let within = |what: &str, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(format!("{what} is {value}, not from {least} to {most}"))
            }
        };
        within("latitude", self.latitude, -90.0, 90.0)?;
        within("longitude", self.longitude, -180.0, 180.0)?;
        within("speed_m_s", self.speed_m_s.unwrap_or(0.0), 0.0, FASTEST_M_S)
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
    /// Checks its figures.
    ///
    /// # Errors
    /// The figure that cannot be right.
    pub fn check(&self) -> Result<(), String> {
        let points = self.track.len();
        if !(1..=MOST_TRACK_POINTS).contains(&points) {
            return Err(format!(
                "travel.track has {points} points, not 1 to {MOST_TRACK_POINTS}"
            ));
        }
        let [west, south, east, north] = self.bounds;
        let corners = [[west, south], [east, north]];
        // The box and the highest speed are in range under the same rules as each point.
        for [longitude, latitude] in self.track.iter().copied().chain(corners) {
            let position = Position {
                latitude,
                longitude,
                speed_m_s: self.fastest_m_s,
            };
            position.check().map_err(|reason| format!("travel: {reason}"))?;
        }
        Ok(())
    }
}
