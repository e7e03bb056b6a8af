//! Environment variables that override keys, each read by the type of its key: `4711` is a name for `node.name` and a number
//! for `http.port`. The type is known only where the configuration is read, so a value begins as text, and is read in another
//! way where its key has another type.

use figment::error::Kind;
use figment::value::{Dict, Map, Value};
use figment::{Error, Metadata, Profile, Provider};
use serde_json::Value as Json;

/// The prefix of environment variables. `ALBIREO_HTTP__LISTEN` overrides `listen` in `[http]`.
pub(super) const PREFIX: &str = "ALBIREO_";

/// The beginnings of values that are read as TOML first.
const TOML: [char; 3] = ['[', '{', '"'];

/// Serde's words about a value that has none of the forms that its key takes.
const UNTAGGED: &str = "did not match any variant";

/// A variable that overrides a key.
struct Variable {
    /// The key: `["http", "listen"]`.
    path: Vec<String>,
    text: String,
}

impl Variable {
    /// The first reading: text, unless it is written as a list, a table or a string of TOML.
    fn value(&self) -> Value {
        if !self.text.starts_with(TOML) {
            return Value::from(self.text.as_str());
        }
        // What is not TOML is read as text.
        match self.text.parse::<Value>() {
            Ok(value) => value,
            Err(never) => match never {},
        }
    }
}

/// The variables that override keys.
pub(super) struct Environment(Vec<Variable>);

impl Environment {
    /// Picks the variables that name a key, or the list of cameras.
    pub(super) fn of(variables: &[(String, String)]) -> Self {
        let mut named = Vec::new();
        for (name, text) in variables {
            let Some(own) = name.strip_prefix(PREFIX) else {
                continue;
            };
            let key = own.to_ascii_lowercase();
            if key.contains("__") || key == "camera" {
                named.push(Variable {
                    path: key.split("__").map(str::to_owned).collect(),
                    text: text.clone(),
                });
            }
        }
        Self(named)
    }

    /// Another reading of the `value` at `path`, which was the wrong one: a list, a number, or true or false, if the value is
    /// text from a variable, and the text of a variable if that was read as TOML. `None` if there is none.
    pub(super) fn another(&self, path: &[String], value: &Json, error: &Kind) -> Option<Json> {
        let variable = self.0.iter().find(|variable| path.starts_with(&variable.path))?;
        match (value, error) {
            (Json::String(text), Kind::InvalidType(_, wants)) if wants.contains("sequence") => {
                Some(text.split(',').map(str::trim).filter(|part| !part.is_empty()).collect())
            }
            (Json::String(text), Kind::InvalidType(..)) => scalar(text),
            (Json::String(text), Kind::Message(words)) if words.contains(UNTAGGED) => scalar(text),
            (Json::String(_), _) => None,
            (_, Kind::InvalidType(_, wants)) if wants.contains("string") => {
                let is_toml = variable.text.starts_with(TOML) && path.len() == variable.path.len();
                is_toml.then(|| variable.text.as_str().into())
            }
            _ => None,
        }
    }
}

/// A number, or true or false.
fn scalar(text: &str) -> Option<Json> {
    let text = text.trim();
    if let Ok(flag) = text.parse::<bool>() {
        return Some(flag.into());
    }
    if let Ok(number) = text.parse::<u64>() {
        return Some(number.into());
    }
    if let Ok(number) = text.parse::<i64>() {
        return Some(number.into());
    }
    // JSON has no infinite numbers; they stay text.
    let number = text.parse::<f64>().ok()?;
    serde_json::Number::from_f64(number).map(Json::Number)
}

impl Provider for Environment {
    fn metadata(&self) -> Metadata {
        Metadata::named("environment variable(s)")
    }

    fn data(&self) -> Result<Map<Profile, Dict>, Error> {
        let mut all = Dict::new();
        for variable in &self.0 {
            insert(&mut all, &variable.path, variable.value());
        }
        Ok(Profile::Default.collect(all))
    }
}

/// Sets the value at `path`, in tables that are created on the way.
fn insert(table: &mut Dict, path: &[String], value: Value) {
    match path {
        [] => {}
        [name] => {
            table.insert(name.clone(), value);
        }
        [name, rest @ ..] => {
            let inner = table.entry(name.clone()).or_insert_with(|| Value::from(Dict::new()));
            if !matches!(inner, Value::Dict(..)) {
                *inner = Value::from(Dict::new());
            }
            if let Value::Dict(_, inner) = inner {
                insert(inner, rest, value);
            }
        }
    }
}
