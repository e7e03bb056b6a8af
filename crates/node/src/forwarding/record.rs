//! Records what hooks are told of. A task of its own: a hook that waits for its address would begin a recording too late.

use super::config::HookConfig;
use crate::recorder::Recorder;
use crate::state::board::Board;
use albireo_wire::{Sighting, SightingEvent};
use std::sync::Arc;
use tokio::sync::broadcast::error::RecvError;

/// Begins a recording of a camera whenever one of `hooks` that records is told of a sighting there.
pub(crate) async fn record_sightings(
    hooks: Vec<HookConfig>,
    board: Arc<Board>,
    recorder: Arc<Recorder>,
) {
    let mut sightings = board.sightings();
    loop {
        let sighting = match sightings.recv().await {
            Ok(sighting) => sighting,
            Err(RecvError::Lagged(lost)) => {
                tracing::warn!(lost, "sightings came too fast, and began no recording");
                continue;
            }
            Err(RecvError::Closed) => return,
        };
        if hooks.iter().any(|hook| hook.record && hook.hears(&sighting)) {
            recorder.event(board.camera_place(&sighting.camera), &reason(&sighting));
        }
    }
}

fn reason(sighting: &Sighting) -> String {
    let class = &sighting.class;
    match sighting.event {
        SightingEvent::Appeared => format!("{class} appeared"),
        SightingEvent::Left => format!("{class} left"),
    }
}
