//! The class that decides the frames of one stream.

use crate::boxes::{Arrays, Found, arrays, read};
use crate::grey::Grey;
use crate::order::Order;
use crate::settled::Settling;
use albireo_core::audit::{AuditDraw, AuditSums};
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{
    Evidence, FrameHead, LatePolicy, Need, Outcome, PauseFrames, Policy, PolicyConfig, Profile,
    no_pause,
};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// The state of an object, as a Python tuple: id, class, whether it is confirmed, confidence, box (centre and sides,
/// normalised), uncertainty, hits, frames since its last detection, frames since the detector last measured or missed
/// it, misses in a row.
type Object = (u64, u16, bool, f64, [f64; 4], f64, u32, u32, u32, u32);

/// A settled frame, as a Python tuple: number, state, whether it was settled, boxes.
type SettledTuple<'py> = (u64, &'static str, bool, Arrays<'py>);

/// Decides the frames of one stream.
#[pyclass(module = "albireo._core")]
pub(crate) struct Decider {
    policy: LatePolicy,
    size: PictureSize,
    order: Order,
    outcome: Outcome,
    detections: Vec<Detection>,
    grey: Grey,
    draw: AuditDraw,
    audit: AuditSums,
    /// The final answer of a frame whose detections came late.
    late: Outcome,
    settling: Option<Settling>,
}

#[pymethods]
impl Decider {
    /// Makes a decider. What belongs together is one tuple, as a function of Rust should have few arguments; the tuples
    /// are named where they are taken apart:
    ///
    /// - `size`: width and height of the pictures, pixels.
    /// - `audit`: the share of frames that are drawn for an audit, and the seed of the draw.
    /// - `answers`: whether detections come late, and the longest delay of settled frames, if frames are settled.
    /// - `pause`: on an empty road one frame in this many is looked at; and the frames without a detection after which
    ///   the road is empty.
    #[new]
    fn new(
        policy: &str,
        profile: &str,
        threshold: Option<f64>,
        size: (u32, u32),
        audit: (f64, u64),
        answers: (bool, Option<u64>),
        pause: (u32, u32),
    ) -> PyResult<Self> {
        let (width, height) = size;
        let (audited_share, audit_seed) = audit;
        let (comes_late, longest_delay) = answers;
        let (every, after) = pause;
        let mut built = build(policy, profile)?;
        if let Some(threshold) = threshold {
            built.set_threshold(threshold).map_err(wrong)?;
        }
        if every > 1 && !built.takes_pause() {
            return Err(PyValueError::new_err(no_pause(built.name())));
        }
        let mut policy = if comes_late {
            LatePolicy::new(built).map_err(|error| {
                PyValueError::new_err(format!(
                    "policy '{}' cannot take late detections: it predicts no boxes",
                    error.policy
                ))
            })?
        } else {
            LatePolicy::waiting(built)
        };
        policy.set_pause(PauseFrames {
            every,
            after,
            ..PauseFrames::OFF
        });
        Ok(Self {
            policy,
            size: PictureSize::new(width, height),
            order: Order::default(),
            outcome: Outcome::default(),
            detections: Vec::new(),
            grey: Grey::default(),
            draw: AuditDraw::new(audited_share, audit_seed),
            audit: AuditSums::default(),
            late: Outcome::default(),
            settling: longest_delay.map(Settling::new),
        })
    }

    /// Takes the grey picture of the next frame, an array of shape (rows, columns).
    fn look(&mut self, picture: PyReadonlyArray2<'_, u8>) -> PyResult<()> {
        self.grey.take(&picture)
    }

    /// Takes the picture of the next frame, an array of shape (rows, columns, 3 or 4), from red to blue or from blue to
    /// red.
    fn look_in_color(
        &mut self,
        picture: PyReadonlyArray3<'_, u8>,
        red_first: bool,
    ) -> PyResult<()> {
        self.grey.take_colored(&picture, red_first)
    }

    /// Begins a frame, by default the next one, and returns whether it wants the detector. `empty` is a screen's verdict
    /// on the scene.
    fn begin(&mut self, py: Python<'_>, frame: Option<u64>, empty: Option<bool>) -> PyResult<bool> {
        let (index, step) = self.order.next(frame)?;
        let head = FrameHead {
            index,
            step,
            picture: self.size,
        };
        // Other threads of Python may run while a picture is examined, which takes long.
        let need = if self.grey.has_picture() {
            py.detach(|| self.ask(head, empty))
        } else {
            self.ask(head, empty)
        };
        self.grey.forget();
        if need != Need::Detections {
            self.finish_frame(index, Answer::Final);
            return Ok(false);
        }
        if self.policy.waits() {
            self.order.wait(index);
        } else {
            self.finish_frame(index, Answer::Early);
        }
        Ok(true)
    }

