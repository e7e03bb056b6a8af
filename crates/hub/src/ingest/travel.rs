//! Converts the way of a clip into its columns, and checks every figure.

use super::clip::whole;
use albireo_wire::ClipTravel;

/// The longest way of a clip, metres: around the Earth.
const MOST_METRES: f64 = 4.1e7;

/// The columns of a clip's way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TravelRow {
    pub(super) distance_mm: i64,
    /// The whole of it as JSON.
    pub(super) json: String,
}

impl TravelRow {
    /// Reads the figures of a clip's way.
    ///
    /// # Errors
    /// The figure that cannot be stored, and the reason.
    pub(super) fn new(travel: &ClipTravel) -> Result<Self, String> {
        travel.check()?;
        let distance_mm = whole("travel.distance_m", travel.distance_m, MOST_METRES, 1e3)?;
        let json = serde_json::to_string(travel).map_err(|error| error.to_string())?;
        Ok(Self { distance_mm, json })
    }
}
