//! The handles through which a camera reports its work and measures its energy.

use crate::energy::account::Measured;
use crate::sampler::PowerHandle;
use albireo_wire::EnergyQuality;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// A camera that shares the node's energy. Cheap to clone; removed with its last clone.
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

impl PowerHandle {
    /// Adds a camera that shares the node's energy.
    pub fn camera(&self) -> CameraEnergy {
        let number = self.account().cameras.add();
        let power = self.clone();
        CameraEnergy(Arc::new(Registered { number, power }))
    }
}

impl CameraEnergy {
    /// Counts a frame.
    pub fn frame(&self) {
        self.0.power.account().cameras.frame(self.0.number);
    }

    /// Counts a detector call whose run ended at `end`. `used` is the camera's part of the run's time: an equal part
    /// for each of its pictures, without waiting time.
    pub fn detector_called(&self, end: Instant, used: Duration) {
        let mut account = self.0.power.account();
        account.detector.called(end, used);
        account.cameras.called(self.0.number, used);
    }

    /// Counts an avoided detector call: a frame answered without it by choice.
    pub fn call_avoided(&self) {
        self.0.power.account().cameras.avoided(self.0.number);
    }

    /// Begins a measurement at `start`, which may be some seconds ago.
    pub fn measure(&self, start: Instant) -> Measurement {
        Measurement {
            number: self.0.power.account().open(self.0.number, start),
            camera: self.clone(),
        }
    }
}

/// A running energy measurement, in constant memory. Dropping it discards it.
#[derive(Debug)]
pub struct Measurement {
    number: u64,
    camera: CameraEnergy,
}

impl Measurement {
    /// Sets the provisional end: the energy up to that instant is kept, however late it turns out to be the end. It
    /// never moves back.
    pub fn until(&self, at: Instant) {
        self.camera.0.power.account().until(self.number, at);
    }

    /// Returns the energy used until `end`. Waits for the first sample after it, at most `patience` and at most two
    /// intervals, because the meter may have failed. Does not wait without a meter or after sampling has stopped.
    pub async fn finish(&self, end: Instant, patience: Duration) -> Option<Measured> {
        let power = &self.camera.0.power;
        let interval = power.account().interval;
        if power.account().quality != EnergyQuality::Unavailable {
            let limit = end + 2 * interval + Duration::from_millis(50);
            let patient = Instant::now().checked_add(patience).unwrap_or(limit);
            let mut newest = power.newest.clone();
            let reached = newest.wait_for(|newest| *newest >= Some(end));
            let _ = tokio::time::timeout_at(limit.min(patient), reached).await;
        }
        power.account().close(self.number, end)
    }
}

impl Drop for Measurement {
    fn drop(&mut self) {
        self.camera.0.power.account().forget(self.number);
    }
}
