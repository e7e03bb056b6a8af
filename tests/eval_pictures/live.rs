//! The node's way: a policy that asks detector and screen itself, only when it needs to.

use super::{NO_PIXELS, fixture_detector, fixture_screen, look, settings, specs, write_pictures};
use albireo_core::detection::Detection;
use albireo_core::policy::{Evidence, FrameHead, FrameState, GreyPicture, Need, Outcome, Policy};
use albireo_eval::data::classes::{Meaning, from_name};
use albireo_eval::footage::{FrameSource, PictureFolder};
use albireo_eval::pictures::{PicturedClip, run_pictured};
use albireo_eval::source::ScreenRule;
use albireo_node::detector::{CameraSlot, DetectorConfig, DetectorHandle};
use albireo_node::frame::{
    EncodedPicture, FrameLimits, Picture, PixelLayout, decode, decode_grey_half,
};
use albireo_node::screen::{ScreenConfig, ScreenHandle, decoding_target};
use std::sync::Arc;

const CAMERA: CameraSlot = CameraSlot(0);

struct Node {
    detector: DetectorHandle,
    screen: ScreenHandle,
}

impl Node {
    async fn start(detector: &DetectorConfig, screen: &ScreenConfig, confidence: f64) -> Self {
        // A node's detector drops what is below the confidence itself.
        let detector = DetectorConfig {
            confidence,
            ..detector.clone()
        };
        Self {
            detector: DetectorHandle::start(&detector).await.unwrap(),
            screen: ScreenHandle::start(screen, None).await.unwrap().unwrap(),
        }
    }

    fn picture(&self, encoded: &EncodedPicture) -> Arc<Picture> {
        let mut picture = Picture::default();
        let (limits, layout) = (FrameLimits::default(), PixelLayout::Rgb8);
        let [detector, screen] = [
            self.detector.preparation().format(),
            self.screen.input_format(),
        ];
        let target = decoding_target(detector, Some(screen), encoded.size);
        decode(encoded, &limits, layout, Some(target), &mut picture).unwrap();
        Arc::new(picture)
    }

    /// What the detector finds, of the evaluated classes under their numbers.
    async fn detect(&self, encoded: &EncodedPicture) -> Vec<Detection> {
        let found = self.detector.detect(CAMERA, self.picture(encoded)).await;
        let found = found.unwrap().detections.into_iter();
        found
            .filter_map(|detection| {
                let name = &self.detector.class_names()[usize::from(detection.class.0)];
                match from_name(name) {
                    Meaning::Class(class) => Some(Detection { class, ..detection }),
                    _ => None,
                }
            })
            .collect()
    }

    async fn decide(
        &self,
        policy: &mut dyn Policy,
        index: u64,
        encoded: &EncodedPicture,
    ) -> FrameState {
        let mut grey = Picture::default();
        let mut need = policy.begin(FrameHead {
            index,
            step: 1,
            picture: encoded.size,
        });
        loop {
            need = match need {
                Need::Nothing => break,
                Need::Screen => {
                    let verdict = self.screen.ask(CAMERA, self.picture(encoded)).await;
                    let empty = verdict.unwrap().empty;
                    policy.answer(Evidence::Screen { empty })
                }
                Need::GreyPicture => {
                    decode_grey_half(encoded, &FrameLimits::default(), &mut grey).unwrap();
                    policy.answer(Evidence::GreyPicture(GreyPicture {
                        size: grey.size,
                        pixels: &grey.pixels,
                    }))
                }
                Need::Detections => {
                    let found = self.detect(encoded).await;
                    policy.answer(Evidence::Detections(&found))
                }
            };
        }
        let mut outcome = Outcome::default();
        policy.finish(&mut outcome);
        outcome.state
    }
}

/// The node's detections on the same pictures are the pass's, and every policy that asks for itself decides
/// as its replay does.
pub(crate) fn assert_live_alike(
    source: &mut dyn FrameSource,
    detector: &DetectorConfig,
    screen: &ScreenConfig,
    pictured: &PicturedClip,
    confidence: f64,
) {
    let mut pictures = Vec::new();
    while let Some(picture) = source.next().unwrap() {
        pictures.push(picture);
    }
    assert_eq!(pictures.len(), pictured.clip.frames);
    let mut policies = specs(&NO_PIXELS, ScreenRule::Recorded);
    policies.extend(specs(&["statues:25"], ScreenRule::Recorded).pop());
    let settings = settings(confidence, ScreenRule::Recorded);
    let replayed = run_pictured(pictured, &policies, &settings, &|| ()).unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let node = Node::start(detector, screen, confidence).await;
        let stored = pictured.clip.detections.as_ref().unwrap();
        for (frame, (encoded, stored)) in pictures.iter().zip(stored).enumerate() {
            let live = node.detect(encoded).await;
            let stored: Vec<_> = stored
                .iter()
                .filter(|stored| stored.confidence >= confidence)
                .map(|stored| stored.normalise(encoded.size))
                .collect();
            assert_eq!(live.len(), stored.len(), "frame {frame}");
            for (live, stored) in live.iter().zip(&stored) {
                assert_eq!(
                    (live.class, live.confidence),
                    (stored.class, stored.confidence)
                );
                let (live, stored) = (live.bounding_box, stored.bounding_box);
                // Stored boxes went through pixels and back.
                for (live, stored) in [
                    (live.center_x, stored.center_x),
                    (live.center_y, stored.center_y),
                    (live.width, stored.width),
                    (live.height, stored.height),
                ] {
                    assert!(
                        (live - stored).abs() < 1e-14,
                        "frame {frame}: {live} {stored}"
                    );
                }
            }
        }
        for (policy, replayed) in policies.iter().zip(&replayed) {
            let mut decider = policy.config.build().unwrap();
            let mut states = Vec::new();
            for (index, encoded) in pictures.iter().enumerate() {
                states.push(node.decide(decider.as_mut(), index as u64, encoded).await);
            }
            assert_eq!(states, replayed.sequence, "{}", policy.label);
        }
    });
}

#[test]
#[ignore = "needs ONNX Runtime"]
fn a_policy_that_asks_for_itself_decides_as_its_replay_does() {
    let folder = tempfile::tempdir().unwrap();
    write_pictures(folder.path(), 60);
    let mut source = PictureFolder::open(folder.path(), 10.0).unwrap();
    let (detector, screen) = (fixture_detector(), fixture_screen());
    let pictured = look(&mut source, &detector, &screen);
    source.rewind().unwrap();
    assert_live_alike(&mut source, &detector, &screen, &pictured, 0.5);
}
