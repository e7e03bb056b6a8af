//! Reads a configuration from its file and the environment.

mod reasons;
#[cfg(test)]
mod tests;

use super::environment::{Environment, PREFIX};
use super::{ConfigError, Finding, unreadable};
use figment::Figment;
use figment::error::{Actual, Kind};
use figment::providers::{Format, Serialized, Toml};
use reasons::finding;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::path::Path;

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
    let file = file.unwrap_or(Path::new("built-in defaults")).display().to_string();
    match config {
        Some(config) if findings.is_empty() => Ok(config),
        _ => Err(ConfigError { file, findings }),
    }
}

/// Like [`load`], but returns what could be read, with defaults for the rest, together with all errors.
pub fn examine<C: Configuration>(file: Option<&Path>) -> (Option<C>, Vec<Finding>) {
    let Some(file) = file else {
        return examine_text("");
    };
    match std::fs::read_to_string(file) {
        Ok(text) => examine_text(&text),
        Err(error) => (
            None,
            vec![Finding::new(
                "",
                unreadable::reason(file, &error, C::SECTIONS),
            )],
        ),
    }
}

/// Like [`examine`], with the file's text.
pub fn examine_text<C: Configuration>(text: &str) -> (Option<C>, Vec<Finding>) {
    let mut variables = Vec::new();
    for (name, value) in std::env::vars_os() {
        // A name or a value that is no text cannot be one of ours.
        if let (Ok(name), Ok(value)) = (name.into_string(), value.into_string()) {
            variables.push((name, value));
        }
    }
    let home = std::env::home_dir();
    examine_with(text, &variables, home.as_deref())
}

/// Like [`examine_text`], with these environment variables and this home folder.
fn examine_with<C: Configuration>(
    text: &str,
    variables: &[(String, String)],
    home: Option<&Path>,
) -> (Option<C>, Vec<Finding>) {
    let mut findings = misspelt_variables(C::SECTIONS, variables);
    let environment = Environment::of(variables);
    let figment = Figment::from(Serialized::defaults(C::defaults()))
        .merge(Toml::string(text))
        .merge(&environment);
    let (config, malformed) = read::<C>(&figment, &environment, home);
    findings.extend(malformed);
    if let Some(config) = &config {
        let reported: Vec<_> = findings.iter().map(|finding| finding.key.clone()).collect();
        for finding in config.findings() {
            // A value left out because of its form has its default here, or shortens a list, and is already reported.
            if !reported.iter().any(|reported| is_or_holds(&finding.key, reported)) {
                findings.push(finding);
            }
        }
    }
    for finding in &mut findings {
        // An element of a list is from where the list is from.
        let (list, _) = finding.key.split_once('[').unwrap_or((&finding.key, ""));
        if let Some(metadata) = figment.find_metadata(list)
            && metadata.name.contains("environment")
        {
            let name = list.to_ascii_uppercase().replace('.', "__");
            let source = format!(" (from environment variable {PREFIX}{name})");
            finding.reason.push_str(&source);
        }
        finding.key = by_name(&figment, &finding.key);
    }
    (config, findings)
}

/// True if the value at `inner` is the one at `key`, or a part of it.
fn is_or_holds(key: &str, inner: &str) -> bool {
    match inner.strip_prefix(key) {
        Some(rest) => rest.is_empty() || rest.starts_with(['.', '[']),
        None => false,
    }
}

/// The errors that were reported, and where: others only follow from them.
#[derive(Default)]
struct Reported {
    findings: Vec<Finding>,
    left_out: Vec<Vec<String>>,
    /// The places to which the values of unknown keys were put.
    guessed: Vec<Vec<String>>,
}

impl Reported {
    fn add(&mut self, error: &Kind, path: &[String], removed: &str) {
        self.findings.push(finding(error, path, removed));
        self.left_out.push(path.to_vec());
    }

    /// True if the error would not be there without those before: a table lacks what was left out of it, and a value that
    /// was put to another key may have another type.
    fn explains(&self, error: &Kind, path: &[String]) -> bool {
        if path.is_empty() || matches!(error, Kind::UnknownField(..)) {
            return false;
        }
        let is_in = |inner: &Vec<String>| inner.len() > path.len() && inner.starts_with(path);
        self.left_out.iter().any(is_in) || self.guessed.iter().any(|guess| path.starts_with(guess))
    }
}

