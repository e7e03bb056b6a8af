//! The names of a model's classes: configured, from its metadata, or the list that belongs to its head.

use super::classes::named_classes;
use super::head::Head;
use super::{ClassNames, HeadName, StartError};
use crate::onnx::Metadata;
use std::path::Path;

/// The 80 classes of the COCO detection task (Lin et al., "Microsoft COCO", 2014), in the order of their
/// category numbers, which is the order detectors trained on it use.
pub(super) const COCO_CLASSES: &str = include_str!("coco.txt");

/// COCO's unused category numbers. Models that answer with category numbers (RF-DETR) have 91 classes, from 0 to 90.
const UNUSED_CATEGORIES: [usize; 11] = [0, 12, 26, 29, 30, 45, 66, 68, 69, 71, 83];

/// The COCO names by category number; empty for an unused number.
fn coco_categories() -> Vec<String> {
    let mut names = COCO_CLASSES.lines();
    let mut categories = Vec::new();
    for number in 0..=90 {
        let name = if UNUSED_CATEGORIES.contains(&number) {
            ""
        } else {
            names.next().unwrap_or_default()
        };
        categories.push(name.to_owned());
    }
    categories
}

/// True if these are the classes of COCO, however a few of them are written (`aeroplane`, `motorbike`, `tv monitor`).
pub fn are_of_coco(names: &[String]) -> bool {
    let is_known =
        |name: &&String| COCO_CLASSES.lines().any(|class| class.eq_ignore_ascii_case(name));
    let used = named_classes(names).len();
    let known = names.iter().filter(is_known).count();
    used == 80 && known >= 70
}

/// The number of names that are configured or in the metadata, if there are any that can be read.
pub(super) fn count(configured: Option<&ClassNames>, metadata: &Metadata) -> Option<usize> {
    let names = given(configured, metadata).ok()?.names?;
    Some(names.len())
}

/// The names of a model's classes.
#[derive(Debug)]
pub(super) struct ModelNames {
    /// By class number; an empty name is a class that does not occur.
    pub(super) names: Vec<String>,
    /// What was assumed of them, in words.
    pub(super) assumed: Option<String>,
}

/// Returns the names of the model's classes: the configured ones, else those of its metadata, else the list that
/// belongs to its head.
///
/// # Errors
/// If there are no names, too few or too many, or they cannot be read.
pub(super) fn read(
    configured: Option<&ClassNames>,
    metadata: &Metadata,
    head: &Head,
) -> Result<ModelNames, StartError> {
    let wrong = |reason: String| StartError::configuration("detector.class_names", reason);
    let Given {
        names,
        source,
        begins_empty,
    } = given(configured, metadata).map_err(wrong)?;
    let Some(mut names) = names else {
        let names = own_list(head).ok_or_else(|| wrong(no_names(head)))?;
        return Ok(ModelNames {
            names,
            assumed: None,
        });
    };
    // The empty line is that of the class which has no name.
    if begins_empty && head.classes == Some(names.len() + 1) {
        names.insert(0, String::new());
    }
    let count = names.len();
    if let Some(classes) = head.classes
        && !head.fits_names(count)
    {
        return Err(wrong(format!(
            "the model, read with the head `{}`, has another number of classes than {source} has names, {classes} and \
             {count}; if the names are right, another head belongs to the model (detector.head)",
            head.name.as_str()
        )));
    }
    if count > usize::from(u16::MAX) {
        return Err(wrong(format!("{count} names are too many")));
    }
    let assumed = if begins_empty && head.classes.is_none() {
        Some(format!(
            "{source} begins with an empty line, which is passed over: if class 0 of the model does not occur, give \
             detector.class_names as a list that begins with an empty name"
        ))
    } else {
        no_object(head, count)
    };
    Ok(ModelNames { names, assumed })
}

/// What is assumed of a model of the DETR family with one class more than there are names; `None` for any other.
fn no_object(head: &Head, names: usize) -> Option<String> {
    if head.classes? != names + 1 {
        return None;
    }
    Some(format!(
        "class {names}, the last of 0 to {names}, has no name and is taken for \"no object\": if the model's numbers \
         begin with 1, give detector.class_names as a list that begins with an empty name"
    ))
}

/// What is said of a model without names.
fn no_names(head: &Head) -> String {
    let classes = match head.classes {
        Some(1) => "1 class".to_owned(),
        Some(classes) => format!("{classes} classes"),
        None => "classes".to_owned(),
    };
    format!(
        "the model, read with the head `{}`, does not name its {classes}; give a file with one name per line, or a list, \
         or \"coco\" if it was trained on COCO (\"coco91\" if its numbers are COCO's categories)",
        head.name.as_str()
    )
}

