//! The settings that the Albireo policy leaves open, and the two profiles that set them.
//!
//! The paper's text and the code published with it disagree in places. Each such place is one setting here, or in its
//! [`LifeCycle`] and [`Association`]; a profile gives each a value.

use super::published_threshold::sizeless;
use crate::kalman::FilterParameters;
use crate::objects::{Association, GateOrder, LifeCycle, ObjectSettings};
use serde::{Deserialize, Serialize};

/// A named set of settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// The paper's text.
    #[default]
    Paper,
    /// The published code, to reproduce its decisions exactly.
    Reference,
}

/// The basis of the periodic cap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeriodicCap {
    /// Due when the frame's index in the stream is a multiple of the cap (published code). If that frame was lost, the
    /// next frame is due.
    FrameIndex,
    /// Due when the last detector call was this many frames ago (paper).
    SinceDetector,
}

/// The boxes reported on a detector frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DetectorFrameBoxes {
    /// All boxes of the detector with its confidences, and the predicted boxes of rescued objects (paper).
    Detector,
    /// The updated filters' boxes of all objects (published code).
    Filter,
}

/// The confidence reported with a filter's box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReportedConfidence {
    /// The confidence of the object's last detection (paper).
    Last,
    /// The last confidence times `max(0.1, 1 − τ/u)` (published code, on every frame).
    Decayed,
}

/// The settings of the Albireo policy, except the threshold `u`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlbireoSettings {
    /// True if the empty-scene screen is asked when no object is active. Otherwise the detector is.
    pub asks_screen: bool,
    /// True if τ = u skips the detector. Published code: yes; paper: only τ < u does.
    pub skip_at_equality: bool,
    /// The detector runs when an active object's age reaches this many frames (paper, T_max).
    pub t_max: u32,
    /// The detector runs after this many frames while objects are active.
    pub periodic_cap: u32,
    /// The basis of `periodic_cap`. Published code: the frame index; paper: frames since the last detector call.
    pub periodic_cap_counts: PeriodicCap,
    /// The boxes reported on a detector frame. Published code: the filters'; paper: the detector's.
    pub detector_frame_boxes: DetectorFrameBoxes,
    /// The confidence of filters' boxes. Published code: decayed; paper: last.
    pub confidence: ReportedConfidence,
    /// The filter, and the rules of matching, birth and death.
    pub objects: ObjectSettings,
}

impl AlbireoSettings {
    /// Returns the settings of `profile`.
    pub fn of(profile: Profile) -> Self {
        match profile {
            Profile::Paper => Self::paper(),
            Profile::Reference => Self::reference(),
        }
    }

    /// The paper's text, and the published code where the paper is silent. The paper calls the representation
    /// independent of resolution, so the measurement noise is a share of the picture: `u` then has the same meaning at
    /// every size as at the paper's 1280x720.
    pub fn paper() -> Self {
        let reference = Self::reference();
        Self {
            skip_at_equality: false,
            periodic_cap_counts: PeriodicCap::SinceDetector,
            detector_frame_boxes: DetectorFrameBoxes::Detector,
            confidence: ReportedConfidence::Last,
            objects: ObjectSettings {
                filter: sizeless(reference.objects.filter),
                association: Association {
                    gate: GateOrder::BeforeAssignment,
                    ..reference.objects.association
                },
                life_cycle: LifeCycle {
                    rescue_resets_age: false,
                    boundary_margin: 0.0,
                    ..reference.objects.life_cycle
                },
            },
            ..reference
        }
    }

    /// The published code.
    pub fn reference() -> Self {
        Self {
            asks_screen: true,
            skip_at_equality: true,
            t_max: 15,
            periodic_cap: 30,
            periodic_cap_counts: PeriodicCap::FrameIndex,
            detector_frame_boxes: DetectorFrameBoxes::Filter,
            confidence: ReportedConfidence::Decayed,
            objects: ObjectSettings {
                filter: FilterParameters::default(),
                association: Association {
                    iou_gate: 0.25,
                    iou_frames: 2,
                    mahalanobis_gate: 9.4877,
                    gate: GateOrder::AfterAssignment,
                },
                life_cycle: LifeCycle {
                    hits_to_confirm: 3,
                    c_rescue: 0.5,
                    r_max: 2,
                    rescue_resets_age: true,
                    boundary_margin: 0.05,
                },
            },
        }
    }
}
