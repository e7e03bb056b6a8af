//! Counts what a camera sends, before anything is left out: frames, broken ones, and complaints about them.

use albireo_vision::recordings::PassedOver;
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What a camera has sent since the node started.
#[derive(Debug, Default)]
pub(crate) struct Arrivals {
    frames: AtomicU64,
    broken: AtomicU64,
    complaints: AtomicU64,
    /// The last complaint.
    complaint: Mutex<Option<Arc<str>>>,
    passed_over: AtomicU64,
    /// The last file that was passed over, and why.
    last_passed_over: Mutex<Option<Arc<str>>>,
}

/// The counts of [`Arrivals`] at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArrivalCounts {
    /// Frames that came, also those above the camera's `max_rate`.
    pub frames: u64,
    /// Frames of these that are broken: from a complaint of the decoder to the next whole key frame.
    pub broken: u64,
    /// Complaints of the decoder.
    pub complaints: u64,
    /// Video files that could not be played, if its source is several.
    pub passed_over: u64,
}

impl Arrivals {
    /// Counts a frame.
    pub(crate) fn frame(&self, is_broken: bool) {
        self.frames.fetch_add(1, Ordering::Relaxed);
        self.broken.fetch_add(u64::from(is_broken), Ordering::Relaxed);
    }

    /// Counts a frame of a camera whose decoder nobody hears.
    pub(crate) fn whole_frame(&self) {
        self.frame(false);
    }

    /// Counts a complaint of the decoder.
    pub(crate) fn complaint(&self, text: &str) {
        self.complaints.fetch_add(1, Ordering::Relaxed);
        *self.complaint.lock() = Some(text.into());
    }

    /// Counts a video file that cannot be played.
    pub(crate) fn passed_over(&self, file: &PassedOver) {
        self.passed_over.fetch_add(1, Ordering::Relaxed);
        *self.last_passed_over.lock() = Some(file.to_string().into());
    }

    /// The last video file that could not be played, and why.
    pub(crate) fn last_passed_over(&self) -> Option<Arc<str>> {
        self.last_passed_over.lock().clone()
    }

    /// The present counts.
    pub(crate) fn now(&self) -> ArrivalCounts {
        ArrivalCounts {
            frames: self.frames.load(Ordering::Relaxed),
            broken: self.broken.load(Ordering::Relaxed),
            complaints: self.complaints.load(Ordering::Relaxed),
            passed_over: self.passed_over.load(Ordering::Relaxed),
        }
    }

    /// The last complaint.
    pub(crate) fn last_complaint(&self) -> Option<Arc<str>> {
        self.complaint.lock().clone()
    }
}
