//! Writes the layout of MOTChallenge: a folder for each sequence of pictures.

use super::frames::LabelledFrame;
use super::{ExportedFrames, place_of, sequence_name};
use crate::error::EvalError;
use crate::files::write;
use crate::footage::Pace;
use crate::text::counted;
use std::path::{Path, PathBuf};

/// MOTChallenge's numbers of the classes that it has.
const CLASSES: [(&str, usize); 5] = [
    ("pedestrian", 1),
    ("person", 1),
    ("car", 3),
    ("bicycle", 4),
    ("motorcycle", 5),
];
/// The number of the first class that it does not have; `classes.txt` names them.
const FIRST_OTHER: usize = 14;

/// A sequence that is being written.
#[derive(Debug)]
pub(super) struct Sequence {
    folder: PathBuf,
    name: String,
    size: [u32; 2],
    frames: ExportedFrames,
    times_ns: Vec<u64>,
    /// The lines of its boxes.
    rows: String,
    /// The names of classes that MOTChallenge does not have.
    others: Vec<String>,
}

impl Sequence {
    /// Begins the sequence of a camera of a recording; `first` is its first frame.
    pub(super) fn new(
        recording: &Path,
        first: &LabelledFrame,
        frames: ExportedFrames,
        out: &Path,
    ) -> Self {
        let name = sequence_name(recording, &first.camera);
        Self {
            folder: out.join(&name),
            name,
            size: first.size,
            frames,
            times_ns: Vec::new(),
            rows: String::new(),
            others: Vec::new(),
        }
    }

    /// Adds a frame, and writes its picture.
    pub(super) fn add(&mut self, frame: &LabelledFrame) -> Result<(), EvalError> {
        self.times_ns.push(frame.t_ns);
        let number = self.times_ns.len();
        let file = self.folder.join("img1").join(format!("{number:06}.jpg"));
        write(&file, &frame.picture)?;
        for found in &frame.boxes {
            let [x1, y1, x2, y2] = found.corners.map(f64::from);
            // Pixels count from 1.
            let left = x1 + 1.0;
            let top = y1 + 1.0;
            let width = x2 - x1;
            let height = y2 - y1;
            let place = format!("{left:.2},{top:.2},{width:.2},{height:.2}");
            let row = match self.frames {
                // The columns of gt.txt. Track ids count from 1; what a policy without tracks shows has none.
                ExportedFrames::Shown => {
                    let track = found
                        .object
                        .map_or_else(|| "-1".to_owned(), |object| (object.0 + 1).to_string());
                    let class = self.class(&found.class);
                    format!("{number},{track},{place},1,{class},1")
                }
                // The columns of det.txt: no track, a confidence.
                ExportedFrames::Audit => {
                    format!("{number},-1,{place},{:.4},-1,-1,-1", found.confidence)
                }
            };
            self.rows.push_str(&row);
            self.rows.push('\n');
        }
        Ok(())
    }

    fn class(&mut self, name: &str) -> usize {
        if let Some((_, number)) = CLASSES.iter().find(|(known, _)| *known == name) {
            return *number;
        }
        FIRST_OTHER + place_of(&mut self.others, name)
    }

    /// Writes the boxes and `seqinfo.ini`. Returns what a user of the sequence must know, if there is something.
    pub(super) fn finish(self) -> Result<Option<String>, EvalError> {
        let boxes = match self.frames {
            ExportedFrames::Shown => "gt/gt.txt",
            ExportedFrames::Audit => "det/det.txt",
        };
        write(&self.folder.join(boxes), self.rows)?;
        if !self.others.is_empty() {
            let line = |(number, name): (usize, &String)| format!("{number} {name}\n");
            let lines: String = (FIRST_OTHER..).zip(&self.others).map(line).collect();
            write(&self.folder.join("classes.txt"), lines)?;
        }
        let pace = match self.frames {
            ExportedFrames::Shown => Pace::of(&self.times_ns),
            // Single frames have no rate.
            ExportedFrames::Audit => None,
        };
        let rate = pace.map_or(1.0, |pace| pace.rate);
        let frames = self.times_ns.len();
        let [width, height] = self.size;
        let info = format!(
            "[Sequence]\nname={}\nimDir=img1\nframeRate={rate:.2}\nseqLength={frames}\nimWidth={width}\nimHeight={height}\nimExt=.jpg\n",
            self.name
        );
        write(&self.folder.join("seqinfo.ini"), info)?;
        let jumps = pace.map_or(0, |pace| pace.jumps);
        if jumps == 0 {
            return Ok(None);
        }
        Ok(Some(format!(
            "{}: its frames are no single drive: their times jump {} (a replay that loops, a pause between events); frameRate \
             is that between the jumps",
            self.name,
            counted(jumps, "time")
        )))
    }
}
