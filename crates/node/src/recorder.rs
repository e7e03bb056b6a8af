//! Recordings of cameras as MCAP files: pictures and boxes, always or around events, bounded on the disk. Whoever gives a frame
//! never waits: a writer's thread takes it from a bounded queue, and what finds no room is counted.

mod config;
mod folder;
mod window;
mod writer;

pub use config::{Occasion, RecordConfig};

use albireo_recording::AuditMessage;
use albireo_service::clock::unix_nanoseconds;
use albireo_service::rate_limit::RateLimit;
use albireo_service::readiness::Fault;
use albireo_vision::picture::{EncodedPicture, FrameLimits};
use albireo_wire::{DetectionsMessage, Position};
use parking_lot::Mutex;
use rustix::process::setpriority_process;
use rustix::thread::gettid;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use utoipa::ToSchema;
use writer::Writer;

/// The most frames that wait for the writer.
const MOST_WAITING: usize = 256;
/// The most bytes of pictures that wait for the writer. More would be memory that a stalled disk takes from the detector.
const MOST_WAITING_BYTES: usize = 64 << 20;

/// Missing frames are a fault for this long.
const RECENT: Duration = Duration::from_secs(60);

/// The writer's place behind the other threads, from 0 to 19.
const NICENESS: i32 = 10;

/// The time between two log lines about missing frames.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// Whose memory the pictures of frames are in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PictureMemory {
    /// The node's: they can be held for any time.
    Own,
    /// That of a sender, who wants it back: they are copied.
    Lent,
}

/// What is recorded, and what is not.
#[derive(Clone, Debug, Default, Serialize, ToSchema)]
pub(crate) struct RecordingStatus {
    /// The folder; absent if nothing is recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub folder: Option<PathBuf>,
    /// What begins a recording besides a request: `always`, `audit`.
    #[schema(value_type = Vec<String>)]
    pub when: Vec<Occasion>,
    /// Seconds that are kept before and after an event.
    pub before_s: f64,
    /// See `before_s`.
    pub after_s: f64,
    /// The cameras that are being recorded now.
    pub recording: Vec<String>,
    /// Recordings in the folder.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// The most bytes: the oldest recordings are deleted first.
    pub max_bytes: u64,
    /// Days after which a recording is deleted.
    pub keep_days: f64,
    /// Events since the start.
    pub events: u64,
    /// Frames since the start that are in a recording.
    pub written_frames: u64,
    /// Frames since the start that are missing in a recording because the disk or the processor is too slow.
    pub dropped_frames: u64,
    /// Frames since the start that are missing because the disk or the picture is at fault.
    pub failed_frames: u64,
    /// Frames since the start on which the audit found a difference, and that are in a recording.
    pub audited_frames: u64,
    /// Why the last such event has fewer seconds before it than `before_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shortened: Option<String>,
    /// Why nothing can be written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fault: Option<String>,
    /// The cameras of which there is nothing to record, and what to do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing: Option<String>,
}

#[derive(Debug, Default)]
struct RecorderCounts {
    shown: RecordingStatus,
    /// The last time that a frame was dropped.
    dropped_at: Option<Instant>,
}

/// What the writer is asked to do.
enum Order {
    Frame(RecordedFrame),
    /// A frame on which the audit found a difference.
    Audited {
        camera: usize,
        picture: EncodedPicture,
        audit: Box<AuditMessage>,
    },
    Event {
        /// One camera, or all.
        camera: Option<usize>,
        at: Instant,
        t_ns: u64,
        reason: Arc<str>,
    },
}

/// An answered frame.
#[derive(Debug)]
struct RecordedFrame {
    camera: usize,
    /// The time at which it was received.
    at: Instant,
    picture: EncodedPicture,
    detections: Arc<DetectionsMessage>,
    position: Option<Position>,
}

impl Order {
    fn bytes(&self) -> usize {
        match self {
            Self::Frame(frame) => frame.picture.bytes.len(),
            Self::Audited { picture, .. } => picture.bytes.len(),
            Self::Event { .. } => 0,
        }
    }

    /// The time of what it is about, if it has one.
    fn at(&self) -> Option<Instant> {
        match self {
            Self::Frame(frame) => Some(frame.at),
            Self::Event { at, .. } => Some(*at),
            Self::Audited { .. } => None,
        }
    }
}

/// Records the cameras of a node, if it has a folder for that.
pub(crate) struct Recorder {
    config: RecordConfig,
    cameras: Vec<String>,
    counts: Arc<Mutex<RecorderCounts>>,
    /// The writer's queue; `None` without a folder, and after the end.
    queue: Mutex<Option<SyncSender<Order>>>,
    /// Bytes of the pictures in it.
    waiting: Arc<AtomicUsize>,
    /// The other end of the queue, until the writer starts.
    orders: Mutex<Option<Receiver<Order>>>,
    /// Resolves once the writer has ended.
    ended: Mutex<Option<oneshot::Receiver<()>>>,
    /// Log lines about missing frames.
    drops: RateLimit,
}

