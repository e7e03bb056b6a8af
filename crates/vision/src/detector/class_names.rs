//! The names of a model's classes: configured, from its metadata, or the list that belongs to its head.

use super::{ClassNames, HeadName, Metadata, StartError};

/// The 80 classes of the COCO detection task (Lin et al., "Microsoft COCO", 2014), in the order of their
/// category numbers, which is the order detectors trained on it use.
pub(super) const COCO_CLASSES: &str = include_str!("coco.txt");

/// COCO's unused category numbers. Models that answer with category numbers (RF-DETR) have 91 classes, from 0 to 90.
const UNUSED_CATEGORIES: [usize; 11] = [0, 12, 26, 29, 30, 45, 66, 68, 69, 71, 83];

/// The COCO names by category number; empty for an unused number.
fn coco_categories() -> Vec<String> {
    let mut names = COCO_CLASSES.lines();
    (0..=90)
        .map(|number| match UNUSED_CATEGORIES.contains(&number) {
            true => String::new(),
            false => names.next().unwrap_or_default().to_owned(),
        })
        .collect()
}

/// Returns the names of the model's classes: the configured ones, else those of its metadata, else the list that
/// belongs to its head. `classes` is the number of classes in the outputs, if known. An empty name is a class that does
/// not occur.
///
/// # Errors
/// If there are no names, too few or too many, or they cannot be read.
pub(super) fn read(
    configured: Option<&ClassNames>,
    metadata: &Metadata,
    head: HeadName,
    classes: Option<usize>,
) -> Result<Vec<String>, StartError> {
    let wrong = |reason: String| StartError::configuration("detector.class_names", reason);
    let (names, source) = match configured {
        Some(ClassNames::List(names)) => (Some(names.clone()), "the list".to_owned()),
        Some(ClassNames::File(path)) => {
            let source = path.display().to_string();
            let text = std::fs::read_to_string(path).map_err(|error| error.to_string());
            let names = text
                .and_then(|text| lines(&text))
                .map_err(|error| wrong(format!("{source}: {error}")))?;
            (Some(names), source)
        }
        None => {
            let names = metadata.class_names().map_err(|error| {
                wrong(format!(
                    "the class names in the model's metadata cannot be read ({error}); give a file or a list"
                ))
            })?;
            (names, "its metadata".to_owned())
        }
    };
    let Some(names) = names else {
        return own_list(head, classes).ok_or_else(|| {
            let classes = classes.map_or_else(String::new, |classes| format!("{classes} "));
            wrong(format!(
                "the model does not name its {classes}classes; give a file with one name per line, or a list"
            ))
        });
    };
    let count = names.len();
    // Models of the DETR family may end with a class for "no object".
    let fits = |classes| count == classes || (head == HeadName::Detr && count + 1 == classes);
    if let Some(classes) = classes.filter(|classes| !fits(*classes)) {
        return Err(wrong(format!(
            "the model has {classes} classes, and {source} has {count} names"
        )));
    }
    if names.len() > usize::from(u16::MAX) {
        return Err(wrong(format!("{} names are too many", names.len())));
    }
    Ok(names)
}

/// The list that belongs to a head, if it has as many names as there are classes.
fn own_list(head: HeadName, classes: Option<usize>) -> Option<Vec<String>> {
    match (head, classes?) {
        (_, 80) => Some(COCO_CLASSES.lines().map(str::to_owned).collect()),
        (HeadName::Detr, 91) => Some(coco_categories()),
        _ => None,
    }
}

fn lines(text: &str) -> Result<Vec<String>, String> {
    let names: Vec<String> = text.trim_end().lines().map(|line| line.trim().to_owned()).collect();
    match names.iter().position(String::is_empty) {
        _ if names.is_empty() => Err("it is empty; one name per line is needed".to_owned()),
        Some(line) => Err(format!("line {} is empty", line + 1)),
        None => Ok(names),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::metadata::tests::metadata;

    fn file_with(text: &str) -> (tempfile::TempPath, ClassNames) {
        let file = tempfile::NamedTempFile::new().unwrap().into_temp_path();
        std::fs::write(&file, text).unwrap();
        let names = ClassNames::File(file.to_path_buf());
        (file, names)
    }

    #[test]
    fn without_names_the_heads_list_is_used_if_its_length_fits() {
        use HeadName::{Detr, EndToEnd, Yolo, Yolox};
        let none = Metadata::default();
        let names = |head, classes| read(None, &none, head, classes);
        assert_eq!(names(Yolox, Some(80)).unwrap()[2], "car");
        assert_eq!(names(Yolo, Some(80)).unwrap().len(), 80);
        let categories = names(Detr, Some(91)).unwrap();
        assert_eq!(categories.len(), 91);
        // Category numbers from the annotation files of COCO 2017.
        for (number, name) in [(0, ""), (3, "car"), (13, "stop sign"), (90, "toothbrush")] {
            assert_eq!(categories[number], name);
        }
        for (head, classes) in [(Yolo, Some(79)), (EndToEnd, None)] {
            let error = names(head, classes).unwrap_err().to_string();
            assert!(error.starts_with("detector.class_names"), "{error}");
        }
    }

    #[test]
    fn configured_names_precede_those_of_the_metadata_and_must_fit_the_head() {
        use HeadName::{Detr, EndToEnd, Yolo};
        let two = metadata(&[("names", "{0: 'car', 1: 'bus'}")]);
        let broken = metadata(&[("names", "{0: car}")]);
        let own = ClassNames::List(vec!["Auto".to_owned(), "Bus".to_owned()]);
        let (_file, lines) = file_with("Auto\r\ntraffic light\n\n");
        for (given, metadata, head, classes, expected) in [
            (None, &two, Yolo, Some(2), ["car", "bus"]),
            // The third is "no object".
            (None, &two, Detr, Some(3), ["car", "bus"]),
            (None, &two, EndToEnd, None, ["car", "bus"]),
            (Some(&own), &two, Yolo, Some(2), ["Auto", "Bus"]),
            (Some(&own), &broken, Yolo, Some(2), ["Auto", "Bus"]),
            (Some(&lines), &two, Yolo, Some(2), ["Auto", "traffic light"]),
        ] {
            assert_eq!(read(given, metadata, head, classes).unwrap(), expected);
        }
    }

    #[test]
    fn unusable_names_are_an_error_that_says_where_they_are() {
        let (empty, no_lines) = file_with("");
        let (gap, lines) = file_with("car\n\nbus\n");
        let two = "{0: 'car', 1: 'bus'}";
        for (given, names, said) in [
            (None, two, "3 classes"),
            (None, two, "2 names"),
            (None, "{0: car}", "metadata"),
            (Some(no_lines), two, empty.to_str().unwrap()),
            (Some(lines), two, gap.to_str().unwrap()),
        ] {
            let metadata = metadata(&[("names", names)]);
            let read = read(given.as_ref(), &metadata, HeadName::Yolo, Some(3));
            let error = read.unwrap_err().to_string();
            assert!(error.starts_with("detector.class_names"), "{error}");
            assert!(error.contains(said), "{error}");
        }
    }
}