    /// Takes the detections of a frame that was answered earlier, or `None` if the detector failed; returns the final
    /// boxes.
    fn deliver<'py>(
        &mut self,
        py: Python<'py>,
        frame: u64,
        found: Option<Found<'py>>,
    ) -> PyResult<Arrays<'py>> {
        if let Some(found) = &found {
            read(found, self.size, &mut self.detections)?;
        }
        if self.policy.waits() {
            return Err(PyRuntimeError::new_err(
                "deliver(n, result) is for detections that come late: make the skipper with late=True",
            ));
        }
        let evidence = match found {
            Some(_) => Evidence::Detections(&self.detections),
            None => Evidence::Unavailable,
        };
        let pending = self.policy.pending();
        self.policy
            .deliver(frame, evidence, &mut self.late)
            .map_err(|_| not_waiting(frame, pending))?;
        if let Some(settling) = &mut self.settling {
            settling.late(frame, &self.late);
        }
        Ok(arrays(py, &self.late.boxes, self.size))
    }

    /// State and cause of the frame that was delivered last, and whether the detector failed.
    #[getter]
    fn delivered(&self) -> (&'static str, Option<&'static str>, bool) {
        (
            self.late.state.as_str(),
            self.late.cause.map(|cause| cause.as_str()),
            self.late.degraded,
        )
    }

    /// The frame that waits for late detections.
    #[getter]
    fn pending(&self) -> Option<u64> {
        // A policy that waits for its detections has none that come late.
        if self.policy.waits() {
            return None;
        }
        self.policy.pending()
    }

    /// Returns the frames that were settled since the last call; with `end`, all that are left.
    fn settled<'py>(&mut self, py: Python<'py>, end: bool) -> PyResult<Vec<SettledTuple<'py>>> {
        let Some(settling) = &mut self.settling else {
            return Err(PyRuntimeError::new_err(
                "nothing is settled: make the skipper with settle=True",
            ));
        };
        if end {
            settling.end_stream();
        }
        let frames = settling.take().into_iter().map(|frame| {
            let boxes = arrays(py, &frame.boxes, self.size);
            (frame.number, frame.state, frame.settled, boxes)
        });
        Ok(frames.collect())
    }

    /// Takes the detections of the current frame, and returns the boxes to show.
    fn update<'py>(
        &mut self,
        py: Python<'py>,
        xyxy: PyReadonlyArray2<'py, f64>,
        confidence: PyReadonlyArray1<'py, f64>,
        class_id: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Arrays<'py>> {
        let frame = self.order.awaited("update(result)")?;
        let found = (xyxy, confidence, class_id);
        read(&found, self.size, &mut self.detections)?;
        let evidence = Evidence::Detections(&self.detections);
        self.policy.deliver(frame, evidence, &mut self.outcome).map_err(wrong)?;
        self.finish_frame(frame, Answer::Final);
        Ok(arrays(py, &self.outcome.boxes, self.size))
    }

    /// Ends the current frame without the detections that it wants, and returns the boxes to show.
    fn unavailable<'py>(&mut self, py: Python<'py>) -> PyResult<Arrays<'py>> {
        let frame = self.order.awaited("unavailable()")?;
        self.policy
            .deliver(frame, Evidence::Unavailable, &mut self.outcome)
            .map_err(wrong)?;
        self.finish_frame(frame, Answer::Final);
        Ok(arrays(py, &self.outcome.boxes, self.size))
    }

    /// Returns the boxes of the current frame.
    fn boxes<'py>(&self, py: Python<'py>) -> PyResult<Arrays<'py>> {
        self.order.require_decided()?;
        Ok(arrays(py, &self.outcome.boxes, self.size))
    }

    /// True if a frame belongs to the random sample of an audit.
    fn drawn(&self, frame: u64) -> bool {
        self.draw.draw(frame)
    }

    /// Compares the boxes of the current frame, which skipped the detector, with the detector's.
    fn compare(
        &mut self,
        xyxy: PyReadonlyArray2<'_, f64>,
        confidence: PyReadonlyArray1<'_, f64>,
        class_id: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        self.order.require_decided()?;
        if !self.outcome.state.is_skipped() {
            return Err(PyRuntimeError::new_err(
                "the detector has already run on this frame: an audit compares frames that were skipped",
            ));
        }
        let found = (xyxy, confidence, class_id);
        read(&found, self.size, &mut self.detections)?;
        self.audit.add(&self.outcome.boxes, &self.detections);
        Ok(())
    }

    /// Share of the detector's boxes on the audited frames that were shown, with its 95 % interval.
    fn recall(&self) -> Option<(f64, f64, f64)> {
        let recall = self.audit.recall()?;
        Some((recall.rate, recall.low, recall.high))
    }

    /// Forgets all objects, as at the start of a stream.
    fn reset(&mut self) {
        self.policy.reset();
        if let Some(settling) = &mut self.settling {
            settling.end_stream();
        }
        self.order = Order::default();
        self.grey.forget();
    }

    /// Returns all objects, the oldest first.
    fn objects(&self) -> Vec<Object> {
        let mut objects = Vec::new();
        self.policy.policy().objects(&mut |object| {
            let place = object.bounding_box;
            objects.push((
                object.id.0,
                object.class.0,
                object.confirmed,
                object.confidence,
                <[f64; 4]>::from(place),
                object.tau,
                object.hits,
                object.since_update,
                object.since_infer,
                object.misses,
            ));
        });
        objects
    }

    #[getter]
    fn frame(&self) -> Option<u64> {
        self.order.frame()
    }

    #[getter]
    fn wants(&self) -> bool {
        self.order.wants_detector()
    }

    #[getter]
    fn policy(&self) -> &'static str {
        self.policy.policy().name()
    }

    /// True if the policy examines pictures.
    #[getter]
    fn looks(&self) -> bool {
        self.policy.policy().pictures().is_some()
    }

    /// Name, meaning, least and largest value of the threshold.
    #[getter]
    fn threshold_spec(&self) -> Option<(&'static str, &'static str, f64, f64)> {
        let spec = self.policy.policy().threshold_spec()?;
        Some((spec.name, spec.meaning, spec.minimum, spec.maximum))
    }

    #[getter]
    fn threshold(&self) -> Option<f64> {
        self.policy.policy().threshold()
    }

    #[setter]
    fn set_threshold(&mut self, value: f64) -> PyResult<()> {
        self.policy.set_threshold(value).map_err(wrong)
    }

    #[getter]
    fn state(&self) -> &'static str {
        self.outcome.state.as_str()
    }

    #[getter]
    fn cause(&self) -> Option<&'static str> {
        self.outcome.cause.map(|cause| cause.as_str())
    }

    #[getter]
    fn tau_max(&self) -> Option<f64> {
        self.outcome.tau_max
    }

    #[getter]
    fn active(&self) -> usize {
        self.outcome.active
    }

    #[getter]
    fn degraded(&self) -> bool {
        self.outcome.degraded
    }

    #[getter]
    fn refused(&self) -> u64 {
        self.policy.policy().rejected_detections()
    }
}

