//! The sizes that outputs keep at every size of the input, where the model leaves them open. Exporters write an output as
//! `[?, ?, ?]` unless something simplifies the graph, and call the last side of any output open because that of YOLO is; no
//! head could be told from that, or a wrong one.

use super::head::is_cells;
use super::opening::{half, run_on_black};
use crate::onnx::{OnnxSession, PictureInput, Signature, TensorSpec};
use albireo_core::geometry::PictureSize;

/// The model's signature; outputs with open sides get the size that runs show to be how many numbers belong together. How
/// many rows there are may depend on the picture. The number of class names, if known, tells one side from the other.
pub(super) fn measured(
    session: &mut OnnxSession,
    input: PictureInput,
    stride: u32,
    names: Option<usize>,
) -> Signature {
    let signature = session.signature().clone();
    if signature.has_open_sides() {
        of_two_runs(session, signature, input, stride)
    } else {
        of_one_run(session, signature, input, names)
    }
}

/// Where the sides of the input are fixed, one run shows what every run has.
fn of_one_run(
    session: &mut OnnxSession,
    mut signature: Signature,
    input: PictureInput,
    names: Option<usize>,
) -> Signature {
    if !signature.outputs.iter().any(has_open_side) {
        return signature;
    }
    // Where it does not run the sizes stay open, and the refusal says what is known.
    let Ok(shapes) = shapes_at(session, input) else {
        return signature;
    };
    for (output, found) in signature.outputs.iter_mut().zip(&shapes) {
        if has_open_side(output) {
            keep_of_one_run(&mut output.shape, found, input.size, names);
        }
    }
    signature
}

/// Where the sides of the input are open, an output with an open last side gets the last size that is the same in runs at
/// `input` and at half of it.
fn of_two_runs(
    session: &mut OnnxSession,
    mut signature: Signature,
    input: PictureInput,
    stride: u32,
) -> Signature {
    if !signature.outputs.iter().any(is_open) {
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
    let Ok(all_at_largest) = shapes_at(session, input) else {
        return signature;
    };
    let Ok(all_at_smaller) = shapes_at(session, smaller) else {
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

/// The shapes of the outputs of a run on black.
fn shapes_at(session: &mut OnnxSession, input: PictureInput) -> Result<Vec<Vec<i64>>, String> {
    run_on_black(session, input, |outputs| {
        outputs.iter().map(|output| output.shape.to_vec()).collect()
    })
}

/// Writes into the shape how many numbers belong together in a run of a model with an input of `size`: the last side, or the
/// one before it if the last has a number for each cell. A map, whose sides are cells, is the same in every run.
fn keep_of_one_run(shape: &mut [i64], found: &[i64], size: PictureSize, names: Option<usize>) {
    if shape.len() != found.len() {
        return;
    }
    let kept = match *found {
        // Either way; neither side changes.
        [_, numbers, last] if numbers == last && is_cells(last, size) => 1..3,
        [_, numbers, last] if has_column_per_cell(numbers, last, size, names) => 1..2,
        [_, _, _] => 2..3,
        _ => 1..found.len(),
    };
    for side in kept {
        // A black picture may have nothing at all.
        if shape[side] == -1 && found[side] > 0 {
            shape[side] = found[side];
        }
    }
}

/// True if an output has a column for each cell and not a row for each box, by two of three signs: the first side is that of
/// the numbers by the names of the classes, the last is that of the cells, and the last is longer.
fn has_column_per_cell(first: i64, last: i64, size: PictureSize, names: Option<usize>) -> bool {
    // A box, perhaps an objectness, and a score per class.
    let are_numbers = |side: i64| {
        let side = usize::try_from(side).ok();
        names.is_some_and(|names| side == Some(4 + names) || side == Some(5 + names))
    };
    if are_numbers(last) && !are_numbers(first) {
        return false;
    }
    let signs = [are_numbers(first), is_cells(last, size), first < last];
    signs.iter().filter(|&&sign| sign).count() >= 2
}

/// True if a side beside that of the batch is open, in an output of rows or maps.
fn has_open_side(output: &TensorSpec) -> bool {
    output.shape.len() > 2 && output.shape.iter().skip(1).any(|&side| side == -1)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_run_shows_how_many_numbers_belong_together_and_not_how_many_boxes_there_are() {
        for (declared, found, kept) in [
            ([-1, -1, -1], [1, 84, 8400], [-1, 84, -1]),
            ([-1, -1, 8400], [1, 84, 8400], [-1, 84, 8400]),
            ([-1, -1, -1], [1, 8400, 85], [-1, -1, 85]),
            ([1, -1, -1], [1, 300, 84], [1, -1, 84]),
            ([1, -1, -1], [1, 3, 6], [1, -1, 6]),
            ([1, -1, 6], [1, 3, 6], [1, -1, 6]),
            ([1, -1, -1], [1, 0, 0], [1, -1, -1]),
        ] {
            let mut shape = declared;
            keep_of_one_run(&mut shape, &found, PictureSize::new(640, 640), None);
            assert_eq!(shape, kept, "{declared:?} {found:?}");
        }
    }

    #[test]
    fn the_names_tell_a_side_of_numbers_from_one_of_fewer_cells() {
        // An input of 160x160 has 525 cells, one of 64x64 84, and one of 16x16 five, or six with the part of one.
        for (side, names, found, kept) in [
            (160, Some(1000), [1, 1004, 525], [1, 1004, -1]),
            (160, Some(1000), [1, 525, 1004], [1, -1, 1004]),
            (160, Some(80), [1, 84, 525], [1, 84, -1]),
            (160, Some(80), [1, 525, 84], [1, -1, 84]),
            // By strides that nobody knows.
            (640, Some(80), [1, 84, 9000], [1, 84, -1]),
            (64, Some(80), [1, 84, 84], [1, 84, 84]),
            (16, Some(80), [1, 300, 6], [1, -1, 6]),
            // As many final boxes as there are names and four.
            (640, Some(296), [1, 300, 6], [1, -1, 6]),
        ] {
            let mut shape = [1, -1, -1];
            keep_of_one_run(&mut shape, &found, PictureSize::new(side, side), names);
            assert_eq!(shape, kept, "{side} {names:?} {found:?}");
        }
    }

    #[test]
    fn one_run_shows_all_sides_of_a_map() {
        let mut shape = [-1, -1, -1, -1];
        let size = PictureSize::new(640, 640);
        keep_of_one_run(&mut shape, &[1, 85, 40, 40], size, None);
        assert_eq!(shape, [-1, 85, 40, 40]);
    }
}
