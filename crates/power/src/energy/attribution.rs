//! Divides a node's energy between its cameras, and computes the detector time that avoided calls saved.
//!
//! At each sample, the node's energy since the previous sample is divided between the cameras in proportion to their
//! recent detector time (older time decays exponentially, with a time constant of [`MEMORY_S`]). A frame counts as
//! [`FRAME_S`], so cameras that call no detector share by their frames. The shares add up to the whole, so the clips
//! of all cameras together never count a joule twice.
//!
//! An avoided call would have taken the mean time of a call; all avoided calls together, at most the idle time of the
//! one detector.

use crate::energy::totals::Sum;
use std::collections::BTreeMap;
use std::time::Duration;

/// Time constant of a camera's weight, seconds.
const MEMORY_S: f64 = 1.0;

/// The weight of a frame in seconds of detector time: about the processor cost of a predicted frame.
const FRAME_S: f64 = 1e-4;

/// Weights do not decay below this: they still belong to the cameras that were active last.
const LEAST_WEIGHT: f64 = 1e-9;

/// The number of calls over which the mean call time is taken.
const CALLS: f64 = 50.0;

/// Idle detector time that avoided calls may still use, seconds: a call could begin that much earlier or later.
const LONGEST_IDLE_S: f64 = 1.0;

#[derive(Debug, Default)]
struct Camera {
    weight: f64,
    /// Detector time of the calls avoided since the last sample.
    avoided_s: f64,
    totals: Sum,
}

/// Divides the node's energy.
#[derive(Debug, Default)]
pub(crate) struct Attribution {
    cameras: BTreeMap<u64, Camera>,
    next_number: u64,
    /// The mean time of a call.
    call_s: Option<f64>,
    /// Detector time used since the last sample.
    used_s: f64,
    /// Recent idle time of the detector, less the part already assigned to avoided calls.
    idle_s: f64,
}

impl Attribution {
    /// Adds a camera and returns its number.
    pub(crate) fn add(&mut self) -> u64 {
        let number = self.next_number;
        self.next_number += 1;
        self.cameras.insert(number, Camera::default());
        number
    }

    /// Removes a camera.
    pub(crate) fn remove(&mut self, number: u64) {
        self.cameras.remove(&number);
    }

    /// Counts a frame.
    pub(crate) fn frame(&mut self, number: u64) {
        self.cameras.entry(number).or_default().weight += FRAME_S;
    }

    /// Counts a detector call that took `used` of detector time.
    pub(crate) fn called(&mut self, number: u64, used: Duration) {
        let used = used.as_secs_f64();
        self.used_s += used;
        let mean = self.call_s.unwrap_or(used);
        self.call_s = Some(mean + (used - mean) / CALLS);
        self.cameras.entry(number).or_default().weight += used;
    }

    /// Counts an avoided call.
    pub(crate) fn avoided(&mut self, number: u64) {
        let camera = self.cameras.entry(number).or_default();
        camera.avoided_s += self.call_s.unwrap_or_default();
    }

    /// Divides the `joules` of the last `seconds` and returns the totals of all cameras.
    pub(crate) fn divide(&mut self, joules: f64, seconds: f64) -> Vec<(u64, Sum)> {
        let used_s = std::mem::take(&mut self.used_s);
        let longest_s = seconds.max(LONGEST_IDLE_S);
        let idle_s = (self.idle_s + seconds - used_s).min(longest_s);
        let avoided_s: f64 = self.cameras.values().map(|camera| camera.avoided_s).sum();
        // The one detector could have run the avoided calls only while it was idle.
        let saved_s = avoided_s.min(idle_s).max(0.0);
        self.idle_s = idle_s - saved_s;
        let weights: f64 = self.cameras.values().map(|camera| camera.weight).sum();
        let equal_share = 1.0 / self.cameras.len() as f64;
        let decay = if weights > LEAST_WEIGHT {
            (-seconds / MEMORY_S).exp()
        } else {
            1.0
        };
        for camera in self.cameras.values_mut() {
            let share = if weights > 0.0 {
                camera.weight / weights
            } else {
                equal_share
            };
            camera.totals.joules += joules * share;
            if saved_s > 0.0 {
                camera.totals.seconds += saved_s * camera.avoided_s / avoided_s;
            }
            camera.avoided_s = 0.0;
            camera.weight *= decay;
        }
        self.cameras.iter().map(|(number, camera)| (*number, camera.totals)).collect()
    }
}

#[cfg(test)]
mod tests;
