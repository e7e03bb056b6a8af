//! The class that decides the frames of one stream.

use crate::boxes::{Arrays, Found, arrays, read};
use crate::grey::Grey;
use crate::order::Order;
use crate::settled::Settling;
use albireo_core::audit::{AuditDraw, AuditSums};
use albireo_core::detection::Detection;
use albireo_core::geometry::PictureSize;
use albireo_core::policy::{
    Evidence, FrameHead, LatePolicy, Need, Outcome, PauseFrames, PolicyConfig, Profile, no_pause,
};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// The state of an object: id, class, whether it is confirmed, confidence, box (centre and sides, normalised),
/// uncertainty, hits, frames since its last detection, frames since the detector last measured or missed it, misses in a row.
type Object = (u64, u16, bool, f64, [f64; 4], f64, u32, u32, u32, u32);

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
    /// Makes a decider for pictures of `size` (width, height); `audit` is the share of frames that are drawn, and a seed;
    /// `answers` says whether detections come late, and the longest delay of settled frames; `pause` is the number of frames
    /// of which one is looked at on an empty road, and the frames without a detection after which it is empty.
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
        let (late, settle) = answers;
        let (every, after) = pause;
        let mut config = PolicyConfig {
            profile: match profile {
                "paper" => Profile::Paper,
                "reference" => Profile::Reference,
                other => {
                    return Err(PyValueError::new_err(format!(
                        "there is no profile '{other}'; the profiles are 'paper' and 'reference'"
                    )));
                }
            },
            ..PolicyConfig::default()
        };
        config.select(policy).map_err(wrong)?;
        let mut policy = config.build().map_err(wrong)?;
        if let Some(threshold) = threshold {
            policy.set_threshold(threshold).map_err(wrong)?;
        }
        if every > 1 && !policy.takes_pause() {
            return Err(PyValueError::new_err(no_pause(policy.name())));
        }
        let mut policy = if late {
            LatePolicy::new(policy).map_err(|error| {
                PyValueError::new_err(format!(
                    "policy '{}' cannot take late detections: it predicts no boxes",
                    error.policy
                ))
            })?
        } else {
            LatePolicy::waiting(policy)
        };
        policy.set_pause(PauseFrames {
            every,
            after,
            ..PauseFrames::OFF
        });
        Ok(Self {
            policy,
            size: PictureSize::new(size.0, size.1),
            order: Order::default(),
            outcome: Outcome::default(),
            detections: Vec::new(),
            grey: Grey::default(),
            draw: AuditDraw::new(audit.0, audit.1),
            audit: AuditSums::default(),
            late: Outcome::default(),
            settling: settle.map(Settling::new),
        })
    }

    /// Takes the grey picture of the next frame, an array of shape (rows, columns).
    fn look(&mut self, picture: PyReadonlyArray2<'_, u8>) -> PyResult<()> {
        self.grey.take(&picture)
    }

    /// Takes the picture of the next frame, an array of shape (rows, columns, 3 or 4), from red to blue or from blue to red.
    fn look_in_color(
        &mut self,
        picture: PyReadonlyArray3<'_, u8>,
        red_first: bool,
    ) -> PyResult<()> {
        self.grey.take_colored(&picture, red_first)
    }

    /// Begins frame `n` and returns whether it wants the detector. `empty` is a screen's verdict on the scene.
    fn begin(&mut self, py: Python<'_>, n: Option<u64>, empty: Option<bool>) -> PyResult<bool> {
        let (n, step) = self.order.next(n)?;
        let head = FrameHead {
            index: n,
            step,
            picture: self.size,
        };
        let need = if self.grey.is_there() {
            py.detach(|| self.ask(head, empty))
        } else {
            self.ask(head, empty)
        };
        self.grey.forget();
        let wanted = need == Need::Detections;
        if wanted && self.policy.waits() {
            self.order.wait(n);
        } else {
            self.decided(n, wanted);
        }
        Ok(wanted)
    }

    /// Takes the detections of frame `n`, which was answered earlier, or `None` if the detector failed; returns the final
    /// boxes.
    fn deliver<'py>(
        &mut self,
        py: Python<'py>,
        n: u64,
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
            .deliver(n, evidence, &mut self.late)
            .map_err(|_| not_waiting(n, pending))?;
        if let Some(settling) = &mut self.settling {
            settling.late(n, &self.late);
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
        self.policy.pending().filter(|_| !self.policy.waits())
    }

    /// Returns the frames that were settled since the last call: number, state, whether it was settled, boxes. `end` returns
    /// all that are left.
    fn settled<'py>(
        &mut self,
        py: Python<'py>,
        end: bool,
    ) -> PyResult<Vec<(u64, &'static str, bool, Arrays<'py>)>> {
        let Some(settling) = &mut self.settling else {
            return Err(PyRuntimeError::new_err(
                "nothing is settled: make the skipper with settle=True",
            ));
        };
        if end {
            settling.flush();
        }
        let frames = settling.take().into_iter();
        Ok(frames
            .map(|(n, state, settled, boxes)| (n, state, settled, arrays(py, &boxes, self.size)))
            .collect())
    }

    /// Takes the detections of the current frame, and returns the boxes to show.
    fn update<'py>(
        &mut self,
        py: Python<'py>,
        xyxy: PyReadonlyArray2<'py, f64>,
        confidence: PyReadonlyArray1<'py, f64>,
        class_id: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Arrays<'py>> {
        let n = self.order.awaited("update(result)")?;
        let found = (xyxy, confidence, class_id);
        read(&found, self.size, &mut self.detections)?;
        let evidence = Evidence::Detections(&self.detections);
        self.policy.deliver(n, evidence, &mut self.outcome).map_err(wrong)?;
        self.decided(n, false);
        Ok(arrays(py, &self.outcome.boxes, self.size))
    }

    /// Ends the current frame without the detections that it wants, and returns the boxes to show.
    fn unavailable<'py>(&mut self, py: Python<'py>) -> PyResult<Arrays<'py>> {
        let n = self.order.awaited("unavailable()")?;
        self.policy
            .deliver(n, Evidence::Unavailable, &mut self.outcome)
            .map_err(wrong)?;
        self.decided(n, false);
        Ok(arrays(py, &self.outcome.boxes, self.size))
    }

    /// Returns the boxes of the current frame.
    fn boxes<'py>(&self, py: Python<'py>) -> PyResult<Arrays<'py>> {
        self.order.decided()?;
        Ok(arrays(py, &self.outcome.boxes, self.size))
    }

    /// True if frame `n` belongs to the random sample of an audit.
    fn drawn(&self, n: u64) -> bool {
        self.draw.draw(n)
    }

    /// Compares the boxes of the current frame, which skipped the detector, with the detector's.
    fn compare(
        &mut self,
        xyxy: PyReadonlyArray2<'_, f64>,
        confidence: PyReadonlyArray1<'_, f64>,
        class_id: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        self.order.decided()?;
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
            settling.flush();
        }
        self.order = Order::default();
        self.grey.forget();
    }

    /// Returns all objects, the oldest first.
    fn objects(&self) -> Vec<Object> {
        let mut objects = Vec::new();
        self.policy.policy().objects(&mut |object| {
            let b = object.bounding_box;
            objects.push((
                object.id.0,
                object.class.0,
                object.confirmed,
                object.confidence,
                [b.center_x, b.center_y, b.width, b.height],
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
                Need::Screen => {
                    empty.map_or(Evidence::Unavailable, |empty| Evidence::Screen { empty })
                }
                Need::GreyPicture => self.grey.evidence(None),
                Need::SmallGreyPicture { width } => self.grey.evidence(Some(width)),
            };
            // This frame is the pending one, so its evidence is never refused.
            need = self
                .policy
                .deliver(head.index, evidence, &mut self.outcome)
                .unwrap_or(Need::Nothing);
        }
    }

    /// Makes frame `n` decided and passes its answer to the settler. `pending` is true if late detections will change it.
    fn decided(&mut self, n: u64, pending: bool) {
        self.order.decide(n);
        if let Some(settling) = &mut self.settling {
            settling.frame(n, &self.outcome, pending);
        }
    }
}

fn wrong(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// The error for detections of frame `n`, which asked for none, while `pending` may.
fn not_waiting(n: u64, pending: Option<u64>) -> PyErr {
    let reason = match pending {
        Some(pending) => format!("frame {pending} does"),
        None => {
            return PyRuntimeError::new_err(format!(
                "frame {n} does not wait for detections: submit(n) was not True for it"
            ));
        }
    };
    PyRuntimeError::new_err(format!("frame {n} does not wait for detections, {reason}"))
}
