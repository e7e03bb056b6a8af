//! Summarises the node in one answer, for the head of the page, and lists the routes.

use super::RouteState;
use super::health::{Readiness, readiness};
use crate::position::PositionStatus;
use crate::state::board::{ForwardedCounts, ModelReading, Savings};
use albireo_service::clock::seconds;
use albireo_service::http::{Route, routes};
use albireo_vision::detector::{InputUse, PaddedInput, Precision};
use albireo_wire::{CertificateStatus, OutboxStatus};
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

/// How the detector's model is read, and which of its classes are reported.
#[derive(Serialize, ToSchema)]
pub(super) struct DetectorReading {
    /// Head and input, in words.
    head: String,
    /// Names of the classes that are reported, by class number.
    classes: Vec<String>,
    /// Names of the model's classes that are not reported (`detector.report_classes`).
    left_out: Vec<String>,
    /// Boxes of these classes since the start.
    boxes_left_out: u64,
    /// Rows of the model's output that were impossible since the start: a number that is not finite, or a box without an
    /// area or much larger than the input.
    boxes_impossible: u64,
    /// The inputs that pictures run at, one for each shape of picture that has come.
    inputs: Vec<DetectorInput>,
    /// Whether a GPU finds what the CPU finds, by the boxes of the first picture in which it found any; absent until then,
    /// and on the CPU.
    #[serde(skip_serializing_if = "Option::is_none")]
    precision: Option<DetectorPrecision>,
    /// The build of TensorRT's engine while the provider listed after it answers; absent if nothing is being built.
    #[serde(skip_serializing_if = "Option::is_none")]
    engine_build: Option<DetectorEngineBuild>,
}

/// TensorRT builds its engine.
#[derive(Serialize, ToSchema)]
struct DetectorEngineBuild {
    /// Seconds since it began.
    elapsed_s: f64,
    /// Seconds that the last build took on this machine, of this model or of another; absent before the first.
    #[serde(skip_serializing_if = "Option::is_none")]
    last_build_s: Option<f64>,
}

/// What the comparison of a provider with the CPU showed.
#[derive(Serialize, ToSchema)]
struct DetectorPrecision {
    /// True if all boxes agree within 2 pixels of the input and 0.02 of confidence; absent if they could not be compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    agrees: Option<bool>,
    /// The outcome in words, with what to do.
    words: String,
}

/// The input that pictures of one shape run at.
#[derive(Serialize, ToSchema)]
struct DetectorInput {
    /// Size of the first picture of this shape, columns x rows.
    #[schema(example = "1920x1080")]
    picture: String,
    /// The input, columns x rows.
    #[schema(example = "416x256")]
    input: String,
    /// Share of the input that the picture leaves empty, 0 to 1.
    padding: f64,
    /// `fixed`: the model has one size. Of a model with open height and width: `comparing` the smallest input that holds the
    /// picture with the largest, `smallest` once both find the same, `largest` if they do not.
    choice: &'static str,
    /// The same in words, with the reason and what to do.
    words: String,
}

/// A node: its readiness, run time, energy and savings.
#[derive(Serialize, ToSchema)]
pub(super) struct NodeOverview {
    /// The program's version.
    version: &'static str,
    /// Seconds since it started.
    uptime_s: f64,
    #[serde(flatten)]
    readiness: Readiness,
    /// The address of the hub's page: the label `hub`; absent without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    hub: Option<String>,
    /// The first Zenoh endpoint at which the node, or its router, takes frames: of `zenoh.listen`, or of `zenoh.connect`.
    #[serde(skip_serializing_if = "Option::is_none")]
    frames_at: Option<String>,
    /// How the detector's model is read; absent while it starts.
    #[serde(skip_serializing_if = "Option::is_none")]
    detector: Option<DetectorReading>,
    /// Reports that wait for a hub.
    outbox: OutboxStatus,
    /// What was forwarded to hooks and an MQTT broker.
    forwarded: Vec<ForwardedCounts>,
    /// The certificates of its sessions, with their ends.
    certificates: Vec<CertificateStatus>,
    /// Where its positions come from; never the position itself.
    position: PositionStatus,
    /// The source of its figures of power: `rapl`, `estimate`, …; `none` without one.
    power_source: String,
    /// Savings since the start.
    since_start: Savings,
    /// Savings of today: since midnight UTC, or since the start if that is later.
    today: Savings,
    /// Savings under the policy in force, since it was switched; absent if it never was.
    #[serde(skip_serializing_if = "Option::is_none")]
    since_switch: Option<Savings>,
}