/// Names, and where they are from.
struct Given {
    /// `None` if nothing names the classes.
    names: Option<Vec<String>>,
    source: String,
    /// As in [`FileNames`].
    begins_empty: bool,
}

/// The names of a file.
struct FileNames {
    names: Vec<String>,
    /// True if an empty line stands before the first name, and nothing in the file says whether it is that of a class 0
    /// which does not occur.
    begins_empty: bool,
}

impl FileNames {
    /// Names of which each has its place.
    fn in_places(names: Vec<String>) -> Self {
        Self {
            names,
            begins_empty: false,
        }
    }
}

/// The names that are configured, else those of the metadata.
fn given(configured: Option<&ClassNames>, metadata: &Metadata) -> Result<Given, String> {
    match configured {
        Some(ClassNames::List(names)) => Ok(Given {
            names: Some(names.clone()),
            source: "the list".to_owned(),
            begins_empty: false,
        }),
        Some(ClassNames::File(path)) => {
            let source = path.display().to_string();
            let read = match listed_as(path) {
                Some(names) => FileNames::in_places(names),
                None => read_file(path).map_err(|error| format!("{source}: {error}"))?,
            };
            Ok(Given {
                names: Some(read.names),
                source,
                begins_empty: read.begins_empty,
            })
        }
        None => {
            let names = metadata.class_names().map_err(|error| {
                format!(
                    "the class names in the model's metadata cannot be read ({error}); give a file or a list"
                )
            })?;
            Ok(Given {
                names,
                source: "its metadata".to_owned(),
                begins_empty: false,
            })
        }
    }
}

/// The list of COCO that `path` stands for; a file of that name goes before.
pub(super) fn listed_as(path: &Path) -> Option<Vec<String>> {
    if path.is_file() {
        return None;
    }
    match path.to_str() {
        Some("coco") => Some(coco()),
        Some("coco91") => Some(coco_categories()),
        _ => None,
    }
}

fn read_file(path: &Path) -> Result<FileNames, String> {
    let bytes = std::fs::read(path).map_err(|error| error.to_string())?;
    of_file(&bytes)
}

fn coco() -> Vec<String> {
    COCO_CLASSES.lines().map(str::to_owned).collect()
}

/// The list that belongs to a head, if it has as many names as there are classes.
fn own_list(head: &Head) -> Option<Vec<String>> {
    let has_categories = matches!(head.name, HeadName::Detr | HeadName::RtDetr);
    match head.classes? {
        80 => Some(coco()),
        91 if has_categories => Some(coco_categories()),
        _ => None,
    }
}

/// The names of a file, as programs and editors write them: one per line, perhaps numbered, or a dictionary or a list as
/// in Python or JSON; with a byte-order mark, in UTF-8 or UTF-16; lines that begin with `#` are comments. An empty line
/// before names that are numbered from 1 is the class 0 of a model that does not use it.
fn of_file(bytes: &[u8]) -> Result<FileNames, String> {
    let decoded = text_of(bytes)?;
    let text = decoded.trim_start_matches('\u{feff}').trim_end();
    if text.trim_start().starts_with(['{', '[']) {
        return metadata_names(text.trim_start()).map(FileNames::in_places);
    }
    if let Some(other) = other_format(text) {
        return Err(other.to_owned());
    }
    let mut names = Vec::new();
    let mut begins_empty = false;
    for (line, number) in text.lines().zip(1..) {
        let name = line.trim();
        if name.starts_with('#') {
            continue;
        }
        if !name.is_empty() {
            names.push(name);
        } else if names.is_empty() {
            begins_empty = true;
        } else {
            return Err(format!("line {number} is empty"));
        }
    }
    if names.is_empty() {
        return Err("it is empty; one name per line is needed".to_owned());
    }
    match numbering(&names, begins_empty) {
        Numbering::None => Ok(FileNames {
            names: names.into_iter().map(str::to_owned).collect(),
            begins_empty,
        }),
        Numbering::Of(numbered) => Ok(FileNames::in_places(by_number(&numbered))),
        Numbering::Unclear(reason) => Err(reason.to_owned()),
    }
}

/// What is said of a file of names in a format that is not read.
fn other_format(text: &str) -> Option<&'static str> {
    let has_line = |start: &str| text.lines().any(|line| line.trim_start().starts_with(start));
    if has_line("names:") {
        return Some(
            "it is a data set in YAML: write what is under `names` into a file of its own, one name per line",
        );
    }
    if has_line("item {") || has_line("item{") {
        return Some(
            "it is a label map of TensorFlow (`item {`): write the names into a file of their own, one per line behind its \
             number (`1 person`), after an empty line for the class 0, which does not occur",
        );
    }
    if text.contains(',') && text.lines().count() == 1 && numbered_name(text).is_none() {
        return Some(
            "it is one line with commas: one name per line is needed; if it is one name, write it as a list: [\"a, b\"]",
        );
    }
    None
}

