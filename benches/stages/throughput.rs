//! Measures the cost of the queue: frames of several cameras through the shared detector, against the same model in a
//! plain loop. Also measures the gain from decoding a camera's next frame while the model runs.

use super::decode_for;
use super::samples::median;
use albireo_vision::detector::{CameraSlot, DetectorHandle, DetectorNetwork, PreparedPicture};
use albireo_vision::picture::{EncodedPicture, Picture};
use std::sync::Arc;
use std::time::Instant;
use tokio::task::JoinHandle;

/// The number of cameras that call at the same time, so that a picture always waits.
pub(crate) const CAMERAS: usize = 3;

/// When a camera's frame is decoded and prepared.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum MadeReady {
    /// When its turn comes.
    InTurn,
    /// While the model runs on the frame before.
    Ahead,
}

/// The frames per second of each round.
#[derive(Default)]
pub(crate) struct Throughput {
    queued: Vec<f64>,
    looped: Vec<f64>,
    model_alone: Vec<f64>,
    model_queued: Vec<f64>,
    one_after_the_other: Vec<f64>,
    ahead: Vec<f64>,
}

impl Throughput {
    /// Runs all pictures through the plain loop once.
    pub(crate) fn run_loop(
        &mut self,
        network: &mut DetectorNetwork,
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

    /// Runs all pictures through the queue once, distributed over the cameras.
    pub(crate) async fn run_queue(
        &mut self,
        detector: &DetectorHandle,
        pictures: &[Arc<Picture>],
    ) -> anyhow::Result<()> {
        let start = Instant::now();
        let mut cameras = Vec::new();
        for camera in 0..CAMERAS {
            let detector = detector.clone();
            let own: Vec<_> = pictures.iter().skip(camera).step_by(CAMERAS).cloned().collect();
            cameras.push(tokio::spawn(async move {
                let mut model = 0.0;
                for picture in own {
                    let detected = detector.detect(CameraSlot(camera), picture).await?;
                    model += detected.output.model.as_secs_f64();
                }
                anyhow::Ok(model)
            }));
        }
        let mut model = 0.0;
        for camera in cameras {
            model += camera.await??;
        }
        let frames = pictures.len() as f64;
        self.model_queued.push(frames / model);
        self.queued.push(frames / start.elapsed().as_secs_f64());
        Ok(())
    }

    /// Runs all frames of one camera, including decoding.
    pub(crate) async fn run_camera(
        &mut self,
        detector: &DetectorHandle,
        frames: &[EncodedPicture],
        made_ready: MadeReady,
    ) -> anyhow::Result<()> {
        let start = Instant::now();
        let mut next = frames.first().map(|frame| make_ready(detector, frame));
        for number in 1..=frames.len() {
            let Some(ready) = next.take() else { break };
            let ready = ready.await??;
            let following = || frames.get(number).map(|frame| make_ready(detector, frame));
            if made_ready == MadeReady::Ahead {
                next = following();
            }
            detector.detect_prepared(CameraSlot(0), ready).await?;
            if made_ready == MadeReady::InTurn {
                next = following();
            }
        }
        let rate = frames.len() as f64 / start.elapsed().as_secs_f64();
        match made_ready {
            MadeReady::Ahead => self.ahead.push(rate),
            MadeReady::InTurn => self.one_after_the_other.push(rate),
        }
        Ok(())
    }

    /// The lines under the table.
    pub(crate) fn print(&self) {
        let ratio_of = |rates: &[f64], base: &[f64]| {
            let ratios: Vec<_> = rates.iter().zip(base).map(|(rate, base)| rate / base).collect();
            median(&ratios)
        };
        let ratio = |base: &[f64]| ratio_of(&self.queued, base);
        println!(
            "Frames queued by {CAMERAS} cameras: {:.1} frames/s, which is {:.3} of the same session with\n\
             letterbox and head in a plain loop ({:.1}), and {:.3} of the session alone ({:.1}).",
            median(&self.queued),
            ratio(&self.looped),
            median(&self.looped),
            ratio(&self.model_alone),
            median(&self.model_alone),
        );
        println!(
            "(While it is queued for, the model itself runs at {:.3} of its speed alone.)",
            ratio_of(&self.model_queued, &self.model_alone),
        );
        println!(
            "One camera, decoding included: {:.1} frames/s; with the next frame made ready while\n\
             the model runs {:.1}, which is {:.3} of that and {:.3} of the session alone.",
            median(&self.one_after_the_other),
            median(&self.ahead),
            ratio_of(&self.ahead, &self.one_after_the_other),
            ratio_of(&self.ahead, &self.model_alone),
        );
    }
}

/// Decodes a frame and prepares it for the detector, on a blocking thread.
fn make_ready(
    detector: &DetectorHandle,
    frame: &EncodedPicture,
) -> JoinHandle<anyhow::Result<PreparedPicture>> {
    let frame = frame.clone();
    let preparation = detector.preparation().clone();
    tokio::task::spawn_blocking(move || {
        let mut picture = Picture::default();
        decode_for(preparation.format(), &frame, &mut picture)?;
        Ok(preparation.prepare(&picture)?)
    })
}
