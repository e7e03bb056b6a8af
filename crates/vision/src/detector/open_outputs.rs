//! The sizes that outputs keep at every size of the input, where the model leaves them open. Exporters write an output of
//! a model with open height and width as `[?, ?, ?]` unless something simplifies the graph, and call the last side of any
//! output open because that of YOLO is; no head could be told from that, or a wrong one.

use super::opening::{half, run_on_black};
use crate::onnx::{OnnxSession, PictureInput, Signature, TensorSpec};

/// The model's signature; an output with an open last side gets the size that is the same in runs at `input` and at half of
/// it. Only the last such size counts: it is how many numbers a row has, and how many rows there are may depend on the
/// picture.
pub(super) fn measured(session: &mut OnnxSession, input: PictureInput, stride: u32) -> Signature {
    let mut signature = session.signature().clone();
    if !signature.has_open_sides() || !signature.outputs.iter().any(is_open) {
        return signature;
    }
    let smaller = PictureInput {
        size: half(input.size, stride),
        ..input
    };
    // One stride cannot be halved, and nothing could be told from two runs at one size.
    if smaller.size == input.size {
        return signature;
    }
    let mut shapes_at = |input| {
        run_on_black(session, input, |outputs| {
            outputs.iter().map(|output| output.shape.to_vec()).collect::<Vec<_>>()
        })
    };
    // Where it does not run the sizes stay open, and the refusal says what is known.
    let (Ok(all_at_largest), Ok(all_at_smaller)) = (shapes_at(input), shapes_at(smaller)) else {
        return signature;
    };
    let shapes = all_at_largest.iter().zip(&all_at_smaller);
    for (output, (at_largest, at_smaller)) in signature.outputs.iter_mut().zip(shapes) {
        if is_open(output) {
            keep_last_equal(&mut output.shape, at_largest, at_smaller);
        }
    }
    signature
}

/// Writes the last side that is the same in both runs into the shape; that of the batch does not count.
fn keep_last_equal(shape: &mut [i64], at_largest: &[i64], at_smaller: &[i64]) {
    if shape.len() != at_largest.len() {
        return;
    }
    for side in (1..shape.len()).rev() {
        let size = at_largest[side];
        if size > 0 && at_smaller.get(side) == Some(&size) {
            shape[side] = size;
            return;
        }
    }
}

/// True if the last side of this output is open, and there is another beside that of the batch.
fn is_open(output: &TensorSpec) -> bool {
    output.shape.len() > 2 && output.shape.last() == Some(&-1)
}
