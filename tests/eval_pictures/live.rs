//! Decisions as in the node: a policy asks detector and screen on demand, with the limit on consecutive empty frames.

use super::{settings, specs};
use albireo_core::detection::Detection;
use albireo_core::policy::{Evidence, FrameHead, FrameState, Need, Outcome, Policy};
use albireo_eval::data::Clip;
use albireo_eval::data::classes::from_name;
use albireo_eval::footage::FrameSource;
use albireo_eval::run::run;
use albireo_eval::settings::ScreenRule;
use albireo_eval::settings::Settings;
use albireo_node::LiveEvidence;
use albireo_vision::detector::{CameraSlot, DetectorConfig, DetectorHandle};
use albireo_vision::picture::{EncodedPicture, FrameLimits};
use albireo_vision::pixel_work::PixelWork;
use albireo_vision::screen::{EmptyRun, ScreenConfig, ScreenHandle};

const CAMERA: CameraSlot = CameraSlot(0);

/// The parts that the cameras of a node share.
struct Node {
    detector: DetectorHandle,
    model: Option<ScreenHandle>,
    screen: ScreenConfig,
}

impl Node {
    async fn start(detector: &DetectorConfig, screen: &ScreenConfig, confidence: f64) -> Self {
        // The detector of a node itself drops detections below the confidence.
        let detector = DetectorConfig {
            confidence,
            ..detector.clone()
        };
        Self {
            detector: DetectorHandle::start(&detector).await.unwrap(),
            model: ScreenHandle::start(screen, None).await.unwrap(),
            screen: screen.clone(),
        }
    }

    /// The evidence of a camera, as in its loop in the node.
    fn camera(&self) -> LiveEvidence {
        let detector = self.detector.clone();
        let screen = self.model.clone();
        let empty_run = EmptyRun::new(self.screen.longest_empty_run);
        let preparation = self.detector.preparation().clone();
        let input = screen.as_ref().map(ScreenHandle::input_format);
        let pixels = PixelWork::new(preparation, input, FrameLimits::default(), 1);
        let never = tokio_util::sync::CancellationToken::new();
        LiveEvidence::new(detector, screen, empty_run, CAMERA, pixels, never)
    }

    /// The detections of evaluated classes, with the evaluation's class numbers.
    fn evaluated(&self, found: &[Detection]) -> Vec<Detection> {
        let evaluated = found.iter().filter_map(|detection| {
            let name = &self.detector.class_names()[usize::from(detection.class.0)];
            let class = from_name(name).ok()?;
            Some(Detection {
                class,
                ..*detection
            })
        });
        evaluated.collect()
    }
}

struct Decided {
    states: Vec<FrameState>,
    /// The calls that the limit on consecutive empty frames forced.
    forced: u64,
}

/// The decisions on a camera with these pictures.
async fn decided(node: &Node, policy: &mut dyn Policy, pictures: &[EncodedPicture]) -> Decided {
    let mut camera = node.camera();
    let mut outcome = Outcome::default();
    let mut states = Vec::new();
    let mut forced = 0;
    for (index, encoded) in pictures.iter().enumerate() {
        let head = FrameHead {
            index: index as u64,
            step: 1,
            picture: encoded.size,
        };
        camera.next_frame();
        let mut need = policy.begin(head);
        while need != Need::Nothing {
            camera.fetch(need, encoded).await.unwrap();
            need = match camera.fetched(need) {
                Evidence::Detections(found) => {
                    policy.answer(Evidence::Detections(&node.evaluated(found)))
                }
                other => policy.answer(other),
            };
        }
        policy.finish(&mut outcome);
        states.push(outcome.state);
        forced += u64::from(camera.screen_is_overruled());
    }
    Decided { states, forced }
}

/// How a node is configured.
#[derive(Clone, Copy)]
pub(crate) struct NodeSettings<'a> {
    pub(crate) detector: &'a DetectorConfig,
    pub(crate) screen: &'a ScreenConfig,
    pub(crate) confidence: f64,
}

/// Asserts that the node's detections on the same pictures equal those of the pass, and that every live policy decides as its
/// replay does. Returns how often the limit on consecutive empty frames forced a detector call.
pub(crate) fn assert_live_alike(
    source: &mut dyn FrameSource,
    node: NodeSettings<'_>,
    pictured: &Clip,
    policies: &str,
) -> u64 {
    let NodeSettings {
        detector,
        screen,
        confidence,
    } = node;
    let mut pictures = Vec::new();
    while let Some(picture) = source.next().unwrap() {
        pictures.push(picture);
    }
    assert_eq!(pictures.len(), pictured.frames);
    let rule = ScreenRule::Recorded;
    let policies = specs(policies, rule);
    let settings = Settings {
        longest_empty_run: screen.longest_empty_run,
        ..settings(confidence, rule)
    };
    let replayed = run([pictured], &policies, &settings, &|| ()).unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let node = Node::start(detector, screen, confidence).await;
        let stored = pictured.detections.as_ref().unwrap();
        for (frame, (encoded, stored)) in pictures.iter().zip(stored).enumerate() {
            let mut camera = node.camera();
            camera.fetch(Need::Detections, encoded).await.unwrap();
            let Evidence::Detections(found) = camera.fetched(Need::Detections) else {
                panic!("no detections of frame {frame}");
            };
            let live = node.evaluated(found);
            let stored: Vec<_> = stored
                .iter()
                .filter(|found| found.confidence >= confidence)
                .map(|found| found.normalise(encoded.size))
                .collect();
            assert_eq!(live.len(), stored.len(), "frame {frame}");
            for (live, stored) in live.iter().zip(&stored) {
                let [found, expected] = [live, stored].map(|found| (found.class, found.confidence));
                assert_eq!(found, expected, "frame {frame}");
                let [live, stored] =
                    [live, stored].map(|found| <[f64; 4]>::from(found.bounding_box));
                // Stored boxes were converted to pixels and back.
                for (live, stored) in live.into_iter().zip(stored) {
                    let off = (live - stored).abs();
                    assert!(off < 1e-14, "frame {frame}: {live} {stored}");
                }
            }
        }
        let mut forced = 0;
        for (policy, replayed) in policies.iter().zip(&replayed) {
            let mut decider = policy.config.build().unwrap();
            let live = decided(&node, decider.as_mut(), &pictures).await;
            let label = &policy.label;
            assert_eq!(live.states, replayed.states_by_frame, "{label}");
            forced += live.forced;
        }
        forced
    })
}