/// Reads the configuration. A variable of the environment that has another type than its key is read in another way. An
/// unknown key or a value of the wrong type is reported and left out, and the rest is read again, so all errors are found at
/// once. `None` if the rest cannot be read either.
fn read<C: Configuration>(
    figment: &Figment,
    environment: &Environment,
    home: Option<&Path>,
) -> (Option<C>, Vec<Finding>) {
    let mut reported = Reported::default();
    let mut values: Value = match figment.extract() {
        Ok(values) => values,
        Err(errors) => {
            for error in errors {
                reported.add(&error.kind, &error.path, C::REMOVED);
            }
            return (None, reported.findings);
        }
    };
    put_at_home(&mut values, home);
    let mut infinite = Vec::new();
    find_infinite(&values, &mut Vec::new(), &mut infinite);
    for path in infinite {
        let found = Actual::Other("inf or nan".to_owned());
        let error = Kind::InvalidValue(found, "a finite number".to_owned());
        reported.add(&error, &path, C::REMOVED);
        take_out(&mut values, &path);
    }
    loop {
        let errors = match Figment::from(Serialized::defaults(&values)).extract::<C>() {
            Ok(config) => return (Some(config), reported.findings),
            Err(errors) => errors,
        };
        for error in errors {
            let mut path = error.path.clone();
            if let Kind::UnknownField(name, _) = &error.kind
                && path.last() != Some(name)
            {
                path.push(name.clone());
            }
            if let Some(value) = values.pointer_mut(&pointer(&path))
                && let Some(another) = environment.another(&path, value, &error.kind)
            {
                *value = another;
                put_at_home(value, home);
                continue;
            }
            if !reported.explains(&error.kind, &path) {
                reported.add(&error.kind, &path, C::REMOVED);
            }
            let taken = take_out(&mut values, &path);
            if taken.is_none() || reported.findings.len() >= MOST_FINDINGS {
                return (None, reported.findings);
            }
            if let (Kind::UnknownField(name, known), Some(value)) = (&error.kind, taken) {
                // Read as what was meant, it is not missed in errors that follow from this one.
                if let Some(meant) = meant(name, known)
                    && let Some(guess) = put_beside(&mut values, &path, meant, value)
                {
                    reported.guessed.push(guess);
                }
            }
        }
    }
}

/// Replaces `~/` at the beginning of every text by the home folder, as a shell would. Secrets and labels are no paths.
fn put_at_home(values: &mut Value, home: Option<&Path>) {
    match values {
        Value::Object(members) => {
            for (name, value) in members {
                let is_no_path = name == "labels" || (name == "token" && value.is_string());
                if !is_no_path {
                    put_at_home(value, home);
                }
            }
        }
        Value::Array(values) => {
            for value in values {
                put_at_home(value, home);
            }
        }
        Value::String(text) => {
            let place = text.strip_prefix("sqlite:").unwrap_or(text);
            if let (Some(rest), Some(home)) = (place.strip_prefix("~/"), home) {
                let scheme = &text[..text.len() - place.len()];
                *text = format!("{scheme}{}", home.join(rest).display());
            }
        }
        _ => {}
    }
}

/// Removes the value at `path`, or the whole list if it is an element of one, so that the rest can be read and every
/// other element keeps its place; `None` if that is impossible.
fn take_out(values: &mut Value, path: &[String]) -> Option<Value> {
    let last = path.iter().rposition(|part| !is_index(part))?;
    match values.pointer_mut(&pointer(&path[..last])) {
        Some(Value::Object(table)) => table.remove(&path[last]),
        _ => None,
    }
}

/// Puts a value under another name into the table of `path`, unless that name is taken. Returns its new path.
fn put_beside(
    values: &mut Value,
    path: &[String],
    name: &str,
    value: Value,
) -> Option<Vec<String>> {
    let (_, table) = path.split_last()?;
    match values.pointer_mut(&pointer(table)) {
        Some(Value::Object(members)) if !members.contains_key(name) => {
            members.insert(name.to_owned(), value);
            Some([table, &[name.to_owned()]].concat())
        }
        _ => None,
    }
}

/// Finds the numbers that are not finite. JSON has none, so they are null here, and no other value is: read on, one would
/// pass for a key that is not set.
fn find_infinite(values: &Value, path: &mut Vec<String>, found: &mut Vec<Vec<String>>) {
    match values {
        Value::Null => found.push(path.clone()),
        Value::Object(members) => {
            for (name, value) in members {
                path.push(name.clone());
                find_infinite(value, path, found);
                path.pop();
            }
        }
        Value::Array(elements) => {
            for (index, value) in elements.iter().enumerate() {
                path.push(index.to_string());
                find_infinite(value, path, found);
                path.pop();
            }
        }
        _ => {}
    }
}

/// The known name that an unknown one is a typing error of.
pub(super) fn meant<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let mistakes = |known: &&str| strsim::osa_distance(name, known);
    let nearest = known.iter().copied().min_by_key(mistakes)?;
    if mistakes(&nearest) > 2 {
        return None;
    }
    Some(nearest)
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
    named_key(figment, key).unwrap_or_else(|| key.to_owned())
}

/// Such a key; `None` if it has no number, or nothing at that number has a name.
fn named_key(figment: &Figment, key: &str) -> Option<String> {
    let (list, rest) = key.split_once('[')?;
    let (index, rest) = rest.split_once(']')?;
    let values: Value = figment.extract_inner(list).ok()?;
    let name = values.pointer(&format!("/{index}/name"))?.as_str()?;
    if name.is_empty() {
        return None;
    }
    Some(format!("{list}.{name}{rest}"))
}

/// Reports variables that look like a key with one underscore instead of two: they would silently have no
/// effect.
fn misspelt_variables(sections: &[&str], variables: &[(String, String)]) -> Vec<Finding> {
    let mut misspelt = Vec::new();
    for (name, _) in variables {
        let own = name.strip_prefix(PREFIX).unwrap_or_default();
        if let Some((section, key)) = own.split_once('_')
            && sections.contains(&section)
            && !key.starts_with('_')
        {
            let reason = format!(
                "environment variable {name} names no key; between section and key belong two underscores: \
                 {PREFIX}{section}__{key}"
            );
            misspelt.push(Finding::new("", reason));
        }
    }
    misspelt
}
