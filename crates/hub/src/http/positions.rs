//! Serves where clips were made, as GeoJSON (RFC 7946), and deletes it.

use super::body::cut_page;
use crate::history::{PositionQuery, PositionedClip};
use crate::hub::Hub;
use albireo_service::clock::{DAY_MS, unix_milliseconds};
use albireo_service::http::{Problem, within};
use axum::Json;
use axum::extract::{Query, State};
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use std::time::{Duration, UNIX_EPOCH};
use utoipa::{IntoParams, ToSchema};

/// Most clips per answer: a track of 60 points has about 1.5 kB.
const MOST: i64 = 5000;

/// The GeoJSON of clips, the last first.
#[derive(Serialize, ToSchema)]
pub(super) struct Positions {
    /// `FeatureCollection`.
    #[schema(value_type = String)]
    r#type: &'static str,
    /// One for each clip.
    features: Vec<ClipFeature>,
    /// True if there are more clips than `limit`: ask again with `until_ms` of the last one's `at_ms`.
    truncated: bool,
}

/// The GeoJSON of a clip.
#[derive(Serialize, ToSchema)]
struct ClipFeature {
    /// `Feature`.
    #[schema(value_type = String)]
    r#type: &'static str,
    /// Its number in the database.
    id: i64,
    /// West, south, east, north, degrees.
    bbox: [f64; 4],
    geometry: Geometry,
    properties: Properties,
}

/// A way, or the place of a camera that did not move. Longitude and latitude, degrees.
#[derive(Serialize, ToSchema)]
#[serde(tag = "type", content = "coordinates")]
enum Geometry {
    Point([f64; 2]),
    LineString(Vec<[f64; 2]>),
}

/// The figures of a clip.
#[derive(Serialize, ToSchema)]
struct Properties {
    #[serde(flatten)]
    clip: PositionedClip,
    /// The highest speed, metres per second; null if no position had one.
    fastest_m_s: Option<f64>,
    /// When it began, and when it ended, as dates of RFC 3339.
    began: String,
    ended: String,
}

/// Where clips were made, as GeoJSON for QGIS and Grafana's Geomap
///
/// Only of nodes that know their position. `curl -o positions.geojson http://127.0.0.1:8090/api/v1/positions.geojson`
#[utoipa::path(
    get, operation_id = "positions", path = "/api/v1/positions.geojson", tag = "history", params(PositionQuery),
    responses((status = 200, content_type = "application/geo+json", body = Positions))
)]
pub(super) async fn geojson(
    State(hub): State<Hub>,
    Query(wanted): Query<PositionQuery>,
) -> Result<Response, Problem> {
    let limit = within("limit", wanted.limit.unwrap_or(1000), 1..=MOST)?;
    let now_ms = unix_milliseconds();
    let since_ms = wanted.since_ms.unwrap_or(now_ms - DAY_MS);
    let times = since_ms..wanted.until_ms.unwrap_or(i64::MAX);
    let mut clips = hub.store()?.positions(&wanted, times, limit + 1).await?;
    let truncated = cut_page(&mut clips, limit, |clip| clip.id).is_some();
    let collection = Positions {
        r#type: "FeatureCollection",
        features: clips.into_iter().map(feature).collect(),
        truncated,
    };
    let kind = [(CONTENT_TYPE, "application/geo+json")];
    Ok((kind, Json(collection)).into_response())
}

fn feature(mut clip: PositionedClip) -> ClipFeature {
    let travel = std::mem::take(&mut clip.travel);
    let geometry = match travel.track[..] {
        [place] => Geometry::Point(place),
        _ => Geometry::LineString(travel.track),
    };
    let date = |seconds: f64| {
        let since_epoch_s = clip.at_ms as f64 / 1e3 + seconds;
        let since_epoch = Duration::try_from_secs_f64(since_epoch_s).unwrap_or_default();
        let at = UNIX_EPOCH.checked_add(since_epoch).unwrap_or(UNIX_EPOCH);
        humantime::format_rfc3339_millis(at).to_string()
    };
    ClipFeature {
        r#type: "Feature",
        id: clip.id,
        bbox: travel.bounds,
        geometry,
        properties: Properties {
            fastest_m_s: travel.fastest_m_s,
            began: date(0.0),
            ended: date(clip.duration_s),
            clip,
        },
    }
}

/// Selects positions to delete.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Deletion {
    /// Of this node.
    node: String,
    /// Only of clips that began before this time, milliseconds since the Unix epoch; all by default.
    until_ms: Option<i64>,
}

/// What was deleted.
#[derive(Serialize, ToSchema)]
pub(super) struct Deleted {
    /// Clips whose positions are gone.
    clips: usize,
}

/// Deletes where a node's clips were made
///
/// The clips stay, and so do the sums of distance, which name no place. Reports that the node still has are stored with their
/// positions when they come. `curl -X DELETE 'http://127.0.0.1:8090/api/v1/positions?node=car-7'`
#[utoipa::path(
    delete, operation_id = "delete_positions", path = "/api/v1/positions", tag = "history", params(Deletion),
    responses((status = 200, body = Deleted))
)]
pub(super) async fn delete(
    State(hub): State<Hub>,
    Query(wanted): Query<Deletion>,
) -> Result<Json<Deleted>, Problem> {
    let until_ms = wanted.until_ms.unwrap_or(i64::MAX);
    let clips = hub.store()?.delete_positions(wanted.node, until_ms).await?;
    Ok(Json(Deleted { clips }))
}
