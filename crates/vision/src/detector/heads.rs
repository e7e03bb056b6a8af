//! The head of one model, bound to each size of its input that is used.

use super::HeadSetting;
use super::head::{self, Head, HeadOverrides};
use crate::onnx::{PictureInput, Signature};
use albireo_core::geometry::PictureSize;

/// The head of one model. There are as many sizes as its input has strides, whatever pictures come.
pub(super) struct Heads {
    setting: HeadSetting,
    signature: Signature,
    input: PictureInput,
    overrides: HeadOverrides,
    largest: Head,
    smaller: Vec<Head>,
    /// What was assumed of the model, in words.
    assumed: Vec<String>,
}

impl Heads {
    /// Binds the head to the model's largest input.
    ///
    /// # Errors
    /// If this head cannot read the model: the first difference.
    pub(super) fn bind(
        setting: HeadSetting,
        signature: Signature,
        input: PictureInput,
        overrides: HeadOverrides,
    ) -> Result<Self, String> {
        let largest = head::bind(&setting, &signature, input, overrides)?;
        Ok(Self {
            setting,
            signature,
            input,
            overrides,
            largest,
            smaller: Vec::new(),
            assumed: Vec::new(),
        })
    }

    /// Adds what was assumed of the model, if anything was.
    pub(super) fn assume(&mut self, words: Option<String>) {
        self.assumed.extend(words);
    }

    /// What was assumed of the model: it may be wrong, and nothing but a person can tell.
    pub(super) fn assumed(&self) -> &[String] {
        &self.assumed
    }

    /// The head of the largest input.
    pub(super) fn largest(&self) -> &Head {
        &self.largest
    }

    /// The head of an input of `size`, which is bound when the size first occurs.
    ///
    /// # Errors
    /// If it cannot read the model at this size.
    pub(super) fn at(&mut self, size: PictureSize) -> Result<&Head, String> {
        if size == self.largest.input_format.size {
            return Ok(&self.largest);
        }
        let is_it = |head: &Head| head.input_format.size == size;
        let place = match self.smaller.iter().position(is_it) {
            Some(place) => place,
            None => {
                let input = PictureInput { size, ..self.input };
                let bound = head::bind(&self.setting, &self.signature, input, self.overrides)?;
                self.smaller.push(bound);
                self.smaller.len() - 1
            }
        };
        Ok(&self.smaller[place])
    }
}
