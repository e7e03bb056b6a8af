//! Two cameras that share a detector: each has a policy of its own, for objects of one picture say nothing of another's.
//!
//! `cargo run -p albireo-core --example two_cameras`

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{BoundingBox, PictureSize};
use albireo_core::policy::{FrameEvidence, FrameHead, Outcome, Policy, PolicyConfig, decide};
use std::error::Error;

/// A camera: its policy, and what it has cost.
struct Camera {
    name: &'static str,
    picture: PictureSize,
    /// How far its object moves per frame, as a share of the picture's width.
    speed: f64,
    policy: Box<dyn Policy>,
    calls: u32,
}

impl Camera {
    /// What the shared detector finds in its picture: an object that goes to and fro.
    fn detect(&self, frame: u64) -> Vec<Detection> {
        let center_x = 0.5 + 0.3 * (self.speed * frame as f64).sin();
        vec![Detection {
            bounding_box: BoundingBox::new(center_x, 0.5, 0.1, 0.2),
            class: ClassId(0),
            confidence: 0.9,
        }]
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut config = PolicyConfig::default();
    config.select("expected-loss:0.3")?;
    let mut cameras = [
        Camera {
            name: "yard",
            picture: PictureSize::new(640, 360),
            speed: 0.002,
            policy: config.build()?,
            calls: 0,
        },
        Camera {
            name: "road",
            picture: PictureSize::new(1920, 1080),
            speed: 0.1,
            policy: config.build()?,
            calls: 0,
        },
    ];
    // One outcome for all: its buffers are reused.
    let mut outcome = Outcome::default();
    for index in 0..250 {
        for camera in &mut cameras {
            let head = FrameHead {
                index,
                step: 1,
                picture: camera.picture,
            };
            // Read only on frames that need the detector. To run it only then, see `own_loop`.
            let found = camera.detect(index);
            let mut evidence = FrameEvidence::detections(&found);
            let Ok(()) = decide(&mut *camera.policy, head, &mut evidence, &mut outcome);
            camera.calls += u32::from(!outcome.state.is_skipped());
        }
    }
    for camera in &cameras {
        println!("{}: {} calls for 250 frames", camera.name, camera.calls);
    }
    Ok(())
}
