//! The extension module of the Python package `albireo`: a policy of the core behind NumPy arrays.
//!
//! The Python code checks arguments and has the types of results; this module only handles boxes as arrays.

use albireo_core::audit::{AuditDraw, AuditSums};
use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::{
    BoxSource, Evidence, FrameHead, GreyPicture, InvalidThreshold, LatePolicy, Need, Outcome,
    OutputBox, Policy, PolicyConfig, Profile, SettledFrame, Settler,
};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::time::Duration;

/// The stage of the current frame.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// There has been no frame yet.
    NoFrame,
    /// The frame wants the detector.
    WantsDetector,
    /// The frame is decided.
    Decided,
}

/// Boxes as arrays: `xyxy` of shape (N, 4) in pixels, confidence, class, id (-1 without) and index into `SOURCES`, each
/// of length N.
type Arrays<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<u8>>,
);

/// The state of an object: id, class, whether it is confirmed, confidence, box (centre and sides, normalised),
/// uncertainty, hits, frames since its last detection, frames since the detector last measured or missed it, misses in a row.
type Object = (u64, u16, bool, f64, [f64; 4], f64, u32, u32, u32, u32);

/// A policy, and when its frames are answered.
enum Engine {
    /// A frame waits for the detections that it wants.
    Waiting(Box<dyn Policy>),
    /// A frame is answered at once, and takes its detections when they come.
    Late(LatePolicy),
}

impl Engine {
    fn policy(&self) -> &dyn Policy {
        match self {
            Self::Waiting(policy) => &**policy,
            Self::Late(late) => late.policy(),
        }
    }

    fn set_threshold(&mut self, value: f64) -> Result<(), InvalidThreshold> {
        match self {
            Self::Waiting(policy) => policy.set_threshold(value),
            Self::Late(late) => late.set_threshold(value),
        }
    }
}

