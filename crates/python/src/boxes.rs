//! Converts boxes between NumPy's arrays in pixels and the core's types.

use albireo_core::detection::{ClassId, Detection};
use albireo_core::geometry::{Corners, PictureSize};
use albireo_core::policy::{BoxSource, OutputBox};
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, ndarray,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The names of the sources, in the order of [`source_index`].
pub(crate) const SOURCES: [&str; 4] = ["detected", "predicted", "followed", "rescued"];

const fn source_index(source: BoxSource) -> u8 {
    match source {
        BoxSource::Detected => 0,
        BoxSource::Predicted => 1,
        BoxSource::Followed => 2,
        BoxSource::Rescued => 3,
    }
}

/// Detections as arrays: `xyxy` of shape (N, 4) in pixels, confidence and class, each of length N.
pub(crate) type Found<'py> = (
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray1<'py, f64>,
);

/// Boxes as arrays: `xyxy` of shape (N, 4) in pixels, confidence, class, id (-1 without) and index into [`SOURCES`],
/// each of length N.
pub(crate) type Arrays<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<u8>>,
);

/// Reads detections on a picture of `size` into `detections`. The arrays must agree in length.
pub(crate) fn read(
    found: &Found<'_>,
    size: PictureSize,
    detections: &mut Vec<Detection>,
) -> PyResult<()> {
    let (xyxy, confidence, class_id) = found;
    let xyxy = xyxy.as_array();
    let confidence = confidence.as_array();
    let class_id = class_id.as_array();
    let (boxes, columns) = xyxy.dim();
    if columns != 4 || confidence.len() != boxes || class_id.len() != boxes {
        return Err(PyValueError::new_err(format!(
            "there are boxes of shape ({boxes}, {columns}), {} confidences and {} classes; they must be (N, 4), N and N",
            confidence.len(),
            class_id.len()
        )));
    }
    detections.clear();
    for row in 0..boxes {
        let class = class_id[row];
        if class.fract() != 0.0 || !(0.0..=65_535.0).contains(&class) {
            return Err(PyValueError::new_err(format!(
                "a class is {class}; classes are whole numbers from 0 to 65535"
            )));
        }
        let corners = Corners {
            x1: xyxy[[row, 0]],
            y1: xyxy[[row, 1]],
            x2: xyxy[[row, 2]],
            y2: xyxy[[row, 3]],
        };
        detections.push(Detection {
            bounding_box: corners.normalise(size),
            class: ClassId(class as u16),
            confidence: confidence[row],
        });
    }
    Ok(())
}

/// Writes boxes on a picture of `size` as arrays.
pub(crate) fn arrays<'py>(py: Python<'py>, boxes: &[OutputBox], size: PictureSize) -> Arrays<'py> {
    fn column<'py, T: Element>(
        py: Python<'py>,
        boxes: &[OutputBox],
        value_of: impl Fn(&OutputBox) -> T,
    ) -> Bound<'py, PyArray1<T>> {
        let values: Vec<T> = boxes.iter().map(value_of).collect();
        values.into_pyarray(py)
    }
    let mut corners_of_boxes = Vec::with_capacity(boxes.len());
    for found in boxes {
        let corners = found.bounding_box.pixel_corners(size);
        corners_of_boxes.push([corners.x1, corners.y1, corners.x2, corners.y2]);
    }
    let xyxy = ndarray::Array2::from(corners_of_boxes);
    (
        xyxy.into_pyarray(py),
        column(py, boxes, |found| found.confidence),
        column(py, boxes, |found| i64::from(found.class.0)),
        column(py, boxes, |found| match found.object {
            Some(object) => object.0.cast_signed(),
            None => -1,
        }),
        column(py, boxes, |found| source_index(found.source)),
    )
}
