//! Reads a configuration from its file and the environment.

use super::{ConfigError, Finding};
use figment::providers::{Env, Format, Toml};
use figment::{Figment, Source};
use serde::de::DeserializeOwned;
use std::path::Path;

/// What environment variables begin with. `ALBIREO_HTTP__LISTEN` overrides `listen` in `[http]`.
const PREFIX: &str = "ALBIREO_";

/// A configuration that [`load`] can read: all settings of one service.
pub trait Configuration: DeserializeOwned {
    /// Its sections in capitals, as they stand in the names of environment variables.
    const SECTIONS: &'static [&'static str];

    /// Everything that is wrong with the values; empty when they can be used.
    fn findings(&self) -> Vec<Finding>;
}

/// Reads `file` (the built-in defaults without one), lets environment variables override it, and checks
/// everything.
///
/// # Errors
/// [`ConfigError`] with all unknown keys and impossible values found.
pub fn load<C: Configuration>(file: Option<&Path>) -> Result<C, ConfigError> {
    let name = file.map_or_else(
        || "built-in defaults".to_owned(),
        |file| file.display().to_string(),
    );
    let fail = |findings| ConfigError {
        file: name.clone(),
        findings,
    };
    let mut figment = Figment::new();
    if let Some(file) = file {
        // Figment takes a missing file for an empty one.
        if let Err(error) = std::fs::metadata(file) {
            return Err(fail(vec![Finding::new("", error.to_string())]));
        }
        figment = figment.merge(Toml::file_exact(file));
    }
    let variables = std::env::vars_os().filter_map(|(k, _)| k.into_string().ok());
    let misspelt = misspelt_variables(variables, C::SECTIONS);
    if !misspelt.is_empty() {
        return Err(fail(misspelt));
    }
    let figment = figment.merge(
        Env::prefixed(PREFIX)
            .filter(|key| key.as_str().contains("__") || key == "camera")
            .split("__"),
    );
    let config: C = figment
        .extract()
        .map_err(|error| fail(error.into_iter().map(finding).collect()))?;
    let mut findings = config.findings();
    if findings.is_empty() {
        return Ok(config);
    }
    for finding in &mut findings {
        if finding.source.is_none() {
            finding.source = source(&figment, &finding.key);
        }
    }
    Err(fail(findings))
}

/// Where the value of `key` comes from, when it is not the file.
fn source(figment: &Figment, key: &str) -> Option<String> {
    let path = key.replace('[', ".").replace(']', "");
    let metadata = figment.find_metadata(&path)?;
    let from_file = matches!(metadata.source, Some(Source::File(_)));
    (!from_file).then(|| metadata.name.to_string())
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

fn finding(error: figment::Error) -> Finding {
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
    let source = error.metadata.as_ref().and_then(|metadata| {
        let from_file = matches!(metadata.source, Some(Source::File(_)));
        (!from_file).then(|| metadata.name.to_string())
    });
    Finding {
        key,
        reason: reason(&error.kind),
        source,
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

fn reason(kind: &figment::error::Kind) -> String {
    use figment::error::{Kind, OneOf};
    match kind {
        Kind::UnknownField(name, known) => {
            format!("unknown key `{name}`; known are {}", OneOf(known))
        }
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
