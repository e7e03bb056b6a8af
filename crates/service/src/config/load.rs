//! Reads a configuration from its file and the environment.

use super::environment::{Environment, PREFIX};
use super::{ConfigError, Finding, unreadable};
use figment::Figment;
use figment::error::{Actual, Kind, OneOf};
use figment::providers::{Format, Serialized, Toml};
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
        let metadata = figment.find_metadata(list);
        if metadata.is_some_and(|found| found.name.contains("environment")) {
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
    let rest = inner.strip_prefix(key);
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

/// Reads the configuration. A variable of the environment that has another type than its key is read in another way. An
/// unknown key or a value of the wrong type is reported and left out, and the rest is read again, so all errors are found at
/// once. `None` if the rest cannot be read either.
fn read<C: Configuration>(
    figment: &Figment,
    environment: &Environment,
    home: Option<&Path>,
) -> (Option<C>, Vec<Finding>) {
    let mut findings: Vec<Finding> = Vec::new();
    let mut values: Value = match figment.extract() {
        Ok(values) => values,
        Err(errors) => {
            for error in errors {
                findings.push(finding(&error.kind, &error.path, C::REMOVED));
            }
            return (None, findings);
        }
    };
    put_at_home(&mut values, home);
    loop {
        let errors = match Figment::from(Serialized::defaults(&values)).extract::<C>() {
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
            if let Some(value) = values.pointer_mut(&pointer(&path))
                && let Some(another) = environment.another(&path, value, &error.kind)
            {
                *value = another;
                put_at_home(value, home);
                continue;
            }
            findings.push(finding(&error.kind, &path, C::REMOVED));
            let taken = take_out(&mut values, &path);
            if taken.is_none() || findings.len() >= MOST_FINDINGS {
                return (None, findings);
            }
            if let (Kind::UnknownField(name, known), Some(value)) = (&error.kind, taken) {
                // Read as what was meant, it is not missed in errors that follow from this one.
                if let Some(meant) = meant(name, known) {
                    put_beside(&mut values, &path, meant, value);
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

/// Puts a value under another name into the table of `path`, unless that name is taken.
fn put_beside(values: &mut Value, path: &[String], name: &str, value: Value) {
    let Some((_, table)) = path.split_last() else {
        return;
    };
    if let Some(Value::Object(table)) = values.pointer_mut(&pointer(table)) {
        table.entry(name).or_insert(value);
    }
}

/// The known name that an unknown one is a typing error of.
pub(super) fn meant<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let mistakes = |known: &&str| strsim::osa_distance(name, known);
    let nearest = known.iter().copied().min_by_key(mistakes)?;
    (mistakes(&nearest) <= 2).then_some(nearest)
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

/// The error about the value at `path`. For removed keys and values it names the replacement, whichever camera it is:
/// `camera[1].ring` is `camera.ring`.
fn finding(error: &Kind, path: &[String], removed: &str) -> Finding {
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

/// What is wrong, in words.
fn reason(kind: &Kind) -> String {
    match kind {
        Kind::UnknownField(name, known) => match meant(name, known) {
            Some(meant) => format!("unknown key `{name}`; did you mean `{meant}`?"),
            None => format!("unknown key `{name}`; known are {}", OneOf(known)),
        },
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
            let wrong = cameras
                .filter(|(_, camera)| matches!(&*camera.name, "" | "a b"))
                .map(|(index, _)| format!("camera[{index}].name"))
                .map(|key| Finding::new(key, "no such name"));
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
            "http.prot: unknown key `prot`; did you mean `port`?",
            "http.timeout: must be a number, not string \"long\"",
        ];
        assert_eq!(reported, expected);
    }

    #[test]
    fn a_typing_error_in_a_key_is_one_error() {
        for (text, error) in [
            (
                "[http]\nport = 1\n[[camera]]\nnmae = \"front\"\n",
                "camera[0].nmae: unknown key `nmae`; did you mean `name`?",
            ),
            (
                "[htp]\nport = 1\n",
                "htp: unknown key `htp`; did you mean `http`?",
            ),
            (
                "[http]\nprt = 2\nport = 1\n",
                "http.prt: unknown key `prt`; did you mean `port`?",
            ),
        ] {
            let (_, findings) = examine_text::<Small>(text);
            let reported: Vec<_> = findings.iter().map(ToString::to_string).collect();
            assert_eq!(reported, [error], "{text}");
        }
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

    #[derive(serde::Deserialize, Debug, PartialEq)]
    #[serde(rename_all = "lowercase")]
    enum Mode {
        Peer,
        Client,
    }

    #[derive(serde::Deserialize, Debug, Default, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    struct Typed {
        node: TypedNode,
    }

    #[derive(serde::Deserialize, Debug, Default, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    struct TypedNode {
        name: String,
        u: Option<f64>,
        port: u16,
        on: bool,
        mode: Option<Mode>,
        connect: Vec<String>,
        sizes: Vec<u32>,
        labels: std::collections::BTreeMap<String, String>,
        folder: Option<std::path::PathBuf>,
    }

    impl Configuration for Typed {
        const SECTIONS: &'static [&'static str] = &["NODE"];

        fn findings(&self) -> Vec<Finding> {
            Vec::new()
        }
    }

    /// What is read from a file with these variables, which have the names of keys under `[node]`.
    fn typed(text: &str, variables: &[(&str, &str)]) -> (TypedNode, Vec<String>) {
        let variables = variables.iter().map(|(name, text)| {
            let name = format!("{PREFIX}NODE__{}", name.to_ascii_uppercase());
            (name, (*text).to_owned())
        });
        let variables: Vec<_> = variables.collect();
        let home = Some(Path::new("/home/ann"));
        let (config, findings) = examine_with::<Typed>(text, &variables, home);
        let findings = findings.iter().map(ToString::to_string).collect();
        (config.unwrap_or_default().node, findings)
    }

    #[test]
    fn a_variable_is_read_by_the_type_of_its_key() {
        let nothing = TypedNode::default;
        let named = |name: &str| TypedNode {
            name: name.to_owned(),
            ..nothing()
        };
        let connect = |list: &[&str]| TypedNode {
            connect: list.iter().map(|one| (*one).to_owned()).collect(),
            ..nothing()
        };
        let u = |u| TypedNode {
            u: Some(u),
            ..nothing()
        };
        let sizes = |sizes: &[u32]| TypedNode {
            sizes: sizes.to_vec(),
            ..nothing()
        };
        let port = TypedNode {
            port: 80,
            ..nothing()
        };
        let on = TypedNode {
            on: true,
            ..nothing()
        };
        let mode = TypedNode {
            mode: Some(Mode::Client),
            ..nothing()
        };
        for (key, text, read) in [
            ("name", "4711", named("4711")),
            ("name", "0042", named("0042")),
            ("name", "12.5", named("12.5")),
            ("name", "5e-4", named("5e-4")),
            ("name", "true", named("true")),
            ("name", "[a]", named("[a]")),
            ("name", "\"4711\"", named("4711")),
            ("name", "", named("")),
            ("u", "5e-4", u(5e-4)),
            ("u", "5E-4", u(5e-4)),
            ("u", "0.0005", u(5e-4)),
            ("u", " 3 ", u(3.0)),
            ("port", "80", port),
            ("on", "true", on),
            ("mode", "client", mode),
            ("connect", "tcp/a:1", connect(&["tcp/a:1"])),
            (
                "connect",
                "tcp/a:1, tcp/b:2",
                connect(&["tcp/a:1", "tcp/b:2"]),
            ),
            ("connect", "[\"tcp/a:1\"]", connect(&["tcp/a:1"])),
            ("connect", "4711,5e-4", connect(&["4711", "5e-4"])),
            ("connect", "", connect(&[])),
            ("sizes", "320", sizes(&[320])),
            ("sizes", "320,640", sizes(&[320, 640])),
            ("sizes", "[320, 640]", sizes(&[320, 640])),
        ] {
            assert_eq!(
                typed("", &[(key, text)]),
                (read, Vec::new()),
                "{key}={text}"
            );
        }
        let labels = [("labels__region", "7"), ("labels__line", "north")];
        let (node, findings) = typed("[node.labels]\nline = \"south\"\ndepot = \"1\"\n", &labels);
        let expected = [("depot", "1"), ("line", "north"), ("region", "7")];
        let labels = node.labels.iter().map(|(name, value)| (name.as_str(), value.as_str()));
        assert_eq!(
            (labels.collect::<Vec<_>>(), findings),
            (expected.to_vec(), Vec::new())
        );
    }

    #[test]
    fn a_variable_of_another_type_is_reported_with_its_name() {
        let said = |key: &str, text: &str| typed("", &[(key, text)]).1.join("; ");
        let from = |key: &str| format!(" (from environment variable ALBIREO_NODE__{key})");
        for (key, text, error) in [
            ("u", "low", "node.u: must be a number, not string \"low\""),
            (
                "port",
                "-1",
                "node.port: must be a whole number, 0 or more, not signed int `-1`",
            ),
            (
                "mode",
                "4711",
                "node.mode: `4711` is not `peer` or `client`",
            ),
            (
                "sizes",
                "320,b",
                "node.sizes[1]: must be a whole number, 0 or more, not string \"b\"",
            ),
        ] {
            let shown = key.to_uppercase();
            let reported = said(key, text);
            assert!(reported.starts_with(error), "{reported}");
            assert!(reported.contains(&from(&shown)), "{reported}");
        }
    }

    #[test]
    fn a_tilde_is_the_home_folder_in_a_file_and_in_a_variable() {
        let state = Some(Path::new("/home/ann/state"));
        let (node, _) = typed("[node]\nfolder = \"~/state\"\n", &[]);
        assert_eq!(node.folder.as_deref(), state);
        let (node, _) = typed("", &[("folder", "~/state"), ("connect", "~/a,~/b")]);
        assert_eq!(node.folder.as_deref(), state);
        assert_eq!(node.connect, ["/home/ann/a", "/home/ann/b"]);
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
