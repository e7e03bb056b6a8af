//! The writer's thread: takes frames and events from the queue, and writes them into files.

use super::folder::Folder;
use super::window::{MOST_HELD_BYTES, Window};
use super::{
    LOG_PERIOD, Occasion, Order, PictureMemory, RecordConfig, RecordedFrame, RecorderCounts,
};
use albireo_recording::{EventMessage, RecordingError, RecordingFile};
use albireo_service::rate_limit::RateLimit;
use albireo_vision::picture::{EncodedPicture, FrameFault, FrameLimits, PictureFormat, to_jpeg};
use albireo_wire::VERSION;
use bytes::Bytes;
use parking_lot::Mutex;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant, SystemTime};

/// A file ends when it is as large as this, and the next one begins.
const LARGEST: u64 = 256 << 20;
/// A file ends when it is as old as this.
const OLDEST: Duration = Duration::from_secs(600);
/// No file takes more than this part of what all cameras may take, so that there is always an old one to delete.
const PART_OF_ALL: u64 = 4;

/// How often the disk is waited for: what was recorded since is lost in a power cut.
const KEEP_EVERY: Duration = Duration::from_secs(2);
/// How often old recordings are deleted, and a disk that has failed is tried again.
const TIDY_EVERY: Duration = Duration::from_secs(5);

/// The most events that wait for the first frame of a recording: of a camera that is away for days only the newest tell why.
const MOST_REASONS: usize = 100;

/// Writes the recordings of all cameras.
pub(super) struct Writer {
    cameras: Vec<CameraWriter>,
    folder: Folder,
    limits: FrameLimits,
    memory: PictureMemory,
    largest: u64,
    counts: Arc<Mutex<RecorderCounts>>,
    /// The time from which a disk that has failed is tried again.
    retry_at: Option<Instant>,
    /// Log lines about pictures that cannot be written.
    faults: RateLimit,
}

/// One camera's recording.
struct CameraWriter {
    name: String,
    window: Window,
    file: Option<OpenFile>,
    /// Why the next file begins.
    reasons: Vec<EventMessage>,
}

struct OpenFile {
    file: RecordingFile,
    path: PathBuf,
    begun: Instant,
    /// True if something was written since the disk was last waited for.
    is_changed: bool,
}

impl Writer {
    pub(super) fn new(
        config: &RecordConfig,
        folder: &Path,
        cameras: &[String],
        limits: FrameLimits,
        memory: PictureMemory,
        counts: Arc<Mutex<RecorderCounts>>,
    ) -> Self {
        let before = Duration::from_secs_f64(config.before_s);
        let after = Duration::from_secs_f64(config.after_s);
        let is_always = config.when.contains(&Occasion::Always);
        let camera = |name: &String| CameraWriter {
            name: name.clone(),
            window: if is_always {
                Window::always(before, after)
            } else {
                Window::around_events(before, after)
            },
            file: None,
            reasons: Vec::new(),
        };
        let keep = Duration::from_secs_f64(config.keep_days * 86_400.0);
        let max_bytes = config.max_bytes();
        let share = max_bytes / PART_OF_ALL / cameras.len().max(1) as u64;
        Self {
            cameras: cameras.iter().map(camera).collect(),
            folder: Folder::new(folder, max_bytes, keep),
            limits,
            memory,
            largest: LARGEST.min(share),
            counts,
            retry_at: None,
            faults: RateLimit::new(LOG_PERIOD),
        }
    }