fn detector(reading: &ModelReading) -> DetectorReading {
    let counts = reading.meter.read();
    DetectorReading {
        head: reading.description.clone(),
        classes: reading.classes.clone(),
        left_out: reading.left_out.clone(),
        boxes_left_out: counts.other_class,
        boxes_impossible: counts.rejected,
        inputs: reading.preparation.inputs().iter().map(input).collect(),
        precision: precision(&reading.precision.outcome()),
        engine_build: reading.engine_build.elapsed().map(|elapsed| DetectorEngineBuild {
            elapsed_s: seconds(elapsed),
            last_build_s: reading.engine_build.expected().map(seconds),
        }),
    }
}

fn precision(outcome: &Precision) -> Option<DetectorPrecision> {
    match outcome {
        Precision::NotCompared => None,
        Precision::Compared(agreement) => Some(DetectorPrecision {
            agrees: Some(agreement.agrees()),
            words: agreement.to_string(),
        }),
        Precision::Failed(reason) => Some(DetectorPrecision {
            agrees: None,
            words: format!("could not be compared: {reason}"),
        }),
    }
}

fn input(found: &InputUse) -> DetectorInput {
    let PaddedInput { size, padding } = found.input();
    DetectorInput {
        picture: found.picture.to_string(),
        input: size.to_string(),
        padding,
        choice: found.choice.as_str(),
        words: found.to_string(),
    }
}

/// The node in one answer
///
/// Like `/readyz`, but always with status 200: it is for display, not for probes.
/// `curl http://127.0.0.1:8080/api/v1/node`
#[utoipa::path(get, operation_id = "node_overview", path = "/api/v1/node", tag = "health", responses((status = 200, body = NodeOverview)))]
pub(super) async fn overview(State(shared): State<RouteState>) -> Json<NodeOverview> {
    let board = &shared.board;
    let savings = board.savings();
    Json(NodeOverview {
        version: env!("CARGO_PKG_VERSION"),
        uptime_s: seconds(board.uptime()),
        readiness: readiness(board),
        hub: shared
            .config
            .pointer("/node/labels/hub")
            .and_then(|label| label.as_str().map(str::to_owned)),
        frames_at: ["/zenoh/listen/0", "/zenoh/connect/0"]
            .into_iter()
            .find_map(|place| shared.config.pointer(place)?.as_str().map(str::to_owned)),
        detector: board.reading.get().map(detector),
        outbox: shared.outbox.counts().status,
        forwarded: board.forwarded(),
        certificates: board.certificates.status(),
        position: board.positions.status(),
        power_source: board.power().source,
        since_start: savings.since_start,
        today: savings.today,
        since_switch: board.savings_of_policy(),
    })
}

/// Service, version and list of routes.
#[derive(Serialize, ToSchema)]
pub(super) struct Index {
    /// The node's name.
    node: String,
    /// The program's version.
    version: &'static str,
    /// The policy that decides the frames.
    policy: &'static str,
    /// Names of the cameras.
    cameras: Vec<String>,
    /// The path of the full description.
    openapi: &'static str,
    /// All routes.
    routes: Vec<Route>,
}

/// Service, version and list of routes
///
/// `curl http://127.0.0.1:8080/api/v1`
#[utoipa::path(get, path = "/api/v1", tag = "health", responses((status = 200, body = Index)))]
pub(super) async fn index(State(shared): State<RouteState>) -> Json<Index> {
    let board = &shared.board;
    Json(Index {
        node: board.node.clone(),
        version: env!("CARGO_PKG_VERSION"),
        policy: board.policy().name,
        cameras: shared.camera_names(),
        openapi: "/openapi.json",
        routes: routes(&super::openapi()),
    })
}
