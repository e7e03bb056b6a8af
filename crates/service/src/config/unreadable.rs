//! Says why a configuration file cannot be read, where it was looked for, and which one may be meant.

use super::load::meant;
use figment::Figment;
use figment::providers::{Format, Toml};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};

/// The most files that are named where none is nearly the one that was asked for.
const MOST_NAMED: usize = 4;

/// The reason, with the absolute path that was tried. `sections` are those of such a file, in capitals.
pub(super) fn reason(file: &Path, error: &Error, sections: &[&str]) -> String {
    let tried = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let shown = tried.display();
    let is_of_place = matches!(
        error.kind(),
        ErrorKind::NotFound | ErrorKind::IsADirectory | ErrorKind::NotADirectory
    );
    if !is_of_place {
        return format!("{shown}: {error}");
    }
    let folder = if tried.is_dir() {
        tried.as_path()
    } else {
        tried.parent().unwrap_or(Path::new("/"))
    };
    if !folder.is_dir() {
        return format!("{shown}: there is no folder {}", folder.display());
    }
    let what = if tried.is_dir() {
        "this is a folder"
    } else {
        "there is no such file"
    };
    format!("{shown}: {what}{}", hint(file, folder, sections))
}

/// The file of `folder`, or of `config` in it, that may be meant; else those that are there.
fn hint(file: &Path, folder: &Path, sections: &[&str]) -> String {
    let wanted = file.file_name().unwrap_or_default().to_string_lossy();
    let mut found = files(folder, sections);
    found.extend(files(&folder.join("config"), sections));
    let names: Vec<String> = found.iter().map(|path| name(path)).collect();
    let known: Vec<&str> = names.iter().map(String::as_str).collect();
    if let Some(nearest) = meant(&wanted, &known)
        && let Some(path) = found.iter().find(|path| name(path) == nearest)
    {
        return format!("; did you mean `{}`?", path.display());
    }
    found.truncate(MOST_NAMED);
    match found.as_slice() {
        [] => "; config/node.toml of the project is one to begin with".to_owned(),
        [only] => format!("; did you mean `{}`?", only.display()),
        several => {
            let several: Vec<_> =
                several.iter().map(|path| format!("`{}`", path.display())).collect();
            format!("; did you mean one of {}?", several.join(", "))
        }
    }
}

/// The configuration files in a folder that have only such sections, in the order of their names.
fn files(folder: &Path, sections: &[&str]) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| has_only(path, sections))
        .collect();
    found.sort();
    found
}

/// True if a file is TOML and has such sections, and no other.
fn has_only(path: &Path, sections: &[&str]) -> bool {
    if path.extension().is_none_or(|extension| extension != "toml") {
        return false;
    }
    let read: Result<BTreeMap<String, Value>, _> = Figment::from(Toml::file_exact(path)).extract();
    let Ok(tables) = read else {
        return false;
    };
    // A list, such as that of the cameras, need not be a section.
    let is_known = |(name, value): (&String, &Value)| {
        value.is_array() || sections.contains(&name.to_ascii_uppercase().as_str())
    };
    !tables.is_empty() && tables.iter().all(is_known)
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(path: &Path) -> String {
        reason(path, &std::fs::read_to_string(path).unwrap_err(), &["NODE"])
    }

    #[test]
    fn the_path_that_was_tried_is_told_with_the_file_that_is_meant() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let inner = root.join("config");
        std::fs::create_dir(&inner).unwrap();
        let missing = root.join("noed.toml");
        let at = missing.display();
        let expected = format!(
            "{at}: there is no such file; config/node.toml of the project is one to begin with"
        );
        assert_eq!(said(&missing), expected);

        let node = inner.join("node.toml");
        let other = inner.join("other.toml");
        for (path, text) in [
            (&node, "[node]\nname = \"a\""),
            (&other, "[[camera]]\nname = \"a\""),
            (&root.join("node.txt"), "[node]"),
            (&root.join("nodes.toml"), "[package]"),
        ] {
            std::fs::write(path, text).unwrap();
        }
        let expected = format!(
            "{at}: there is no such file; did you mean `{}`?",
            node.display()
        );
        assert_eq!(said(&missing), expected);
        let both = format!(
            "did you mean one of `{}`, `{}`?",
            node.display(),
            other.display()
        );
        assert!(said(&root.join("fleet.toml")).ends_with(&both));
        let expected = format!("{}: this is a folder; {both}", inner.display());
        assert_eq!(said(&inner), expected);
        let nowhere = root.join("confg/node.toml");
        let expected = format!(
            "{}: there is no folder {}",
            nowhere.display(),
            root.join("confg").display()
        );
        assert_eq!(said(&nowhere), expected);
    }
}
