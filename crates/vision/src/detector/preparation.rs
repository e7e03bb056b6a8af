//! Turns pictures into the input of one model by letterbox, on any thread, so that the model's own thread only runs the
//! model. Buffers are reused.

use super::inputs::Inputs;
use super::{InputUse, ModelInput};
use crate::picture::{Fit, FrameFault, InputFormat, InputMapping, InputTensor, Letterbox};
use crate::picture::{Picture, PixelLayout};
use crate::worker::{RunError, WorkerInput};
use albireo_core::geometry::PictureSize;
use parking_lot::Mutex;
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Makes the inputs of one model from pictures. Clones share their buffers; several threads may prepare at once.
#[derive(Clone)]
pub struct Preparation(Arc<PreparationState>);

struct PreparationState {
    inputs: Inputs,
    /// Buffers not in use: of each size at most as many as were ever in use at once.
    idle: Mutex<Vec<Letterbox>>,
}

/// A picture as the model's input. Its buffer is reused when the picture is dropped.
pub struct PreparedPicture {
    /// Always `Some` until the picture is dropped.
    letterbox: Option<Letterbox>,
    /// The size of the picture itself.
    source: PictureSize,
    mapping: InputMapping,
    took: Duration,
    origin: Preparation,
}

impl fmt::Debug for Preparation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Preparation").field(&self.model()).finish()
    }
}

impl Preparation {
    /// Creates a preparation for a model with this input.
    pub fn new(input: impl Into<ModelInput>) -> Self {
        Self(Arc::new(PreparationState {
            inputs: Inputs::new(input.into()),
            idle: Mutex::default(),
        }))
    }

    /// The input that the model expects; the largest, if its sides are open.
    pub fn format(&self) -> InputFormat {
        self.0.inputs.model().format
    }

    /// The input that the model expects, and the sizes that it may have.
    pub fn model(&self) -> ModelInput {
        self.0.inputs.model()
    }

    /// The size of the input at which a picture of this size runs now.
    pub(super) fn input_size(&self, picture: PictureSize) -> PictureSize {
        self.0.inputs.size_for(picture)
    }

    /// The inputs of the pictures so far, by their shape.
    pub fn inputs(&self) -> Vec<InputUse> {
        self.0.inputs.uses()
    }

    /// Resizes `picture` and converts it to the model's input, of the size that pictures of its shape run at. Takes up to
    /// a few milliseconds.
    ///
    /// # Errors
    /// If the picture is empty or its buffer does not fit its size.
    pub fn prepare(&self, picture: &Picture) -> Result<PreparedPicture, FrameFault> {
        self.prepare_at(picture, self.input_size(picture.source_size))
    }

    /// [`prepare`](Self::prepare) for an input of `size`.
    pub(super) fn prepare_at(
        &self,
        picture: &Picture,
        size: PictureSize,
    ) -> Result<PreparedPicture, FrameFault> {
        let start = Instant::now();
        let reused = self.take_idle(size);
        let mut letterbox = reused.unwrap_or_else(|| Letterbox::of_size(self.format(), size));
        let mapping = letterbox.fill(picture)?;
        Ok(PreparedPicture {
            letterbox: Some(letterbox),
            source: picture.source_size,
            mapping,
            took: start.elapsed(),
            origin: self.clone(),
        })
    }

    /// Takes a buffer of `size` that is not in use, if there is one.
    fn take_idle(&self, size: PictureSize) -> Option<Letterbox> {
        let mut idle = self.0.idle.lock();
        let place = idle.iter().rposition(|letterbox| letterbox.size() == size)?;
        Some(idle.swap_remove(place))
    }
}

/// Prepares `picture` on a blocking thread and drops it.
///
/// # Errors
/// If it cannot be prepared.
pub(crate) async fn prepare_off_thread(
    preparation: Preparation,
    picture: Arc<Picture>,
) -> Result<PreparedPicture, RunError> {
    let work = move || {
        let prepared = preparation.prepare(&picture);
        // Before the result is sent, so that its receiver is the only owner.
        drop(picture);
        prepared.map_err(|error| RunError::BadPicture(error.to_string()))
    };
    tokio::task::spawn_blocking(work)
        .await
        .unwrap_or_else(|error| Err(RunError::BadPicture(error.to_string())))
}

impl PreparedPicture {
    /// The input, in the shape of the format.
    pub fn tensor(&self) -> &InputTensor {
        const NONE: &InputTensor = &InputTensor::Bytes(Vec::new());
        self.letterbox.as_ref().map_or(NONE, Letterbox::tensor)
    }

