//! The text in a model's file beside its graph, as Ultralytics and our own exports write it.

use super::signature::is_possible;
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

    /// True if the model ends with boxes that need no suppression: `end2end`, or the exporter's argument `nms`.
    pub fn is_end_to_end(&self) -> bool {
        let is_true =
            |key: &str| self.get(key).is_some_and(|value| value.eq_ignore_ascii_case("true"));
        let mut arguments = self.get("args").unwrap_or_default().to_lowercase();
        arguments.retain(|sign| !sign.is_whitespace());
        is_true("end2end")
            || is_true("nms")
            || arguments.contains("'nms':true")
            || arguments.contains("\"nms\":true")
    }

    /// True if the exporter says that the model is an RT-DETR: `head`, in Ultralytics 8.4.
    pub fn is_rt_detr(&self) -> bool {
        self.get("head") == Some("RTDETRDecoder")
    }

    /// The input size of the export: `imgsz`, rows first. `None` for a size that no input has: exporters write [0, 0] for one
    /// that they do not know.
    pub fn image_size(&self) -> Option<PictureSize> {
        let text = self.get("imgsz")?.trim();
        let list = within(text, '[', ']').or_else(|| within(text, '(', ')'));
        let mut sides = Vec::new();
        for side in list.unwrap_or(text).split(',') {
            sides.push(side.trim().parse().ok()?);
        }
        let size = match *sides.as_slice() {
            [side] => PictureSize::new(side, side),
            [rows, columns] => PictureSize::new(columns, rows),
            _ => return None,
        };
        is_possible(size).then_some(size)
    }

    /// The stride of the export: sides of the input are multiples of it.
    pub fn stride(&self) -> Option<u32> {
        let stride: f64 = self.get("stride")?.trim().parse().ok()?;
        if (1.0..=256.0).contains(&stride) {
            Some(stride as u32)
        } else {
            None
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
        // Python writes `None` for what was never set.
        if matches!(text.trim(), "None" | "null") {
            return Ok(None);
        }
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

/// What is between these two signs at the ends of `text`.
fn within(text: &str, open: char, close: char) -> Option<&str> {
    text.strip_prefix(open)?.strip_suffix(close)
}

/// The unread rest of a Python or JSON literal.
struct Literal<'a>(&'a str);

impl Literal<'_> {
    /// Reads the names by class number.
    fn names(mut self) -> Result<BTreeMap<usize, String>, String> {
        let mut names = BTreeMap::new();
        let is_dictionary = self.take('{');
        if !is_dictionary && !self.take('[') {
            return Err(self.expected("`{` or `[`"));
        }
        let close = if is_dictionary { '}' } else { ']' };
        while !self.take(close) {
            let number = if is_dictionary {
                self.key()?
            } else {
                names.len()
            };
            let name = self.name()?;
            if names.insert(number, name).is_some() {
                return Err(format!("class {number} is listed twice"));
            }
            if !self.take(',') {
                if self.take(close) {
                    break;
                }
                return Err(self.expected(&format!("`,` or `{close}`")));
            }
        }
        if self.0.is_empty() {
            Ok(names)
        } else {
            Err(self.expected("the end"))
        }
    }

    fn expected(&self, what: &str) -> String {
        if self.0.is_empty() {
            return format!("{what} is expected before the end of the text");
        }
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

    /// Reads a class number and the colon after it.
    fn key(&mut self) -> Result<usize, String> {
        let number = self.number()?;
        if self.take(':') {
            Ok(number)
        } else {
            Err(self.expected("`:`"))
        }
    }

    /// Reads a class number, plain or quoted as in JSON, whole or written as `2.0`.
    fn number(&mut self) -> Result<usize, String> {
        let digits = if self.0.starts_with(['"', '\'']) {
            self.quoted()?
        } else {
            self.bare().to_owned()
        };
        if digits.is_empty() {
            return Err(self.expected("a class number"));
        }
        let whole = digits.strip_suffix(".0").unwrap_or(&digits);
        whole.parse().map_err(|_| format!("`{digits}` is not a class number"))
    }

    /// Reads signs up to the next that ends a value.
    fn bare(&mut self) -> &str {
        let end = self.0.find([':', ',', '}', ']', ' ', '\n']).unwrap_or(self.0.len());
        let (value, rest) = self.0.split_at(end);
        self.0 = rest.trim_start();
        value
    }

    /// Reads a name: quoted, or a number, which some exporters write without quotes.
    fn name(&mut self) -> Result<String, String> {
        if self.0.starts_with(|sign: char| sign.is_ascii_digit()) {
            return Ok(self.bare().to_owned());
        }
        self.quoted()
    }

    fn quoted(&mut self) -> Result<String, String> {
        let quote = match self.0.chars().next() {
            Some(quote @ ('"' | '\'')) => quote,
            _ => return Err(self.expected("a quoted name")),
        };
        let mut name = String::new();
        let mut rest = &self.0[1..];
        loop {
            let Some(sign) = rest.chars().next() else {
                return Err(self.expected("a name with an end"));
            };
            rest = &rest[sign.len_utf8()..];
            if sign == quote {
                self.0 = rest.trim_start();
                return Ok(name);
            }
            if sign != '\\' {
                name.push(sign);
                continue;
            }
            let Some((sign, after)) = escaped(rest) else {
                return Err(self.expected("a name without such an escape"));
            };
            name.push(sign);
            rest = after;
        }
    }
}

/// The sign that an escape of JSON or Python means, without its backslash, and the text after it.
fn escaped(text: &str) -> Option<(char, &str)> {
    let kind = text.chars().next()?;
    let rest = &text[kind.len_utf8()..];
    let plain = |sign| Some((sign, rest));
    match kind {
        'n' => plain('\n'),
        't' => plain('\t'),
        'r' => plain('\r'),
        'b' => plain('\u{8}'),
        'f' => plain('\u{c}'),
        '\\' | '\'' | '"' | '/' => plain(kind),
        'x' => by_code(rest, 2),
        'U' => by_code(rest, 8),
        'u' => by_code(rest, 4).or_else(|| surrogates(rest)),
        _ => None,
    }
}

/// The number that the first `digits` hexadecimal digits mean.
fn hexadecimal(text: &str, digits: usize) -> Option<u32> {
    let written = text.get(..digits)?;
    // `from_str_radix` alone would also take a sign.
    if written.chars().all(|sign| sign.is_ascii_hexdigit()) {
        u32::from_str_radix(written, 16).ok()
    } else {
        None
    }
}

/// The sign whose number is in the first `digits` hexadecimal digits.
fn by_code(text: &str, digits: usize) -> Option<(char, &str)> {
    let code = hexadecimal(text, digits)?;
    Some((char::from_u32(code)?, &text[digits..]))
}

/// The sign that JSON writes as two halves: `d83d\ude97`.
fn surrogates(text: &str) -> Option<(char, &str)> {
    let half = |text: &str| u16::try_from(hexadecimal(text, 4)?).ok();
    let rest = text.get(4..)?.strip_prefix("\\u")?;
    let sign = char::decode_utf16([half(text)?, half(rest)?]).next()?.ok()?;
    Some((sign, &rest[4..]))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(crate) fn metadata(entries: &[(&str, &str)]) -> Metadata {
        let owned = |&(key, value): &(&str, &str)| (key.to_owned(), value.to_owned());
        Metadata::new(entries.iter().map(owned))
    }

    fn names(text: &str) -> Result<Vec<String>, String> {
        metadata(&[("names", text)]).class_names().map(Option::unwrap)
    }

    #[test]
    fn names_are_read_as_python_and_json_write_them() {
        for text in [
            "{0: 'car', 1: \"driver's cab\"}",
            "{ 0 : 'car' , 1: 'driver\\'s cab', }",
            "{\"0\": \"car\", \"1\": \"driver's cab\"}",
            "['car', \"driver's cab\"]",
            "{1: 'driver\\'s cab', 0: 'car'}",
            "{0.0: 'car', 1.0: 'driver\\x27s cab'}",
            "{\"0\": \"c\\u0061r\", \"1\": \"driver\\u0027s cab\"}",
        ] {
            assert_eq!(names(text).unwrap(), ["car", "driver's cab"], "{text}");
        }
    }

    #[test]
    fn names_have_signs_of_any_script_written_as_escapes() {
        let names =
            names(r#"{"0": "\u884c\u4eba", "1": "caf\u00e9 \ud83d\ude97", "2": "car\xa0red"}"#);
        assert_eq!(names.unwrap(), ["行人", "café 🚗", "car\u{a0}red"]);
    }

    #[test]
    fn a_name_may_be_a_number_without_quotes() {
        assert_eq!(names("{0: 0, 1: 7}").unwrap(), ["0", "7"]);
    }

    #[test]
    fn a_model_whose_names_are_missing_or_none_has_no_names() {
        let missing = metadata(&[]);
        assert_eq!(missing.class_names(), Ok(None));
        let none = metadata(&[("names", "None")]);
        assert_eq!(none.class_names(), Ok(None));
    }

    #[test]
    fn unreadable_names_are_reported_with_what_is_wrong_and_where() {
        for (text, expected) in [
            ("", "`{` or `[` is expected before the end of the text"),
            ("{}", "it has no names"),
            ("{0: 'car', 2: 'bus'}", "class 1 has no name"),
            ("{0: 'car', 0: 'bus'}", "class 0 is listed twice"),
            (
                "{0: 'car'",
                "`,` or `}` is expected before the end of the text",
            ),
            (
                "{0: ",
                "a quoted name is expected before the end of the text",
            ),
            ("{0: car}", "a quoted name is expected before `car}`"),
            ("{0: 'car", "a name with an end is expected before `'car`"),
            ("{0 'car'}", "`:` is expected before `'car'}`"),
            ("{: 'car'}", "a class number is expected before `: 'car'}`"),
            ("{-1: 'car'}", "`-1` is not a class number"),
            ("['car'] and more", "the end is expected before `and more`"),
            (
                "{99999999999999999999999: 'car'}",
                "`99999999999999999999999` is not a class number",
            ),
        ] {
            assert_eq!(names(text).unwrap_err(), expected, "{text}");
        }
    }

    #[test]
    fn an_escape_is_hexadecimal_digits_without_a_sign() {
        for name in [r"'\x+a'", r"'\u+041'", r"'\U+0000041'", r"'\ud83d\u+e97'"] {
            let error = names(&format!("[{name}]")).unwrap_err();
            let expected = format!("a name without such an escape is expected before `{name}]`");
            assert_eq!(error, expected);
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
            ("[0, 0]", None),
            ("[640, 9000]", None),
            ("[8000, 8000]", None),
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
