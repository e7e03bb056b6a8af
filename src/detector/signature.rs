//! What a model says about itself: names, element types and shapes of its inputs and outputs.

use crate::geometry::PictureSize;
use std::fmt;

/// One input or output of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorSpec {
    /// Its name in the graph.
    pub name: String,
    /// Whether its elements are float32.
    pub is_float32: bool,
    /// The element type in words, for messages.
    pub element_type: String,
    /// Its dimensions; -1 where the model leaves one open.
    pub shape: Vec<i64>,
}

/// The inputs and outputs of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signature {
    /// What it takes.
    pub inputs: Vec<TensorSpec>,
    /// What it gives.
    pub outputs: Vec<TensorSpec>,
}

impl Signature {
    /// The size of the model's one picture input, which must be float32 `[1, 3, rows, columns]`; an open
    /// batch dimension counts as 1.
    ///
    /// # Errors
    /// What is wrong with the inputs, in words.
    pub fn picture_input(&self) -> Result<PictureSize, String> {
        let [input] = self.inputs.as_slice() else {
            return Err(format!(
                "it has {} inputs instead of one",
                self.inputs.len()
            ));
        };
        if !input.is_float32 {
            return Err(format!(
                "the elements of its input are {} instead of float32",
                input.element_type
            ));
        }
        match *input.shape.as_slice() {
            [1 | -1, 3, rows, columns] if rows == -1 || columns == -1 => {
                Err("its input size is open; export it with a fixed size".to_owned())
            }
            [1 | -1, 3, rows, columns] => {
                let side = |value: i64| {
                    u32::try_from(value)
                        .ok()
                        .filter(|side| (1..=8192).contains(side))
                };
                match (side(columns), side(rows)) {
                    (Some(width), Some(height)) => Ok(PictureSize::new(width, height)),
                    _ => Err("the sides of its input are not between 1 and 8192".to_owned()),
                }
            }
            [1 | -1, _, _, 3] => {
                Err("its input has the colours last (NHWC) instead of first (NCHW)".to_owned())
            }
            _ => Err("its input is not of the form [1, 3, rows, columns]".to_owned()),
        }
    }

    /// The model's one output, which must be float32.
    ///
    /// # Errors
    /// What is wrong with the outputs, in words.
    pub fn only_output(&self) -> Result<&TensorSpec, String> {
        let [output] = self.outputs.as_slice() else {
            return Err(format!(
                "it has {} outputs instead of one",
                self.outputs.len()
            ));
        };
        if !output.is_float32 {
            return Err(format!(
                "the elements of its output are {} instead of float32",
                output.element_type
            ));
        }
        Ok(output)
    }
}

impl fmt::Display for TensorSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}` {} [", self.name, self.element_type)?;
        for (index, &dimension) in self.shape.iter().enumerate() {
            let comma = if index == 0 { "" } else { ", " };
            match dimension {
                -1 => write!(f, "{comma}?")?,
                _ => write!(f, "{comma}{dimension}")?,
            }
        }
        f.write_str("]")
    }
}

impl fmt::Display for Signature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |specs: &[TensorSpec]| {
            specs
                .iter()
                .map(ToString::to_string)
                .collect::<Vec<_>>()
                .join(" and ")
        };
        write!(
            f,
            "input {} and output {}",
            list(&self.inputs),
            list(&self.outputs)
        )
    }
}
