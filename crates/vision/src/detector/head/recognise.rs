//! Finds the head that a model needs: by the exporter's metadata, names and shapes, and, where formats share these, by
//! the values of the model's first run.

use super::families::{FAMILIES, Family};
use super::{Evidence, Head, HeadOverrides, bind_family, unread};
use crate::detector::HeadName;
use crate::onnx::{PictureInput, Signature, TensorView};

/// The heads that a model could need by its signature: at least one.
pub struct Recognised(Vec<Head>);

/// Returns the heads for a model with this signature, picture input and number of class names, if known.
///
/// # Errors
/// If no head fits, or if the metadata describe a model that is not a detector: the reason, and what to do.
pub fn recognise(
    signature: &Signature,
    input: PictureInput,
    names: Option<usize>,
) -> Result<Recognised, String> {
    let metadata = &signature.metadata;
    if let Some(task) = metadata.get("task")
        && task != "detect"
    {
        return Err(refused(
            signature,
            input,
            format_args!(
                "its metadata say that its task is `{task}`; a model for the task `detect` is needed"
            ),
        ));
    }
    let told = if metadata.is_rt_detr() {
        Some(HeadName::RtDetr)
    } else if metadata.is_end_to_end() {
        Some(HeadName::EndToEnd)
    } else {
        None
    };
    if let Some(head) = told {
        return fitting(signature, input, &[head]).map_err(|reason| {
            refused(
                signature,
                input,
                format_args!(
                    "its metadata are those of an export for the head `{}`, and {reason}",
                    head.as_str()
                ),
            )
        });
    }
    let all: Vec<_> = FAMILIES.iter().map(|family| family.name).collect();
    let Ok(Recognised(mut heads)) = fitting(signature, input, &all) else {
        let known = unread::reason(signature);
        let reason = known.as_deref().unwrap_or("it looks like none of the models that are read");
        return Err(refused(signature, input, reason));
    };
    // Heads see different numbers of classes in rows of one length, as they take different numbers of them for the box.
    // A model without names is likely to have the classes of COCO.
    let names = names.unwrap_or(80);
    if heads.iter().any(|head| head.fits_names(names)) {
        heads.retain(|head| head.fits_names(names));
    }
    Ok(Recognised(heads))
}

/// The heads among `names` that a model looks like.
fn fitting(
    signature: &Signature,
    input: PictureInput,
    names: &[HeadName],
) -> Result<Recognised, String> {
    let mut heads = Vec::new();
    let mut first_reason = None;
    for family in FAMILIES.iter().filter(|family| names.contains(&family.name)) {
        match looks_like(family, signature, input) {
            Ok(head) => heads.push(head),
            Err(reason) if first_reason.is_none() => first_reason = Some(reason),
            Err(_) => {}
        }
    }
    if heads.is_empty() {
        return Err(first_reason.unwrap_or_default());
    }
    Ok(Recognised(heads))
}

/// Binds a head to a model that looks like one of it, whether or not a user said so.
fn looks_like(family: &Family, signature: &Signature, input: PictureInput) -> Result<Head, String> {
    let head = bind_family(family, signature, input, HeadOverrides::default())?;
    match (family.looks_other)(signature, input.size) {
        Some(reason) => Err(reason),
        None => Ok(head),
    }
}

impl Recognised {
    /// The head, if the signature alone tells it.
    pub fn only(&self) -> Option<HeadName> {
        match self.0.as_slice() {
            [head] => Some(head.name),
            _ => None,
        }
    }

    /// Those of the heads that fit the sizes of a run where the signature leaves them open: YOLOX has one row for each cell,
    /// and YOLOv5 three.
    fn with_sizes_of(
        self,
        signature: &Signature,
        input: PictureInput,
        outputs: &[TensorView<'_>],
    ) -> Self {
        let mut seen = signature.clone();
        for (output, view) in seen.outputs.iter_mut().zip(outputs) {
            for (side, &size) in output.shape.iter_mut().zip(view.shape) {
                // A black picture may have no boxes at all.
                if *side == -1 && size > 0 {
                    *side = size;
                }
            }
        }
        let names: Vec<_> = self.0.iter().map(|head| head.name).collect();
        fitting(&seen, input, &names).unwrap_or(self)
    }

    /// The head that the outputs of a run on a black picture tell, or else the exporter's convention.
    ///
    /// # Errors
    /// If nothing decides: the settings that would.
    pub fn by_values(
        self,
        signature: &Signature,
        input: PictureInput,
        outputs: &[TensorView<'_>],
    ) -> Result<HeadName, String> {
        let mut sure = Vec::new();
        let mut names = Vec::new();
        let mut against = Vec::new();
        let Recognised(heads) = self.with_sizes_of(signature, input, outputs);
        for head in heads {
            match head.evidence(outputs, LEAST_SCORE) {
                Evidence::Against(reason) => {
                    against.push(format!("no `{}`: {reason}", head.name.as_str()));
                }
                Evidence::For => {
                    sure.push(head.name);
                    names.push(head.name);
                }
                Evidence::None => names.push(head.name),
            }
        }
        // Evidence for one head counts more than that there is none against it.
        if let [name] = sure.as_slice() {
            return Ok(*name);
        }
        if let [name] = names.as_slice() {
            return Ok(*name);
        }
        if let Some(name) = by_convention(signature)
            && names.contains(&name)
        {
            return Ok(name);
        }
        if names.is_empty() {
            return Err(format!(
                "its shapes are known, and the values of its first run are not: {}. If you know the columns of its \
                 output, set detector.head = {{ columns = \"x1 y1 x2 y2 score class\" }}",
                against.join("; ")
            ));
        }
        let choices: Vec<_> = names.iter().map(|name| format!("\"{}\"", name.as_str())).collect();
        Err(format!(
            "it could be any of {}, which share the shape of its output; set detector.head to the one that it is (the \
             number of names in detector.class_names tells some of them apart)",
            choices.join(", ")
        ))
    }
}

/// Scores of a real run are above it, and unused rows are 0.
const LEAST_SCORE: f64 = 1e-4;

/// The head whose exporter gives the only output this name. YOLOX with decoding in the graph and YOLOv6 have outputs of
/// the same shape and meaning, and want their pictures differently.
fn by_convention(signature: &Signature) -> Option<HeadName> {
    match signature.outputs.as_slice() {
        [output] if output.name == "output" => Some(HeadName::Yolox),
        [output] if output.name == "outputs" => Some(HeadName::Yolov5),
        _ => None,
    }
}

/// The whole refusal: the reason, and for each head the first difference.
fn refused(signature: &Signature, input: PictureInput, reason: impl std::fmt::Display) -> String {
    let line = |family: &Family| {
        let found = match looks_like(family, signature, input) {
            Ok(_) => "it could be".to_owned(),
            Err(difference) => difference,
        };
        format!(
            "    {}: {} ({found})",
            family.name.as_str(),
            family.looks_for
        )
    };
    let heads: Vec<_> = FAMILIES.iter().map(line).collect();
    format!("{reason}.\n  Looked for\n{}", heads.join("\n"))
}
