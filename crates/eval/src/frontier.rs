//! Accuracy against skip rate: what a policy reaches at the same number of detector calls as another.
//!
//! Two policies with a knob each can only be compared fairly where both skip as many frames. So every
//! comparison here turns the knob of one policy until its mean skip rate is that of the other, on the
//! same clips, and tests the differences clip by clip. The same is done for several [`View`]s of the
//! recordings: as they are, at half the frame rate, with lost frames, with unsure detections.
//!
//! Every policy is judged as it is meant to be: those of the paper by the published definitions (profile
//! `reference`), all others by the boxes and confidences that they report.

mod comparison;
mod hindsight;
mod leave_one_out;
mod operating_point;
mod pixels;
mod pixels_text;
mod report;
mod text;
mod view;

pub use comparison::EqualSkip;
pub use comparison::PairedDifference;
pub use comparison::ViewStudy;
pub use comparison::{Study, study};
pub use leave_one_out::Tried;
pub use leave_one_out::{
    Judging, LeaveOneOut, Variation, leave_one_out, render as render_leave_one_out,
};
pub use operating_point::Candidate;
pub use operating_point::ClipFigures;
pub use operating_point::{FrontierError, NotASetting, OperatingPoint, SettingValue};
pub use pixels::{RateStudy, all_at_rate, pixel_steps, pixel_study};
pub use pixels_text::{render_pixels, write_pixels};
pub use report::write;
pub use text::render;
pub use view::{View, ViewedClip};