/// A name with the number of its class.
struct NumberAndName<'a> {
    number: u16,
    name: &'a str,
}

/// What the numbers at the starts of lines are.
enum Numbering<'a> {
    /// None, or parts of the names.
    None,
    /// Those of the classes.
    Of(Vec<NumberAndName<'a>>),
    /// Perhaps those of the classes: what to do.
    Unclear(&'static str),
}

/// What the numbers at the starts of these lines are: those of the classes if every line has one, and they grow from the
/// first class on, which is 1 only behind an empty line.
fn numbering<'a>(names: &[&'a str], begins_empty: bool) -> Numbering<'a> {
    let Some(numbered) = growing(names) else {
        let below_first = names.get(1..).and_then(growing).unwrap_or_default();
        return match below_first.first() {
            Some(second) if second.number <= 1 => Numbering::Unclear(
                "its lines are numbered but for the first, which may be a heading: leave the heading out, or the numbers",
            ),
            _ => Numbering::None,
        };
    };
    match numbered.first().map(|first| first.number) {
        Some(0) => Numbering::Of(numbered),
        Some(1) if begins_empty => Numbering::Of(numbered),
        Some(1) => Numbering::Unclear(
            "its lines are numbered from 1, and the classes of most models from 0: leave the numbers out, or, if the \
             model's begin with 1 as well, let the file begin with an empty line; if the numbers are parts of the names, \
             write them as a list: [\"1 a\", \"2 b\"]",
        ),
        _ => Numbering::None,
    }
}

/// These lines with their numbers, if each has one that is larger than that before it.
fn growing<'a>(lines: &[&'a str]) -> Option<Vec<NumberAndName<'a>>> {
    let mut found: Vec<NumberAndName<'a>> = Vec::new();
    for &line in lines {
        let next = numbered_name(line)?;
        if found.last().is_some_and(|last| last.number >= next.number) {
            return None;
        }
        found.push(next);
    }
    Some(found)
}

/// The names in the places of their numbers, which grow; those between are empty.
fn by_number(numbered: &[NumberAndName<'_>]) -> Vec<String> {
    let mut names = Vec::new();
    for NumberAndName { number, name } in numbered {
        names.resize(usize::from(*number), String::new());
        names.push((*name).to_owned());
    }
    names
}

/// The text of a file in UTF-8, or in UTF-16 with a byte-order mark.
fn text_of(bytes: &[u8]) -> Result<String, String> {
    match bytes {
        [0xff, 0xfe, rest @ ..] => text_of_utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => text_of_utf16(rest, u16::from_be_bytes),
        _ => String::from_utf8(bytes.to_vec()).map_err(|_| "it is not text in UTF-8".to_owned()),
    }
}

fn text_of_utf16(bytes: &[u8], number: fn([u8; 2]) -> u16) -> Result<String, String> {
    // An odd byte at the end is half a unit: no character.
    let (pairs, _) = bytes.as_chunks::<2>();
    let units: Vec<u16> = pairs.iter().map(|pair| number(*pair)).collect();
    String::from_utf16(&units).map_err(|error| error.to_string())
}

/// The number and the name of a line such as `2 car`, `2: car` or `2,car`.
fn numbered_name(line: &str) -> Option<NumberAndName<'_>> {
    let after_number = line.trim_start_matches(|sign: char| sign.is_ascii_digit());
    let digits = &line[..line.len() - after_number.len()];
    let name = after_number
        .trim_start_matches([':', ',', ';', '='])
        .trim()
        .trim_matches(['"', '\'']);
    // Without anything between them the number is a part of the name, as in `4x4`.
    let is_apart = name.len() < after_number.len();
    if !is_apart || name.is_empty() {
        return None;
    }
    let number = digits.parse().ok()?;
    Some(NumberAndName { number, name })
}