impl Recorder {
    /// A recorder of these cameras, which has not started.
    pub(crate) fn new(config: &RecordConfig, cameras: Vec<String>) -> Arc<Self> {
        let (queue, orders) = sync_channel(MOST_WAITING);
        let is_on = config.folder.is_some();
        let shown = RecordingStatus {
            folder: config.folder.clone(),
            when: config.when.clone(),
            before_s: config.before_s,
            after_s: config.after_s,
            max_bytes: config.max_bytes(),
            keep_days: config.keep_days,
            ..RecordingStatus::default()
        };
        Arc::new(Self {
            config: config.clone(),
            cameras,
            counts: Arc::new(Mutex::new(RecorderCounts {
                shown,
                dropped_at: None,
            })),
            queue: Mutex::new(is_on.then_some(queue)),
            waiting: Arc::default(),
            orders: Mutex::new(is_on.then_some(orders)),
            ended: Mutex::default(),
            drops: RateLimit::new(LOG_PERIOD),
        })
    }

    /// Starts the writer, if there is a folder to write to. What is asked for before waits for it.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub(crate) fn start(&self, limits: FrameLimits, memory: PictureMemory) -> std::io::Result<()> {
        let Some(folder) = &self.config.folder else {
            return Ok(());
        };
        let Some(orders) = self.orders.lock().take() else {
            return Ok(());
        };
        let (end, ended) = oneshot::channel();
        let counts = Arc::clone(&self.counts);
        let mut writer = Writer::new(&self.config, folder, &self.cameras, limits, memory, counts);
        let waiting = Arc::clone(&self.waiting);
        std::thread::Builder::new().name("recorder".to_owned()).spawn(move || {
            // Whatever answers frames goes first. Refused, the thread is one like the others.
            let _ = setpriority_process(Some(gettid()), NICENESS);
            writer.run(&orders, &waiting);
            drop(end);
        })?;
        *self.ended.lock() = Some(ended);
        Ok(())
    }

    /// Ends the recordings, and returns once their files are whole. Nothing more is recorded.
    pub(crate) async fn stop(&self) {
        drop(self.queue.lock().take());
        let ended = self.ended.lock().take();
        if let Some(ended) = ended {
            let _ = ended.await;
        }
    }

    /// The part of a camera, by its place in the configuration.
    pub(crate) fn of_camera(self: Arc<Self>, camera: usize) -> CameraRecorder {
        CameraRecorder {
            recorder: self,
            camera,
        }
    }

    /// Begins a recording of one camera, or of all, or prolongs it. Everything that happens to a node and is worth pictures
    /// calls this. False if nothing is recorded here.
    pub(crate) fn event(&self, camera: Option<usize>, reason: &str) -> bool {
        self.order(Order::Event {
            camera,
            at: Instant::now(),
            t_ns: unix_nanoseconds(),
            reason: reason.into(),
        })
    }

    /// The present status.
    pub(crate) fn status(&self) -> RecordingStatus {
        self.counts.lock().shown.clone()
    }

    /// Why the recordings are not what was asked for, if so.
    pub(crate) fn fault(&self) -> Option<Fault> {
        let counts = self.counts.lock();
        if let Some(fault) = &counts.shown.fault {
            return Some(Fault::degraded(fault.clone()));
        }
        if counts.dropped_at?.elapsed() >= RECENT {
            return None;
        }
        let reason = "frames are missing in recordings: the disk of record.folder or the processor is too slow";
        Some(Fault::degraded(reason))
    }

    /// Gives the writer an order without waiting. False if nothing is recorded here.
    fn order(&self, order: Order) -> bool {
        let queue = self.queue.lock();
        let Some(queue) = queue.as_ref() else {
            return false;
        };
        let bytes = order.bytes();
        let waiting = self.waiting.fetch_add(bytes, Ordering::Relaxed);
        let has_room = waiting == 0 || waiting + bytes <= MOST_WAITING_BYTES;
        let is_sent = has_room && queue.try_send(order).is_ok();
        if !is_sent {
            self.waiting.fetch_sub(bytes, Ordering::Relaxed);
            self.drop_one();
        }
        true
    }

    fn drop_one(&self) {
        let mut counts = self.counts.lock();
        counts.shown.dropped_frames += 1;
        counts.dropped_at = Some(Instant::now());
        drop(counts);
        self.drops.log(|held_back| {
            tracing::warn!(
                held_back,
                "a frame is missing in the recordings: the disk of record.folder or the processor is too slow"
            );
        });
    }
}

/// One camera's part of the recorder.
#[derive(Clone)]
pub(crate) struct CameraRecorder {
    recorder: Arc<Recorder>,
    camera: usize,
}

impl CameraRecorder {
    /// Records an answered frame, received at `at`, if its camera is recorded. Never waits.
    pub(crate) fn frame(
        &self,
        picture: &EncodedPicture,
        detections: &Arc<DetectionsMessage>,
        position: Option<Position>,
        at: Instant,
    ) {
        // Most nodes record nothing: no clones for them.
        if self.recorder.config.folder.is_some() {
            self.recorder.order(Order::Frame(RecordedFrame {
                camera: self.camera,
                at,
                picture: picture.clone(),
                detections: Arc::clone(detections),
                position,
            }));
        }
    }

    /// True if frames on which the audit finds a difference are recorded.
    pub(crate) fn wants_audited(&self) -> bool {
        let config = &self.recorder.config;
        config.folder.is_some() && config.when.contains(&Occasion::Audit)
    }

    /// Records a frame on which the audit found a difference, and what surrounds it.
    pub(crate) fn audited(&self, picture: EncodedPicture, audit: AuditMessage) {
        self.recorder.order(Order::Audited {
            camera: self.camera,
            picture,
            audit: Box::new(audit),
        });
        self.recorder.event(Some(self.camera), "audit");
    }
}

#[cfg(test)]
mod tests;
