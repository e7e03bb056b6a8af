//! Reads a configuration from its file and the environment.

use super::{ConfigError, Finding};
use figment::Figment;
use figment::error::{Actual, Kind, OneOf};
use figment::providers::{Env, Format, Serialized, Toml};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::path::Path;

/// The prefix of environment variables. `ALBIREO_HTTP__LISTEN` overrides `listen` in `[http]`.
const PREFIX: &str = "ALBIREO_";

/// The maximum number of errors reported about the form of a configuration.
const MOST_FINDINGS: usize = 100;

/// A configuration that [`load`] can read: all settings of one service.
pub trait Configuration: DeserializeOwned {
    /// Its sections in capitals, as in the names of environment variables.
    const SECTIONS: &'static [&'static str];

    /// Values of keys, by section, that differ from the defaults of the section's type.
    fn defaults() -> Value {
        json!({})
    }

    /// Removed keys and values (`section.key = value`), one per line: the key, `: `, and what replaced it.
    const REMOVED: &'static str = "";

    /// Returns all errors in the values; empty if they are valid.
    fn findings(&self) -> Vec<Finding>;
}

/// Reads `file`, or the built-in defaults without one, lets environment variables override it, and checks
/// everything.
///
/// # Errors
/// [`ConfigError`] with all unknown keys and invalid values.
pub fn load<C: Configuration>(file: Option<&Path>) -> Result<C, ConfigError> {
    let (config, findings) = examine(file);
    let file = file.unwrap_or(Path::new("built-in defaults"));
    let file = file.display().to_string();
    match config {
        Some(config) if findings.is_empty() => Ok(config),
        _ => Err(ConfigError { file, findings }),
    }
}

/// Like [`load`], but returns what could be read, with defaults for the rest, together with all errors.
pub fn examine<C: Configuration>(file: Option<&Path>) -> (Option<C>, Vec<Finding>) {
    match file.map(std::fs::read_to_string).transpose() {
        Ok(text) => examine_text(text.as_deref().unwrap_or_default()),
        Err(error) => (None, vec![Finding::new("", error.to_string())]),
    }
}

/// Like [`examine`], with the file's text.
pub fn examine_text<C: Configuration>(text: &str) -> (Option<C>, Vec<Finding>) {
    let figment = Figment::from(Serialized::defaults(C::defaults())).merge(Toml::string(text));
    let mut findings = misspelt_variables(C::SECTIONS);
    let figment = figment.merge(
        Env::prefixed(PREFIX)
            .filter(|key| key.as_str().contains("__") || key == "camera")
            .split("__"),
    );
    let (config, malformed) = read::<C>(&figment);
    findings.extend(malformed);
    if let Some(config) = &config {
        let known: Vec<_> = findings.iter().map(|finding| finding.key.clone()).collect();
        // A value left out because of its form has its default here, or shortens a list, and is already reported.
        let reported = |key: &str| {
            known.iter().any(|known| {
                let rest = known.strip_prefix(key);
                rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
            })
        };
        findings.extend((config.findings().into_iter()).filter(|finding| !reported(&finding.key)));
    }
    for finding in &mut findings {
        let metadata = figment.find_metadata(&finding.key);
        if metadata.is_some_and(|found| found.name.contains("environment")) {
            let name = finding.key.to_ascii_uppercase().replace('.', "__");
            let source = format!(" (from environment variable {PREFIX}{name})");
            finding.reason.push_str(&source);
        }
        finding.key = by_name(&figment, &finding.key);
    }
    (config, findings)
}

/// Reads the configuration. An unknown key or a value of the wrong type is reported and left out, and the rest is read
/// again, so all errors are found at once. `None` if the rest cannot be read either.
fn read<C: Configuration>(figment: &Figment) -> (Option<C>, Vec<Finding>) {
    let mut findings: Vec<Finding> = Vec::new();
    // First without changes, because these errors know their source.
    let mut read = figment.extract::<C>();
    let mut values: Value = figment.extract().unwrap_or_default();
    loop {
        let errors = match read {
            Ok(config) => return (Some(config), findings),
            Err(errors) => errors,
        };
        for error in errors {
            let mut path = error.path.clone();
            if let Kind::UnknownField(name, _) = &error.kind
                && path.last() != Some(name)
            {
                path.push(name.clone());
            }
            findings.push(finding(&error.kind, &path, C::REMOVED));
            if !take_out(&mut values, &path) || findings.len() >= MOST_FINDINGS {
                return (None, findings);
            }
        }
        read = Figment::from(Serialized::defaults(&values)).extract::<C>();
    }
}

