//! Reads a configuration from its file and the environment.

use super::{ConfigError, Finding};
use figment::Figment;
use figment::providers::{Env, Format, Serialized, Toml};
use figment::value::{Dict, Value};
use serde::de::DeserializeOwned;
use std::path::Path;

/// What environment variables begin with. `ALBIREO_HTTP__LISTEN` overrides `listen` in `[http]`.
const PREFIX: &str = "ALBIREO_";

/// Most things that are told to be wrong with the form of a configuration.
const MOST_FINDINGS: usize = 100;

/// A configuration that [`load`] can read: all settings of one service.
pub trait Configuration: DeserializeOwned {
    /// Its sections in capitals, as they stand in the names of environment variables.
    const SECTIONS: &'static [&'static str];

    /// Keys that an earlier version had, and values (`section.key = value`), each with what became of it.
    const REMOVED: &'static [(&'static str, &'static str)] = &[];

    /// Everything that is wrong with the values; empty when they can be used.
    fn findings(&self) -> Vec<Finding>;
}

/// Reads `file` (the built-in defaults without one), lets environment variables override it, and checks
/// everything.
///
/// # Errors
/// [`ConfigError`] with all unknown keys and impossible values found.
pub fn load<C: Configuration>(file: Option<&Path>) -> Result<C, ConfigError> {
    let (config, findings) = examine(file);
    match config {
        Some(config) if findings.is_empty() => Ok(config),
        _ => Err(ConfigError {
            file: file.map_or_else(
                || "built-in defaults".to_owned(),
                |file| file.display().to_string(),
            ),
            findings,
        }),
    }
}

/// As [`load`]: what could be read of a configuration, with defaults for what could not, and everything that is wrong
/// with it.
pub fn examine<C: Configuration>(file: Option<&Path>) -> (Option<C>, Vec<Finding>) {
    match file.map(std::fs::read_to_string).transpose() {
        Ok(text) => examine_text(text.as_deref().unwrap_or_default()),
        Err(error) => (None, vec![Finding::new("", error.to_string())]),
    }
}

/// As [`examine`], with the file's text.
pub fn examine_text<C: Configuration>(text: &str) -> (Option<C>, Vec<Finding>) {
    let figment = Figment::from(Toml::string(text));
    let variables = std::env::vars_os().filter_map(|(k, _)| k.into_string().ok());
    let mut findings = misspelt_variables(variables, C::SECTIONS);
    let figment = figment.merge(
        Env::prefixed(PREFIX)
            .filter(|key| key.as_str().contains("__") || key == "camera")
            .split("__"),
    );
    let (config, malformed) = read::<C>(&figment);
    findings.extend(malformed);
    if let Some(config) = &config {
        let known: Vec<_> = findings.iter().map(|finding| finding.key.clone()).collect();
        // What was left out because of its form has its default here, or is a shorter list, and is spoken of already.
        let reported = |key: &str| {
            known.iter().any(|known| {
                let rest = known.strip_prefix(key);
                rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
            })
        };
        findings.extend((config.findings().into_iter()).filter(|finding| !reported(&finding.key)));
    }
    for finding in &mut findings {
        if finding.source.is_none() {
            finding.source = source(&figment, &finding.key);
        }
        finding.key = by_name(&figment, &finding.key);
    }
    (config, findings)
}

/// Reads the configuration. What cannot be read, an unknown key or a value of another type, is noted and left out, and
/// the rest is read again: so everything is found in one go. `None` when the rest cannot be read either.
fn read<C: Configuration>(figment: &Figment) -> (Option<C>, Vec<Finding>) {
    let mut findings: Vec<Finding> = Vec::new();
    let mut values = match figment.extract::<Dict>() {
        Ok(values) => values,
        Err(error) => {
            let findings = error.into_iter().map(|error| finding(error, C::REMOVED));
            return (None, findings.collect());
        }
    };
    loop {
        // The first time as it is, for its errors know where they come from.
        let read = if findings.is_empty() {
            figment.extract::<C>()
        } else {
            Figment::from(Serialized::defaults(&values)).extract::<C>()
        };
        let errors = match read {
            Ok(config) => return (Some(config), findings),
            Err(errors) => errors,
        };
        for error in errors {
            let mut path = error.path.clone();
            let mended = match &error.kind {
                figment::error::Kind::UnknownField(name, _) => {
                    if path.last() != Some(name) {
                        path.push(name.clone());
                    }
                    left_out(&mut values, &path)
                }
                figment::error::Kind::MissingField(name) => {
                    path.push(name.to_string());
                    named(&mut values, &path)
                }
                _ => left_out(&mut values, &path),
            };
            let mut noted = finding(error, C::REMOVED);
            if noted.source.is_none() {
                noted.source = source(figment, &path.join("."));
            }
            findings.push(noted);
            if !mended || findings.len() >= MOST_FINDINGS {
                return (None, findings);
            }
        }
    }
}

