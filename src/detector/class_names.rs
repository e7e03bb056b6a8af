//! The names of a model's classes: from a file, or the list that belongs to the head.

use super::{DetectorConfig, HeadName, StartError};
use crate::detection::BDD100K_CLASSES;

/// The 80 classes of the COCO detection task (Lin et al., "Microsoft COCO", 2014), in the order of their
/// category numbers, which is the order detectors trained on it use.
pub const COCO_CLASSES: [&str; 80] = [
    "person",
    "bicycle",
    "car",
    "motorcycle",
    "airplane",
    "bus",
    "train",
    "truck",
    "boat",
    "traffic light",
    "fire hydrant",
    "stop sign",
    "parking meter",
    "bench",
    "bird",
    "cat",
    "dog",
    "horse",
    "sheep",
    "cow",
    "elephant",
    "bear",
    "zebra",
    "giraffe",
    "backpack",
    "umbrella",
    "handbag",
    "tie",
    "suitcase",
    "frisbee",
    "skis",
    "snowboard",
    "sports ball",
    "kite",
    "baseball bat",
    "baseball glove",
    "skateboard",
    "surfboard",
    "tennis racket",
    "bottle",
    "wine glass",
    "cup",
    "fork",
    "knife",
    "spoon",
    "bowl",
    "banana",
    "apple",
    "sandwich",
    "orange",
    "broccoli",
    "carrot",
    "hot dog",
    "pizza",
    "donut",
    "cake",
    "chair",
    "couch",
    "potted plant",
    "bed",
    "dining table",
    "toilet",
    "tv",
    "laptop",
    "mouse",
    "remote",
    "keyboard",
    "cell phone",
    "microwave",
    "oven",
    "toaster",
    "sink",
    "refrigerator",
    "book",
    "clock",
    "vase",
    "scissors",
    "teddy bear",
    "hair drier",
    "toothbrush",
];

/// The class names `config` asks for.
///
/// # Errors
/// When the file cannot be read or is empty.
pub(super) fn read(config: &DetectorConfig) -> Result<Vec<String>, StartError> {
    let Some(path) = &config.class_names else {
        let list: &[&str] = match config.head {
            HeadName::Yolox => &COCO_CLASSES,
            HeadName::Demonstration => &BDD100K_CLASSES,
        };
        return Ok(list.iter().map(|&name| name.to_owned()).collect());
    };
    let wrong = |reason: String| StartError::Configuration {
        key: "detector.class_names",
        reason: format!("{}: {reason}", path.display()),
    };
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    let names: Vec<String> = text
        .trim_end()
        .lines()
        .map(|line| line.trim().to_owned())
        .collect();
    match names.iter().position(String::is_empty) {
        _ if names.is_empty() => Err(wrong("it is empty; one name a line is needed".to_owned())),
        Some(line) => Err(wrong(format!("line {} is empty", line + 1))),
        None => Ok(names),
    }
}

/// For each class, whether it is reported: those in `wanted`, or all when that is empty.
///
/// # Errors
/// When `wanted` has a name that no class has.
pub(super) fn reported(names: &[String], wanted: &[String]) -> Result<Vec<bool>, StartError> {
    if let Some(unknown) = wanted.iter().find(|&name| !names.contains(name)) {
        return Err(StartError::Configuration {
            key: "detector.report_classes",
            reason: format!(
                "the model has no class `{unknown}`; it has {}",
                names.join(", ")
            ),
        });
    }
    Ok(names
        .iter()
        .map(|name| wanted.is_empty() || wanted.contains(name))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn config_with(text: &str) -> (tempfile::NamedTempFile, DetectorConfig) {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        let config = DetectorConfig {
            class_names: Some(file.path().to_owned()),
            ..DetectorConfig::default()
        };
        (file, config)
    }

    #[test]
    fn without_a_file_each_head_has_its_own_list() {
        let names = |head| {
            read(&DetectorConfig {
                head,
                ..DetectorConfig::default()
            })
            .unwrap()
        };
        assert_eq!(names(HeadName::Yolox).len(), 80);
        assert_eq!(names(HeadName::Yolox)[2], "car");
        assert_eq!(names(HeadName::Demonstration), BDD100K_CLASSES);
    }

    #[test]
    fn a_file_has_one_name_a_line_with_either_line_end() {
        let (_file, config) = config_with("car\r\ntraffic light\n\n");
        assert_eq!(read(&config).unwrap(), ["car", "traffic light"]);
    }

    #[test]
    fn a_gap_or_an_empty_file_is_an_error_that_names_the_file() {
        for text in ["", "car\n\nbus\n"] {
            let (file, config) = config_with(text);
            let error = read(&config).unwrap_err().to_string();
            assert!(error.contains("detector.class_names"), "{error}");
            assert!(
                error.contains(&file.path().display().to_string()),
                "{error}"
            );
        }
    }

    #[test]
    fn an_unknown_class_to_report_is_an_error_that_lists_the_known() {
        let names = ["car".to_owned(), "bus".to_owned()];
        let error = reported(&names, &["lorry".to_owned()])
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("lorry") && error.contains("car, bus"),
            "{error}"
        );
        assert_eq!(
            reported(&names, &["bus".to_owned()]).unwrap(),
            [false, true]
        );
        assert_eq!(reported(&names, &[]).unwrap(), [true, true]);
    }
}
