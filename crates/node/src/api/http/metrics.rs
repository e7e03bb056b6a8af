//! Metrics for Prometheus, in OpenMetrics text or in the older text format (0.0.4), as the reader asks.

mod audit;
mod cameras;
mod detector;
mod family;
mod plain;
mod target;
mod tasks;

use self::detector::detector;
use self::family::family;
use self::plain::to_plain;
use super::RouteState;
use super::health::provider;
use super::pictures::Pictures;
use crate::state::board::{Board, CameraBoard, CameraSnapshot};
use albireo_core::policy::{CallCause, FrameState};
use albireo_service::http::Problem;
use albireo_vision::detector::DetectorStatus;
use albireo_wire::EnergyQuality;
use axum::extract::State;
use axum::http::header::{ACCEPT, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, text::encode};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::Registry;
use std::fmt;
use std::sync::Arc;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
const PLAIN: &str = "text/plain; version=0.0.4; charset=utf-8";

/// The registry over a board.
pub(super) struct Metrics(Registry);

impl Metrics {
    /// Metrics of that board, and of the pictures that were shown.
    pub(crate) fn new(board: Arc<Board>, pictures: &Pictures) -> Self {
        let mut registry = Registry::default();
        registry.register_collector(Box::new(ProcessCollector));
        let albireo = registry.sub_registry_with_prefix("albireo");
        albireo.register(
            "shown_pictures_decoded",
            "Pictures decoded because somebody looked at them",
            pictures.decoded().clone(),
        );
        albireo.register_collector(Box::new(BoardCollector(board)));
        Self(registry)
    }
}

/// Reads what the process uses at each scrape. Its names have no prefix: they are every program's.
#[derive(Debug)]
struct ProcessCollector;

impl Collector for ProcessCollector {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        for figure in albireo_service::process::figures() {
            let kind = if figure.counter {
                MetricType::Counter
            } else {
                MetricType::Gauge
            };
            family(&mut encoder, figure.name, figure.help, kind, |family| {
                if figure.counter {
                    family.counter(Vec::new(), figure.value)
                } else {
                    family.gauge(Vec::new(), figure.value)
                }
            })?;
        }
        Ok(())
    }
}

/// Reads the board at each scrape, so that no figure is kept twice.
#[derive(Debug)]
struct BoardCollector(Arc<Board>);

fn quality(quality: EnergyQuality) -> &'static str {
    match quality {
        EnergyQuality::Measured => "measured",
        EnergyQuality::Partial => "partial",
        EnergyQuality::Estimated => "estimated",
        EnergyQuality::Unavailable => "unavailable",
    }
}

impl Collector for BoardCollector {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let cameras: Vec<_> = self
            .0
            .cameras()
            .iter()
            .map(|camera| (&**camera, camera.snapshot()))
            .collect();
        self.node(&mut encoder)?;
        tasks::parts(&mut encoder, &self.0)?;
        detector(&mut encoder, &self.0.detector_counters())?;
        tasks::screen(&mut encoder, &self.0)?;
        frames(&mut encoder, &cameras)?;
        self::cameras::cameras(&mut encoder, &self.0, &cameras)?;
        audit::audit(&mut encoder, &cameras)?;
        threshold(&mut encoder, &cameras)?;
        target::target(&mut encoder, &self.0)?;
        latency(&mut encoder, &cameras)?;
        self.outbox(&mut encoder)?;
        self.power(&mut encoder)
    }
}

impl BoardCollector {
    fn node(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let board = &self.0;
        let status = board.detector_status();
        family(
            encoder,
            "build_info",
            "The program that runs, always 1",
            MetricType::Gauge,
            |family| {
                family.gauge(
                    vec![
                        ("version", env!("CARGO_PKG_VERSION")),
                        ("node", board.node()),
                    ],
                    1_i64,
                )
            },
        )?;
        family(
            encoder,
            "uptime_seconds",
            "Time since the node started",
            MetricType::Gauge,
            |family| family.gauge(Vec::new(), board.uptime().as_secs_f64()),
        )?;
        family(
            encoder,
            "ready",
            "Whether the node works as configured",
            MetricType::Gauge,
            |family| family.gauge(Vec::new(), i64::from(board.readiness().health().is_ready())),
        )?;
        family(
            encoder,
            "detector_ready",
            "Whether the detector works",
            MetricType::Gauge,
            |family| {
                let ready = matches!(status, DetectorStatus::Ready { .. });
                family.gauge(Vec::new(), i64::from(ready))
            },
        )?;
        let wanted = board
            .detector_facts()
            .requested
            .first()
            .map(|first| first.as_str());
        let fell_back =
            provider(&status).is_some_and(|runs| wanted.is_some_and(|wanted| wanted != runs));
        family(
            encoder,
            "detector_fallback",
            "Whether another execution provider runs the detector than the first that is configured",
            MetricType::Gauge,
            |family| family.gauge(Vec::new(), i64::from(fell_back)),
        )?;
        let help = "The detector's model and the execution provider that really runs it, always 1";
        family(
            encoder,
            "detector_info",
            help,
            MetricType::Gauge,
            |family| {
                let labels = vec![
                    ("model", board.detector_facts().model.as_str()),
                    ("provider", provider(&status).unwrap_or("none")),
                    ("policy", board.policy()),
                ];
                family.gauge(labels, 1_i64)
            },
        )
    }

