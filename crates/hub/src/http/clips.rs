//! Serves clips, as pages of JSON and as CSV, and the reports that were set aside.

use super::body::cut_page;
use crate::history::{ClipQuery, StoredClip, StoredSetAside};
use crate::hub::Hub;
use crate::store::{Store, StoreError};
use albireo_service::http::{Problem, within};
use axum::body::Body;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use axum::{BoxError, Json};
use futures_util::{StreamExt, TryStreamExt, stream};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Most rows per page.
const MOST: i64 = 1000;

/// A page of clips, the last received first.
#[derive(Serialize, ToSchema)]
pub(super) struct ClipPage {
    clips: Vec<StoredClip>,
    /// The `cursor` of the next page; absent on the last page.
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<i64>,
}

/// Clips by node, camera and time, page by page
///
/// `curl 'http://127.0.0.1:8090/api/v1/clips?node=car-7&limit=20'`
#[utoipa::path(
    get, operation_id = "list_clips", path = "/api/v1/clips", tag = "history", params(ClipQuery),
    responses((status = 200, body = ClipPage))
)]
pub(super) async fn list(
    State(hub): State<Hub>,
    Query(wanted): Query<ClipQuery>,
) -> Result<Json<ClipPage>, Problem> {
    check(&wanted)?;
    let limit = within("limit", wanted.limit.unwrap_or(100), 1..=MOST)?;
    let mut clips = hub.store()?.clips(&wanted, limit + 1).await?;
    let next = cut_page(&mut clips, limit, |clip| clip.id);
    Ok(Json(ClipPage { clips, next }))
}

fn check(wanted: &ClipQuery) -> Result<(), Problem> {
    if wanted.camera.is_some() && wanted.node.is_none() {
        let detail = "`camera` needs `node`: cameras of different nodes may have the same name";
        return Err(Problem::new(StatusCode::BAD_REQUEST, detail));
    }
    Ok(())
}

/// Clips as CSV: all of them, or at most `limit`
///
/// The hub reads and sends them in pages, so the file may be larger than its memory. The audit's figures are left out.
/// `curl -O 'http://127.0.0.1:8090/api/v1/clips.csv?since_ms=1790000000000'`
#[utoipa::path(
    get, operation_id = "clips_csv", path = "/api/v1/clips.csv", tag = "history", params(ClipQuery),
    responses((status = 200, content_type = "text/csv", body = String))
)]
pub(super) async fn csv(
    State(hub): State<Hub>,
    Query(wanted): Query<ClipQuery>,
) -> Result<Response, Problem> {
    check(&wanted)?;
    let left = within("limit", wanted.limit.unwrap_or(i64::MAX), 1..=i64::MAX)?;
    let rows = CsvRows {
        store: hub.store()?.clone(),
        wanted,
        left,
    };
    let mut pages = Box::pin(stream::try_unfold(rows, |mut rows| async move {
        let page = rows.next_page().await?;
        Ok::<_, StoreError>(page.map(|clips| (clips, rows)))
    }));
    // The first page is read before the answer begins, so that the answer to an error has its status.
    let first = pages.try_next().await?;
    let all_pages = stream::iter(first.map(Ok)).chain(pages);
    let texts = all_pages.enumerate().map(|(number, clips)| {
        let has_headers = number == 0;
        written(clips?, has_headers)
    });
    let headers = [
        (CONTENT_TYPE, "text/csv; charset=utf-8"),
        (CONTENT_DISPOSITION, "attachment; filename=\"clips.csv\""),
    ];
    Ok((headers, Body::from_stream(texts)).into_response())
}

/// The clips of a CSV file that are not read yet.
struct CsvRows {
    store: Store,
    /// Selects them; its cursor is the last one that was read.
    wanted: ClipQuery,
    /// Most clips that are still to be read.
    left: i64,
}

impl CsvRows {
    /// Reads the next page; `None` if there are no more clips.
    async fn next_page(&mut self) -> Result<Option<Vec<StoredClip>>, StoreError> {
        let clips = self.store.clips(&self.wanted, self.left.min(MOST)).await?;
        let Some(last) = clips.last() else {
            return Ok(None);
        };
        self.wanted.cursor = Some(last.id);
        self.left -= clips.len() as i64;
        Ok(Some(clips))
    }
}

fn written(clips: Vec<StoredClip>, has_headers: bool) -> Result<Vec<u8>, BoxError> {
    let mut writer = csv::WriterBuilder::new().has_headers(has_headers).from_writer(Vec::new());
    for clip in clips {
        // CSV cannot hold nested fields; the JSON pages have the audit's figures.
        let audit = None;
        writer.serialize(StoredClip { audit, ..clip })?;
    }
    Ok(writer.into_inner()?)
}

/// Selects reports that were set aside.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct AsideSelection {
    /// Only of this node.
    node: Option<String>,
    /// `next` of the previous page.
    cursor: Option<i64>,
    /// Maximum number, up to 100; 20 by default.
    limit: Option<i64>,
}

/// A page of invalid reports, the latest first.
#[derive(Serialize, ToSchema)]
pub(super) struct AsidePage {
    reports: Vec<StoredSetAside>,
    /// The `cursor` of the next page; absent on the last page.
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<i64>,
}

/// Invalid reports, with the reasons
///
/// The hub acknowledges them, so that they do not hold up later reports, and keeps them here.
/// `curl http://127.0.0.1:8090/api/v1/set-aside`
#[utoipa::path(
    get, operation_id = "list_set_aside", path = "/api/v1/set-aside", tag = "history", params(AsideSelection),
    responses((status = 200, body = AsidePage))
)]
pub(super) async fn set_aside(
    State(hub): State<Hub>,
    Query(selection): Query<AsideSelection>,
) -> Result<Json<AsidePage>, Problem> {
    let limit = within("limit", selection.limit.unwrap_or(20), 1..=100)?;
    let store = hub.store()?;
    let node = selection.node.as_deref();
    let mut reports = store.set_aside(node, selection.cursor, limit + 1).await?;
    let next = cut_page(&mut reports, limit, |report| report.id);
    Ok(Json(AsidePage { reports, next }))
}
