//! The names of the heads.

use serde::{Deserialize, Serialize};

/// The head that reads a model's output tensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum HeadName {
    /// By the model's metadata, or its outputs' names and shapes.
    Auto,
    /// YOLOv8, YOLO11, YOLO26 one-to-many: `[1, 4 + classes, anchors]`, suppression by us.
    Yolo,
    /// YOLO26, YOLOv10 and exports with suppression inside: `[1, boxes, 6]`.
    EndToEnd,
    /// RF-DETR: `[1, queries, 4]` and `[1, queries, classes]`.
    Detr,
    /// YOLOX: `[1, cells, 5 + classes]`, not decoded.
    Yolox,
    /// FastestDet: `[1, 5 + classes, rows, columns]`, not decoded.
    #[serde(rename = "fastestdet")]
    #[cfg_attr(feature = "cli", value(name = "fastestdet"))]
    FastestDet,
}

impl HeadName {
    /// The heads that `auto` can find.
    pub(crate) const RECOGNISED: [Self; 5] = [
        Self::Yolo,
        Self::EndToEnd,
        Self::Detr,
        Self::Yolox,
        Self::FastestDet,
    ];

    /// Its name in configuration and messages.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Yolo => "yolo",
            Self::EndToEnd => "end-to-end",
            Self::Detr => "detr",
            Self::Yolox => "yolox",
            Self::FastestDet => "fastestdet",
        }
    }

    /// The outputs of its models, in words.
    pub(crate) const fn looks_for(self) -> &'static str {
        match self {
            Self::Auto => "any of the others",
            Self::Yolo => "one output [1, 4 + classes, anchors]",
            Self::EndToEnd => "one output [1, boxes, 6]",
            Self::Detr => {
                "outputs `dets` [1, queries, 4] and `labels` [1, queries, classes], or `pred_boxes` and `logits`"
            }
            Self::Yolox => "one output [1, cells of strides 8, 16 and 32, 5 + classes]",
            Self::FastestDet => "one output [1, 5 + classes, rows / 16, columns / 16]",
        }
    }
}
