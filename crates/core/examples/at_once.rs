//! Answers at once, from a detector that takes four frames: each frame is answered by prediction, and the detections follow.
//!
//! `cargo run -p albireo-core --example at_once`

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{Evidence, FrameHead, LatePolicy, Need, Outcome, PolicyConfig};
use std::error::Error;

const PICTURE: PictureSize = PictureSize::new(640, 360);

/// The number of frames that pass while the detector runs.
const DETECTOR_FRAMES: u64 = 4;

/// Stands for your detector, on another thread or machine: one object that moves to the right.
fn detect(frame: u64) -> Vec<Detection> {
    let center_x = 0.2 + 0.004 * frame as f64;
    vec![Detection {
        bounding_box: BoundingBox::new(center_x, 0.5, 0.1, 0.2),
        class: ClassId(0),
        confidence: 0.9,
    }]
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut config = PolicyConfig::default();
    config.select("expected-loss")?;
    let mut policy = LatePolicy::new(config.build()?)?;
    let mut now = Outcome::default();
    let mut late = Outcome::default();
    // The frame on which the detector runs.
    let mut examined: Option<u64> = None;
    for index in 0..60 {
        if let Some(frame) = examined.take_if(|frame| index - *frame == DETECTOR_FRAMES) {
            // The objects move on from there to the present frame.
            policy.deliver(frame, Evidence::Detections(&detect(frame)), &mut late)?;
            println!("frame {frame}: final answer, {} boxes", late.boxes.len());
        }
        let head = FrameHead {
            index,
            step: 1,
            picture: PICTURE,
        };
        let mut need = policy.frame(head, &mut now);
        // No screen for empty scenes here: go on to the detector.
        while need != Need::Nothing && need != Need::Detections {
            need = policy.deliver(index, Evidence::Unavailable, &mut late)?;
        }
        if need == Need::Detections {
            examined = Some(index);
        }
        println!("frame {index}: {} boxes at once", now.boxes.len());
    }
    Ok(())
}
