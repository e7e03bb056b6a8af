//! Every number of the expected-loss policy, the threshold aside, with the values that were found on recorded
//! sequences. `s = √(w·h)` is the size of a box.

use serde::{Deserialize, Serialize};

/// What a user of the policy may set, the threshold aside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedLossSettings {
    /// What is made of the pixels of frames that are answered without the detector.
    pub pixels: Pixels,
    /// The detector is called when its last call was this many frames ago.
    pub longest_pause: u32,
    /// Frames without any answer of the detector after which all objects are forgotten.
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

/// What is made of the pixels of frames that are answered without the detector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pixels {
    /// Nothing: such a frame is not even decoded.
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
/// What is left of the centre's velocity after a frame.
pub(in crate::policy) const CENTER_FADING: f64 = 0.985;
/// What is left of the log-sides' velocity after a frame.
pub(in crate::policy) const SIZE_FADING: f64 = 0.95;
/// Largest growth of ln s per frame that the motion takes into account.
pub(in crate::policy) const LARGEST_GROWTH: f64 = 0.15;
/// Standard deviation of a new object's centre velocity, in s per frame.
pub(in crate::policy) const NEWCOMER_CENTER_VELOCITY: f64 = 0.2;
/// Standard deviation of a new object's log-side velocity per frame.
pub(in crate::policy) const NEWCOMER_SIZE_VELOCITY: f64 = 0.08;

// The scale α of an object's covariance, from the normalised innovations of its updates.
/// Weight of a new innovation in an object's α.
pub(in crate::policy) const ALPHA_RATE: f64 = 0.2;
/// Weight of a new innovation in the camera's ᾱ, with which new objects start.
pub(in crate::policy) const CAMERA_ALPHA_RATE: f64 = 0.1;
/// A squared normalised innovation counts at most so much.
pub(in crate::policy) const LARGEST_INNOVATION: f64 = 25.0;
/// Smallest α.
pub(in crate::policy) const LEAST_ALPHA: f64 = 0.1;
/// Largest α.
pub(in crate::policy) const MOST_ALPHA: f64 = 8.0;

// The gates of the two stages of matching; the class is ignored.
/// Stage 1 accepts intersection over union of this or more.
pub(in crate::policy) const IOU_GATE: f64 = 0.3;
/// Stage 2 accepts squared Mahalanobis distances below this: the 95 % quantile of χ² with four
/// degrees of freedom.
pub(in crate::policy) const MAHALANOBIS_GATE: f64 = 9.49;

// Birth and removal.
/// An unmatched detection of this confidence or more becomes an object. Less confident ones can only
/// prolong an object that is known. (With detections of at least 0.5 the value makes no difference;
/// on the recordings every detection that is let in pays.)
pub(in crate::policy) const BIRTH_CONFIDENCE: f64 = 0.1;
/// Detector frames in a row without a match at which an object is removed.
pub(in crate::policy) const MISSES_TO_REMOVAL: u32 = 6;
/// An object is removed when less of its predicted box than this share lies in the picture.
pub(in crate::policy) const LEAST_VISIBLE: f64 = 0.1;
/// Matches that make an object confirmed, its first detection included. Only confirmed objects teach
/// the velocity of newcomers.
pub(in crate::policy) const HITS_TO_CONFIRM: u32 = 3;
/// Weight of the ridge in the regression of newcomers' velocities.
pub(in crate::policy) const VELOCITY_RIDGE: f64 = 5.0;
/// What is left of the regression's memory after a detector frame.
pub(in crate::policy) const VELOCITY_MEMORY: f64 = 0.98;
/// Largest velocity the regression may give a newcomer, in s (centre) or 1 (log-sides) per frame.
pub(in crate::policy) const LARGEST_VELOCITY: f64 = 0.3;
/// Smallest side of a reported box, pixels.
pub(in crate::policy) const LEAST_SIDE: f64 = 1.0;

