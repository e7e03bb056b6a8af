//! The screen's network: any two-class model with a picture input, on the CPU.

use super::ScreenConfig;
use crate::detector::{
    CameraSlot, ExecutionProvider, Interrupter, Model, ModelError, OnnxSession, SessionSettings,
    Signature, StartError,
};
use crate::frame::{Fit, InputFormat, Letterbox, Picture, ValueRange};
use crate::geometry::PictureSize;
use std::path::{Path, PathBuf};

/// The two outputs of the network, before any normalisation.
pub type Logits = [f32; 2];

/// What the network expects of a model, in words.
const EXPECTED: &str = "one float32 input [1, 3, rows, columns] and one float32 output [1, 2]";

pub(super) struct Network {
    session: OnnxSession,
    size: PictureSize,
    letterbox: Letterbox,
}

impl Network {
    /// Loads the model and runs it once, so that the first picture is not the slow one.
    pub(super) fn open(
        model: &Path,
        config: &ScreenConfig,
        onnxruntime: Option<PathBuf>,
    ) -> Result<Self, StartError> {
        let session = OnnxSession::open(&SessionSettings {
            model: model.to_owned(),
            providers: vec![ExecutionProvider::Cpu],
            may_fall_back: false,
            threads: 1,
            onnxruntime,
        })?;
        let signature = session.signature();
        let size = input_size(signature).map_err(|reason| StartError::ModelDoesNotFit {
            path: model.to_owned(),
            head: "screen",
            model: signature.to_string(),
            expected: EXPECTED.to_owned(),
            reason,
        })?;
        let letterbox = Letterbox::new(InputFormat {
            size,
            fit: Fit::Stretch,
            color_order: config.color_order,
            value_range: ValueRange::ToOne,
        });
        let mut network = Self {
            session,
            size,
            letterbox,
        };
        network.infer().map_err(|error| StartError::WarmUp {
            path: model.to_owned(),
            reason: error.0,
        })?;
        Ok(network)
    }

    fn infer(&mut self) -> Result<Logits, ModelError> {
        let planes = self.letterbox.tensor();
        self.session.run(self.size, planes, |outputs| {
            let values = outputs.first().map(|output| output.values);
            match values {
                Some(&[first, second]) if first.is_finite() && second.is_finite() => {
                    Ok([first, second])
                }
                _ => Err(ModelError(format!(
                    "the screen gave {} instead of two finite numbers",
                    values.map_or_else(|| "nothing".to_owned(), |values| format!("{values:?}"))
                ))),
            }
        })?
    }
}

fn input_size(signature: &Signature) -> Result<PictureSize, String> {
    let size = signature.picture_input()?;
    match *signature.only_output()?.shape.as_slice() {
        [1 | -1, 2] => Ok(size),
        _ => Err("its output has another shape".to_owned()),
    }
}

impl Model for Network {
    type Output = Logits;

    fn run(&mut self, _camera: CameraSlot, picture: &Picture) -> Result<Logits, ModelError> {
        self.letterbox
            .fill(picture)
            .map_err(|error| ModelError(error.to_string()))?;
        self.infer()
    }

    fn provider(&self) -> ExecutionProvider {
        self.session.provider()
    }

    fn interrupter(&self) -> Option<Interrupter> {
        Some(self.session.interrupter())
    }
}
