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
        let does_not_fit = |reason: String| {
            StartError::does_not_fit(model, signature, ("screen", EXPECTED), reason)
        };
        let input = picture_input(signature).map_err(does_not_fit)?;
        if !config.empty_is_second {
            refuse_empty_second(signature).map_err(does_not_fit)?;
        }
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

/// Refuses a model that names its second class `empty`: the detector would be skipped whenever something is in view.
fn refuse_empty_second(signature: &Signature) -> Result<(), String> {
    // Names that are missing or cannot be read say nothing of the order.
    let Ok(Some(names)) = signature.metadata.class_names() else {
        return Ok(());
    };
    match names.as_slice() {
        [first, second] if second.trim().eq_ignore_ascii_case("empty") => {
            Err(format!("its class 0 is `{first}`; the first must be empty"))
        }
        _ => Ok(()),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::onnx::{ElementType, TensorSpec, metadata};

    fn spec(name: &str, shape: &[i64]) -> TensorSpec {
        TensorSpec {
            name: name.to_owned(),
            element: ElementType::Float32,
            shape: shape.to_vec(),
        }
    }

    fn screen(input: &[i64], entries: &[(&str, &str)]) -> Signature {
        Signature {
            inputs: vec![spec("images", input)],
            outputs: vec![spec("logits", &[1, 2])],
            metadata: metadata(entries),
        }
    }

    #[test]
    fn a_screen_of_open_size_is_to_be_exported_with_a_fixed_one() {
        for open in [&[1, 3, -1, -1][..], &[-1, 3, 64, -1], &[1, -1, -1, 3]] {
            let refusal = picture_input(&screen(open, &[])).unwrap_err();
            let expected = "its input size is open; export it with a fixed size";
            assert!(refusal.starts_with(expected), "{refusal}");
        }
    }

    #[test]
    fn a_screen_whose_second_class_is_empty_is_refused() {
        let judged = |names| refuse_empty_second(&screen(&[1, 3, 64, 64], &[("names", names)]));
        for swapped in ["{0: 'busy', 1: 'empty'}", r#"["busy", "Empty"]"#] {
            let refusal = judged(swapped).unwrap_err();
            assert_eq!(refusal, "its class 0 is `busy`; the first must be empty");
        }
        for fitting in ["{0: 'empty', 1: 'busy'}", "{0: 'a', 1: 'b'}", "None", "{"] {
            assert_eq!(judged(fitting), Ok(()));
        }
    }
}
