//! Reads a configuration from its file and the environment.

use super::{ConfigError, NodeConfig, Problem};
use figment::providers::{Env, Format, Toml};
use figment::{Figment, Source};
use std::path::Path;

/// What environment variables begin with. `ALBIREO_HTTP__LISTEN` overrides `listen` in `[http]`.
const PREFIX: &str = "ALBIREO_";

impl NodeConfig {
    /// Reads `file` (the built-in defaults without one), lets environment variables override it, and
    /// checks everything.
    ///
    /// # Errors
    /// [`ConfigError`] with all unknown keys and impossible values found.
    pub fn load(file: Option<&Path>) -> Result<Self, ConfigError> {
        let name = file.map_or_else(
            || "built-in defaults".to_owned(),
            |file| file.display().to_string(),
        );
        let fail = |problems| ConfigError {
            file: name.clone(),
            problems,
        };
        let mut figment = Figment::new();
        if let Some(file) = file {
            // Figment takes a missing file for an empty one.
            if let Err(error) = std::fs::metadata(file) {
                return Err(fail(vec![Problem::new("", error.to_string())]));
            }
            figment = figment.merge(Toml::file_exact(file));
        }
        let misspelt =
            misspelt_variables(std::env::vars_os().filter_map(|(k, _)| k.into_string().ok()));
        if !misspelt.is_empty() {
            return Err(fail(misspelt));
        }
        let config: Self = figment
            .merge(
                Env::prefixed(PREFIX)
                    .filter(|key| key.as_str().contains("__") || key == "camera")
                    .split("__"),
            )
            .extract()
            .map_err(|error| fail(error.into_iter().map(problem).collect()))?;
        let problems = config.problems();
        if problems.is_empty() {
            Ok(config)
        } else {
            Err(fail(problems))
        }
    }
}

/// Variables that look like a key with one underscore where two belong: left alone they would silently
/// do nothing.
pub(super) fn misspelt_variables(names: impl Iterator<Item = String>) -> Vec<Problem> {
    const SECTIONS: [&str; 10] = [
        "NODE", "ZENOH", "HTTP", "DETECTOR", "SCREEN", "POLICY", "CLIP", "FRAME", "POWER", "LOG",
    ];
    names
        .filter_map(|name| {
            let rest = name.strip_prefix(PREFIX)?;
            let (section, key) = rest.split_once('_')?;
            (SECTIONS.contains(&section) && !key.starts_with('_')).then(|| {
                Problem::new(
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

fn problem(error: figment::Error) -> Problem {
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
    Problem {
        key,
        reason: reason(&error.kind),
        source,
    }
}

fn reason(kind: &figment::error::Kind) -> String {
    use figment::error::{Kind, OneOf};
    match kind {
        Kind::UnknownField(name, known) => {
            format!("unknown key `{name}`; known are {}", OneOf(known))
        }
        Kind::UnknownVariant(value, known) => format!("`{value}` is not one of {}", OneOf(known)),
        Kind::MissingField(name) => format!("`{name}` is missing"),
        Kind::InvalidType(found, expected) => format!("must be {expected}, not {found}"),
        Kind::InvalidValue(found, expected) => format!("must be {expected}, not {found}"),
        other => other.to_string(),
    }
}
