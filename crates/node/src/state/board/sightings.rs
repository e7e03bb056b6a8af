//! Finds when a class appears in a camera's picture and when it leaves, by the published boxes. Pure: the time is an argument.

use super::camera::Shared;
use super::{Board, CameraBoard, Event, News};
use albireo_service::clock::seconds;
use albireo_wire::{DetectionsMessage, Sighting, SightingEvent, VERSION};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;
use tokio::time::Instant;

/// For how long a class must be there, or away, until that counts: the `[sightings]` section.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SightingsConfig {
    /// Seconds for which every frame must have a box of the class.
    pub appear_s: f64,
    /// Seconds for which no frame may have one.
    pub leave_s: f64,
}

impl Default for SightingsConfig {
    fn default() -> Self {
        Self {
            appear_s: 0.5,
            leave_s: 5.0,
        }
    }
}

/// A frame: when it was answered, and its own time.
#[derive(Clone, Copy, Debug)]
struct Moment {
    at: Instant,
    t_ns: u64,
}

/// A class that is there, or is about to be.
#[derive(Debug)]
struct WatchedClass {
    class: String,
    is_there: bool,
    /// The first of the last frames, all of which say otherwise than `is_there`.
    turning: Option<Moment>,
    /// The first frame with the class.
    first: Moment,
    /// The newest frame with the class.
    last: Moment,
}

/// A class appeared or left.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Turn {
    pub class: String,
    pub event: SightingEvent,
    pub since_ns: u64,
    pub count: u32,
    pub confidence: Option<f32>,
    pub seconds: Option<f64>,
}

/// Watches the classes of one camera. Only frames count: while none comes, nothing is known, and nothing changes.
#[derive(Debug)]
pub(super) struct ClassWatch {
    appear: Duration,
    leave: Duration,
    /// The classes in the newest frames: few.
    watched: Vec<WatchedClass>,
}

impl ClassWatch {
    pub(super) fn new(config: SightingsConfig) -> Self {
        // The configuration was checked.
        let limit = |limit_s| Duration::try_from_secs_f64(limit_s).unwrap_or_default();
        Self {
            appear: limit(config.appear_s),
            leave: limit(config.leave_s),
            watched: Vec::new(),
        }
    }

    /// The classes that are there.
    pub(super) fn there(&self) -> impl Iterator<Item = &str> {
        self.watched
            .iter()
            .filter(|watched| watched.is_there)
            .map(|watched| watched.class.as_str())
    }

    /// Takes the answer of a frame at `now`; returns what changed by it.
    pub(super) fn frame(&mut self, now: Instant, answer: &DetectionsMessage) -> Vec<Turn> {
        let frame = Moment {
            at: now,
            t_ns: answer.t_ns,
        };
        for one in &answer.boxes {
            if !self.watched.iter().any(|watched| watched.class == one.class) {
                self.watched.push(WatchedClass {
                    class: one.class.clone(),
                    is_there: false,
                    turning: None,
                    first: frame,
                    last: frame,
                });
            }
        }
        let mut turns = Vec::new();
        for watched in &mut self.watched {
            let confidences: Vec<f32> = answer
                .boxes
                .iter()
                .filter(|one| one.class == watched.class)
                .map(|one| one.confidence)
                .collect();
            let is_seen = !confidences.is_empty();
            let Some(event) = watched.frame(frame, is_seen, self.appear, self.leave) else {
                continue;
            };
            let since_ns = match event {
                SightingEvent::Appeared => watched.first.t_ns,
                SightingEvent::Left => watched.last.t_ns,
            };
            let stayed = match event {
                SightingEvent::Appeared => None,
                SightingEvent::Left => Some(seconds(watched.last.at - watched.first.at)),
            };
            turns.push(Turn {
                class: watched.class.clone(),
                event,
                since_ns,
                count: confidences.len() as u32,
                confidence: confidences.into_iter().reduce(f32::max),
                seconds: stayed,
            });
        }
        self.watched.retain(|watched| watched.is_there || watched.turning.is_some());
        turns
    }
}

impl WatchedClass {
    /// Takes a frame with the class, if it `is_seen`, or without it.
    fn frame(
        &mut self,
        frame: Moment,
        is_seen: bool,
        appear: Duration,
        leave: Duration,
    ) -> Option<SightingEvent> {
        if is_seen {
            self.last = frame;
        }
        if is_seen == self.is_there {
            self.turning = None;
            return None;
        }
        let since = *self.turning.get_or_insert(frame);
        let limit = if is_seen { appear } else { leave };
        if frame.at - since.at < limit {
            return None;
        }
        self.is_there = is_seen;
        self.turning = None;
        if is_seen {
            self.first = since;
            Some(SightingEvent::Appeared)
        } else {
            Some(SightingEvent::Left)
        }
    }
}

impl Shared {
    /// Tells whoever listens of a sighting.
    fn tell(&self, sighting: Sighting) {
        let sighting = Arc::new(sighting);
        let news = News::Sighting(Arc::clone(&sighting));
        // Errors only mean that there are no subscribers.
        let _ = self.events.send(Event::new(news));
        let _ = self.sightings.send(sighting);
    }
}

impl CameraBoard {
    /// Tells what appeared or left by the answer of a frame.
    pub(super) fn tell_sightings(&self, answer: &DetectionsMessage) {
        let turns = self.classes.lock().frame(Instant::now(), answer);
        for turn in turns {
            self.shared.tell(Sighting {
                v: VERSION,
                node: self.shared.node.to_string(),
                camera: self.name.to_string(),
                class: turn.class,
                event: turn.event,
                seq: answer.seq,
                t_ns: answer.t_ns,
                since_ns: turn.since_ns,
                count: turn.count,
                confidence: turn.confidence,
                seconds: turn.seconds,
            });
        }
    }

