//! The names of the heads, and the setting that chooses one.

use super::head::ColumnList;
use albireo_core::geometry::PictureSize;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// The head that reads a model's output tensors. What each expects is in the table of `head/families.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HeadName {
    /// By the model's metadata, its outputs' names and shapes, and the values of its first run.
    Auto,
    /// YOLOv8, YOLOv9, YOLO11, YOLO12, YOLO26 one-to-many: a score per class, no objectness.
    Yolo,
    /// YOLOv5, YOLOv6, YOLOv7: objectness and a score per class, or final boxes in rows of seven.
    Yolov5,
    /// YOLOX, decoded in the graph or not.
    Yolox,
    /// YOLO-NAS, flat or raw.
    YoloNas,
    /// YOLO26, YOLOv10, DeepStream-Yolo and exports with suppression inside: rows of six.
    EndToEnd,
    /// RF-DETR and others of its family with ImageNet's normalisation: boxes and logits.
    Detr,
    /// RT-DETR of Ultralytics and of transformers, D-FINE and DEIM without their last step.
    RtDetr,
    /// D-FINE, DEIM and RT-DETR of their authors: labels, boxes, scores.
    DFine,
    /// RTMDet as mmdeploy exports it.
    Rtmdet,
    /// FastestDet: not decoded.
    FastestDet,
    /// Final boxes in columns that the setting lists.
    Columns,
}

/// Each head with its name in configuration and messages.
const NAMES: [(HeadName, &str); 12] = [
    (HeadName::Auto, "auto"),
    (HeadName::Yolo, "yolo"),
    (HeadName::Yolov5, "yolov5"),
    (HeadName::Yolox, "yolox"),
    (HeadName::YoloNas, "yolo-nas"),
    (HeadName::EndToEnd, "end-to-end"),
    (HeadName::Detr, "detr"),
    (HeadName::RtDetr, "rt-detr"),
    (HeadName::DFine, "d-fine"),
    (HeadName::Rtmdet, "rtmdet"),
    (HeadName::FastestDet, "fastestdet"),
    (HeadName::Columns, "columns"),
];

/// Names of models that people give instead of a head's, without dashes and in small letters.
const MEANT: [(&str, HeadName); 16] = [
    ("yolov8", HeadName::Yolo),
    ("yolov9", HeadName::Yolo),
    ("yolov11", HeadName::Yolo),
    ("yolo11", HeadName::Yolo),
    ("yolo12", HeadName::Yolo),
    ("yolo26", HeadName::Yolo),
    ("ultralytics", HeadName::Yolo),
    ("yolov6", HeadName::Yolov5),
    ("yolov7", HeadName::Yolov5),
    ("yolov10", HeadName::EndToEnd),
    ("e2e", HeadName::EndToEnd),
    ("nms", HeadName::EndToEnd),
    ("rfdetr", HeadName::Detr),
    ("deim", HeadName::DFine),
    ("deepstream", HeadName::EndToEnd),
    ("mmdeploy", HeadName::Rtmdet),
];

impl HeadName {
    /// Its name in configuration and messages.
    pub fn as_str(self) -> &'static str {
        NAMES.iter().find(|(head, _)| *head == self).map_or("", |(_, name)| name)
    }

    /// How its models are exported with open height and width, or for an input of this size.
    pub(super) fn export_for(self, PictureSize { width, height }: PictureSize) -> String {
        let sides = format!("[{height}, {width}]");
        let how = match self {
            Self::Yolo | Self::EndToEnd => {
                format!("export it with dynamic=True, or with imgsz={sides}")
            }
            Self::Yolov5 => {
                format!(
                    "export it with --dynamic, or with --imgsz {height} {width} (v6, v7: --img-size)"
                )
            }
            Self::Yolox => format!(
                "open its sides with models/open_input.py, or export it with test_size ({height},{width})"
            ),
            Self::YoloNas => format!("export it with input_image_shape={sides}"),
            Self::Rtmdet => "export it with mmdeploy's dynamic configuration".to_owned(),
            _ => format!("export it with open height and width, or with {sides} (rows, columns)"),
        };
        format!("{how} (models/README.md)")
    }
}