/// A frame that the settler has returned: its number, state, whether it was settled, and its boxes.
type Settled = (u64, &'static str, bool, Vec<OutputBox>);

fn settled(frame: &SettledFrame<'_>) -> Settled {
    (
        frame.index,
        frame.state.as_str(),
        frame.settled,
        frame.boxes.to_vec(),
    )
}

/// Decides the frames of one stream.
#[pyclass(module = "albireo._core")]
struct Decider {
    engine: Engine,
    size: PictureSize,
    last: Option<u64>,
    stage: Stage,
    outcome: Outcome,
    detections: Vec<Detection>,
    grey: Grey,
    draw: AuditDraw,
    audit: AuditSums,
    /// The final answer of a frame whose detections came late.
    late: Outcome,
    settler: Option<Settler>,
    settled: Vec<Settled>,
}

/// A grey picture in a buffer that is reused.
#[derive(Default)]
struct Grey {
    size: Option<PictureSize>,
    pixels: Vec<u8>,
}

#[pymethods]
impl Decider {
    /// Makes a decider for pictures of `size` (width, height); `audit` is the share of frames that are drawn, and a seed.
    #[new]
    fn new(
        policy: &str,
        profile: &str,
        threshold: Option<f64>,
        size: (u32, u32),
        audit: (f64, u64),
        late: bool,
        settle: Option<u64>,
    ) -> PyResult<Self> {
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
        let engine = if late {
            Engine::Late(LatePolicy::new(policy).map_err(|error| {
                PyValueError::new_err(format!(
                    "policy '{}' cannot take late detections: it predicts no boxes",
                    error.policy
                ))
            })?)
        } else {
            Engine::Waiting(policy)
        };
        Ok(Self {
            engine,
            size: PictureSize::new(size.0, size.1),
            last: None,
            stage: Stage::NoFrame,
            outcome: Outcome::default(),
            detections: Vec::new(),
            grey: Grey::default(),
            draw: AuditDraw::new(audit.0, audit.1),
            audit: AuditSums::default(),
            late: Outcome::default(),
            settler: settle.map(|frames| Settler::new(Duration::from_secs(frames))),
            settled: Vec::new(),
        })
    }

    /// Takes the grey picture of the next frame, an array of shape (rows, columns).
    fn look(&mut self, picture: PyReadonlyArray2<'_, u8>) -> PyResult<()> {
        let [rows, columns] = *picture.shape() else {
            return Err(PyValueError::new_err("a grey picture has two dimensions"));
        };
        let side = |pixels: usize| {
            u32::try_from(pixels)
                .ok()
                .filter(|side| (1..=65_535).contains(side))
                .ok_or_else(|| {
                    PyValueError::new_err(format!(
                        "a grey picture of {columns}x{rows} pixels: its sides must be 1 to 65535"
                    ))
                })
        };
        let size = PictureSize::new(side(columns)?, side(rows)?);
        // The picture is copied, so that no one changes it while it is read without the interpreter's lock.
        self.grey.pixels.clear();
        self.grey.pixels.extend(picture.as_array().iter());
        self.grey.size = Some(size);
        Ok(())
    }

    /// Begins frame `n` and returns whether it wants the detector. `empty` is a screen's verdict on the scene.
    fn begin(&mut self, py: Python<'_>, n: Option<u64>, empty: Option<bool>) -> PyResult<bool> {
        let following = self.last.map_or(Some(0), |last| last.checked_add(1));
        let n = n.or(following).unwrap_or(u64::MAX);
        let step = match self.last {
            Some(last) if n <= last => {
                return Err(PyValueError::new_err(format!(
                    "frame {n} cannot follow frame {last}: frame numbers must increase (a new stream begins with reset())"
                )));
            }
            Some(last) => u32::try_from(n - last).unwrap_or(u32::MAX),
            None => 1,
        };
        self.last = Some(n);
        let head = FrameHead {
            index: n,
            step,
            picture: self.size,
        };
        let looks = self.grey.size.is_some();
        let need = if looks {
            py.detach(|| self.ask(head, empty))
        } else {
            self.ask(head, empty)
        };
        self.grey.size = None;
        let wanted = need == Need::Detections;
        match &mut self.engine {
            Engine::Waiting(_) if wanted => self.stage = Stage::WantsDetector,
            Engine::Waiting(_) => self.finish(),
            Engine::Late(_) => self.answered(wanted),
        }
        Ok(wanted)
    }

    /// Takes the detections of frame `n`, which was answered earlier, or `None` if the detector failed; returns the final
    /// boxes.
    fn deliver<'py>(
        &mut self,
        py: Python<'py>,
        n: u64,
        found: Option<(
            PyReadonlyArray2<'py, f64>,
            PyReadonlyArray1<'py, f64>,
            PyReadonlyArray1<'py, f64>,
        )>,
    ) -> PyResult<Arrays<'py>> {
        if let Some((xyxy, confidence, class_id)) = &found {
            self.read(xyxy, confidence, class_id)?;
        }
        let Engine::Late(late) = &mut self.engine else {
            return Err(PyRuntimeError::new_err(
                "deliver(n, result) is for detections that come late: make the skipper with late=True",
            ));
        };
        let evidence = match found {
            Some(_) => Evidence::Detections(&self.detections),
            None => Evidence::Unavailable,
        };
        late.deliver(n, evidence, &mut self.late).map_err(|_| {
            PyRuntimeError::new_err(match late.pending() {
                Some(pending) => {
                    format!("frame {n} does not wait for detections, frame {pending} does")
                }
                None => {
                    format!("frame {n} does not wait for detections: submit(n) was not True for it")
                }
            })
        })?;
        let given = &mut self.settled;
        if let Some(settler) = &mut self.settler {
            settler.late(n, &self.late, |frame| given.push(settled(&frame)));
        }
        Ok(self.arrays(py, &self.late.boxes))
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
        match &self.engine {
            Engine::Waiting(_) => None,
            Engine::Late(late) => late.pending(),
        }
    }

    /// Returns the frames that were settled since the last call: number, state, whether it was settled, boxes. `end` returns
    /// all that are left.
    fn settled<'py>(
        &mut self,
        py: Python<'py>,
        end: bool,
    ) -> PyResult<Vec<(u64, &'static str, bool, Arrays<'py>)>> {
        let given = &mut self.settled;
        match &mut self.settler {
            Some(settler) if end => settler.flush(|frame| given.push(settled(&frame))),
            Some(_) => {}
            None => {
                return Err(PyRuntimeError::new_err(
                    "nothing is settled: make the skipper with settle=True",
                ));
            }
        }
        let frames = std::mem::take(&mut self.settled);
        Ok(frames
            .into_iter()
            .map(|(n, state, settled, boxes)| (n, state, settled, self.arrays(py, &boxes)))
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
        self.awaited("update(result)")?;
        self.read(&xyxy, &confidence, &class_id)?;
        if let Engine::Waiting(policy) = &mut self.engine {
            policy.answer(Evidence::Detections(&self.detections));
        }
        self.finish();
        Ok(self.arrays(py, &self.outcome.boxes))
    }

    /// Ends the current frame without the detections that it wants, and returns the boxes to show.
    fn unavailable<'py>(&mut self, py: Python<'py>) -> PyResult<Arrays<'py>> {
        self.awaited("unavailable()")?;
        if let Engine::Waiting(policy) = &mut self.engine {
            policy.answer(Evidence::Unavailable);
        }
        self.finish();
        Ok(self.arrays(py, &self.outcome.boxes))
    }

    /// Returns the boxes of the current frame.
    fn boxes<'py>(&self, py: Python<'py>) -> PyResult<Arrays<'py>> {
        self.decided()?;
        Ok(self.arrays(py, &self.outcome.boxes))
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
        self.decided()?;
        if !self.outcome.state.is_skipped() {
            return Err(PyRuntimeError::new_err(
                "the detector has already run on this frame: an audit compares frames that were skipped",
            ));
        }
        self.read(&xyxy, &confidence, &class_id)?;
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
        match &mut self.engine {
            Engine::Waiting(policy) => policy.reset(),
            Engine::Late(late) => late.reset(),
        }
        let given = &mut self.settled;
        if let Some(settler) = &mut self.settler {
            settler.flush(|frame| given.push(settled(&frame)));
        }
        self.last = None;
        self.stage = Stage::NoFrame;
        self.grey.size = None;
    }

    /// Returns all objects, the oldest first.
    fn objects(&self) -> Vec<Object> {
        let mut objects = Vec::new();
        self.engine.policy().objects(&mut |object| {
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
        self.last
    }

    #[getter]
    fn wants(&self) -> bool {
        self.stage == Stage::WantsDetector
    }

    #[getter]
    fn policy(&self) -> &'static str {
        self.engine.policy().name()
    }

    /// True if the policy examines pictures.
    #[getter]
    fn looks(&self) -> bool {
        self.engine.policy().pictures().is_some()
    }

    /// Name, meaning, least and largest value of the threshold.
    #[getter]
    fn threshold_spec(&self) -> Option<(&'static str, &'static str, f64, f64)> {
        let spec = self.engine.policy().threshold_spec()?;
        Some((spec.name, spec.meaning, spec.minimum, spec.maximum))
    }

    #[getter]
    fn threshold(&self) -> Option<f64> {
        self.engine.policy().threshold()
    }

    #[setter]
    fn set_threshold(&mut self, value: f64) -> PyResult<()> {
        self.engine.set_threshold(value).map_err(wrong)
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
        self.engine.policy().rejected_detections()
    }
}