impl Decider {
    /// Answers the policy's needs for a frame, until it needs the detector or nothing more.
    fn ask(&mut self, head: FrameHead, empty: Option<bool>) -> Need {
        let mut need = self.policy.frame(head, &mut self.outcome);
        loop {
            let evidence = match need {
                Need::Nothing | Need::Detections => return need,
                Need::Screen => match empty {
                    Some(empty) => Evidence::Screen { empty },
                    None => Evidence::Unavailable,
                },
                Need::GreyPicture => self.grey.halved(),
                Need::SmallGreyPicture { width } => self.grey.with_columns(width),
            };
            // This frame is the pending one, so its evidence is never refused.
            need = self
                .policy
                .deliver(head.index, evidence, &mut self.outcome)
                .unwrap_or(Need::Nothing);
        }
    }

    /// Makes a frame decided and passes its answer to the settler.
    fn finish_frame(&mut self, frame: u64, answer: Answer) {
        self.order.decide(frame);
        if let Some(settling) = &mut self.settling {
            settling.frame(frame, &self.outcome, answer == Answer::Early);
        }
    }
}

/// Whether the answer of a frame may still change.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Answer {
    Final,
    /// Late detections will change it.
    Early,
}

/// Builds the policy `NAME[:ARGUMENT]` under a profile.
fn build(policy: &str, profile: &str) -> PyResult<Box<dyn Policy>> {
    let profile = match profile {
        "paper" => Profile::Paper,
        "reference" => Profile::Reference,
        other => {
            return Err(PyValueError::new_err(format!(
                "there is no profile '{other}'; the profiles are 'paper' and 'reference'"
            )));
        }
    };
    let mut config = PolicyConfig {
        profile,
        ..PolicyConfig::default()
    };
    config.select(policy).map_err(wrong)?;
    config.build().map_err(wrong)
}

fn wrong(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// The error for detections of a frame that waits for none. `pending` is the frame that waits for some.
fn not_waiting(frame: u64, pending: Option<u64>) -> PyErr {
    let reason = match pending {
        Some(pending) => format!(", frame {pending} does"),
        None => ": submit(n) was not True for it".to_owned(),
    };
    PyRuntimeError::new_err(format!(
        "frame {frame} does not wait for detections{reason}"
    ))
}
