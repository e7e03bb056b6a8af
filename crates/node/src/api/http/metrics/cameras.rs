//! What each camera does: whether frames come, what was seen, what it cost.

use super::Snapshots;
use super::family::family;
use crate::state::board::Board;
use crate::state::readiness::CAMERAS;
use prometheus_client::encoding::DescriptorEncoder;
use prometheus_client::metrics::MetricType;
use std::fmt;

/// Writes one line of each kind a camera.
pub(super) fn cameras(
    encoder: &mut DescriptorEncoder<'_>,
    board: &Board,
    cameras: &Snapshots<'_>,
) -> fmt::Result {
    let health = board.readiness().health();
    let silent = |name: &str| {
        (health.faults.iter()).any(|fault| fault.part == CAMERAS && fault.subject == name)
    };
    family(
        encoder,
        "camera_state",
        "Whether frames come from a camera: 1 for the state it is in (live, stale, never_seen), 0 for the others",
        MetricType::Gauge,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                let now = match snapshot.last_frame_age {
                    None => "never_seen",
                    Some(_) if silent(camera.name()) => "stale",
                    Some(_) => "live",
                };
                ["live", "stale", "never_seen"]
                    .into_iter()
                    .try_for_each(|state| {
                        let labels = vec![("camera", camera.name()), ("state", state)];
                        family.gauge(labels, i64::from(state == now))
                    })
            })
        },
    )?;
    family(
        encoder,
        "boxes",
        "Boxes reported, by class and by how each is known (detected, predicted, followed, rescued)",
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                snapshot
                    .boxes
                    .iter()
                    .try_for_each(|((class, source), count)| {
                        let labels = vec![
                            ("camera", camera.name()),
                            ("class", &**class),
                            ("source", *source),
                        ];
                        family.counter(labels, *count as f64)
                    })
            })
        },
    )?;
    family(
        encoder,
        "camera_shared_memory_frames",
        "Frames that came in memory which their sender on this machine shares, and were read in place",
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                let labels = vec![("camera", camera.name())];
                family.counter(labels, snapshot.shared_frames as f64)
            })
        },
    )?;
    family(
        encoder,
        "messages_unpublished",
        "Messages about a camera (answers, counters, clip reports) that did not go out, as Zenoh took them too slowly or \
         not at all",
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                family.counter(vec![("camera", camera.name())], snapshot.unpublished as f64)
            })
        },
    )?;
    family(
        encoder,
        "looks",
        "Frames of which a small grey picture was decoded, to follow boxes by optical flow in it",
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                family.counter(vec![("camera", camera.name())], snapshot.looks as f64)
            })
        },
    )?;
    family(
        encoder,
        "camera_energy_joules",
        "Energy of the clips that ended, each camera's share by the time the detector ran for it, over the time that \
         samples cover; `power_info` says whether it is measured or estimated",
        MetricType::Counter,
        |family| {
            cameras.iter().try_for_each(|(camera, snapshot)| {
                family.counter(vec![("camera", camera.name())], snapshot.clip_joules)
            })
        },
    )
}