/// Removes the value at `path`, or the whole list if it is an element of one, so that the rest can be read and every
/// other element keeps its place; false if that is impossible.
fn take_out(values: &mut Value, path: &[String]) -> bool {
    let Some(last) = path.iter().rposition(|part| !is_index(part)) else {
        return false;
    };
    match values.pointer_mut(&pointer(&path[..last])) {
        Some(Value::Object(table)) => table.remove(&path[last]).is_some(),
        _ => false,
    }
}

fn is_index(part: &str) -> bool {
    part.parse::<usize>().is_ok()
}

/// A path as a JSON pointer (RFC 6901).
fn pointer(path: &[String]) -> String {
    let escaped = |part: &String| format!("/{}", part.replace('~', "~0").replace('/', "~1"));
    path.iter().map(escaped).collect()
}

/// Turns `camera[1].rate` into `camera.cabin.rate` if the second camera is named `cabin`.
fn by_name(figment: &Figment, key: &str) -> String {
    let named = || {
        let (list, rest) = key.split_once('[')?;
        let (index, rest) = rest.split_once(']')?;
        let values: Value = figment.extract_inner(list).ok()?;
        let name = values.pointer(&format!("/{index}/name"))?.as_str()?;
        (!name.is_empty()).then(|| format!("{list}.{name}{rest}"))
    };
    named().unwrap_or_else(|| key.to_owned())
}

/// Reports variables that look like a key with one underscore instead of two: they would silently have no
/// effect.
fn misspelt_variables(sections: &[&str]) -> Vec<Finding> {
    let names = std::env::vars_os().filter_map(|(name, _)| name.into_string().ok());
    let misspelt = names.filter_map(|name| {
        let (section, key) = name.strip_prefix(PREFIX)?.split_once('_')?;
        let reason = format!(
            "environment variable {name} names no key; between section and key belong two underscores: \
             {PREFIX}{section}__{key}"
        );
        let is_misspelt = sections.contains(&section) && !key.starts_with('_');
        is_misspelt.then(|| Finding::new("", reason))
    });
    misspelt.collect()
}

