//! Every number of the expected-loss policy, the knob aside, with the values that were found on recorded
//! sequences.

use serde::{Deserialize, Serialize};

/// The settings of the expected-loss policy. `s = √(w·h)` is the size of a box.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExpectedLossSettings {
    /// How objects move and how detections are weighed against it.
    pub motion: Motion,
    /// How surprises widen the uncertainty.
    pub surprise: Surprise,
    /// Which detection belongs to which object.
    pub association: ExpectedLossAssociation,
    /// How new objects begin and missed ones end.
    pub life: Life,
    /// The confidences that are reported.
    pub confidence: Confidence,
    /// When the detector is called.
    pub call: Call,
    /// What is made of the pixels of frames that are answered without the detector.
    pub pixels: Pixels,
    /// How boxes are followed in them.
    pub flow: Flow,
}

/// What is made of the pixels of frames that are answered without the detector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pixels {
    /// Nothing: such a frame is not even decoded.
    #[default]
    Off,
    /// The boxes are followed by sparse optical flow, where that is worth its price.
    Flow,
}

/// How boxes are followed, and what is believed of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flow {
    /// Columns of the grey picture that is asked for.
    pub width: u32,
    /// Points along each side of the grid in a box.
    pub grid: u32,
    /// Sizes of the picture that points are searched in, coarse to fine.
    pub levels: u32,
    /// What a look costs, as a share of what a call of the detector costs. At 0 every skipped frame with objects is
    /// looked at.
    pub price: f64,
    /// No box is followed over more frames than this from the last picture that was looked at.
    pub longest_gap: u32,
    /// Where the followed box begins: the share of the detector's box against the filter's.
    pub detected: f64,
    /// Noise of the centre's measured shift, in s.
    pub center_noise: f64,
    /// Noise of the same, pixels of the grey picture.
    pub pixel_noise: f64,
    /// Noise of the measured growth of the log-sides.
    pub size_noise: f64,
    /// What the points' spread, in smaller sides of the box, adds to both.
    pub spread_noise: f64,
    /// What a spread of one takes from the reliability of a look.
    pub spread_weight: f64,
    /// What an unreliable look takes from an object's health at most.
    pub doubt: f64,
    /// What is left of an object's health where it could not be followed.
    pub lost: f64,
    /// The power of health in the miss probability.
    pub health_weight: f64,
    /// A side of a box that lies so near to the picture's border, pixels of the grey picture, stays there while what
    /// is inside moves away from it.
    pub border: f64,
    /// With the first picture, takes the place of `call.birth_prior`: where followed boxes are seldom lost, most of
    /// what a call brings is new objects.
    pub birth_prior: f64,
}

impl Default for Flow {
    fn default() -> Self {
        Self {
            width: 320,
            grid: 4,
            levels: 3,
            price: 0.0,
            longest_gap: 5,
            detected: 0.8,
            center_noise: 0.01,
            pixel_noise: 0.1,
            size_noise: 0.01,
            spread_noise: 1.0,
            spread_weight: 4.0,
            doubt: 0.7,
            lost: 0.5,
            health_weight: 1.0,
            border: 4.0,
            birth_prior: 0.1,
        }
    }
}

/// Constant velocity of the centre and of the logarithms of the sides, slowly fading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Process noise √q of the centre per frame, in s.
    pub center_process: f64,
    /// Process noise √q of the log-sides per frame.
    pub size_process: f64,
    /// Measurement noise √R of the centre, in s.
    pub center_measurement: f64,
    /// Measurement noise √R of the log-sides.
    pub size_measurement: f64,
    /// What is left of the centre's velocity after a frame.
    pub center_fading: f64,
    /// What is left of the log-sides' velocity after a frame.
    pub size_fading: f64,
    /// Largest growth of ln s per frame that the motion takes into account.
    pub largest_growth: f64,
    /// Standard deviation of a new object's centre velocity, in s per frame.
    pub newcomer_center_velocity: f64,
    /// Standard deviation of a new object's log-side velocity per frame.
    pub newcomer_size_velocity: f64,
}

impl Default for Motion {
    fn default() -> Self {
        Self {
            center_process: 0.02,
            size_process: 0.015,
            center_measurement: 0.025,
            size_measurement: 0.06,
            center_fading: 0.985,
            size_fading: 0.95,
            largest_growth: 0.15,
            newcomer_center_velocity: 0.2,
            newcomer_size_velocity: 0.08,
        }
    }
}

/// The scale α of an object's covariance, from the normalised innovations of its updates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surprise {
    /// Weight of a new innovation in an object's α.
    pub rate: f64,
    /// Weight of a new innovation in the camera's ᾱ, with which new objects start.
    pub camera_rate: f64,
    /// A squared normalised innovation counts at most so much.
    pub largest_innovation: f64,
    /// Smallest α.
    pub least: f64,
    /// Largest α.
    pub most: f64,
}