/// Takes the value at `path` out; false when there is none.
fn left_out(values: &mut Dict, path: &[String]) -> bool {
    let Some((last, table)) = path.split_last() else {
        return false;
    };
    match inside(values, table) {
        Some(Inside::Table(table)) => table.remove(last).is_some(),
        Some(Inside::List(list)) => match last.parse::<usize>() {
            Ok(index) if index < list.len() => {
                list.remove(index);
                true
            }
            _ => false,
        },
        None => false,
    }
}

/// Gives a name where one is missing, so that the rest can be read; false when that cannot be done.
fn named(values: &mut Dict, path: &[String]) -> bool {
    let Some((last, table)) = path.split_last() else {
        return false;
    };
    match inside(values, table) {
        Some(Inside::Table(found)) => {
            let name = format!("unnamed-{}", table.join("-"));
            found.insert(last.clone(), Value::from(name)).is_none()
        }
        _ => false,
    }
}

enum Inside<'a> {
    Table(&'a mut Dict),
    List(&'a mut Vec<Value>),
}

/// The table or list at `path`.
fn inside<'a>(values: &'a mut Dict, path: &[String]) -> Option<Inside<'a>> {
    let Some((first, rest)) = path.split_first() else {
        return Some(Inside::Table(values));
    };
    let mut value = values.get_mut(first)?;
    for part in rest {
        value = match value {
            Value::Dict(_, table) => table.get_mut(part)?,
            Value::Array(_, list) => list.get_mut(part.parse::<usize>().ok()?)?,
            _ => return None,
        };
    }
    match value {
        Value::Dict(_, table) => Some(Inside::Table(table)),
        Value::Array(_, list) => Some(Inside::List(list)),
        _ => None,
    }
}

/// The environment variable that the value of `key` comes from, when it is not the file.
fn source(figment: &Figment, key: &str) -> Option<String> {
    let path = key.replace('[', ".").replace(']', "");
    let metadata = figment.find_metadata(&path)?;
    metadata
        .name
        .contains("environment")
        .then(|| variable(&path))
}

/// `camera[1].rate` as `camera.cabin.rate`, where the second camera is named `cabin`.
fn by_name(figment: &Figment, key: &str) -> String {
    let named = || {
        let (list, rest) = key.split_once('[')?;
        let (index, rest) = rest.split_once(']')?;
        let mut values = figment.extract::<Dict>().ok()?;
        let table = inside(&mut values, &[list.to_owned(), index.to_owned()])?;
        let Inside::Table(table) = table else {
            return None;
        };
        let name = table
            .get("name")?
            .as_str()
            .filter(|name| !name.is_empty())?;
        Some(format!("{list}.{name}{rest}"))
    };
    named().unwrap_or_else(|| key.to_owned())
}

/// The environment variable that sets the key at `path`.
fn variable(path: &str) -> String {
    let name = path.to_ascii_uppercase().replace('.', "__");
    format!("environment variable {PREFIX}{name}")
}

/// Variables that look like a key with one underscore where two belong: left alone they would silently
/// do nothing.
fn misspelt_variables(names: impl Iterator<Item = String>, sections: &[&str]) -> Vec<Finding> {
    names
        .filter_map(|name| {
            let rest = name.strip_prefix(PREFIX)?;
            let (section, key) = rest.split_once('_')?;
            (sections.contains(&section) && !key.starts_with('_')).then(|| {
                Finding::new(
                    "",
                    format!(
                        "environment variable {name} names no key; between section and key belong two \
                         underscores: {PREFIX}{section}__{key}"
                    ),
                )
            })
        })
        .collect()
}

fn finding(error: figment::Error, removed: &[(&str, &str)]) -> Finding {
    let mut key = String::new();
    for part in &error.path {
        if part.bytes().all(|byte| byte.is_ascii_digit()) {
            key.push_str(&format!("[{part}]"));
        } else {
            if !key.is_empty() {
                key.push('.');
            }
            key.push_str(part);
        }
    }
    // Of whichever camera: `camera[1].ring` is `camera.ring`.
    let without_places = |key: &str| {
        let parts = key.split('.');
        let names = parts.map(|part| part.split('[').next().unwrap_or_default());
        names.collect::<Vec<_>>().join(".")
    };
    let removed = |wanted: &str| {
        let wanted = without_places(wanted);
        removed.iter().find(|(name, _)| *name == wanted)
    };
    let removed = match &error.kind {
        figment::error::Kind::UnknownField(..) => removed(&key),
        figment::error::Kind::UnknownVariant(value, _) => removed(&format!("{key} = {value}")),
        _ => None,
    };
    let reason = match removed {
        Some((_, became)) => format!("was removed: {became}"),
        None => reason(&error.kind),
    };
    Finding {
        key,
        reason,
        source: None,
    }
}

