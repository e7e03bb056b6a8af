//! Writes COCO: pictures in `images`, one file of annotations.

use super::frames::LabelledFrame;
use super::{place_of, sequence_name};
use crate::error::EvalError;
use crate::files::{write, write_json};
use serde_json::{Value, json};
use std::path::Path;

/// The annotations so far.
#[derive(Debug, Default)]
pub(super) struct Coco {
    images: Vec<Value>,
    annotations: Vec<Value>,
    /// The names of the classes; the first has the number 1.
    classes: Vec<String>,
}

impl Coco {
    /// Adds a frame, and writes its picture.
    pub(super) fn add(
        &mut self,
        recording: &Path,
        frame: &LabelledFrame,
        out: &Path,
    ) -> Result<(), EvalError> {
        let id = self.images.len() + 1;
        let LabelledFrame { seq, camera, .. } = frame;
        let name = format!("{}_{id:06}.jpg", sequence_name(recording, camera));
        write(&out.join("images").join(&name), &frame.picture)?;
        let [width, height] = frame.size;
        self.images.push(json!({
            "id": id, "file_name": name, "width": width, "height": height,
            "camera": camera, "seq": seq, "t_ns": frame.t_ns,
        }));
        for found in &frame.boxes {
            let [left, top, right, bottom] = found.corners.map(f64::from);
            let box_width = right - left;
            let box_height = bottom - top;
            let category = place_of(&mut self.classes, &found.class) + 1;
            let mut annotation = json!({
                "id": self.annotations.len() + 1, "image_id": id, "category_id": category,
                "bbox": [left, top, box_width, box_height], "area": box_width * box_height, "iscrowd": 0,
                "score": found.confidence,
            });
            if let Some(object) = found.object {
                annotation["track_id"] = object.0.into();
            }
            self.annotations.push(annotation);
        }
        Ok(())
    }

    /// Writes `annotations.json`.
    pub(super) fn finish(self, out: &Path) -> Result<(), EvalError> {
        let category = |(id, name): (usize, &String)| json!({"id": id, "name": name});
        let dataset = json!({
            "info": {"description": "Frames recorded by albireo; boxes and scores are those of its detector"},
            "images": self.images,
            "annotations": self.annotations,
            "categories": (1..).zip(&self.classes).map(category).collect::<Vec<_>>(),
        });
        write_json(&out.join("annotations.json"), &dataset)
    }
}
