//! Whose energy it is when several cameras use one node, and what the detector calls that a policy avoided would have
//! taken of the detector's time.
//!
//! At each sample the node's energy since the sample before is divided between the cameras by the detector time each
//! used lately (older time counts exponentially less, with a time constant of [`MEMORY_S`]). A frame counts as
//! [`FRAME_S`], so that cameras that call no detector divide by their frames. The parts add up to the whole, so the
//! clips of all cameras together never count a joule twice.
//!
//! An avoided call would have taken as long as calls take; all of them together no more than the time for which the
//! one detector had nothing to do.

use crate::totals::CameraTotals;
use std::collections::BTreeMap;
use std::time::Duration;

/// Time constant of a camera's weight, seconds.
const MEMORY_S: f64 = 1.0;

/// What a frame counts beside the detector time, seconds: about what a predicted frame costs the processor.
const FRAME_S: f64 = 1e-4;

/// Weights that have fallen to this stay: they are still those of the last cameras that did anything.
const LEAST_WEIGHT: f64 = 1e-9;

/// Calls over which their mean time is taken.
const CALLS: f64 = 50.0;

/// Idle time of the detector that a call may still use, seconds: it would have begun that much earlier or later.
const LONGEST_IDLE_S: f64 = 1.0;

#[derive(Debug, Default)]
struct Camera {
    weight: f64,
    /// Detector time of the calls avoided since the last sample.
    avoided_s: f64,
    totals: CameraTotals,
}

/// Divides the node's energy.
#[derive(Debug, Default)]
pub(crate) struct Attribution {
    cameras: BTreeMap<u64, Camera>,
    next_number: u64,
    /// Mean time of a call.
    call_s: Option<f64>,
    /// Detector time used since the last sample.
    used_s: f64,
    /// Time for which the detector had nothing to do lately, less what avoided calls were given of it.
    idle_s: f64,
}

impl Attribution {
    /// Takes a camera in; its number.
    pub(crate) fn add(&mut self) -> u64 {
        let number = self.next_number;
        self.next_number += 1;
        self.cameras.insert(number, Camera::default());
        number
    }

    /// Forgets a camera.
    pub(crate) fn remove(&mut self, number: u64) {
        self.cameras.remove(&number);
    }

    /// Counts a frame.
    pub(crate) fn frame(&mut self, number: u64) {
        if let Some(camera) = self.cameras.get_mut(&number) {
            camera.weight += FRAME_S;
        }
    }

    /// Counts a call of the detector that used `used` of its time.
    pub(crate) fn called(&mut self, number: u64, used: Duration) {
        let used = used.as_secs_f64();
        self.used_s += used;
        let mean = self.call_s.unwrap_or(used);
        self.call_s = Some(mean + (used - mean) / CALLS);
        if let Some(camera) = self.cameras.get_mut(&number) {
            camera.weight += used;
        }
    }

    /// Counts a call that was avoided.
    pub(crate) fn avoided(&mut self, number: u64) {
        if let (Some(camera), Some(call_s)) = (self.cameras.get_mut(&number), self.call_s) {
            camera.avoided_s += call_s;
        }
    }

    /// Divides the `joules` of the last `seconds`; the totals of all cameras.
    pub(crate) fn divide(&mut self, joules: f64, seconds: f64) -> Vec<(u64, CameraTotals)> {
        let idle = self.idle_s + seconds - std::mem::take(&mut self.used_s);
        let idle = idle.min(seconds.max(LONGEST_IDLE_S));
        let avoided: f64 = self.cameras.values().map(|camera| camera.avoided_s).sum();
        let saved = avoided.min(idle).max(0.0);
        self.idle_s = idle - saved;
        let weights: f64 = self.cameras.values().map(|camera| camera.weight).sum();
        let cameras = self.cameras.len() as f64;
        let decay = match weights > LEAST_WEIGHT {
            true => (-seconds / MEMORY_S).exp(),
            false => 1.0,
        };
        for camera in self.cameras.values_mut() {
            let share = match weights > 0.0 {
                true => camera.weight / weights,
                false => 1.0 / cameras,
            };
            camera.totals.joules += joules * share;
            if saved > 0.0 {
                camera.totals.saved_s += saved * camera.avoided_s / avoided;
            }
            camera.avoided_s = 0.0;
            camera.weight *= decay;
        }
        let totals = self.cameras.iter();
        totals
            .map(|(number, camera)| (*number, camera.totals))
            .collect()
    }
}

#[cfg(test)]
mod tests;
