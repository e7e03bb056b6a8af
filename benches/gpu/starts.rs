//! Measures the time from the start of the process to the arrival of the first detection, with empty and with full
//! caches.

use super::arguments::{Arguments, Policy, name_of};
use super::node::{Node, PATIENCE, Settings};
use super::page::{NONE, median};
use super::pieces::{Row, Table, TableName};
use super::stages::frames;
use albireo_vision::picture::EncodedPicture;
use anyhow::bail;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The number of starts with full caches.
const WARM: usize = 3;

pub(crate) fn table() -> Table {
    Table {
        heading: "From start to first detection",
        text: format!(
            "A node in a new process, a camera that sends at 30 frames per second all the while: seconds from the process's start until \
             its first detections arrive. *Cold*: CUDA's cache of kernels (`CUDA_CACHE_PATH`) and TensorRT's of engines \
             (`detector.gpu.engine_cache`) are empty folders; *warm*: the same folders again, the median of {WARM}. The CPU provider \
             has no such cache, and the system's cache of files is never emptied.",
        ),
        columns: &["model", "provider used", "cold, s", "warm, s"],
    }
}

pub(crate) async fn measure(arguments: &Arguments, model: &Path) -> anyhow::Result<Vec<Row>> {
    let pictures = Arc::new(frames()?);
    let caches = tempfile::tempdir()?;
    let (cold, provider) = start(arguments, model, &pictures, caches.path()).await?;
    let mut warm = Vec::new();
    for _ in 0..WARM {
        warm.push(start(arguments, model, &pictures, caches.path()).await?.0);
    }
    let warm = median(&warm).map_or_else(|| NONE.to_owned(), |seconds| format!("{seconds:.2}"));
    Ok(vec![Row {
        table: TableName::Starts,
        cells: vec![name_of(model), provider, format!("{cold:.2}"), warm],
    }])
}

/// Starts a node; returns the seconds to its first detection, and the provider that it uses.
async fn start(
    arguments: &Arguments,
    model: &Path,
    pictures: &Arc<Vec<EncodedPicture>>,
    caches: &Path,
) -> anyhow::Result<(f64, String)> {
    let folder = tempfile::tempdir()?;
    let vanilla = Policy {
        name: "vanilla".to_owned(),
        threshold: None,
    };
    let mut node = Node::start(&Settings {
        detector: arguments.detector_with(model, Some(caches)),
        policy: &vanilla,
        cameras: 1,
        caches,
        folder: folder.path(),
    })
    .await?;
    let started = node.started;
    let mut provider = None;
    let mut sent = 0;
    let first = loop {
        // Sends 2 s of frames at a time, to notice a node that has exited.
        let until = || node.first_detection().is_some();
        node.send(0, Arc::clone(pictures), sent..sent + 60, until).await?;
        sent += 60;
        if let Some(first) = node.first_detection() {
            break first;
        }
        if started.elapsed() > PATIENCE {
            bail!("no detection within {} s", PATIENCE.as_secs());
        }
        // Reports the reason if the node has exited.
        let ready = tokio::time::timeout(Duration::from_millis(100), node.ready(folder.path()));
        if let Ok(ready) = ready.await {
            provider = Some(ready?);
        }
    };
    let provider = match provider {
        Some(provider) => provider,
        None => node.ready(folder.path()).await?,
    };
    Ok(((first - started).as_secs_f64(), provider))
}