    fn outbox(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let counts = self.0.outbox().counts();
        let gauges = [
            (
                "outbox_waiting",
                "Clip reports that no hub has acknowledged",
                counts.waiting,
            ),
            (
                "outbox_in_memory",
                "Of these, reports that are not on disk",
                counts.in_memory,
            ),
            (
                "outbox_again",
                "Clip reports that a hub had and has lost, to be sent again",
                counts.again,
            ),
            (
                "outbox_durable",
                "Whether clip reports survive a power loss",
                u64::from(counts.durable),
            ),
        ];
        for (name, help, value) in gauges {
            let value = i64::try_from(value).unwrap_or(i64::MAX);
            family(encoder, name, help, MetricType::Gauge, |family| {
                family.gauge(Vec::new(), value)
            })?;
        }
        let counters = [
            ("outbox_kept", "Clip reports taken in", counts.kept),
            (
                "outbox_acknowledged",
                "Clip reports that a hub has acknowledged",
                counts.acknowledged,
            ),
            (
                "outbox_lost",
                "Clip reports lost: the outbox was full or its disk broken",
                counts.lost,
            ),
            (
                "outbox_undeliverable",
                "Clip reports that a hub refused for good, or that could not be read",
                counts.undeliverable,
            ),
            (
                "outbox_disk_failures",
                "Times the state directory failed",
                counts.disk_failures,
            ),
        ];
        for (name, help, value) in counters {
            family(encoder, name, help, MetricType::Counter, |family| {
                family.counter(Vec::new(), value as f64)
            })?;
        }
        Ok(())
    }

    fn power(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let power = self.0.power();
        let labels = |domain| vec![("domain", domain), ("source", power.source.as_str())];
        let help = "Whether power is measured or estimated now, or unavailable: always 1";
        family(encoder, "power_info", help, MetricType::Gauge, |family| {
            let labels = vec![
                ("source", power.source.as_str()),
                ("quality", quality(power.quality)),
            ];
            family.gauge(labels, 1_i64)
        })?;
        let help = "Power now; `power_info` says whether it is measured or estimated";
        family(encoder, "power_watts", help, MetricType::Gauge, |family| {
            power
                .watts
                .iter()
                .try_for_each(|entry| family.gauge(labels(entry.domain.as_str()), entry.watts))
        })?;
        let help = "Energy since the node started, over the time that samples cover; `power_info` says \
                    whether it is measured or estimated";
        family(
            encoder,
            "energy_joules",
            help,
            MetricType::Counter,
            |family| {
                power
                    .joules
                    .iter()
                    .try_for_each(|(domain, joules)| family.counter(labels(domain), *joules))
            },
        )?;
        let help = "Time that samples of power cover since the node started: `energy_joules` is that time's, \
                    and divided by it the mean power";
        family(
            encoder,
            "energy_covered_seconds",
            help,
            MetricType::Counter,
            |family| {
                power
                    .covered_s
                    .iter()
                    .try_for_each(|(domain, seconds)| family.counter(labels(domain), *seconds))
            },
        )?;
        if let Some((sensor, celsius)) = &power.hottest {
            let help = "The machine's hottest sensor";
            let name = "temperature_celsius";
            family(encoder, name, help, MetricType::Gauge, |family| {
                family.gauge(vec![("sensor", sensor.as_str())], *celsius)
            })?;
        }
        let help = "Times the power source could not be read";
        family(
            encoder,
            "power_failed_reads",
            help,
            MetricType::Counter,
            |family| {
                let labels = vec![("source", power.source.as_str())];
                family.counter(labels, power.failed_reads as f64)
            },
        )?;
        let help = "CPU time spent on reading the power source";
        family(
            encoder,
            "power_meter_cpu_seconds",
            help,
            MetricType::Counter,
            |family| {
                let labels = vec![("source", power.source.as_str())];
                family.counter(labels, power.cost.cpu.as_secs_f64())
            },
        )
    }
}

type Snapshots<'a> = [(&'a CameraBoard, CameraSnapshot)];

