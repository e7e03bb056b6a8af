//! Finds the head that a model needs: by the exporter's metadata, names and shapes, and, where formats share these, by
//! the values of the model's first run.

use super::families::{FAMILIES, Family, family};
use super::reading::count;
use super::rt_detr::MOST_NUMBERS;
use super::{Evidence, Head, HeadOverrides, Objection, bind_family, unread};
use crate::detector::HeadName;
use crate::onnx::{PictureInput, Signature, TensorView};

/// The heads that a model could need by its signature: at least one.
pub struct Recognised(Vec<Head>);

/// The head that a model needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecognisedHead {
    /// Its name.
    pub name: HeadName,
    /// What was assumed, in words, if other models have the same outputs.
    pub assumed: Option<String>,
}

impl RecognisedHead {
    /// The head that the outputs tell.
    fn told(name: HeadName, signature: &Signature) -> Self {
        let assumed = if name == HeadName::YoloNas && signature.outputs.len() == 2 {
            Some(SHARED_BY_YOLO_NAS.to_owned())
        } else {
            None
        };
        Self { name, assumed }
    }

    /// The head that only the name of the output tells from the others that fit.
    fn told_by_name(name: HeadName, fitting: &[Head], signature: &Signature) -> Self {
        if name == HeadName::Yolox && is_named_as_by_yolox(signature) && have_one_count(fitting) {
            return Self {
                name,
                assumed: None,
            };
        }
        let mut others = Vec::new();
        for other in fitting {
            if other.name != name {
                others.push(format!("\"{}\"", other.name.as_str()));
            }
        }
        Self {
            name,
            assumed: Some(format!(
                "only the name of its output tells it from {}: set detector.head to \"{}\" if what it finds is right, or \
                 else to {}",
                others.join(", "),
                name.as_str(),
                others.join(" or ")
            )),
        }
    }
}

/// True if both ends of the graph are called as YOLOX's own exporter calls them.
fn is_named_as_by_yolox(signature: &Signature) -> bool {
    match (signature.inputs.as_slice(), signature.outputs.as_slice()) {
        ([input], [output]) => input.name == "images" && output.name == "output",
        _ => false,
    }
}

/// True if these heads see one number of classes.
fn have_one_count(heads: &[Head]) -> bool {
    heads.windows(2).all(|pair| pair[0].classes == pair[1].classes)
}

/// What is said of boxes and scores in two outputs.
const SHARED_BY_YOLO_NAS: &str = "PP-YOLOE, RTMDet, DAMO-YOLO and others may have the same two outputs: if it finds \
                                  too little, set detector.head = \"yolo-nas\" with the range, color_order and fit \
                                  that it wants";

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
    // A model without names may have the classes of COCO, if its shapes show as many.
    let expected = names.unwrap_or(80);
    let decides =
        |head: &Head| head.fits_names(expected) && (names.is_some() || head.classes.is_some());
    if heads.iter().any(decides) {
        heads.retain(|head| head.fits_names(expected));
    }
    Ok(Recognised(heads))
}

