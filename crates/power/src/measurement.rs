//! The handles by which a camera reports its work and asks for its energy.

use crate::account::Measured;
use crate::sampler::PowerHandle;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// One of the cameras between which the node's energy is divided. It is cheap to clone, and forgotten with its last clone.
#[derive(Clone, Debug)]
pub struct CameraEnergy(Arc<Registered>);

#[derive(Debug)]
struct Registered {
    number: u64,
    power: PowerHandle,
}

impl Drop for Registered {
    fn drop(&mut self) {
        self.power.account().cameras.remove(self.number);
    }
}

impl CameraEnergy {
    pub(crate) fn new(power: PowerHandle) -> Self {
        let number = power.account().cameras.add();
        Self(Arc::new(Registered { number, power }))
    }

    /// Counts a frame.
    pub fn frame(&self) {
        self.0.power.account().cameras.frame(self.0.number);
    }

    /// Counts a detector call whose run ended at `end`. `used` is the camera's part of the run's time: an even part for
    /// each of its pictures, without any waiting.
    pub fn detector_called(&self, end: Instant, used: Duration) {
        let mut account = self.0.power.account();
        account.detector.called(end, used);
        account.cameras.called(self.0.number, used);
    }

    /// Counts a detector call that was avoided: a frame answered without it by choice.
    pub fn call_avoided(&self) {
        self.0.power.account().cameras.avoided(self.0.number);
    }

    /// Measures from `start` on, which may lie some seconds back.
    pub fn measure(&self, start: Instant) -> Measurement {
        Measurement {
            number: self.0.power.account().open(self.0.number, start),
            camera: self.clone(),
        }
    }
}

/// Energy that is being measured, in constant memory. Dropped, it is forgotten.
#[derive(Debug)]
pub struct Measurement {
    number: u64,
    camera: CameraEnergy,
}

impl Measurement {
    /// Says where the measurement ends if nothing more happens: the energy up to that instant is kept, however late it
    /// turns out that it was the end. It never moves back.
    pub fn until(&self, at: Instant) {
        self.camera.0.power.account().until(self.number, at);
    }

    /// What was used up to `end`. Waits for the first sample after it, at most two intervals and not longer than
    /// `patience`; not at all without a meter.
    pub async fn finish(&self, end: Instant, patience: Duration) -> Option<Measured> {
        let power = &self.camera.0.power;
        power.sampled(end, patience).await;
        let mut account = power.account();
        let measured = account.close(self.number, end);
        drop(account);
        measured
    }
}

impl Drop for Measurement {
    fn drop(&mut self) {
        self.camera.0.power.account().forget(self.number);
    }
}
