//! Writes and reads traces: the decision and the state of a policy on each frame, as gzipped JSON Lines.
//!
//! One line per frame with the keys of [`TraceFrame`], one file per clip and policy:
//! `<policy>/<clip>.jsonl.gz`. The traces of the published Python code are in the same form, so the two
//! can be compared line by line.

use crate::error::EvalError;
use albireo_core::policy::{FrameState, ObjectRecord};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

/// One frame of a trace.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TraceFrame {
    /// Index from 0.
    pub frame: u64,
    /// The frame's state.
    pub state: FrameState,
    /// Largest τ over the active objects after predicting, before the decision.
    pub tau_max: Option<f64>,
    /// Number of active objects at that point.
    pub active: usize,
    /// All objects after the frame, in the policy's own order.
    pub objects: Vec<ObjectRecord>,
}

/// Writes `frames` to `path`, and creates its folder if needed.
///
/// # Errors
/// [`EvalError`] when the folder or file cannot be written.
pub fn write(path: &Path, frames: &[TraceFrame]) -> Result<(), EvalError> {
    let attempt = || -> std::io::Result<()> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let file = std::fs::File::create(path)?;
        let mut out = BufWriter::new(flate2::write::GzEncoder::new(
            file,
            flate2::Compression::default(),
        ));
        for frame in frames {
            serde_json::to_writer(&mut out, frame)?;
            out.write_all(b"\n")?;
        }
        out.into_inner()?.finish()?.sync_data()
    };
    attempt().map_err(|source| EvalError::write(path, source))
}

/// Reads a trace.
///
/// # Errors
/// [`EvalError`] naming the file, and the line if one is broken.
pub fn read(path: &Path) -> Result<Vec<TraceFrame>, EvalError> {
    let failed = |error| EvalError::read(path, error, "a trace is a gzipped file");
    let file = std::fs::File::open(path).map_err(failed)?;
    let reader = BufReader::new(flate2::read::GzDecoder::new(file));
    let mut frames = Vec::new();
    for (number, line) in (1..).zip(reader.lines()) {
        let text = line.map_err(failed)?;
        let frame =
            serde_json::from_str(&text).map_err(|error| EvalError::line(path, number, error))?;
        frames.push(frame);
    }
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use super::super::scoring::tests::object;
    use super::*;

    #[test]
    fn a_trace_read_back_is_the_trace_written_to_the_last_bit() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("albireo").join("clip.jsonl.gz");
        let frames = vec![
            TraceFrame {
                frame: 0,
                state: FrameState::EI,
                tau_max: None,
                active: 0,
                objects: Vec::new(),
            },
            TraceFrame {
                frame: 1,
                state: FrameState::P,
                tau_max: Some(0.1 + 0.2),
                active: 1,
                objects: vec![object([0.1, 0.7, 1e-17, 0.3])],
            },
        ];
        write(&path, &frames).expect("the trace can be written");
        assert_eq!(read(&path).expect("the trace can be read"), frames);
    }

    #[test]
    fn a_broken_line_is_named_with_its_number() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("clip.jsonl.gz");
        let lines = r#"{"frame":0,"state":"I","tau_max":null,"active":0,"objects":[]}
            {"frame":1}"#;
        let mut file = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        file.write_all(lines.as_bytes()).expect("written");
        std::fs::write(&path, file.finish().expect("compressed")).expect("written");
        let message = read(&path).expect_err("line 2 is broken").to_string();
        assert!(message.contains(":2:"), "{message}");
    }
}
