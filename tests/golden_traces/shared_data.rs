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

/// A row of `golden/summary.csv`, as far as it is about frame states.
pub(crate) struct SummaryRow {
    pub sequence: String,
    /// The name of the policy there: `ctd-0.50`, `albireo-u3e-4-erd-nonempty`.
    pub policy: String,
    pub skip_rate: f64,
    /// Shares of E, P, E+I, I and AI.
    pub shares: [f64; 5],
    /// Boxes scored over the whole sequence.
    pub boxes: usize,
}

/// `golden/summary.csv`.
pub(crate) fn summary() -> Vec<SummaryRow> {
    let text = read_to_string(&shared("golden/summary.csv"));
    let mut lines = text.lines();
    let header: Vec<_> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| header.iter().position(|found| *found == name).unwrap();
    let (sequence, policy, boxes) = (column("sequence"), column("policy"), column("boxes"));
    let skip_rate = column("skip_rate");
    let shares = ["share_E", "share_P", "share_EI", "share_I", "share_AI"].map(column);
    lines
        .map(|line| {
            let fields: Vec<_> = line.split(',').collect();
            SummaryRow {
                sequence: fields[sequence].to_owned(),
                policy: fields[policy].to_owned(),
                skip_rate: fields[skip_rate].parse().unwrap(),
                shares: shares.map(|share| fields[share].parse().unwrap()),
                boxes: fields[boxes].parse().unwrap(),
            }
        })
        .collect()
}

fn read_to_string(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