impl Default for Surprise {
    fn default() -> Self {
        Self {
            rate: 0.2,
            camera_rate: 0.1,
            largest_innovation: 25.0,
            least: 0.1,
            most: 8.0,
        }
    }
}

/// The gates of the two stages of matching; the class is ignored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedLossAssociation {
    /// Stage 1 accepts intersection over union of this or more.
    pub iou_gate: f64,
    /// Stage 2 accepts squared Mahalanobis distances below this: the 95 % quantile of χ² with four
    /// degrees of freedom.
    pub mahalanobis_gate: f64,
}

impl Default for ExpectedLossAssociation {
    fn default() -> Self {
        Self {
            iou_gate: 0.3,
            mahalanobis_gate: 9.49,
        }
    }
}

/// Birth and removal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Life {
    /// An unmatched detection of this confidence or more becomes an object. Less confident ones can only
    /// prolong an object that is known. (With detections of at least 0.5 the value makes no difference;
    /// on the recordings every detection that is let in pays.)
    pub birth_confidence: f64,
    /// Detector frames in a row without a match at which an object is removed.
    pub misses_to_removal: u32,
    /// An object is removed when less of its predicted box than this share lies in the picture.
    pub least_visible: f64,
    /// Frames without any answer of the detector after which all objects are forgotten.
    pub longest_blindness: u32,
    /// Matches that make an object confirmed, its first detection included. Only confirmed objects teach
    /// the velocity of newcomers.
    pub hits_to_confirm: u32,
    /// Weight of the ridge in the regression of newcomers' velocities.
    pub velocity_ridge: f64,
    /// What is left of the regression's memory after a detector frame.
    pub velocity_memory: f64,
    /// Largest velocity the regression may give a newcomer, in s (centre) or 1 (log-sides) per frame.
    pub largest_velocity: f64,
    /// Smallest side of a reported box, pixels.
    pub least_side: f64,
}

impl Default for Life {
    fn default() -> Self {
        Self {
            birth_confidence: 0.1,
            misses_to_removal: 6,
            least_visible: 0.1,
            longest_blindness: 30,
            hits_to_confirm: 3,
            velocity_ridge: 5.0,
            velocity_memory: 0.98,
            largest_velocity: 0.3,
            least_side: 1.0,
        }
    }
}

/// How the confidence of a box is derived from the scores of its object's detections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Confidence {
    /// Smallest weight of a new score in the moving average m.
    pub rate: f64,
    /// Weight of the last score against m.
    pub last: f64,
    /// What a newcomer's confidence is reduced by.
    pub newcomer: f64,
    /// How fast that reduction fades with hits.
    pub newcomer_fading: f64,
    /// What the predicted miss probability takes at most.
    pub prediction: f64,
    /// What is left of the confidence after each miss.
    pub miss: f64,
    /// A missed object below this is not reported.
    pub least: f64,
}

impl Default for Confidence {
    fn default() -> Self {
        Self {
            rate: 0.3,
            last: 0.4,
            newcomer: 0.2,
            newcomer_fading: 0.7,
            prediction: 0.6,
            miss: 0.75,
            least: 0.05,
        }
    }
}

/// What is compared with λ. L is the expected loss of the frame in hand, N̄ the mean number of boxes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CallRule {
    /// `(L + Σ (L − L_t)) / N̄` over the frames t skipped since the last call. λ is the price of a call,
    /// in frames' worth of all boxes, and the pause ends where its cost per frame is least.
    #[default]
    Pause,
    /// `L / √N̄`: the loss of this frame alone.
    Frame,
}

/// When the expected loss calls the detector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Call {
    /// What is compared with λ.
    pub rule: CallRule,
    /// What is left of an object's weight after each miss: what the detector did not find it will
    /// hardly find now.
    pub miss: f64,
    /// Weight of the objects that may have appeared unseen.
    pub birth: f64,
    /// Memory of the birth rate, frames.
    pub birth_memory: f64,
    /// The birth rate before anything was seen, summed scores per frame.
    pub birth_prior: f64,
    /// Memory of the mean summed confidence N̄, frames.
    pub crowd_memory: f64,
    /// N̄ before anything was seen.
    pub crowd_prior: f64,
    /// N̄ counts at least so much.
    pub least_crowd: f64,
    /// The detector is called when its last call was so many frames ago.
    pub longest_pause: u32,
    /// Whether the empty-scene screen is asked before the detector when no object is held.
    pub ask_screen_when_empty: bool,
}

impl Default for Call {
    fn default() -> Self {
        Self {
            rule: CallRule::Pause,
            miss: 0.5,
            birth: 0.7,
            birth_memory: 60.0,
            birth_prior: 0.05,
            crowd_memory: 100.0,
            crowd_prior: 2.0,
            least_crowd: 0.5,
            longest_pause: 15,
            ask_screen_when_empty: true,
        }
    }
}

/// The schedules that share the objects of `expected-loss`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InTracker {
    /// `fixed-skip-in-tracker`: the detector runs on one frame of so many. Need not be whole.
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
