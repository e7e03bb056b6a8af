//! Measures the time from the start of the process to the arrival of the first detection, with empty and with full
//! caches.

use super::arguments::{Arguments, name_of, without_folder};
use super::node::{Node, PATIENCE, Settings};
use super::page::{NONE, Page, median};
use albireo_vision::picture::EncodedPicture;
use anyhow::bail;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The number of starts with full caches.
const WARM: usize = 3;

pub(crate) async fn write(
    page: &mut Page,
    arguments: &Arguments,
    frames: &[EncodedPicture],
) -> anyhow::Result<()> {
    let pictures = Arc::new(frames.to_vec());
    let mut rows = Vec::new();
    for model in arguments.models()? {
        eprintln!("starts with {}", name_of(&model));
        let caches = tempfile::tempdir()?;
        let mut row = vec![name_of(&model)];
        let mut warm = Vec::new();
        for number in 0..=WARM {
            match start(arguments, &model, &pictures, caches.path()).await {
                Ok((seconds, provider)) if number == 0 => {
                    row.extend([provider, format!("{seconds:.2}")]);
                }
                Ok((seconds, _)) => warm.push(seconds),
                Err(error) => {
                    row.push(without_folder(format_args!("{error:#}"), &model));
                    break;
                }
            }
        }
        row.push(median(&warm).map_or_else(|| NONE.to_owned(), |seconds| format!("{seconds:.2}")));
        row.resize(4, NONE.to_owned());
        rows.push(row);
    }
    page.heading("From start to first detection");
    page.text(format!(
        "A node in a new process, a camera that sends at 30 frames per second all the while: seconds from the process's start until \
         its first detections arrive. *Cold*: CUDA's cache of kernels (`CUDA_CACHE_PATH`) and TensorRT's of engines \
         (`detector.gpu.engine_cache`) are empty folders; *warm*: the same folders again, the median of {WARM}. The CPU provider \
         has no such cache, and the system's cache of files is never emptied.",
    ));
    page.table(&["model", "provider used", "cold, s", "warm, s"], &rows);
    Ok(())
}

async fn start(
    arguments: &Arguments,
    model: &Path,
    pictures: &Arc<Vec<EncodedPicture>>,
    caches: &Path,
) -> anyhow::Result<(f64, String)> {
    let folder = tempfile::tempdir()?;
    let mut node = Node::start(&Settings {
        detector: arguments.detector(model, Some(caches)),
        policy: "vanilla",
        cameras: 1,
        caches,
        folder: folder.path(),
    })
    .await?;
    let (started, mut provider) = (node.started, None);
    let first = loop {
        // Sends 2 s of frames at a time, to notice a node that has exited.
        let until = || node.first_detection().is_some();
        node.send(0, Arc::clone(pictures), 60, until).await?;
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
