//! Says what a file is that was given as a model and is no ONNX file, by its first bytes.

use super::graph::external_files;
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path};

/// What a file begins with that stands for one that Git LFS did not fetch.
const LFS_POINTER: &[u8] = b"version https://git-lfs";

/// What a pointer of Git LFS is, with the way out.
const NOT_FETCHED: &str = "a Git LFS pointer, the placeholder of a file that was not fetched: run `git lfs pull` in its \
                           repository, or download the file itself";

/// What other files begin with: the place of the bytes, the bytes, and what the file is with the way out.
const OTHERS: [(usize, &[u8], &str); 13] = [
    (0, LFS_POINTER, NOT_FETCHED),
    (
        0,
        b"PK\x03\x04",
        "a ZIP archive, as PyTorch writes its models (.pt): export it, for Ultralytics with `yolo export model=FILE \
         format=onnx`, or unpack it if it holds an .onnx file",
    ),
    (
        0,
        b"\x80\x02",
        "a Python pickle, as old versions of PyTorch write their models (.pt): export it to ONNX",
    ),
    (
        4,
        b"TFL3",
        "a TensorFlow Lite model: export the model to ONNX from its training framework, or convert this file with \
         `python -m tf2onnx.convert --tflite FILE --output FILE.onnx`",
    ),
    (0, b"ptrt", TENSORRT),
    (0, b"ftrt", TENSORRT),
    (
        0,
        b"\x89HDF",
        "an HDF5 file, as Keras writes its models (.h5): convert it with tf2onnx",
    ),
    (
        0,
        b"RKNN",
        "a model for Rockchip's NPU: give the ONNX file that it was made of",
    ),
    (
        0,
        b"\x01HEF",
        "a model for Hailo's accelerator: give the ONNX file that it was made of",
    ),
    (
        0,
        b"7767517",
        "a model of ncnn: give the ONNX file that it was made of, or export the model to ONNX",
    ),
    (
        0,
        b"\x1f\x8b",
        "compressed with gzip: unpack it with `gunzip`",
    ),
    (
        0,
        b"\xff\xd8\xff",
        "a JPEG picture: the model comes first, then the pictures",
    ),
    (
        0,
        b"\x89PNG",
        "a PNG picture: the model comes first, then the pictures",
    ),
];

const TENSORRT: &str = "a TensorRT engine, which works on one GPU and version only: give the ONNX file that it was made \
                        of, and detector.providers = [\"tensorrt\", \"cuda\"] builds the engine";

/// What `model` is, with the way out, if it is certainly no ONNX file.
pub(super) fn other_kind(model: &Path) -> Option<String> {
    if model.is_dir() {
        return Some(
            "it is a folder: name the .onnx file; a folder of OpenVINO or TensorFlow holds no ONNX model".to_owned(),
        );
    }
    let mut head = Vec::new();
    let file = File::open(model).ok()?;
    file.take(4096).read_to_end(&mut head).ok()?;
    if head.is_empty() {
        return Some("it is empty: copy or download it again".to_owned());
    }
    let kind = known_kind(&head)
        .or_else(|| text(&head))
        .or_else(|| ultralytics_engine(&head))?;
    Some(format!("it is no ONNX file but {kind}"))
}

/// What a file is that begins like one of [`OTHERS`].
fn known_kind(head: &[u8]) -> Option<String> {
    for (at, bytes, kind) in OTHERS {
        if head.get(at..).is_some_and(|rest| rest.starts_with(bytes)) {
            return Some(kind.to_owned());
        }
    }
    None
}

