//! What the queue costs: frames of several cameras through the shared detector, against the same model in a plain
//! loop.

use super::samples::median;
use albireo::detector::{CameraSlot, DetectorHandle, Network};
use albireo::frame::Picture;
use std::sync::Arc;
use std::time::Instant;

/// Cameras that ask at the same time, so that a picture always waits.
pub const CAMERAS: usize = 3;

/// Frames per second of each round.
#[derive(Default)]
pub struct Throughput {
    queued: Vec<f64>,
    looped: Vec<f64>,
    model_alone: Vec<f64>,
}

impl Throughput {
    /// The pictures once through the plain loop.
    pub fn run_loop(
        &mut self,
        network: &mut Network,
        pictures: &[Arc<Picture>],
    ) -> anyhow::Result<()> {
        let mut model = 0.0;
        let start = Instant::now();
        for picture in pictures {
            let prepared = network.preparation().prepare(picture)?;
            model += network.detect(&prepared)?.model.as_secs_f64();
        }
        let frames = pictures.len() as f64;
        self.looped.push(frames / start.elapsed().as_secs_f64());
        self.model_alone.push(frames / model);
        Ok(())
    }

    /// The pictures once through the queue, dealt out to the cameras.
    pub async fn run_queue(
        &mut self,
        detector: &DetectorHandle,
        pictures: &[Arc<Picture>],
    ) -> anyhow::Result<()> {
        let start = Instant::now();
        let cameras: Vec<_> = (0..CAMERAS)
            .map(|camera| {
                let detector = detector.clone();
                let own: Vec<_> = pictures
                    .iter()
                    .skip(camera)
                    .step_by(CAMERAS)
                    .cloned()
                    .collect();
                tokio::spawn(async move {
                    for picture in own {
                        detector.detect(CameraSlot(camera), picture).await?;
                    }
                    anyhow::Ok(())
                })
            })
            .collect();
        for camera in cameras {
            camera.await??;
        }
        let frames = pictures.len() as f64;
        self.queued.push(frames / start.elapsed().as_secs_f64());
        Ok(())
    }

    /// The lines under the table.
    pub fn print(&self) {
        let ratio = |base: &[f64]| {
            let ratios: Vec<_> = self
                .queued
                .iter()
                .zip(base)
                .map(|(one, of)| one / of)
                .collect();
            median(&ratios)
        };
        println!(
            "Frames queued by {CAMERAS} cameras: {:.1} frames/s, which is {:.3} of the same session with\n\
             letterbox and head in a plain loop ({:.1}), and {:.3} of the session alone ({:.1}).",
            median(&self.queued),
            ratio(&self.looped),
            median(&self.looped),
            ratio(&self.model_alone),
            median(&self.model_alone),
        );
    }
}