/// The setting `detector.head`: the name of a head, or the columns of the output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Written", into = "Written")]
pub enum HeadSetting {
    /// A head by its name; never [`HeadName::Columns`].
    Named(HeadName),
    /// The columns of final boxes.
    Columns(ColumnList),
}

impl Default for HeadSetting {
    fn default() -> Self {
        Self::Named(HeadName::Auto)
    }
}

impl HeadSetting {
    /// The name of the head.
    pub fn name(&self) -> HeadName {
        match self {
            Self::Named(name) => *name,
            Self::Columns(_) => HeadName::Columns,
        }
    }
}

impl From<HeadName> for HeadSetting {
    fn from(name: HeadName) -> Self {
        Self::Named(name)
    }
}

/// The setting as it is written in a configuration file.
#[derive(Clone, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "expected the name of a head, or { columns = \"x1 y1 x2 y2 score class\" }"
)]
enum Written {
    Name(String),
    Columns { columns: String },
}

impl TryFrom<Written> for HeadSetting {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        match written {
            Written::Name(name) => name.parse(),
            Written::Columns { columns } => Ok(Self::Columns(columns.parse()?)),
        }
    }
}

impl From<HeadSetting> for Written {
    fn from(setting: HeadSetting) -> Self {
        match setting {
            HeadSetting::Named(name) => Self::Name(name.as_str().to_owned()),
            HeadSetting::Columns(columns) => Self::Columns {
                columns: columns.to_string(),
            },
        }
    }
}

/// As on a command line: a name, or `columns=x1 y1 x2 y2 score class`.
impl FromStr for HeadSetting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(columns) = text.strip_prefix("columns=") {
            return Ok(Self::Columns(columns.parse()?));
        }
        let named = NAMES.iter().find(|(head, name)| *name == text && *head != HeadName::Columns);
        if let Some((head, _)) = named {
            return Ok(Self::Named(*head));
        }
        let meant = match meant_by(text) {
            Some(HeadName::Columns) => {
                " (the columns are listed: { columns = \"x1 y1 x2 y2 score class\" })".to_owned()
            }
            Some(head) => format!(" (you mean `{}`)", head.as_str()),
            None => String::new(),
        };
        let names: Vec<_> = NAMES.iter().map(|(_, name)| *name).collect();
        Err(format!(
            "`{text}` is no head{meant}; the heads are {}",
            names.join(", ")
        ))
    }
}

/// The head that is meant by `text`: the name of a model, or that of a head in other letters or with other dashes.
fn meant_by(text: &str) -> Option<HeadName> {
    let plain = |name: &str| name.to_lowercase().replace(['-', '_', ' '], "");
    let wanted = plain(text);
    if let Some((_, head)) = MEANT.iter().find(|(model, _)| *model == wanted) {
        return Some(*head);
    }
    let (head, _) = NAMES.iter().find(|(_, name)| plain(name) == wanted)?;
    Some(*head)
}

impl fmt::Display for HeadSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Named(name) => f.write_str(name.as_str()),
            Self::Columns(columns) => write!(f, "columns={columns}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_head_is_answered_with_the_head_that_is_meant_or_all_heads() {
        for (text, said) in [
            ("yolov8", "you mean `yolo`"),
            ("RF-DETR", "you mean `detr`"),
            ("YOLO_NAS", "you mean `yolo-nas`"),
            ("columns", "{ columns ="),
            ("zebra", "auto, yolo, yolov5"),
        ] {
            let error = text.parse::<HeadSetting>().unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }

    #[test]
    fn columns_without_a_score_are_refused() {
        let error = "columns=x1 y1 x2 y2".parse::<HeadSetting>().unwrap_err();
        assert!(error.contains("and a score"), "{error}");
    }

    #[test]
    fn a_setting_is_written_as_it_was_read_from_a_command_line() {
        for text in ["auto", "d-fine", "columns=batch x1 y1 x2 y2 class score"] {
            assert_eq!(text.parse::<HeadSetting>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn columns_are_written_as_they_were_read_from_a_file() {
        let written = r#"{"columns":"x1 y1 x2 y2 score class"}"#;
        let setting: HeadSetting = serde_json::from_str(written).unwrap();
        assert_eq!(setting.name(), HeadName::Columns);
        assert_eq!(serde_json::to_string(&setting).unwrap(), written);
    }
}
