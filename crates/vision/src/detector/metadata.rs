//! The text in a model's file beside its graph, as Ultralytics and our own exports write it.

use albireo_core::geometry::PictureSize;
use std::collections::BTreeMap;

/// The longest text that is read; a file with 65,535 long class names stays below it.
const LONGEST: usize = 4 << 20;

/// The keys and values of an ONNX file's `metadata_props`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Metadata(BTreeMap<String, String>);

impl Metadata {
    /// Creates metadata from these entries, without values of more than 4 MiB.
    pub fn new(entries: impl IntoIterator<Item = (String, String)>) -> Self {
        Self(entries.into_iter().filter(|(_, value)| value.len() <= LONGEST).collect())
    }

    /// The value of `key`.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key).map(String::as_str)
    }

    /// True if an Ultralytics exporter wrote it: by its author, or by its task, stride and class names.
    pub(crate) fn is_ultralytics(&self) -> bool {
        self.get("author") == Some("Ultralytics")
            || ["task", "stride", "names"].iter().all(|key| self.0.contains_key(*key))
    }

    /// True if the model ends with boxes that need no suppression: `end2end`, or the exporter's argument `nms`.
    pub fn is_end_to_end(&self) -> bool {
        self.get("end2end").is_some_and(|value| value.eq_ignore_ascii_case("true"))
            || self.get("args").is_some_and(|value| value.contains("'nms': True"))
    }

    /// The input size of the export: `imgsz`, rows first.
    pub fn image_size(&self) -> Option<PictureSize> {
        let text = self.get("imgsz")?.trim();
        let list = [('[', ']'), ('(', ')')]
            .into_iter()
            .find_map(|(open, close)| text.strip_prefix(open)?.strip_suffix(close));
        let numbers = list.unwrap_or(text).split(',');
        let numbers: Option<Vec<u32>> = numbers.map(|side| side.trim().parse().ok()).collect();
        match *numbers?.as_slice() {
            [side] => Some(PictureSize::new(side, side)),
            [rows, columns] => Some(PictureSize::new(columns, rows)),
            _ => None,
        }
    }

    /// The class names in `names`: a dictionary from number to name in Python or JSON syntax, or a list.
    ///
    /// # Errors
    /// If the entry exists but cannot be read.
    pub fn class_names(&self) -> Result<Option<Vec<String>>, String> {
        let Some(text) = self.get("names") else {
            return Ok(None);
        };
        let names = Literal(text.trim_start()).names()?;
        let mut listed = Vec::with_capacity(names.len());
        for (place, (number, name)) in names.into_iter().enumerate() {
            if number != place {
                return Err(format!("class {place} has no name"));
            }
            listed.push(name);
        }
        if listed.is_empty() {
            return Err("it has no names".to_owned());
        }
        Ok(Some(listed))
    }
}

/// The unread rest of a Python or JSON literal.
struct Literal<'a>(&'a str);