// How the confidence of a box is derived from the scores of its object's detections.
/// Smallest weight of a new score in the moving average m.
pub(in crate::policy) const SCORE_RATE: f64 = 0.3;
/// Weight of the last score against m.
pub(in crate::policy) const LAST_SCORE: f64 = 0.4;
/// What a newcomer's confidence is reduced by.
pub(in crate::policy) const NEWCOMER: f64 = 0.2;
/// How fast that reduction fades with hits.
pub(in crate::policy) const NEWCOMER_FADING: f64 = 0.7;
/// What the predicted miss probability takes at most.
pub(in crate::policy) const PREDICTION: f64 = 0.6;
/// What is left of the confidence after each miss.
pub(in crate::policy) const MISS_CONFIDENCE: f64 = 0.75;
/// A missed object below this is not reported.
pub(in crate::policy) const LEAST_CONFIDENCE: f64 = 0.05;

// When the expected loss calls the detector.
/// What is left of an object's weight after each miss: what the detector did not find it will
/// hardly find now.
pub(in crate::policy) const MISS_WEIGHT: f64 = 0.5;
/// Weight of the objects that may have appeared unseen.
pub(in crate::policy) const BIRTH_WEIGHT: f64 = 0.7;
/// Memory of the birth rate, frames.
pub(in crate::policy) const BIRTH_MEMORY: f64 = 60.0;
/// The birth rate before anything was seen, summed scores per frame.
pub(in crate::policy) const BIRTH_PRIOR: f64 = 0.05;
/// Memory of the mean summed confidence N̄, frames.
pub(in crate::policy) const CROWD_MEMORY: f64 = 100.0;
/// N̄ before anything was seen.
pub(in crate::policy) const CROWD_PRIOR: f64 = 2.0;
/// N̄ counts at least so much.
pub(in crate::policy) const LEAST_CROWD: f64 = 0.5;

// How boxes are followed in pictures, and what is believed of it.
/// Columns of the requested grey picture.
pub(in crate::policy) const FLOW_WIDTH: u32 = 320;
/// Points along each side of the grid in a box.
pub(in crate::policy) const FLOW_GRID: u32 = 4;
/// Sizes of the picture that points are searched in, coarse to fine.
pub(in crate::policy) const FLOW_LEVELS: u32 = 3;
/// No box is followed over more frames than this from the last picture that was looked at.
pub(in crate::policy) const LONGEST_GAP: u32 = 5;
/// Where the followed box begins: the share of the detector's box against the filter's.
pub(in crate::policy) const DETECTED_SHARE: f64 = 0.8;
/// Noise of the centre's measured shift, in s.
pub(in crate::policy) const CENTER_NOISE: f64 = 0.01;
/// Noise of the same, pixels of the grey picture.
pub(in crate::policy) const PIXEL_NOISE: f64 = 0.1;
/// Noise of the measured growth of the log-sides.
pub(in crate::policy) const SIZE_NOISE: f64 = 0.01;
/// How much a spread of one lowers the reliability of the flow.
pub(in crate::policy) const SPREAD_WEIGHT: f64 = 4.0;
/// How much an unreliable flow lowers an object's health, at most.
pub(in crate::policy) const DOUBT: f64 = 0.7;
/// What is left of an object's health where it could not be followed.
pub(in crate::policy) const LOST_HEALTH: f64 = 0.5;
/// A side of a box that lies so near to the picture's border, pixels of the grey picture, stays there while what
/// is inside moves away from it.
pub(in crate::policy) const BORDER: f64 = 4.0;
/// With the first picture, takes the place of [`BIRTH_PRIOR`]: where followed boxes are seldom lost, most of
/// what a call brings is new objects.
pub(in crate::policy) const FLOW_BIRTH_PRIOR: f64 = 0.1;

/// The schedules that share the objects of `expected-loss`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InTracker {
    /// `fixed-skip-in-tracker`: the detector runs on one frame in this many. Need not be whole.
    pub n: f64,
    /// `even-skip-in-tracker`: share of the frames to skip.
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