/// What a text file is: no ONNX file is text.
fn text(head: &[u8]) -> Option<String> {
    let is_text = |byte: &u8| matches!(byte, b'\t' | b'\n' | b'\r' | 0x20..=0x7e | 0x80..);
    if !head.iter().all(is_text) {
        return None;
    }
    let words = String::from_utf8_lossy(head).to_lowercase();
    let start = words.trim_start_matches('\u{feff}').trim_start();
    let kind = if start.starts_with("<!doctype html") || start.starts_with("<html") {
        "a web page: the download got an error page or a login; open the address in a browser, or use its link for \
         the raw file"
            .to_owned()
    } else if start.starts_with("<?xml") || start.starts_with("<net") {
        "an XML file, as OpenVINO writes its models: give the ONNX file that it was made of, or export the model to \
         ONNX"
            .to_owned()
    } else {
        let line = start.lines().next().unwrap_or_default();
        let first: String = line.chars().take(60).collect();
        format!("a text that begins with `{first}`: name the .onnx file")
    };
    Some(kind)
}

/// Ultralytics writes the length of its metadata, the metadata as JSON, and then the engine.
fn ultralytics_engine(head: &[u8]) -> Option<String> {
    /// No metadata is as long as this.
    const TOO_LONG: u32 = 1 << 20;
    let (length, rest) = head.split_first_chunk::<4>()?;
    let is_metadata = u32::from_le_bytes(*length) < TOO_LONG && rest.starts_with(b"{\"");
    if is_metadata {
        Some(TENSORRT.to_owned())
    } else {
        None
    }
}

/// ONNX Runtime's reason for not loading `model`, preceded by its meaning if that is known.
pub(super) fn in_words(model: &Path, reason: &str) -> String {
    let lower = reason.to_lowercase();
    if lower.contains("protobuf parsing failed") || lower.contains("invalid protobuf") {
        let bytes = std::fs::metadata(model).map_or(0, |file| file.len());
        return format!(
            "it is no ONNX file, or one that is damaged or cut short (it has {bytes} bytes): copy or export it again, \
             and compare its size ({reason})"
        );
    }
    if let Some(fault) = data_fault(model, lower.contains("out of bounds")) {
        return format!("{fault} ({reason})");
    }
    if lower.contains("unsupported model ir version") || lower.contains("is under development") {
        // What stands before it are the names of functions in C++.
        let place = reason
            .find("Unsupported model IR version")
            .or_else(|| reason.find("Current official support"));
        let known = place.map_or(reason, |place| &reason[place..]);
        return format!(
            "it was exported for a newer ONNX than this ONNX Runtime reads: export it with a lower opset, or name a newer \
             library in detector.onnxruntime ({known})"
        );
    }
    if lower.contains("efficientnms_trt") || lower.contains("batchednms") {
        return format!(
            "its suppression is a plug-in of TensorRT that ONNX Runtime does not have: export it without the plug-in \
             (Ultralytics: nms=True; YOLOv7: --grid --end2end --max-wh 640, or --grid alone) ({reason})"
        );
    }
    if lower.contains("is not a registered function/op") || lower.contains("no op registered") {
        return format!(
            "it uses an operator that this ONNX Runtime does not have: export it without plug-ins, or with a lower \
             opset ({reason})"
        );
    }
    reason.to_owned()
}