fn metadata_names(text: &str) -> Result<Vec<String>, String> {
    Metadata::new([("names".to_owned(), text.to_owned())])
        .class_names()?
        .ok_or_else(|| "it has no names".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::head::tests::bound;
    use crate::onnx::metadata;

    /// A head of this name for a model with this number of classes; `None` only for the end-to-end head, whose output
    /// does not show it.
    fn head(name: HeadName, classes: Option<usize>) -> Head {
        let classes = classes.unwrap_or_default() as i64;
        match name {
            HeadName::Detr => bound(
                name,
                &[1, 3, 32, 64],
                &[("dets", &[1, 4, 4]), ("labels", &[1, 4, classes])],
            ),
            HeadName::EndToEnd => bound(name, &[1, 3, 32, 64], &[("output", &[1, 5, 6])]),
            HeadName::Yolox => bound(name, &[1, 3, 32, 64], &[("output", &[1, 42, 5 + classes])]),
            _ => bound(name, &[1, 3, 32, 64], &[("output", &[1, 4 + classes, 42])]),
        }
    }

    fn file_with(text: &str) -> (tempfile::TempPath, ClassNames) {
        let file = tempfile::NamedTempFile::new().unwrap().into_temp_path();
        std::fs::write(&file, text).unwrap();
        let names = ClassNames::File(file.to_path_buf());
        (file, names)
    }

    /// The names of a model that nothing names, by the head and the number of classes.
    fn unnamed(name: HeadName, classes: Option<usize>) -> Result<Vec<String>, StartError> {
        read(None, &Metadata::default(), &head(name, classes)).map(|read| read.names)
    }

    fn names_in(text: &[u8]) -> Vec<String> {
        of_file(text).unwrap().names
    }

    fn reason_against(text: &[u8]) -> String {
        of_file(text).err().unwrap()
    }

    #[test]
    fn without_names_the_heads_list_is_used_if_its_length_fits() {
        use HeadName::{Detr, Yolo, Yolox};
        assert_eq!(unnamed(Yolox, Some(80)).unwrap()[2], "car");
        assert_eq!(unnamed(Yolo, Some(80)).unwrap().len(), 80);
        let categories = unnamed(Detr, Some(91)).unwrap();
        assert_eq!(categories.len(), 91);
        // Category numbers from the annotation files of COCO 2017.
        for (number, name) in [(0, ""), (3, "car"), (13, "stop sign"), (90, "toothbrush")] {
            assert_eq!(categories[number], name);
        }
    }

    #[test]
    fn without_names_and_without_a_list_that_fits_the_error_names_the_setting() {
        for (name, classes) in [(HeadName::Yolo, Some(79)), (HeadName::EndToEnd, None)] {
            let error = unnamed(name, classes).unwrap_err().to_string();
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
        for (given, metadata, name, classes, expected) in [
            (None, &two, Yolo, Some(2), ["car", "bus"]),
            // The third is "no object".
            (None, &two, Detr, Some(3), ["car", "bus"]),
            (None, &two, EndToEnd, None, ["car", "bus"]),
            (Some(&own), &two, Yolo, Some(2), ["Auto", "Bus"]),
            (Some(&own), &broken, Yolo, Some(2), ["Auto", "Bus"]),
            (Some(&lines), &two, Yolo, Some(2), ["Auto", "traffic light"]),
        ] {
            let read = read(given, metadata, &head(name, classes)).unwrap();
            assert_eq!(read.names, expected);
        }
    }

    #[test]
    fn a_class_that_is_taken_for_no_object_is_said_with_the_way_out() {
        let three = head(HeadName::Detr, Some(3));
        let words = no_object(&three, 2).unwrap();
        for part in ["class 2, the last of 0 to 2", "detector.class_names"] {
            assert!(words.contains(part), "{words}");
        }
        assert_eq!(no_object(&three, 3), None);
        assert_eq!(no_object(&head(HeadName::EndToEnd, None), 2), None);
    }

    #[test]
    fn unusable_names_are_an_error_that_says_where_they_are() {
        let (path_of_empty, empty) = file_with("");
        let (path_of_gap, with_gap) = file_with("car\n\nbus\n");
        let two = "{0: 'car', 1: 'bus'}";
        for (given, names, said) in [
            (None, two, "another number of classes"),
            (None, two, "3 and 2;"),
            (None, "{0: car}", "metadata"),
            (Some(empty), two, path_of_empty.to_str().unwrap()),
            (Some(with_gap), two, path_of_gap.to_str().unwrap()),
        ] {
            let metadata = metadata(&[("names", names)]);
            let error = read(given.as_ref(), &metadata, &head(HeadName::Yolo, Some(3)))
                .unwrap_err()
                .to_string();
            assert!(error.starts_with("detector.class_names"), "{error}");
            assert!(error.contains(said), "{error}");
        }
    }

    #[test]
    fn a_class_file_is_read_as_editors_and_programs_write_it() {
        let utf16: Vec<u8> =
            "\u{feff}person\r\ncar\r\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        for bytes in [
            &b"\xef\xbb\xbfperson\r\ncar\r\n"[..],
            b"# classes\nperson\ncar",
            b"0 person\n1 car\n",
            b"0: person\n1: 'car'\n",
            b"[\"person\", \"car\"]",
            b"{0: 'person', 1: 'car'}",
            &utf16,
        ] {
            assert_eq!(names_in(bytes), ["person", "car"]);
        }
    }

    #[test]
    fn a_name_may_begin_with_a_number_that_is_not_its_place() {
        assert_eq!(names_in(b"4x4\n18-wheeler"), ["4x4", "18-wheeler"]);
    }

    #[test]
    fn an_empty_first_line_is_a_class_0_only_if_the_numbers_or_the_model_say_so() {
        use HeadName::{EndToEnd, Yolo};
        let plain = "\nperson\ncar\n";
        let of_windows = "\u{feff}\r\nperson\r\ncar";
        let two_lines = "\n\nperson\ncar";
        let commented = "# classes\n\nperson\ncar";
        let numbered = "# classes\n\n1 person\n2 car";
        let both = &["person", "car"][..];
        let all = &["", "person", "car"][..];
        for (text, name, classes, expected, is_said) in [
            (plain, Yolo, Some(3), all, false),
            (plain, Yolo, Some(2), both, false),
            (plain, EndToEnd, None, both, true),
            (of_windows, EndToEnd, None, both, true),
            (two_lines, EndToEnd, None, both, true),
            (commented, EndToEnd, None, both, true),
            (commented, Yolo, Some(3), all, false),
            (numbered, EndToEnd, None, all, false),
        ] {
            let (_file, lines) = file_with(text);
            let read = read(Some(&lines), &Metadata::default(), &head(name, classes)).unwrap();
            assert_eq!(read.names, expected, "{text:?} {name:?}");
            let words = read.assumed.unwrap_or_default();
            let found = words.contains("begins with an empty line, which is passed over");
            assert_eq!(found, is_said, "{text:?} {name:?}: {words}");
        }
    }

    #[test]
    fn names_with_numbers_from_0_on_are_in_the_places_of_their_numbers() {
        for text in ["0  person\n2  car", "\n0 person\n2 car", "0,person\n2,car"] {
            assert_eq!(names_in(text.as_bytes()), ["person", "", "car"]);
        }
        assert_eq!(names_in(b"0,plate"), ["plate"]);
        // Names alone, by their meaning.
        for lines in [["2 door", "4 door"], ["10", "20"], ["a", "b, c"]] {
            assert_eq!(names_in(lines.join("\n").as_bytes()), lines);
        }
    }

    #[test]
    fn a_file_whose_numbers_or_format_leave_the_classes_unclear_is_refused_with_what_to_do() {
        for (text, said) in [
            ("1 person\n2 car", "begin with an empty line"),
            ("1: person\n3: car", "begin with an empty line"),
            ("id,name\n0,person\n1,car", "heading"),
            ("path: x\nval: b\nnames:\n  0: person", "YAML"),
            ("nc: 2\nnames: ['person', 'car']", "YAML"),
            ("item {\n  id: 1\n  name: 'person'\n}", "label map"),
            ("person,bicycle,car\n", "commas"),
            ("tank, military", "if it is one name, write it as a list"),
            ("\n# nothing\n", "empty"),
        ] {
            let error = reason_against(text.as_bytes());
            assert!(error.contains(said), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_class_file_that_is_no_text_is_an_error() {
        let error = reason_against(b"\xff\x00\x01");
        assert!(error.contains("not text"), "{error}");
    }

    #[test]
    fn an_empty_line_between_names_is_told_by_its_number_in_the_file() {
        for (text, line) in [
            ("car\n\nbus\n", 2),
            ("# classes\nperson\n\ncar", 3),
            ("\nperson\n# a comment\n\ncar", 4),
        ] {
            let error = reason_against(text.as_bytes());
            assert_eq!(error, format!("line {line} is empty"), "{text:?}");
        }
    }

    #[test]
    fn the_lists_of_coco_stand_for_a_file() {
        let names = |name: &str| {
            let list = ClassNames::File(name.into());
            read(
                Some(&list),
                &Metadata::default(),
                &head(HeadName::EndToEnd, None),
            )
            .unwrap()
            .names
        };
        assert_eq!(names("coco")[2], "car");
        assert_eq!(names("coco91")[3], "car");
    }

    #[test]
    fn both_lists_of_coco_are_of_coco() {
        assert!(are_of_coco(&coco()));
        assert!(are_of_coco(&coco_categories()));
    }
}
