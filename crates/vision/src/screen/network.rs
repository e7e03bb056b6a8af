//! The screen's network: any two-class model with a picture input, on the CPU.

use super::ScreenConfig;
use crate::detector::{Preparation, PreparedPicture};
use crate::onnx::{
    ExecutionProvider, GpuConfig, OnnxSession, PictureInput, SessionSettings, Signature, StartError,
};
use crate::picture::{Fit, InputFormat, Picture, ValueRange};
use crate::worker::{Model, RunError};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// The two outputs of the network, before any normalisation.
pub type Logits = [f32; 2];

/// A description of the expected model.
const EXPECTED: &str =
    "one picture input [1, 3, rows, columns] or [1, rows, columns, 3] and one output [1, 2]";

pub(super) struct ScreenNetwork {
    session: OnnxSession,
    format: InputFormat,
}

impl ScreenNetwork {
    /// Loads the model and runs it once, so that the first picture is not slow.
    pub(super) fn open(
        model: &Path,
        config: &ScreenConfig,
        onnxruntime: Option<PathBuf>,
    ) -> Result<Self, StartError> {
        let session = OnnxSession::open(&SessionSettings {
            model: model.to_owned(),
            providers: vec![ExecutionProvider::Cpu],
            gpu: GpuConfig::default(),
            threads: 1,
            onnxruntime,
            shapes: None,
            engines: None,
        })?;
        let signature = session.signature();
        let input = picture_input(signature).map_err(|reason| {
            StartError::does_not_fit(model, signature, ("screen", EXPECTED), reason)
        })?;
        let format = input.format(Fit::Stretch, config.color_order, ValueRange::ToOne);
        let mut network = Self { session, format };
        let failed = |error: &dyn Display| StartError::first_run(model, error);
        let black = Preparation::new(format)
            .prepare(&Picture::black(format.size))
            .map_err(|error| failed(&error))?;
        network.infer(&black).map_err(|error| failed(&error))?;
        Ok(network)
    }

    fn infer(&mut self, picture: &PreparedPicture) -> Result<Logits, RunError> {
        let InputFormat { size, .. } = self.format;
        let shape = self.format.shape();
        let ran = self.session.run(shape, size, &[picture.tensor()], |outputs| {
            let values = outputs.first().map(|output| output.values);
            logits(values)
        });
        ran.map_err(RunError::Failed)?
    }
}

/// The values of an output as logits, if they are two finite numbers.
fn logits(values: Option<&[f32]>) -> Result<Logits, RunError> {
    let found = match values {
        Some(&[first, second]) if first.is_finite() && second.is_finite() => {
            return Ok([first, second]);
        }
        Some(values) => format!("{values:?}"),
        None => "nothing".to_owned(),
    };
    Err(RunError::Failed(format!(
        "the screen returned {found} instead of two finite numbers"
    )))
}

fn picture_input(signature: &Signature) -> Result<PictureInput, String> {
    let input = signature.picture_input(None)?;
    match *signature.only_output()?.shape.as_slice() {
        [1 | -1, 2] => Ok(input),
        _ => Err("its output has another shape".to_owned()),
    }
}

impl Model for ScreenNetwork {
    type Input = PreparedPicture;
    type Output = Logits;
    /// The input that pictures are prepared for.
    type Facts = InputFormat;

    fn facts(&self) -> InputFormat {
        self.format
    }

    fn run(&mut self, pictures: &[PreparedPicture]) -> Result<Vec<Logits>, RunError> {
        pictures.iter().map(|picture| self.infer(picture)).collect()
    }

    fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }
}
