//! The recorded sequences of the shared data, their golden traces and the table of their figures.

use super::replay::{Recorded, read_corners, read_detections};
use crate::support::shared;
use albireo_core::geometry::PictureSize;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// A recorded sequence.
#[derive(Deserialize)]
pub(crate) struct Sequence {
    pub name: String,
    width: u32,
    height: u32,
    pub frames: u64,
}

#[derive(Deserialize)]
struct Sequences {
    sequences: Vec<Sequence>,
}

impl Sequence {
    pub(crate) fn picture(&self) -> PictureSize {
        PictureSize::new(self.width, self.height)
    }

    pub(crate) fn detections(&self) -> Recorded {
        let path = format!("data/recorded/detections/{}.csv", self.name);
        read_detections(&read_to_string(&shared(&path)), self.picture())
    }

    /// By frame what [`detections`](Self::detections) is made from: corners in pixels, confidence, class.
    pub(crate) fn corners(&self) -> BTreeMap<u64, Vec<[f64; 6]>> {
        let path = format!("data/recorded/detections/{}.csv", self.name);
        read_corners(&read_to_string(&shared(&path)))
    }

    /// The golden trace of the policy that goes by the name `folder`.
    pub(crate) fn golden(&self, folder: &str) -> String {
        let path = shared(&format!("golden/{folder}/{}.jsonl.gz", self.name));
        let file = std::fs::File::open(&path)
            .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut golden = String::new();
        flate2::read::GzDecoder::new(file)
            .read_to_string(&mut golden)
            .unwrap();
        golden
    }
}

/// All 21 of them.
pub(crate) fn sequences() -> Vec<Sequence> {
    let list = read_to_string(&shared("data/recorded/sequences.json"));
    let sequences = serde_json::from_str::<Sequences>(&list).unwrap().sequences;
    assert_eq!(sequences.len(), 21);
    sequences
}

fn read_to_string(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
