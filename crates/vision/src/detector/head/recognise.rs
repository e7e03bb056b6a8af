//! Finds the head that a model needs: from the exporter's metadata if present, otherwise from names and shapes.

use super::reading::{STRIDES, can_be, cells};
use super::{bind, detr};
use crate::detector::{HeadName, PictureInput, Signature};

/// The sets of strides of YOLO models: three feature maps, or four with a finer or a coarser one.
const YOLO_STRIDES: [&[u32]; 3] = [&STRIDES, &[4, 8, 16, 32], &[8, 16, 32, 64]];

/// The maximum number of boxes of end-to-end models. More rows of six numbers are cells of something else.
const MOST_BOXES: i64 = 1000;

/// Returns the head for a model with this signature and picture input. Never [`HeadName::Auto`].
///
/// # Errors
/// If no head fits, if several do, or if the metadata describe a model that is not a detector: the reason, and each head
/// that was tried, the outputs it needs, and why the model does not fit.
pub fn recognise(signature: &Signature, input: PictureInput) -> Result<HeadName, String> {
    let metadata = &signature.metadata;
    let refused = |reason: String| {
        let looked_for = HeadName::RECOGNISED.map(|head| {
            let found = looks_like(head, signature, input).err();
            let found = found.unwrap_or_else(|| "it could be".to_owned());
            format!("{}: {} ({found})", head.as_str(), head.looks_for())
        });
        format!("{reason}. Looked for {}", looked_for.join("; "))
    };
    if let Some(task) = metadata.get("task").filter(|&task| task != "detect") {
        return Err(refused(format!(
            "its metadata say that its task is `{task}`; a model for the task `detect` is needed"
        )));
    }
    if metadata.is_ultralytics() {
        let head = if metadata.is_end_to_end() {
            HeadName::EndToEnd
        } else {
            HeadName::Yolo
        };
        return match bind(head, signature, input) {
            Ok(_) => Ok(head),
            Err(reason) => Err(refused(format!(
                "its metadata are those of an Ultralytics export for the head `{}`, and {reason}",
                head.as_str()
            ))),
        };
    }
    let fitting: Vec<_> = HeadName::RECOGNISED
        .into_iter()
        .filter(|&head| looks_like(head, signature, input).is_ok())
        .collect();
    match fitting.as_slice() {
        [head] => Ok(*head),
        [] => Err(refused("it looks like none of them".to_owned())),
        several => {
            let names: Vec<_> = several.iter().map(|head| head.as_str()).collect();
            Err(refused(format!(
                "it looks like each of {}, and its metadata do not say which",
                names.join(", ")
            )))
        }
    }
}

/// Checks that a model without metadata looks like one for `head`. Stricter than binding, which is for a user who knows
/// the head.
fn looks_like(head: HeadName, signature: &Signature, input: PictureInput) -> Result<(), String> {
    bind(head, signature, input)?;
    let all_cells = || YOLO_STRIDES.map(|strides| cells(input.size, strides));
    let dimension = |place: usize| {
        signature
            .outputs
            .first()
            .and_then(|output| output.shape.get(place))
            .copied()
            .unwrap_or(0)
    };
    match head {
        HeadName::Yolo if !all_cells().iter().any(|&cells| can_be(dimension(2), cells)) => {
            Err(format!(
                "it has {} anchors, and an input of {} has {:?} (by strides)",
                dimension(2),
                input.size,
                all_cells()
            ))
        }
        HeadName::EndToEnd if dimension(1) > MOST_BOXES => {
            Err(format!("it has {} boxes", dimension(1)))
        }
        HeadName::Detr if !detr::is_named(signature) => {
            Err("its outputs have other names, so its scores and colours are not known".to_owned())
        }
        _ => Ok(()),
    }
}