/// The error about the value at `path`. For removed keys and values it names the replacement, whichever camera it is:
/// `camera[1].ring` is `camera.ring`.
fn finding(error: &Kind, path: &[String], removed: &str) -> Finding {
    let (mut key, mut of_any) = (String::new(), String::new());
    for part in path {
        if is_index(part) {
            key.push_str(&format!("[{part}]"));
        } else {
            let dot = if key.is_empty() { "" } else { "." };
            key.push_str(&format!("{dot}{part}"));
            of_any.push_str(&format!("{dot}{part}"));
        }
    }
    let gone = match error {
        Kind::UnknownField(..) => of_any,
        Kind::UnknownVariant(value, _) => format!("{of_any} = {value}"),
        _ => String::new(),
    };
    let mut removed = removed.lines().filter_map(|line| line.split_once(": "));
    match removed.find(|(name, _)| *name == gone) {
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
    let kind = |found: &Actual| {
        let kind = match found {
            Actual::Str(_) => "a string",
            Actual::Seq => "a list",
            Actual::Map => "a table",
            _ => "such a value",
        };
        Actual::Other(kind.to_owned())
    };
    match error {
        Kind::InvalidType(found, expected) => Kind::InvalidType(kind(found), expected.clone()),
        Kind::InvalidValue(found, expected) => Kind::InvalidValue(kind(found), expected.clone()),
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
    match said.split_first() {
        Some((place, reasons)) if !reasons.is_empty() => format!("{place}: {}", reasons.join("; ")),
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
        other => other,
    }
}

fn reason(kind: &Kind) -> String {
    match kind {
        Kind::UnknownField(name, known) => {
            let mistakes = |known: &&str| strsim::osa_distance(name, known);
            match known.iter().copied().min_by_key(mistakes) {
                Some(meant) if mistakes(&meant) <= 2 => {
                    format!("unknown key `{name}`; did you mean `{meant}`?")
                }
                _ => format!("unknown key `{name}`; known are {}", OneOf(known)),
            }
        }
        Kind::UnknownVariant(value, known) => format!("`{value}` is not {}", OneOf(known)),
        Kind::InvalidType(found, expected) | Kind::InvalidValue(found, expected) => {
            format!("must be {}, not {found}", in_words(expected))
        }
        Kind::Message(message) => without_line(message),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize, Default)]
    #[serde(deny_unknown_fields, default)]
    struct Small {
        http: SmallHttp,
        camera: Vec<SmallCamera>,
    }

    #[derive(serde::Deserialize, Default)]
    #[serde(deny_unknown_fields, default)]
    struct SmallHttp {
        timeout: f64,
        port: u16,
    }

    #[derive(serde::Deserialize, Default)]
    #[serde(deny_unknown_fields, default)]
    struct SmallCamera {
        name: String,
        ring: usize,
    }

    impl Configuration for Small {
        const SECTIONS: &'static [&'static str] = &["HTTP"];

        fn findings(&self) -> Vec<Finding> {
            let port = (self.http.port == 0).then(|| Finding::new("http.port", "must not be 0"));
            let cameras = self.camera.iter().enumerate();
            let wrong = cameras.filter(|(_, camera)| matches!(&*camera.name, "" | "a b"));
            let wrong = wrong.map(|(index, _)| format!("camera[{index}].name"));
            let wrong = wrong.map(|key| Finding::new(key, "no such name"));
            port.into_iter().chain(wrong).collect()
        }
    }

    #[derive(serde::Deserialize, Default)]
    #[serde(default)]
    struct Secretive {
        token: Vec<SecretiveToken>,
    }

    #[derive(serde::Deserialize, Default)]
    #[serde(default)]
    struct SecretiveToken {
        token: String,
    }

    impl Configuration for Secretive {
        const SECTIONS: &'static [&'static str] = &[];

        fn findings(&self) -> Vec<Finding> {
            let broken = self.token.iter().filter(|token| token.token.is_empty());
            broken.map(|_| Finding::new("token", "is empty")).collect()
        }
    }

    #[test]
    fn all_errors_in_a_file_are_reported_at_once_in_plain_words() {
        let text = "[http]\ntimeout = \"long\"\nloud = 1\nprot = 8080\n[[camera]]\nring = \"two\"\n\
                    [[camera]]\nname = \"a b\"\nrung = 3\n";
        let (_, findings) = examine_text::<Small>(text);
        let mut reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
        reported.sort();
        let expected = [
            "camera.a b.name: no such name",
            "camera.a b.rung: unknown key `rung`; did you mean `ring`?",
            "camera[0].name: no such name",
            "camera[0].ring: must be a whole number, 0 or more, not string \"two\"",
            "http.loud: unknown key `loud`; known are `timeout` or `port`",
            "http.port: must not be 0",
            "http.prot: unknown key `prot`; did you mean `port`?",
            "http.timeout: must be a number, not string \"long\"",
        ];
        assert_eq!(reported, expected);
    }

    #[test]
    fn no_error_quotes_a_line_or_value_that_may_be_a_secret() {
        for (text, error) in [
            (
                "[http]\ntoken = [hidden\"\n",
                "TOML parse error at line 2, column 10: invalid array; expected `]`",
            ),
            (
                "token = \"hidden\"\n",
                "token: must be a sequence, not a string",
            ),
            (
                "[[token]]\ntoken = [\"hidden\"]\n",
                "token[0].token: must be a string, not a list",
            ),
        ] {
            let (_, findings) = examine_text::<Secretive>(text);
            let reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
            assert_eq!(reported, [error], "{text}");
        }
    }

    #[test]
    fn a_wrong_element_of_a_list_leaves_the_others_their_places() {
        let (config, findings) = examine_text::<Small>("camera = [{}, 7, { name = \"a b\" }]\n");
        let keys = findings.iter().map(|finding| finding.key.as_str());
        let of_cameras: Vec<_> = keys.filter(|key| key.starts_with("camera")).collect();
        assert_eq!(of_cameras, ["camera[1]"]);
        assert!(config.unwrap().camera.is_empty());
    }
}