fn frames(encoder: &mut DescriptorEncoder<'_>, cameras: &Snapshots<'_>) -> fmt::Result {
    family(
        encoder,
        "frames",
        "Frames processed, by frame state",
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                FrameState::ALL.into_iter().try_for_each(|state| {
                    let labels = vec![("camera", camera.name()), ("state", state.as_str())];
                    family.counter(labels, snapshot.states.get(state) as f64)
                })
            })
        },
    )?;
    let help = "Frames that the detector was called for, by cause, whether or not it could be had";
    family(
        encoder,
        "detector_calls",
        help,
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                // A cause that this policy does not have would be a row of zeros for ever.
                let some = snapshot.calls.by_cause().filter(|(_, count)| *count > 0);
                some.into_iter().try_for_each(|(cause, count)| {
                    let labels = vec![("camera", camera.name()), ("cause", cause.as_str())];
                    family.counter(labels, count as f64)
                })
            })
        },
    )?;
    family(
        encoder,
        "frames_dropped",
        "Frames not processed, by kind",
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                snapshot
                    .dropped
                    .by_kind()
                    .into_iter()
                    .try_for_each(|(kind, count)| {
                        family.counter(
                            vec![("camera", camera.name()), ("kind", kind)],
                            count as f64,
                        )
                    })
            })
        },
    )?;
    let help = "Frames that the detector ran on although the empty-scene screen said empty, too often in a row";
    family(
        encoder,
        "screen_overruled",
        help,
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                let labels = vec![("camera", camera.name())];
                family.counter(labels, snapshot.calls.get(CallCause::EmptyLimit) as f64)
            })
        },
    )?;
    let help = "Frames that skipped the detector: state E or P and not degraded";
    family(
        encoder,
        "frames_skipped",
        help,
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                let skipped = snapshot.states.skipped(snapshot.degraded_frames);
                family.counter(vec![("camera", camera.name())], skipped as f64)
            })
        },
    )?;
    let help = "Frames answered from prediction because the detector could not be had: state P, and not \
                skipped";
    family(
        encoder,
        "frames_degraded",
        help,
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                family.counter(
                    vec![("camera", camera.name())],
                    snapshot.degraded_frames as f64,
                )
            })
        },
    )?;
    family(
        encoder,
        "clips",
        "Clips ended",
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                family.counter(vec![("camera", camera.name())], snapshot.clips as f64)
            })
        },
    )?;
    family(
        encoder,
        "last_frame_age_seconds",
        "Time since the newest frame",
        MetricType::Gauge,
        |family| {
            cameras
                .iter()
                .try_for_each(|(camera, snapshot)| match snapshot.last_frame_age {
                    Some(age) => family.gauge(vec![("camera", camera.name())], age.as_secs_f64()),
                    None => Ok(()),
                })
        },
    )
}

fn threshold(encoder: &mut DescriptorEncoder<'_>, cameras: &Snapshots<'_>) -> fmt::Result {
    let help = "Threshold in force, under the policy's name for it";
    family(encoder, "threshold", help, MetricType::Gauge, |family| {
        cameras
            .iter()
            .try_for_each(|(camera, _)| match (camera.threshold(), camera.knob()) {
                (Some(value), Some(knob)) => {
                    family.gauge(vec![("camera", camera.name()), ("knob", knob.name)], value)
                }
                _ => Ok(()),
            })
    })?;
    let help = "Largest uncertainty of the newest frame; absent where it had no objects";
    family(encoder, "tau_max", help, MetricType::Gauge, |family| {
        cameras.iter().try_for_each(|(camera, snapshot)| {
            match snapshot.latest.as_ref().and_then(|latest| latest.tau_max) {
                Some(tau) => family.gauge(vec![("camera", camera.name())], tau),
                None => Ok(()),
            }
        })
    })
}

fn latency(encoder: &mut DescriptorEncoder<'_>, cameras: &Snapshots<'_>) -> fmt::Result {
    let help = "Time from reception to publication of a frame, by frame state";
    family(
        encoder,
        "frame_latency_seconds",
        help,
        MetricType::Histogram,
        |family| {
            cameras.iter().try_for_each(|(camera, _)| {
                FrameState::ALL.into_iter().try_for_each(|state| {
                    let labels = vec![("camera", camera.name()), ("state", state.as_str())];
                    family.histogram(labels, camera.total_latency(state))
                })
            })
        },
    )?;
    let help = "Time the detector took, over the frames where it ran";
    family(
        encoder,
        "detector_latency_seconds",
        help,
        MetricType::Histogram,
        |family| {
            cameras.iter().try_for_each(|(camera, _)| {
                family.histogram(vec![("camera", camera.name())], camera.detector_latency())
            })
        },
    )
}

/// All metrics as OpenMetrics text.
///
/// # Errors
/// A problem document when they cannot be written.
pub(super) fn written(shared: &RouteState) -> Result<String, Problem> {
    let mut text = String::new();
    encode(&mut text, &shared.metrics.0).map_err(|error| {
        let detail = format!("the metrics cannot be written: {error}");
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, detail)
    })?;
    Ok(text)
}

/// Metrics for Prometheus
///
/// OpenMetrics text for a reader that accepts it, else the older text format.
/// `curl http://127.0.0.1:8080/metrics`
#[utoipa::path(
    get, operation_id = "metrics", path = "/metrics", tag = "metrics",
    responses((status = 200, content((String = "text/plain"), (String = "application/openmetrics-text"))))
)]
pub(super) async fn text(
    State(shared): State<RouteState>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let text = written(&shared)?;
    let open = headers
        .get_all(ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .any(|value| value.contains("application/openmetrics-text"));
    Ok(if open {
        ([(CONTENT_TYPE, OPEN_METRICS)], text).into_response()
    } else {
        ([(CONTENT_TYPE, PLAIN)], to_plain(&text)).into_response()
    })
}