/// The remedy for a model whose head a run tells against, if the objection has none: the heads that may read it, or the
/// list of its columns.
pub fn way_out(
    signature: &Signature,
    input: PictureInput,
    names: Option<usize>,
    outputs: &[TensorView<'_>],
) -> String {
    let heads = others(signature, input, names, outputs);
    if heads.is_empty() {
        return "If you know the columns of its output, list them: detector.head = { columns = \"x1 y1 x2 y2 score \
                class\" }"
            .to_owned();
    }
    let settings: Vec<_> = heads.iter().map(with_names).collect();
    format!(
        "It may be read with detector.head = {}",
        settings.join(" or ")
    )
}

/// The reason why a recognised head cannot read outputs of the sizes of this run, where the signature leaves them open.
pub fn misfit(
    name: HeadName,
    signature: &Signature,
    input: PictureInput,
    outputs: &[TensorView<'_>],
) -> Option<String> {
    let seen = with_sizes_of(signature, outputs);
    bind_family(family(name)?, &seen, input, HeadOverrides::default()).err()
}

/// What is assumed of a recognised head if a run on a black picture finds nothing at all, in words: rows of final boxes, of
/// any columns, would then look like the queries of RT-DETR.
pub fn assumed_of_nothing(
    name: HeadName,
    signature: &Signature,
    outputs: &[TensorView<'_>],
) -> Option<String> {
    let [output] = outputs else {
        return None;
    };
    let are_few = output.shape.last().is_some_and(|&last| count(last) <= MOST_NUMBERS);
    let is_told = signature.metadata.is_rt_detr();
    if name != HeadName::RtDetr || is_told || !are_few || !are_all_zero(outputs) {
        return None;
    }
    Some(
        "its rows are all 0 on black, as unused rows of final boxes are: set detector.head to \"rt-detr\" if what it finds \
         is right, or else to the columns of its output"
            .to_owned(),
    )
}

fn are_all_zero(outputs: &[TensorView<'_>]) -> bool {
    outputs.iter().all(|output| output.values.iter().all(|&number| number == 0.0))
}

/// The signature with the sizes of a run where it leaves them open.
fn with_sizes_of(signature: &Signature, outputs: &[TensorView<'_>]) -> Signature {
    let mut seen = signature.clone();
    for (output, view) in seen.outputs.iter_mut().zip(outputs) {
        for (side, &size) in output.shape.iter_mut().zip(view.shape) {
            // A black picture may have no boxes at all.
            if *side == -1 && size > 0 {
                *side = size;
            }
        }
    }
    seen
}

/// The heads that a run says nothing against, of those that the model looks like or that have the right number of classes
/// for it.
fn others(
    signature: &Signature,
    input: PictureInput,
    names: Option<usize>,
    outputs: &[TensorView<'_>],
) -> Vec<Head> {
    let expected = names.unwrap_or(80);
    let mut heads = Vec::new();
    for family in &FAMILIES {
        let Ok(head) = bind_family(family, signature, input, HeadOverrides::default()) else {
            continue;
        };
        let fits = head.classes.is_some() && head.fits_names(expected);
        let may_be = fits || (family.looks_other)(signature, input.size).is_none();
        let evidence = head.evidence(outputs, LEAST_SCORE);
        if may_be && !matches!(evidence, Evidence::Against(_)) {
            heads.push(head);
        }
    }
    heads
}

/// The setting of a head, with the number of names that it then needs.
fn with_names(head: &Head) -> String {
    let name = head.name.as_str();
    match head.classes {
        Some(1) => format!("\"{name}\" (for 1 name in detector.class_names)"),
        Some(classes) => {
            format!("\"{name}\" (for {classes} names in detector.class_names)")
        }
        None => format!("\"{name}\""),
    }
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
    pub fn only(&self, signature: &Signature) -> Option<RecognisedHead> {
        match self.0.as_slice() {
            [head] => Some(RecognisedHead::told(head.name, signature)),
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
        let seen = with_sizes_of(signature, outputs);
        let names: Vec<_> = self.0.iter().map(|head| head.name).collect();
        fitting(&seen, input, &names).unwrap_or(self)
    }

    /// The head that the outputs of a run on a black picture tell, or else the exporter's convention, for a model with this
    /// number of class names, if known.
    ///
    /// # Errors
    /// If nothing decides: the settings that would.
    pub fn by_values(
        self,
        signature: &Signature,
        input: PictureInput,
        names: Option<usize>,
        outputs: &[TensorView<'_>],
    ) -> Result<RecognisedHead, String> {
        let mut sure = Vec::new();
        let mut left = Vec::new();
        let mut reasons = Vec::new();
        let mut remedies = Vec::new();
        let Recognised(heads) = self.with_sizes_of(signature, input, outputs);
        for head in heads {
            match head.evidence(outputs, LEAST_SCORE) {
                Evidence::Against(Objection { reason, remedy }) => {
                    reasons.push(format!("no `{}`: {reason}", head.name.as_str()));
                    remedies.extend(remedy);
                }
                Evidence::For => {
                    sure.push(head.name);
                    left.push(head);
                }
                Evidence::None => left.push(head),
            }
        }
        // Rows of final boxes may all be unused, and queries hardly ever are.
        let may_be_final = left.iter().any(|head| head.name == HeadName::EndToEnd);
        if may_be_final && are_all_zero(outputs) {
            left.retain(|head| head.name != HeadName::RtDetr);
        }
        // Evidence for one head counts more than that there is none against it.
        if let [name] = sure.as_slice() {
            return Ok(RecognisedHead::told(*name, signature));
        }
        if let [head] = left.as_slice() {
            return Ok(RecognisedHead::told(head.name, signature));
        }
        if left.is_empty() {
            let remedy = match remedies.first() {
                Some(remedy) => remedy.clone(),
                None => way_out(signature, input, names, outputs),
            };
            return Err(format!(
                "its shapes are known, and the values of its first run are not: {}. {remedy}",
                reasons.join("; ")
            ));
        }
        if names.is_none() && !have_one_count(&left) {
            return Err(UNNAMED.to_owned());
        }
        if let Some(name) = by_convention(signature)
            && left.iter().any(|head| head.name == name)
        {
            return Ok(RecognisedHead::told_by_name(name, &left, signature));
        }
        let choices: Vec<_> =
            left.iter().map(|head| format!("\"{}\"", head.name.as_str())).collect();
        Err(format!(
            "it could be any of {}, which share the shape of its output; set detector.head to the one that it is (the \
             number of names in detector.class_names tells some of them apart)",
            choices.join(", ")
        ))
    }
}

/// Scores of a real run are above it, and unused rows are 0.
pub const LEAST_SCORE: f64 = 1e-4;

/// What is said of a model without names that heads read with different numbers of classes.
const UNNAMED: &str = "its metadata do not name its classes, and how it is read depends on how many there are: give \
                       detector.class_names all of them, as a file with one name per line, or a list, or \"coco\" if it \
                       was trained on COCO";

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