    /// The classes that are in the camera's picture.
    pub(crate) fn classes_there(&self) -> Vec<String> {
        self.classes.lock().there().map(str::to_owned).collect()
    }
}

impl Board {
    /// Subscribes to sightings from now on: each is told once, when a class has appeared in a camera or left it. For whoever
    /// does something then. A reader that falls more than 256 behind gets `RecvError::Lagged` with the number of lost ones.
    pub fn sightings(&self) -> broadcast::Receiver<Arc<Sighting>> {
        self.shared.sightings.subscribe()
    }

    /// Tells of a sighting that a test makes up.
    #[cfg(test)]
    pub(crate) fn tell(&self, sighting: Sighting) {
        self.shared.tell(sighting);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::answer;
    use albireo_core::policy::{BoxSource, FrameState};
    use albireo_wire::BoxMessage;
    use tokio::time::advance;

    /// A camera of ten frames a second, which shows the classes that a test names.
    struct Scene {
        watch: ClassWatch,
        frames: u64,
    }

    impl Scene {
        fn new(appear_s: f64, leave_s: f64) -> Self {
            let watch = ClassWatch::new(SightingsConfig { appear_s, leave_s });
            Self { watch, frames: 0 }
        }

        /// Shows `classes` for `frames` frames; returns what changed, as `frame: class event`.
        async fn show(&mut self, classes: &[&str], frames: u64) -> Vec<String> {
            let mut said = Vec::new();
            for _ in 0..frames {
                for turn in self.frame(classes) {
                    said.push(format!("{}: {} {:?}", self.frames, turn.class, turn.event));
                }
                self.frames += 1;
                advance(Duration::from_millis(100)).await;
            }
            said
        }

        fn frame(&mut self, classes: &[&str]) -> Vec<Turn> {
            let mut shown = answer(self.frames, FrameState::I);
            shown.t_ns = self.frames * 100_000_000;
            let confidences = (1..).map(|number| 1.0 / number as f32);
            shown.boxes = classes
                .iter()
                .zip(confidences)
                .map(|(class, confidence)| BoxMessage {
                    corners: [0.0, 0.0, 1.0, 1.0],
                    class: (*class).to_owned(),
                    confidence,
                    source: BoxSource::Detected,
                    object: None,
                    confirmed: true,
                })
                .collect();
            self.watch.frame(Instant::now(), &shown)
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_class_appears_and_leaves_once_it_was_there_or_away_for_long_enough() {
        let mut scene = Scene::new(0.5, 2.0);
        assert_eq!(scene.show(&[], 10).await, [""; 0]);
        assert_eq!(scene.show(&["car"], 20).await, ["15: car Appeared"]);
        assert_eq!(scene.watch.there().collect::<Vec<_>>(), ["car"]);
        assert_eq!(scene.show(&[], 30).await, ["50: car Left"]);
        assert_eq!(scene.watch.there().count(), 0);
        assert!(scene.watch.watched.is_empty(), "nothing is kept of it");
    }

    #[tokio::test(start_paused = true)]
    async fn a_flicker_is_no_visitor_and_a_gap_no_departure() {
        let mut scene = Scene::new(0.5, 2.0);
        for _ in 0..20 {
            assert_eq!(scene.show(&["car"], 4).await, [""; 0]);
            assert_eq!(scene.show(&[], 1).await, [""; 0]);
        }
        assert_eq!(scene.show(&["car"], 6).await.len(), 1);
        for _ in 0..20 {
            assert_eq!(scene.show(&[], 19).await, [""; 0]);
            assert_eq!(scene.show(&["car"], 1).await, [""; 0]);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn each_class_has_its_own_time_and_says_how_long_it_was_there() {
        let mut scene = Scene::new(0.2, 1.0);
        scene.show(&["car"], 10).await;
        let both = scene.show(&["car", "bus", "car"], 5).await;
        assert_eq!(both, ["12: bus Appeared"]);
        let turns = scene.show(&["bus"], 10).await;
        assert!(turns.is_empty(), "{turns:?}");
        let left = scene.frame(&["bus"]);
        let expected = Turn {
            class: "car".to_owned(),
            event: SightingEvent::Left,
            since_ns: 1_400_000_000,
            count: 0,
            confidence: None,
            seconds: Some(1.4),
        };
        assert_eq!(left, [expected]);
    }

    #[tokio::test(start_paused = true)]
    async fn what_appeared_is_counted_with_its_best_confidence_and_first_frame() {
        let mut scene = Scene::new(0.2, 1.0);
        scene.show(&["car"], 2).await;
        let turns = scene.frame(&["bus", "car", "car"]);
        let expected = Turn {
            class: "car".to_owned(),
            event: SightingEvent::Appeared,
            since_ns: 0,
            count: 2,
            confidence: Some(0.5),
            seconds: None,
        };
        assert_eq!(turns, [expected]);
    }

    #[tokio::test(start_paused = true)]
    async fn nothing_leaves_while_the_camera_sends_nothing() {
        let mut scene = Scene::new(0.0, 2.0);
        assert_eq!(scene.show(&["car"], 1).await, ["0: car Appeared"]);
        advance(Duration::from_secs(3600)).await;
        assert_eq!(scene.show(&[], 20).await, [""; 0]);
        assert_eq!(scene.show(&[], 1).await, ["21: car Left"]);
    }
}
