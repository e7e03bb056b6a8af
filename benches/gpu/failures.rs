//! Records the messages of the program when a provider is missing and when memory runs out.

use super::arguments::Arguments;
use super::page::Page;
use albireo_core::geometry::PictureSize;
use albireo_vision::detector::{
    CameraSlot, DetectorConfig, DetectorHandle, DetectorNetwork, DetectorStatus, ExecutionProvider,
    GpuConfig,
};
use albireo_vision::picture::Picture;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// An arena that is too small for any model, in MiB.
const TOO_SMALL: u32 = 1;

/// Writes a row per failure, with its cause and the message.
pub(crate) async fn write(page: &mut Page, arguments: &Arguments) -> anyhow::Result<()> {
    eprintln!("refusals");
    let model = arguments.models()?.swap_remove(0);
    let mut rows = Vec::new();
    let mut row = |what: String, said: String| rows.push(vec![what, said]);
    for provider in [
        ExecutionProvider::TensorRt,
        ExecutionProvider::Cuda,
        ExecutionProvider::Cpu,
    ] {
        let config = DetectorConfig {
            providers: vec![provider],
            ..arguments.detector(&model, None)
        };
        row(
            format!("`detector.providers = [\"{}\"]`", provider.as_str()),
            opened(&config),
        );
    }
    let config = arguments.detector(&model, None);
    let too_little = GpuConfig {
        memory_limit_mib: TOO_SMALL,
        ..config.gpu.clone()
    };
    let nowhere = GpuConfig {
        device: 63,
        ..config.gpu.clone()
    };
    for (what, gpu) in [
        (
            format!("`detector.gpu.memory_limit_mib = {TOO_SMALL}`"),
            too_little,
        ),
        ("a GPU with the number 63".to_owned(), nowhere),
    ] {
        let said = if arguments.is_gpu() {
            opened(&DetectorConfig {
                gpu,
                ..config.clone()
            })
        } else {
            "not tried: without meaning for the CPU provider".to_owned()
        };
        row(what, said);
    }
    row(
        "a model whose first run wants 512 TiB".to_owned(),
        opened(&DetectorConfig {
            model: fixture("starving.onnx"),
            ..config.clone()
        }),
    );
    row(
        "a model that wants 512 TiB for one picture of three, while it runs".to_owned(),
        match out_of_memory_while_it_runs(&config).await {
            Ok(said) => said,
            Err(error) => format!("**not as promised**: {error:#}"),
        },
    );
    page.heading("When a provider is missing or memory runs out");
    page.text("What was done, and what the program said, word for word.");
    page.table(&["what", "what was said"], &rows);
    page.text(
        "A GPU that is lost while it runs (`CUDA failure 700`, `719`, `999` and their like, after which nothing works any more in \
         the process) cannot be brought about here without harm to others. What the node does then is tested with the words \
         that ONNX Runtime's source writes, at the seam where sessions are built \
         (`crates/node/src/detector/task/tests/gpu.rs`): the frame is answered from prediction, a new session is tried with \
         growing pauses, and when it fails in the same way the detector is reported as lost and the service manager's watchdog is \
         not fed any more, for only a new process gets a new CUDA context.",
    );
    Ok(())
}

/// The message from opening a detector.
fn opened(config: &DetectorConfig) -> String {
    match DetectorNetwork::open(config) {
        Ok(network) => format!(
            "works; the session runs on `{}`",
            network.provider().as_str()
        ),
        Err(error) => error.to_string(),
    }
}

/// Runs the tests' model that can run out of memory: bright pictures need more than there is, dark ones do not.
async fn out_of_memory_while_it_runs(config: &DetectorConfig) -> anyhow::Result<String> {
    let config = DetectorConfig {
        model: fixture("hungry.onnx"),
        confidence: 0.3,
        ..config.clone()
    };
    let detector = DetectorHandle::start(&config).await?;
    let camera = CameraSlot(0);
    detector.detect(camera, red(102)).await?;
    let Err(said) = detector.detect(camera, red(255)).await else {
        anyhow::bail!("the run was answered");
    };
    let mut status = detector.status();
    let ready = |status: &DetectorStatus| matches!(status, DetectorStatus::Ready { .. });
    tokio::time::timeout(Duration::from_secs(60), status.wait_for(ready)).await??;
    detector.detect(camera, red(102)).await?;
    let counters = detector.counters();
    detector.stop().await;
    anyhow::ensure!(
        (counters.completed, counters.failed, counters.rebuilds) == (2, 1, 1),
        "{counters:?}"
    );
    Ok(format!(
        "\"{said}\"; the session was rebuilt, and the next picture was answered"
    ))
}

fn red(value: u8) -> Arc<Picture> {
    let mut picture = Picture::black(PictureSize::new(128, 64));
    for pixel in picture.pixels.chunks_exact_mut(3) {
        pixel[0] = value;
    }
    Arc::new(picture)
}

fn fixture(name: &str) -> std::path::PathBuf {
    Path::new("tests/fixtures/models").join(name)
}
