//! A loop of one's own: the detector runs only on the frames for which the policy asks.
//!
//! `cargo run -p albireo-core --example own_loop`

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::{Evidence, FrameHead, Need, Outcome, PolicyConfig};
use std::error::Error;

const PICTURE: PictureSize = PictureSize::new(1280, 720);

/// Stands for your detector: one car that moves to the right by two pixels per frame.
fn detect(frame: u64) -> Vec<Detection> {
    let x1 = 100.0 + 2.0 * frame as f64;
    let corners = Corners {
        x1,
        y1: 300.0,
        x2: x1 + 80.0,
        y2: 360.0,
    };
    vec![Detection {
        bounding_box: corners.normalise(PICTURE),
        class: ClassId(2),
        confidence: 0.9,
    }]
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut config = PolicyConfig::default();
    // A higher value skips more.
    config.select("expected-loss:0.3")?;
    let mut policy = config.build()?;
    let mut outcome = Outcome::default();
    let mut calls = 0;
    for index in 0..100 {
        let head = FrameHead {
            index,
            // Larger after lost frames: the objects move on over them.
            step: 1,
            picture: PICTURE,
        };
        let mut need = policy.begin(head);
        while need != Need::Nothing {
            need = if need == Need::Detections {
                calls += 1;
                policy.answer(Evidence::Detections(&detect(index)))
            } else {
                // No screen for empty scenes here, and no grey picture: the policy goes on without.
                policy.answer(Evidence::Unavailable)
            };
        }
        policy.finish(&mut outcome);
        if index % 20 == 0 {
            let state = outcome.state.as_str();
            print!("frame {index}: state {state}");
            if let Some(car) = outcome.boxes.first() {
                let left = car.bounding_box.pixel_corners(PICTURE).x1;
                print!(", the car begins at {left:.0}");
            }
            println!();
        }
    }
    println!("{calls} calls of the detector for 100 frames");
    Ok(())
}
