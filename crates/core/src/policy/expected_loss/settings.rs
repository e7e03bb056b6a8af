//! All constants and settings of the expected-loss policy except the threshold, with values tuned on recorded
//! sequences. `s = √(w·h)` is the size of a box.

use serde::{Deserialize, Serialize};

/// The user settings of the policy, except the threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedLossSettings {
    /// Use of the pixels of frames answered without the detector.
    pub pixels: Pixels,
    /// The detector is called when its last call was this many frames ago.
    pub longest_pause: u32,
    /// Frames without a detector answer after which all objects are forgotten.
    pub longest_blindness: u32,
}

impl Default for ExpectedLossSettings {
    fn default() -> Self {
        Self {
            pixels: Pixels::Off,
            longest_pause: 15,
            longest_blindness: 30,
        }
    }
}

/// Use of the pixels of frames answered without the detector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pixels {
    /// None: such a frame is not even decoded.
    Off,
    /// The boxes are followed by sparse optical flow.
    Flow,
}

// Constant velocity of the centre and of the logarithms of the sides, slowly fading.
/// Process noise √q of the centre per frame, in s.
pub(in crate::policy) const CENTER_PROCESS: f64 = 0.02;
/// Process noise √q of the log-sides per frame.
pub(in crate::policy) const SIZE_PROCESS: f64 = 0.015;
/// Measurement noise √R of the centre, in s.
pub(in crate::policy) const CENTER_MEASUREMENT: f64 = 0.025;
/// Measurement noise √R of the log-sides.
pub(in crate::policy) const SIZE_MEASUREMENT: f64 = 0.06;
/// Factor on the centre's velocity per frame.
pub(in crate::policy) const CENTER_FADING: f64 = 0.985;
/// Factor on the log-sides' velocity per frame.
pub(in crate::policy) const SIZE_FADING: f64 = 0.95;
/// Largest growth of ln s per frame in the motion model.
pub(in crate::policy) const LARGEST_GROWTH: f64 = 0.15;
/// Standard deviation of a new object's centre velocity, in s per frame.
pub(in crate::policy) const NEWCOMER_CENTER_VELOCITY: f64 = 0.2;
/// Standard deviation of a new object's log-side velocity per frame.
pub(in crate::policy) const NEWCOMER_SIZE_VELOCITY: f64 = 0.08;

// The scale α of an object's covariance, from the normalised innovations of its updates.
/// Weight of a new innovation in an object's α.
pub(in crate::policy) const ALPHA_RATE: f64 = 0.2;
/// Weight of a new innovation in the camera's ᾱ, the initial α of new objects.
pub(in crate::policy) const CAMERA_ALPHA_RATE: f64 = 0.1;
/// Upper limit of a squared normalised innovation.
pub(in crate::policy) const LARGEST_INNOVATION: f64 = 25.0;
/// Smallest α.
pub(in crate::policy) const LEAST_ALPHA: f64 = 0.1;
/// Largest α.
pub(in crate::policy) const MOST_ALPHA: f64 = 8.0;

// The gates of the two stages of matching; the class is ignored.
/// Stage 1 accepts an intersection over union of at least this.
pub(in crate::policy) const IOU_GATE: f64 = 0.3;
/// Stage 2 accepts squared Mahalanobis distances below this: the 95 % quantile of χ² with four degrees of freedom.
pub(in crate::policy) const MAHALANOBIS_GATE: f64 = 9.49;

// Birth and removal.
/// An unmatched detection of at least this confidence creates an object. Less confident ones can only prolong a known
/// object. (With detections of at least 0.5 the value makes no difference; on the recordings, every detection that is
/// let in pays off.)
pub(in crate::policy) const BIRTH_CONFIDENCE: f64 = 0.1;
/// Consecutive detector frames without a match after which an object is removed.
pub(in crate::policy) const MISSES_TO_REMOVAL: u32 = 6;
/// An object is removed when less than this share of its predicted box lies in the picture.
pub(in crate::policy) const LEAST_VISIBLE: f64 = 0.1;
/// Matches that confirm an object, including its first detection. Newcomers' velocities are learnt only from confirmed
/// objects.
pub(in crate::policy) const HITS_TO_CONFIRM: u32 = 3;
/// Weight of the ridge in the regression of newcomers' velocities.
pub(in crate::policy) const VELOCITY_RIDGE: f64 = 5.0;
/// Factor on the regression's memory per detector frame.
pub(in crate::policy) const VELOCITY_MEMORY: f64 = 0.98;
/// Largest velocity that the regression may give a newcomer, in s (centre) or 1 (log-sides) per frame.
pub(in crate::policy) const LARGEST_VELOCITY: f64 = 0.3;
/// Smallest side of a reported box, pixels.
pub(in crate::policy) const LEAST_SIDE: f64 = 1.0;