    /// A copy in `format`, that of the model: converted, if the picture was prepared as pixels.
    ///
    /// # Errors
    /// None of a picture that was prepared.
    pub fn converted(&self, format: InputFormat) -> Result<Self, FrameFault> {
        let pixels = match self.tensor() {
            InputTensor::Bytes(pixels) if self.origin.format() != format => pixels,
            // Floats, or the bytes of a model that takes bytes, are in `format` already.
            InputTensor::Bytes(_) | InputTensor::Floats(_) => return Ok(self.copied()),
        };
        let size = self.size();
        let whole = InputFormat {
            size,
            fit: Fit::Stretch,
            ..format
        };
        let mut letterbox = Letterbox::new(whole);
        letterbox.fill(&Picture {
            size,
            source_size: size,
            layout: PixelLayout::Rgb8,
            pixels: pixels.clone(),
        })?;
        Ok(self.with(Some(letterbox)))
    }

    /// A copy whose buffer is its own.
    pub(super) fn copied(&self) -> Self {
        self.with(self.letterbox.clone())
    }

    /// The same picture in another buffer.
    fn with(&self, letterbox: Option<Letterbox>) -> Self {
        Self {
            letterbox,
            source: self.source,
            mapping: self.mapping,
            took: self.took,
            origin: Preparation::new(self.origin.model()),
        }
    }

    /// The mapping from the input's pixels back to the picture.
    pub(crate) fn mapping(&self) -> InputMapping {
        self.mapping
    }

    /// The duration of the preparation.
    pub fn took(&self) -> Duration {
        self.took
    }

    /// Columns and rows of the input.
    pub fn size(&self) -> PictureSize {
        self.letterbox.as_ref().map_or(PictureSize::new(0, 0), Letterbox::size)
    }

    /// The size of the picture itself.
    pub(super) fn source(&self) -> PictureSize {
        self.source
    }

    /// The sizes of the input to which this one belongs.
    pub(super) fn inputs(&self) -> &Inputs {
        &self.origin.0.inputs
    }
}

impl WorkerInput for PreparedPicture {
    fn size(&self) -> PictureSize {
        self.size()
    }
}

impl Drop for PreparedPicture {
    fn drop(&mut self) {
        if let Some(letterbox) = self.letterbox.take() {
            self.origin.0.idle.lock().push(letterbox);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::HeadName;
    use crate::detector::head::tests::bound;
    use crate::picture::InputElement;

    fn format_of_model() -> InputFormat {
        bound(HeadName::Yolox, &[1, 3, 32, 64], &[("output", &[1, 42, 7])]).input_format
    }

    /// A picture of one value, prepared.
    fn prepared_of(preparation: &Preparation, value: u8) -> PreparedPicture {
        let mut picture = Picture::black(preparation.format().size);
        picture.pixels.fill(value);
        preparation.prepare(&picture).unwrap()
    }

    fn holds(prepared: &PreparedPicture, value: f32) -> bool {
        prepared.tensor().to_floats().iter().all(|&it| it == value)
    }

    /// A picture of many values, prepared for a model with this input.
    fn prepared_for(format: InputFormat) -> PreparedPicture {
        let mut picture = Picture::black(PictureSize::new(64, 20));
        for (place, value) in picture.pixels.iter_mut().enumerate() {
            *value = (place % 251) as u8;
        }
        Preparation::new(format).prepare(&picture).unwrap()
    }

    #[test]
    fn pictures_that_are_prepared_at_once_have_separate_buffers() {
        let preparation = Preparation::new(format_of_model());
        let first = prepared_of(&preparation, 1);
        let second = prepared_of(&preparation, 2);
        assert!(holds(&first, 1.0));
        assert!(holds(&second, 2.0));
    }

    #[test]
    fn the_buffer_of_a_dropped_picture_is_reused() {
        let preparation = Preparation::new(format_of_model());
        let first = prepared_of(&preparation, 1);
        let second = prepared_of(&preparation, 2);
        let buffer = first.tensor().to_floats().as_ptr();
        drop(first);
        let third = prepared_of(&preparation, 3);
        assert_eq!(third.tensor().to_floats().as_ptr(), buffer);
        assert!(holds(&third, 3.0));
        assert!(holds(&second, 2.0));
        drop(second);
        drop(third);
        assert_eq!(preparation.0.idle.lock().len(), 2);
    }

    #[test]
    fn pixels_are_converted_to_the_models_format() {
        let format = format_of_model();
        let converted = prepared_for(format.as_pixels()).converted(format).unwrap();
        let expected = prepared_for(format);
        assert_eq!(converted.tensor(), expected.tensor());
        assert_eq!(converted.mapping(), expected.mapping());
    }

    #[test]
    fn bytes_of_a_model_that_takes_them_stay() {
        let takes_bytes = InputFormat {
            element: InputElement::Byte,
            ..format_of_model()
        };
        let bytes = prepared_for(takes_bytes);
        let converted = bytes.converted(takes_bytes).unwrap();
        assert_eq!(converted.tensor(), bytes.tensor());
    }
}