impl Decider {
    /// Answers the policy's needs for a frame, until it needs the detector or nothing more.
    fn ask(&mut self, head: FrameHead, empty: Option<bool>) -> Need {
        let mut need = match &mut self.engine {
            Engine::Waiting(policy) => policy.begin(head),
            Engine::Late(late) => late.frame(head, &mut self.outcome),
        };
        loop {
            let evidence = match need {
                Need::Nothing | Need::Detections => return need,
                Need::Screen => {
                    empty.map_or(Evidence::Unavailable, |empty| Evidence::Screen { empty })
                }
                Need::GreyPicture => self.grey.evidence(None),
                Need::SmallGreyPicture { width } => self.grey.evidence(Some(width)),
            };
            need = match &mut self.engine {
                Engine::Waiting(policy) => policy.answer(evidence),
                // This frame is the pending one, so its evidence is never refused.
                Engine::Late(late) => match late.deliver(head.index, evidence, &mut self.late) {
                    Ok(Need::Nothing) => {
                        self.outcome.clone_from(&self.late);
                        Need::Nothing
                    }
                    Ok(need) => need,
                    Err(_) => Need::Nothing,
                },
            };
        }
    }

    fn finish(&mut self) {
        if let Engine::Waiting(policy) = &mut self.engine {
            policy.finish(&mut self.outcome);
        }
        self.answered(false);
    }

    /// Passes the answer of the current frame to the settler. `pending` is true if late detections will change it.
    fn answered(&mut self, pending: bool) {
        self.stage = Stage::Decided;
        let given = &mut self.settled;
        if let (Some(settler), Some(n)) = (&mut self.settler, self.last) {
            // A frame's number is also its time, so the settler's limit is a number of frames.
            let time = Duration::from_secs(n);
            settler.frame(n, time, &self.outcome, pending, |frame| {
                given.push(settled(&frame))
            });
        }
    }

    /// Refuses a call for a frame that does not want the detector.
    fn awaited(&self, call: &str) -> PyResult<()> {
        match (self.stage, self.last) {
            (Stage::WantsDetector, _) => Ok(()),
            (Stage::Decided, Some(n)) => Err(PyRuntimeError::new_err(format!(
                "frame {n} does not want the detector: its boxes are predict(), and {call} belongs to a frame for which \
                 wants_detector() returned True"
            ))),
            _ => Err(PyRuntimeError::new_err(format!(
                "call wants_detector(n) before {call}: there is no frame yet"
            ))),
        }
    }

