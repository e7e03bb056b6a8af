//! The order of a stream's calls, and the errors for calls out of order.

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// The stage of the current frame.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// The frame wants the detector.
    WantsDetector,
    /// The frame is decided.
    Decided,
}

/// The current frame's number and stage; `None` before a stream's first frame.
#[derive(Default)]
pub(crate) struct Order(Option<(u64, Stage)>);

impl Order {
    /// The number of the current frame.
    pub(crate) fn frame(&self) -> Option<u64> {
        self.0.map(|(frame, _)| frame)
    }

    /// True if the current frame wants the detector.
    pub(crate) const fn wants_detector(&self) -> bool {
        matches!(self.0, Some((_, Stage::WantsDetector)))
    }

    /// Returns the number of the next frame, which is `given` or the one that follows, and its distance to the current
    /// one.
    pub(crate) fn next(&self, given: Option<u64>) -> PyResult<(u64, u32)> {
        let Some((last, _)) = self.0 else {
            return Ok((given.unwrap_or(0), 1));
        };
        let next = given.unwrap_or_else(|| last.saturating_add(1));
        if next <= last {
            return Err(PyValueError::new_err(format!(
                "frame {next} cannot follow frame {last}: frame numbers must increase (a new stream begins with reset())"
            )));
        }
        let step = u32::try_from(next - last).unwrap_or(u32::MAX);
        Ok((next, step))
    }

    /// Makes `frame` the current one, which wants the detector.
    pub(crate) const fn wait(&mut self, frame: u64) {
        self.0 = Some((frame, Stage::WantsDetector));
    }

    /// Makes `frame` the current one, which is decided.
    pub(crate) const fn decide(&mut self, frame: u64) {
        self.0 = Some((frame, Stage::Decided));
    }

    /// Returns the current frame's number, and refuses `call` if that frame does not want the detector.
    pub(crate) fn awaited(&self, call: &str) -> PyResult<u64> {
        match self.0 {
            Some((frame, Stage::WantsDetector)) => Ok(frame),
            Some((frame, Stage::Decided)) => Err(PyRuntimeError::new_err(format!(
                "frame {frame} does not want the detector: its boxes are predict(), and {call} belongs to a frame for which \
                 wants_detector() returned True"
            ))),
            None => Err(PyRuntimeError::new_err(format!(
                "call wants_detector(n) before {call}: there is no frame yet"
            ))),
        }
    }

    /// Refuses a call for a frame that is not decided.
    pub(crate) fn require_decided(&self) -> PyResult<()> {
        match self.0 {
            Some((_, Stage::Decided)) => Ok(()),
            Some((frame, Stage::WantsDetector)) => Err(PyRuntimeError::new_err(format!(
                "frame {frame} wants the detector: call update(result) with what it found, or unavailable() when it failed"
            ))),
            None => Err(PyRuntimeError::new_err(
                "call wants_detector(n) first: there is no frame yet",
            )),
        }
    }
}
