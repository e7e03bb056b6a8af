//! Says in words what is wrong with a value, without the value where it may be a secret.

use super::super::Finding;
use super::{is_index, meant};
use figment::error::{Actual, Kind, OneOf};

/// The error about the value at `path`. For removed keys and values it names the replacement, whichever camera it is:
/// `camera[1].ring` is `camera.ring`.
pub(super) fn finding(error: &Kind, path: &[String], removed: &str) -> Finding {
    let mut key = String::new();
    let mut without_numbers = String::new();
    for part in path {
        if is_index(part) {
            key.push_str(&format!("[{part}]"));
        } else {
            let dot = if key.is_empty() { "" } else { "." };
            key.push_str(&format!("{dot}{part}"));
            without_numbers.push_str(&format!("{dot}{part}"));
        }
    }
    let refused = match error {
        Kind::UnknownField(..) => without_numbers,
        Kind::UnknownVariant(value, _) => format!("{without_numbers} = {value}"),
        _ => String::new(),
    };
    let mut all_removed = removed.lines().filter_map(|line| line.split_once(": "));
    match all_removed.find(|(name, _)| *name == refused) {
        Some((_, became)) => Finding::new(key, format!("was removed: {became}")),
        None if may_hold_a_secret(path) => Finding::new(key, reason(&without_value(error))),
        None => Finding::new(key, reason(error)),
    }
}

/// True for keys whose value is never quoted.
fn may_hold_a_secret(path: &[String]) -> bool {
    let keys = ["token", "source", "source_options", "url"];
    let named = path.iter().rfind(|part| !is_index(part));
    named.is_some_and(|named| keys.contains(&named.as_str()))
}

/// The error without the value that was found.
fn without_value(error: &Kind) -> Kind {
    let kind_of = |found: &Actual| {
        let kind = match found {
            Actual::Str(_) => "a string",
            Actual::Seq => "a list",
            Actual::Map => "a table",
            _ => "such a value",
        };
        Actual::Other(kind.to_owned())
    };
    match error {
        Kind::InvalidType(found, expected) => Kind::InvalidType(kind_of(found), expected.clone()),
        Kind::InvalidValue(found, expected) => Kind::InvalidValue(kind_of(found), expected.clone()),
        other => other.clone(),
    }
}

/// An error of the file's form, which comes with a copy of the line: that may hold a password or a token, and is left out.
fn without_line(message: &str) -> String {
    let is_copy = |line: &&str| {
        line.trim_start_matches(|c: char| c == ' ' || c.is_ascii_digit())
            .starts_with('|')
    };
    let said: Vec<_> = message.lines().filter(|line| !is_copy(line)).collect();
    match said.as_slice() {
        // The parser has no words for a file that ends where a value has to be.
        [place, ""] => format!("{place}: a value is expected before the end of the file"),
        [place, reasons @ ..] if !reasons.is_empty() => format!("{place}: {}", reasons.join("; ")),
        _ => message.to_owned(),
    }
}

/// A readable description of the expected value, if `expected` is the name of a type.
fn in_words(expected: &str) -> &str {
    match expected {
        "f32" | "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "bool" => "true or false",
        "unit" | "unit variant" => "a name alone",
        "newtype variant" => "a name with its value, { name = value }",
        other if other == "enum" || other.starts_with("enum ") => "a name",
        other => other,
    }
}

/// A readable description of the value that was found.
fn found_in_words(found: &Actual) -> String {
    match found {
        Actual::UnitVariant => "a name alone".to_owned(),
        other => other.to_string(),
    }
}

/// What is wrong, in words.
fn reason(kind: &Kind) -> String {
    match kind {
        Kind::UnknownField(name, known) => match meant(name, known) {
            Some(meant) => format!("unknown key `{name}`; did you mean `{meant}`?"),
            None => format!("unknown key `{name}`; known are {}", OneOf(known)),
        },
        Kind::UnknownVariant(value, known) => format!("`{value}` is not {}", OneOf(known)),
        Kind::InvalidType(found, expected) | Kind::InvalidValue(found, expected) => {
            format!(
                "must be {}, not {}",
                in_words(expected),
                found_in_words(found)
            )
        }
        Kind::Message(message) => without_line(message),
        other => other.to_string(),
    }
}