// Derivation of a box's confidence from the scores of its object's detections.
/// Smallest weight of a new score in the moving average m.
pub(in crate::policy) const SCORE_RATE: f64 = 0.3;
/// Weight of the last score relative to m.
pub(in crate::policy) const LAST_SCORE: f64 = 0.4;
/// Reduction of a newcomer's confidence.
pub(in crate::policy) const NEWCOMER: f64 = 0.2;
/// Rate at which that reduction fades with hits.
pub(in crate::policy) const NEWCOMER_FADING: f64 = 0.7;
/// Largest reduction by the predicted miss probability.
pub(in crate::policy) const PREDICTION: f64 = 0.6;
/// Factor on the confidence per miss.
pub(in crate::policy) const MISS_CONFIDENCE: f64 = 0.75;
/// Smallest confidence of a reported missed object.
pub(in crate::policy) const LEAST_CONFIDENCE: f64 = 0.05;

// Detector calls by the expected loss.
/// Factor on an object's weight per miss: the detector will hardly find now what it did not find before.
pub(in crate::policy) const MISS_WEIGHT: f64 = 0.5;
/// Weight of objects that may have appeared unseen.
pub(in crate::policy) const BIRTH_WEIGHT: f64 = 0.7;
/// Memory of the birth rate, frames.
pub(in crate::policy) const BIRTH_MEMORY: f64 = 60.0;
/// Prior birth rate, summed scores per frame.
pub(in crate::policy) const BIRTH_PRIOR: f64 = 0.05;
/// Memory of the mean summed confidence N̄, frames.
pub(in crate::policy) const CROWD_MEMORY: f64 = 100.0;
/// Prior of N̄.
pub(in crate::policy) const CROWD_PRIOR: f64 = 2.0;
/// Lower limit of N̄.
pub(in crate::policy) const LEAST_CROWD: f64 = 0.5;

// Following of boxes in pictures, and its reliability.
/// Width of the requested grey picture, pixels.
pub(in crate::policy) const FLOW_WIDTH: u32 = 320;
/// Points along each side of the grid in a box.
pub(in crate::policy) const FLOW_GRID: usize = 4;
/// Maximum number of frames from the last picture used over which boxes are followed.
pub(in crate::policy) const LONGEST_GAP: u32 = 5;
/// Start of the followed box: the weight of the detector's box against the filter's.
pub(in crate::policy) const DETECTED_SHARE: f64 = 0.8;
/// Noise of the centre's measured shift, in s.
pub(in crate::policy) const CENTER_NOISE: f64 = 0.01;
/// Noise of the centre's measured shift, pixels of the grey picture.
pub(in crate::policy) const PIXEL_NOISE: f64 = 0.1;
/// Noise of the measured growth of the log-sides.
pub(in crate::policy) const SIZE_NOISE: f64 = 0.01;
/// Reduction of the flow's reliability per unit of spread.
pub(in crate::policy) const SPREAD_WEIGHT: f64 = 4.0;
/// Largest reduction of an object's health by an unreliable flow.
pub(in crate::policy) const DOUBT: f64 = 0.7;
/// Factor on an object's health if it could not be followed.
pub(in crate::policy) const LOST_HEALTH: f64 = 0.5;
/// Distance from the picture's border, pixels of the grey picture, within which a side of a box stays there while the
/// inside moves away.
pub(in crate::policy) const BORDER: f64 = 4.0;
/// Replaces [`BIRTH_PRIOR`] from the first picture on: if followed boxes are seldom lost, a call mostly brings new
/// objects.
pub(in crate::policy) const FLOW_BIRTH_PRIOR: f64 = 0.1;

/// The schedules that share the objects of `expected-loss`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InTracker {
    /// `fixed-skip-in-tracker`: the detector runs on one frame in this many. May be fractional.
    pub n: f64,
    /// `even-skip-in-tracker`: share of frames to skip.
    pub skip_rate: f64,
}

impl Default for InTracker {
    fn default() -> Self {
        Self {
            n: 2.0,
            skip_rate: 0.5,
        }
    }
}