    /// Writes until nobody gives orders any more, then ends the files.
    pub(super) fn run(&mut self, orders: &Receiver<Order>, waiting: &AtomicUsize) {
        let prepared = match self.folder.create() {
            Ok(()) => self.folder.mend(),
            Err(error) => Err(error.into()),
        };
        self.judge(prepared);
        self.tidy();
        let mut kept = Instant::now();
        let mut tidied = Instant::now();
        // The time up to which everything was taken from the queue, which may be behind.
        let mut reached = Instant::now();
        loop {
            match orders.recv_timeout(KEEP_EVERY) {
                Ok(order) => {
                    let bytes = order.bytes();
                    if let Some(at) = order.at() {
                        reached = reached.max(at);
                    }
                    self.take(order);
                    waiting.fetch_sub(bytes, Ordering::Relaxed);
                }
                Err(RecvTimeoutError::Timeout) => reached = Instant::now(),
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if kept.elapsed() >= KEEP_EVERY {
                self.keep(reached);
                kept = Instant::now();
            }
            if tidied.elapsed() >= TIDY_EVERY {
                self.tidy();
                tidied = Instant::now();
            }
        }
        for camera in 0..self.cameras.len() {
            self.end_file(camera);
        }
        self.tidy();
    }

    pub(super) fn take(&mut self, order: Order) {
        match order {
            Order::Frame(mut frame) => {
                let camera = frame.camera;
                if !self.cameras[camera].window.takes(frame.at) {
                    return;
                }
                // At once: raw pictures of some seconds would not fit into memory.
                match self.jpeg(&frame.picture) {
                    Ok(picture) => frame.picture = picture,
                    Err(fault) => return self.fail(camera, &fault),
                }
                if let Some(frame) = self.cameras[camera].window.frame(frame) {
                    self.write(&frame);
                }
            }
            Order::Audited {
                camera,
                picture,
                audit,
            } => {
                let picture = match self.jpeg(&picture) {
                    Ok(picture) => picture.bytes,
                    Err(fault) => return self.fail(camera, &fault),
                };
                if self.put(camera, |file, name| file.audited(name, picture, &audit)) {
                    self.counts.lock().shown.audited_frames += 1;
                }
            }
            Order::Event {
                camera,
                at,
                t_ns,
                reason,
            } => {
                self.counts.lock().shown.events += 1;
                let event = EventMessage {
                    v: VERSION,
                    t_ns,
                    reason: reason.to_string(),
                };
                if let Some(camera) = camera {
                    self.begin(camera, at, event);
                } else {
                    for camera in 0..self.cameras.len() {
                        self.begin(camera, at, event.clone());
                    }
                }
            }
        }
    }

    /// Begins or prolongs a recording, with the frames before it.
    fn begin(&mut self, camera: usize, at: Instant, event: EventMessage) {
        let before = self.cameras[camera].window.event(at);
        if let Some(held) = before.shortened_to {
            self.say_short(camera, held);
        }
        for frame in &before.frames {
            self.write(frame);
        }
        let CameraWriter { file, reasons, .. } = &mut self.cameras[camera];
        if file.is_none() {
            // Written with the next frame: a camera without frames has no recording.
            if reasons.len() == MOST_REASONS {
                reasons.remove(0);
            }
            reasons.push(event);
        } else {
            self.put(camera, |file, name| file.event(name, &event));
        }
    }

    fn say_short(&mut self, camera: usize, held: Duration) {
        let camera = &self.cameras[camera].name;
        let said = format!(
            "of record.before_s only {:.1} s of camera {camera} fit into memory ({} MiB of pictures): send smaller or fewer \
             pictures, or want fewer seconds",
            held.as_secs_f64(),
            MOST_HELD_BYTES >> 20,
        );
        tracing::warn!("{said}");
        self.counts.lock().shown.shortened = Some(said);
    }

    /// The picture as a viewer opens it and as the detector saw it: a JPEG file.
    fn jpeg(&self, picture: &EncodedPicture) -> Result<EncodedPicture, FrameFault> {
        let mut bytes = to_jpeg(picture, &self.limits)?;
        let is_same = bytes.as_ptr() == picture.bytes.as_ptr();
        if self.memory == PictureMemory::Lent && is_same {
            bytes = Bytes::copy_from_slice(&bytes);
        }
        Ok(EncodedPicture {
            bytes,
            format: PictureFormat::Jpeg,
            size: picture.size,
            mount: None,
        })
    }

    /// Counts a frame whose picture is at fault.
    fn fail(&mut self, camera: usize, fault: &FrameFault) {
        self.counts.lock().shown.failed_frames += 1;
        let camera = &self.cameras[camera].name;
        self.faults.log(|held_back| {
            tracing::warn!(camera, %fault, held_back, "a frame is not recorded");
        });
    }

    fn write(&mut self, frame: &RecordedFrame) {
        let written = self.put(frame.camera, |file, name| {
            let picture = frame.picture.bytes.clone();
            file.frame(name, picture, &frame.detections, frame.position.as_ref())
        });
        if written {
            self.counts.lock().shown.written_frames += 1;
        }
    }

    /// Writes into the camera's file, which is opened if there is none. False if that failed; that is counted.
    fn put(
        &mut self,
        camera: usize,
        write: impl FnOnce(&mut RecordingFile, &str) -> Result<(), RecordingError>,
    ) -> bool {
        if self.retry_at.is_some_and(|at| Instant::now() < at) {
            self.counts.lock().shown.failed_frames += 1;
            return false;
        }
        let is_new = self.cameras[camera].file.is_none();
        let done = match self.open(camera) {
            Ok((open, name)) => {
                open.is_changed = true;
                write(&mut open.file, name)
            }
            Err(error) => Err(error),
        };
        let is_done = done.is_ok();
        if !is_done {
            self.counts.lock().shown.failed_frames += 1;
            self.cameras[camera].file = None;
        }
        self.judge(done);
        if is_new && is_done {
            self.tidy();
        }
        self.rotate(camera);
        is_done
    }

    /// The camera's file and its name.
    fn open(&mut self, camera: usize) -> Result<(&mut OpenFile, &str), RecordingError> {
        let CameraWriter {
            name,
            file: open,
            reasons,
            ..
        } = &mut self.cameras[camera];
        if open.is_none() {
            self.folder.create()?;
            let path = self.folder.new_path(name, SystemTime::now());
            let mut file = RecordingFile::create(&path)?;
            for reason in reasons.drain(..) {
                file.event(name, &reason)?;
            }
            *open = Some(OpenFile {
                file,
                path,
                begun: Instant::now(),
                is_changed: true,
            });
            self.counts.lock().shown.recording.push(name.clone());
        }
        match open {
            Some(file) => Ok((file, name)),
            None => Err(RecordingError::Message("no file is open".to_owned())),
        }
    }

    /// Ends a file that is large or old enough.
    fn rotate(&mut self, camera: usize) {
        let Some(open) = &self.cameras[camera].file else {
            return;
        };
        if open.file.bytes() >= self.largest || open.begun.elapsed() >= OLDEST {
            self.end_file(camera);
            self.tidy();
        }
    }

    /// Waits until the disk has what was written, and ends the files whose recording was over at the time that is `reached`.
    pub(super) fn keep(&mut self, reached: Instant) {
        for camera in 0..self.cameras.len() {
            let CameraWriter { window, file, .. } = &mut self.cameras[camera];
            let is_over = window.has_length() && !window.is_recording(reached);
            let Some(open) = file else { continue };
            if is_over {
                self.end_file(camera);
            } else if open.is_changed {
                open.is_changed = false;
                let kept = open.file.keep();
                if kept.is_err() {
                    *file = None;
                }
                self.judge(kept);
            }
            self.rotate(camera);
        }
        let names = self
            .cameras
            .iter()
            .filter(|camera| camera.file.is_some())
            .map(|camera| camera.name.clone())
            .collect();
        self.counts.lock().shown.recording = names;
    }

    fn end_file(&mut self, camera: usize) {
        if let Some(open) = self.cameras[camera].file.take() {
            let ended = open.file.finish();
            self.judge(ended);
        }
    }

    /// Deletes old recordings, and counts what is left.
    fn tidy(&mut self) {
        let open: Vec<&Path> = self
            .cameras
            .iter()
            .filter_map(|camera| camera.file.as_ref())
            .map(|open| open.path.as_path())
            .collect();
        match self.folder.tidy(&open, self.largest, SystemTime::now()) {
            Ok(left) => {
                let shown = &mut self.counts.lock().shown;
                shown.files = left.recordings;
                shown.bytes = left.bytes;
            }
            Err(error) => self.judge(Err(error.into())),
        }
    }

    /// Remembers whether the disk works.
    fn judge(&mut self, done: Result<(), RecordingError>) {
        let mut counts = self.counts.lock();
        match done {
            Ok(()) => {
                if counts.shown.fault.take().is_some() {
                    tracing::info!("recordings are written again");
                }
                self.retry_at = None;
            }
            Err(error) => {
                if counts.shown.fault.is_none() {
                    tracing::error!(%error, "recordings cannot be written");
                }
                let reason = format!("recordings cannot be written (record.folder): {error}");
                counts.shown.fault = Some(reason);
                self.retry_at = Some(Instant::now() + TIDY_EVERY);
            }
        }
    }
}