    /// Refuses a call for a frame that is not decided.
    fn decided(&self) -> PyResult<()> {
        match (self.stage, self.last) {
            (Stage::Decided, _) => Ok(()),
            (Stage::WantsDetector, Some(n)) => Err(PyRuntimeError::new_err(format!(
                "frame {n} wants the detector: call update(result) with what it found, or unavailable() when it failed"
            ))),
            _ => Err(PyRuntimeError::new_err(
                "call wants_detector(n) first: there is no frame yet",
            )),
        }
    }

    /// Reads detections, whose arrays must agree in length.
    fn read(
        &mut self,
        xyxy: &PyReadonlyArray2<'_, f64>,
        confidence: &PyReadonlyArray1<'_, f64>,
        class_id: &PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        let (xyxy, confidence, class_id) =
            (xyxy.as_array(), confidence.as_array(), class_id.as_array());
        let (boxes, columns) = xyxy.dim();
        if columns != 4 || confidence.len() != boxes || class_id.len() != boxes {
            return Err(PyValueError::new_err(format!(
                "there are boxes of shape ({boxes}, {columns}), {} confidences and {} classes; they must be (N, 4), N and N",
                confidence.len(),
                class_id.len()
            )));
        }
        self.detections.clear();
        for (row, (&confidence, &class)) in
            (xyxy.rows().into_iter()).zip(confidence.iter().zip(class_id.iter()))
        {
            if class.fract() != 0.0 || !(0.0..=65_535.0).contains(&class) {
                return Err(PyValueError::new_err(format!(
                    "a class is {class}; classes are whole numbers from 0 to 65535"
                )));
            }
            let corners = Corners {
                x1: row[0],
                y1: row[1],
                x2: row[2],
                y2: row[3],
            };
            self.detections.push(Detection {
                bounding_box: corners.normalise(self.size),
                class: ClassId(class as u16),
                confidence,
            });
        }
        Ok(())
    }

    fn arrays<'py>(&self, py: Python<'py>, boxes: &[OutputBox]) -> Arrays<'py> {
        fn column<'py, T: numpy::Element>(
            py: Python<'py>,
            boxes: &[OutputBox],
            of: impl Fn(&OutputBox) -> T,
        ) -> Bound<'py, PyArray1<T>> {
            boxes.iter().map(of).collect::<Vec<_>>().into_pyarray(py)
        }
        let xyxy = numpy::ndarray::Array2::from_shape_fn((boxes.len(), 4), |(row, column)| {
            let corners = boxes[row].bounding_box.pixel_corners(self.size);
            [corners.x1, corners.y1, corners.x2, corners.y2][column]
        });
        (
            xyxy.into_pyarray(py),
            column(py, boxes, |found| found.confidence),
            column(py, boxes, |found| i64::from(found.class.0)),
            column(py, boxes, |found| {
                found.object.map_or(-1, |id| id.0.cast_signed())
            }),
            column(py, boxes, |found| source_index(found.source)),
        )
    }
}

impl Grey {
    /// Returns the picture, halved until it is as small as `width` asks for, or once without a width.
    fn evidence(&mut self, width: Option<u32>) -> Evidence<'_> {
        let Some(mut size) = self.size else {
            return Evidence::Unavailable;
        };
        let least = width.map(|width| width.max(1));
        while size.width >= 2
            && size.height >= 2
            && least.is_none_or(|least| size.width / 2 >= least)
        {
            size = halve(&mut self.pixels, size);
            if least.is_none() {
                break;
            }
        }
        // The buffer has been made smaller, so it cannot be used a second time.
        self.size = None;
        Evidence::GreyPicture(GreyPicture {
            size,
            pixels: &self.pixels,
        })
    }
}

/// Halves a grey picture in each direction, in place, and returns its new size.
fn halve(pixels: &mut Vec<u8>, size: PictureSize) -> PictureSize {
    let half = PictureSize::new(size.width / 2, size.height / 2);
    let (row, half_row) = (size.width as usize, half.width as usize);
    for y in 0..half.height as usize {
        for x in 0..half_row {
            let at = 2 * y * row + 2 * x;
            let sum: u16 = [at, at + 1, at + row, at + row + 1]
                .iter()
                .map(|&pixel| u16::from(pixels[pixel]))
                .sum();
            pixels[y * half_row + x] = ((sum + 2) / 4) as u8;
        }
    }
    pixels.truncate(half_row * half.height as usize);
    half
}

/// The names of the sources, in the order of [`source_index`].
const SOURCES: [&str; 4] = ["detected", "predicted", "followed", "rescued"];

const fn source_index(source: BoxSource) -> u8 {
    match source {
        BoxSource::Detected => 0,
        BoxSource::Predicted => 1,
        BoxSource::Followed => 2,
        BoxSource::Rescued => 3,
    }
}

fn wrong(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// The extension module `albireo._core`.
#[pymodule(gil_used = false)]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Decider>()?;
    module.add("SOURCES", SOURCES)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