/// What is wrong with the files that hold the weights of `model`, which may be too short for it; `None` if there are none, or
/// one lies outside of its folder.
fn data_fault(model: &Path, is_short: bool) -> Option<String> {
    let folder = model.parent()?;
    let names = external_files(&std::fs::read(model).ok()?);
    let mut sizes = Vec::new();
    for name in &names {
        let leads_out = |part| !matches!(part, Component::Normal(_) | Component::CurDir);
        if Path::new(name).components().any(leads_out) {
            return None;
        }
        let file = folder.join(name);
        let shown = file.display();
        let mut head = Vec::new();
        let Ok(data) = File::open(&file) else {
            return Some(format!(
                "its weights are in {shown}, which is missing or cannot be read: copy it there, too"
            ));
        };
        let size = data.metadata().ok()?.len();
        data.take(LFS_POINTER.len() as u64).read_to_end(&mut head).ok()?;
        if head == LFS_POINTER {
            return Some(format!(
                "its weights are in {shown}, which is {NOT_FETCHED}"
            ));
        }
        sizes.push(format!("{shown} ({size} bytes)"));
    }
    if sizes.is_empty() || !is_short {
        return None;
    }
    Some(format!(
        "its weights are in {}, which is cut short or of another model: copy or export both again",
        sizes.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_no_model_is_named_for_what_it_is_with_the_way_out() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("model.onnx");
        for (bytes, said) in [
            (&b""[..], "empty"),
            (
                b"version https://git-lfs.github.com/spec/v1\noid sha256:4d",
                "git lfs pull",
            ),
            (b"PK\x03\x04\x14\0\0\0", "format=onnx"),
            (b"\x80\x02}q\0", "pickle"),
            (b"\x1c\0\0\0TFL3\0\0\0\0", "tf2onnx"),
            (b"ptrt\0\0\0\0", "TensorRT engine"),
            (
                b"\x40\0\0\0{\"description\": \"Ultralytics\"}ftrt",
                "TensorRT engine",
            ),
            (b"<?xml version=\"1.0\"?>\n<net name=\"y\">", "OpenVINO"),
            (b"\xef\xbb\xbf<!DOCTYPE html><html>", "web page"),
            (b"\n<html><head>", "web page"),
            (b"404: Not Found", "`404: not found`"),
            (b"person\ncar\n", "`person`"),
        ] {
            std::fs::write(&file, bytes).unwrap();
            let kind = other_kind(&file).unwrap();
            assert!(kind.contains(said), "{kind}");
        }
    }

    #[test]
    fn weights_in_another_file_that_is_missing_a_pointer_or_cut_are_named_with_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.onnx");
        std::fs::write(&model, b"\x0a\x08location\x12\x01w").unwrap();
        let weights = folder.path().join("w");
        let words = || in_words(&model, "External initializer: c0 are out of bounds");
        let missing = words();
        std::fs::write(&weights, b"version https://git-lfs.github.com/spec/v1\n").unwrap();
        let pointer = words();
        std::fs::write(&weights, [0; 7]).unwrap();
        let cut = words();
        for (found, said) in [
            (missing, "missing"),
            (pointer, "git lfs pull"),
            (cut, "7 bytes"),
        ] {
            let named = weights.display().to_string();
            assert!(found.contains(said) && found.contains(&named), "{found}");
        }
    }

    #[test]
    fn weights_outside_of_the_models_folder_are_not_looked_at() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.onnx");
        std::fs::write(&model, b"\x0a\x08location\x12\x04../w").unwrap();
        let reason = "External data path escapes model directory";
        assert_eq!(in_words(&model, reason), reason);
    }

    #[test]
    fn a_model_for_a_newer_onnx_is_refused_with_both_ways_out_and_without_the_librarys_code() {
        for (reason, kept) in [
            (
                "failed:/src/model.cc:256 onnxruntime::Model::Model(onnx::ModelProto&&) Unsupported model IR version: 99, \
                 max supported IR version: 13",
                "version: 99",
            ),
            (
                "failed:/src/utils.h:46 void onnxruntime::ValidateOpset(bool) Opset 99 is under development and support \
                 for this is limited. Current official support for domain ai.onnx is till opset 26",
                "till opset 26",
            ),
        ] {
            let words = in_words(Path::new("/nowhere.onnx"), reason);
            for part in ["a lower opset", "detector.onnxruntime", kept] {
                assert!(words.contains(part), "{words}");
            }
            assert!(!words.contains("onnxruntime::"), "{words}");
        }
    }

    #[test]
    fn a_folder_is_said_to_be_one() {
        let folder = tempfile::tempdir().unwrap();
        let kind = other_kind(folder.path()).unwrap();
        assert!(kind.contains("it is a folder"), "{kind}");
    }

    #[test]
    fn an_onnx_file_is_taken_for_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("model.onnx");
        // The field `ir_version`, then a name.
        std::fs::write(&file, b"\x08\x08\x12\x07pytorch").unwrap();
        assert_eq!(other_kind(&file), None);
    }
}