/// What was expected, where that is the name of a type.
fn in_words(expected: &str) -> &str {
    match expected {
        "f32" | "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "bool" => "true or false",
        other => other,
    }
}

/// The known name that is at most two typing errors away.
fn closest<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let distances = known.iter().map(|&k| (strsim::osa_distance(name, k), k));
    let (distance, closest) = distances.min()?;
    (distance <= 2).then_some(closest)
}

fn reason(kind: &figment::error::Kind) -> String {
    use figment::error::{Kind, OneOf};
    match kind {
        Kind::UnknownField(name, known) => match closest(name, known) {
            Some(meant) => format!("unknown key `{name}`; did you mean `{meant}`?"),
            None => format!("unknown key `{name}`; known are {}", OneOf(known)),
        },
        Kind::UnknownVariant(value, known) => format!("`{value}` is not {}", OneOf(known)),
        Kind::MissingField(name) => format!("`{name}` is missing"),
        Kind::InvalidType(found, expected) | Kind::InvalidValue(found, expected) => {
            format!("must be {}, not {found}", in_words(expected))
        }
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
        mode: Mode,
        camera: Vec<SmallCamera>,
    }

    #[derive(serde::Deserialize, Default)]
    #[serde(deny_unknown_fields, default)]
    struct SmallHttp {
        timeout: f64,
        port: u16,
    }

    #[derive(serde::Deserialize, Default)]
    #[serde(rename_all = "lowercase")]
    enum Mode {
        #[default]
        Fast,
    }

    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct SmallCamera {
        name: String,
        #[serde(default)]
        ring: usize,
    }

    impl Configuration for Small {
        const SECTIONS: &'static [&'static str] = &["HTTP"];
        const REMOVED: &'static [(&'static str, &'static str)] = &[
            ("http.backlog", "the system's own is used"),
            ("mode = slow", "there is one mode"),
        ];

        fn findings(&self) -> Vec<Finding> {
            let mut findings = Vec::new();
            if self.http.port == 0 {
                findings.push(Finding::new("http.port", "must not be 0"));
            }
            for (index, camera) in self.camera.iter().enumerate() {
                if camera.name.contains(' ') || camera.ring > 9 {
                    findings.push(Finding::new(
                        format!("camera[{index}].name"),
                        "no such name",
                    ));
                }
            }
            findings
        }
    }

    #[test]
    fn everything_that_is_wrong_is_found_in_one_go_and_in_plain_words() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("small.toml");
        let text = "[http]\ntimeout = \"long\"\nloud = 1\nprot = 8080\n[[camera]]\nring = \"two\"\n\
                    [[camera]]\nname = \"a b\"\nrung = 3\n";
        std::fs::write(&file, text).unwrap();
        let Err(error) = load::<Small>(Some(&file)) else {
            panic!("it can be used");
        };
        let mut reported: Vec<_> = error.findings.iter().map(ToString::to_string).collect();
        reported.sort();
        assert_eq!(
            reported,
            [
                "camera.a b.name: no such name",
                "camera.a b.rung: unknown key `rung`; did you mean `ring`?",
                "camera[0].ring: must be a whole number, 0 or more, not string \"two\"",
                "camera[0]: `name` is missing",
                "http.loud: unknown key `loud`; known are `timeout` or `port`",
                "http.port: must not be 0",
                "http.prot: unknown key `prot`; did you mean `port`?",
                "http.timeout: must be a number, not string \"long\"",
            ]
        );
    }

    #[test]
    fn a_removed_key_or_value_is_refused_with_what_became_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("small.toml");
        std::fs::write(&file, "mode = \"slow\"\n[http]\nport = 1\nbacklog = 5\n").unwrap();
        let Err(error) = load::<Small>(Some(&file)) else {
            panic!("it can be used");
        };
        let mut found: Vec<_> = error.findings.iter().map(ToString::to_string).collect();
        found.sort();
        assert_eq!(
            found,
            [
                "http.backlog: was removed: the system's own is used",
                "mode: was removed: there is one mode",
            ]
        );
    }

    #[test]
    fn a_variable_is_named_as_it_is_set() {
        assert_eq!(
            variable("http.cors_origins"),
            "environment variable ALBIREO_HTTP__CORS_ORIGINS"
        );
    }

    #[test]
    fn a_variable_with_one_underscore_too_few_is_told() {
        let names = [
            "ALBIREO_HTTP_LISTEN",
            "ALBIREO_HTTP__LISTEN",
            "ALBIREO_SHARED",
            "HTTP_PROXY",
            "ALBIREO_CONFIG",
        ];
        let found = misspelt_variables(
            names.into_iter().map(str::to_owned),
            &["HTTP", "NODE", "CLIP"],
        );
        assert_eq!(found.len(), 1);
        assert!(
            found[0].reason.contains("ALBIREO_HTTP__LISTEN"),
            "{found:?}"
        );
    }
}