impl Literal<'_> {
    /// Reads the names by class number.
    fn names(mut self) -> Result<BTreeMap<usize, String>, String> {
        let mut names = BTreeMap::new();
        let (numbered, close) = if self.take('{') {
            (true, '}')
        } else if self.take('[') {
            (false, ']')
        } else {
            return Err(self.expected("`{` or `[`"));
        };
        while !self.take(close) {
            let number = if numbered {
                let number = self.number()?;
                if !self.take(':') {
                    return Err(self.expected("`:`"));
                }
                number
            } else {
                names.len()
            };
            let name = self.quoted()?;
            if names.insert(number, name).is_some() {
                return Err(format!("class {number} is listed twice"));
            }
            if !self.take(',') {
                if self.take(close) {
                    break;
                }
                return Err(self.expected("`,` or the end"));
            }
        }
        if self.0.is_empty() {
            Ok(names)
        } else {
            Err(self.expected("the end"))
        }
    }

    fn expected(&self, what: &str) -> String {
        let next: String = self.0.chars().take(20).collect();
        format!("{what} is expected before `{next}`")
    }

    /// Consumes `sign` and the space after it, if it is next.
    fn take(&mut self, sign: char) -> bool {
        match self.0.strip_prefix(sign) {
            Some(rest) => {
                self.0 = rest.trim_start();
                true
            }
            None => false,
        }
    }

    /// Reads a class number, plain or quoted as in JSON.
    fn number(&mut self) -> Result<usize, String> {
        if self.0.starts_with(['"', '\'']) {
            let digits = self.quoted()?;
            return digits.parse().map_err(|_| format!("`{digits}` is not a class number"));
        }
        let end = self.0.find(|sign: char| !sign.is_ascii_digit()).unwrap_or(self.0.len());
        let (digits, rest) = self.0.split_at(end);
        let number = digits.parse().map_err(|_| self.expected("a class number"))?;
        self.0 = rest.trim_start();
        Ok(number)
    }

    fn quoted(&mut self) -> Result<String, String> {
        let mut signs = self.0.char_indices();
        let quote = match signs.next() {
            Some((_, quote @ ('"' | '\''))) => quote,
            _ => return Err(self.expected("a quoted name")),
        };
        let mut name = String::new();
        while let Some((at, sign)) = signs.next() {
            match sign {
                '\\' => match signs.next() {
                    Some((_, 'n')) => name.push('\n'),
                    Some((_, 't')) => name.push('\t'),
                    Some((_, sign @ ('\\' | '\'' | '"'))) => name.push(sign),
                    _ => return Err(self.expected("a name without such an escape")),
                },
                sign if sign == quote => {
                    self.0 = self.0[at + 1..].trim_start();
                    return Ok(name);
                }
                sign => name.push(sign),
            }
        }
        Err(self.expected("a name with an end"))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(in crate::detector) fn metadata(entries: &[(&str, &str)]) -> Metadata {
        let owned = |&(key, value): &(&str, &str)| (key.to_owned(), value.to_owned());
        Metadata::new(entries.iter().map(owned))
    }

    fn names(text: &str) -> Result<Vec<String>, String> {
        let names = metadata(&[("names", text)]).class_names();
        names.map(Option::unwrap)
    }

    #[test]
    fn names_are_read_as_python_and_json_write_them() {
        for text in [
            "{0: 'car', 1: \"driver's cab\"}",
            "{ 0 : 'car' , 1: 'driver\\'s cab', }",
            "{\"0\": \"car\", \"1\": \"driver's cab\"}",
            "['car', \"driver's cab\"]",
            "{1: 'driver\\'s cab', 0: 'car'}",
        ] {
            assert_eq!(names(text).unwrap(), ["car", "driver's cab"], "{text}");
        }
        assert_eq!(metadata(&[]).class_names(), Ok(None));
    }

    #[test]
    fn unreadable_names_are_reported_with_the_place() {
        for (text, part) in [
            ("", "`{` or `[`"),
            ("{}", "no name"),
            ("{0: 'car', 2: 'bus'}", "class 1"),
            ("{0: 'car', 0: 'bus'}", "twice"),
            ("{0: 'car'", "`,`"),
            ("{0: car}", "quoted"),
            ("{0: 'car", "end"),
            ("{0 'car'}", "`:`"),
            ("{-1: 'car'}", "number"),
            ("['car'] and more", "the end"),
            ("{99999999999999999999999: 'car'}", "number"),
        ] {
            let error = names(text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn an_image_size_is_one_number_or_rows_and_columns() {
        for (text, size) in [
            ("[384, 640]", Some((640, 384))),
            ("640", Some((640, 640))),
            ("(384, 640)", Some((640, 384))),
            ("[640", None),
            ("640]", None),
            ("[384, 640)", None),
            ("a", None),
            ("[1, 2, 3]", None),
            ("", None),
        ] {
            let expected = size.map(|(width, height)| PictureSize::new(width, height));
            let found = metadata(&[("imgsz", text)]).image_size();
            assert_eq!(found, expected, "{text}");
        }
    }

    proptest! {
        #[test]
        fn names_are_read_back_as_written(
            wanted in prop::collection::vec("[a-z '\"\\\\]{0,12}", 1..20)
        ) {
            let entry = |(number, name): (usize, &String)| {
                format!("{number}: '{}'", name.replace('\\', "\\\\").replace('\'', "\\'"))
            };
            let text: Vec<String> = wanted.iter().enumerate().map(entry).collect();
            prop_assert_eq!(names(&format!("{{{}}}", text.join(", "))).unwrap(), wanted);
        }
    }
}
