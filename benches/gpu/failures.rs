//! Records the messages of the program when a provider is missing and when memory runs out.

use super::arguments::{Arguments, without_folder};
use super::pieces::{Row, Table, TableName};
use albireo_core::geometry::PictureSize;
use albireo_vision::detector::{
    CameraSlot, DetectorConfig, DetectorHandle, DetectorNetwork, ExecutionProvider, GpuConfig,
    ModelStatus,
};
use albireo_vision::picture::Picture;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// An arena that is too small for any model, in MiB.
const TOO_SMALL: u32 = 1;

pub(crate) fn table() -> Table {
    Table {
        heading: "When a provider is missing or memory runs out",
        text: "What was done, and what the program said, word for word.".to_owned(),
        columns: &["what", "what was said"],
    }
}

/// A row per failure, with its cause and the message.
pub(crate) async fn measure(arguments: &Arguments) -> anyhow::Result<Vec<Row>> {
    let model = arguments.models()?.swap_remove(0);
    let mut rows = Vec::new();
    let mut row = |what: String, said: String| {
        rows.push(Row {
            table: TableName::Failures,
            cells: vec![what, without_folder(said, &model)],
        });
    };
    for provider in [
        ExecutionProvider::TensorRt,
        ExecutionProvider::Cuda,
        ExecutionProvider::Cpu,
    ] {
        let config = DetectorConfig {
            providers: vec![provider],
            ..arguments.detector_with(&model, None)
        };
        row(
            format!("`detector.providers = [\"{}\"]`", provider.as_str()),
            opened(&config),
        );
    }
    let config = arguments.detector_with(&model, None);
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
    Ok(rows)
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
    let ready = |status: &ModelStatus| matches!(status, ModelStatus::Ready { .. });
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
