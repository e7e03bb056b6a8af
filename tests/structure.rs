//! The structure of the workspace: the crates match ARCHITECTURE.md, the method has few dependencies, every dependency is used,
//! and every ignored test names needs that `run.sh` knows.

use crate::support::{project, run_command, text};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// All direct and indirect dependencies of the method. Each is part of every program that embeds the method: an API,
/// command-line, runtime, network or file crate does not belong here.
const METHOD: &str = "albireo-core approx bytemuck matrixmultiply nalgebra num-complex num-integer num-rational num-traits \
    rawpointer safe_arch simba typenum wide itoa memchr serde serde_core serde_derive serde_json strsim zmij thiserror \
    thiserror-impl proc-macro2 quote syn unicode-ident";

/// Dependencies that only enable features of others, see the program's feature `development`.
const FOR_THEIR_FEATURES: [&str; 2] = ["regex-automata", "regex-syntax"];

fn cargo(arguments: &[&str]) -> String {
    run_command(Command::new(env!("CARGO")).args(arguments)).succeeds()
}

fn metadata(more: &[&str]) -> Vec<Value> {
    let text = cargo(&[&["metadata", "--offline", "--format-version=1"], more].concat());
    let mut metadata: Value = serde_json::from_str(&text).unwrap();
    serde_json::from_value(metadata["packages"].take()).unwrap()
}

fn word(value: &Value) -> &str {
    value.as_str().unwrap()
}

/// A dependency in a manifest.
struct Dependency {
    /// The name in the registry or the workspace.
    package: String,
    /// The name in the sources.
    name: String,
    only_for_tests: bool,
}

/// A crate of the workspace.
struct Member {
    /// The name without `albireo-`; the program is `the program`.
    name: String,
    folder: PathBuf,
    dependencies: Vec<Dependency>,
}

impl Member {
    fn read(package: &Value) -> Self {
        let dependencies = package["dependencies"].as_array().unwrap().iter();
        let dependencies = dependencies.map(|dependency| {
            let name = dependency["rename"].as_str();
            let name = name.unwrap_or(word(&dependency["name"]));
            Dependency {
                package: word(&dependency["name"]).to_owned(),
                name: name.replace('-', "_"),
                only_for_tests: dependency["kind"] == "dev",
            }
        });
        let manifest = Path::new(word(&package["manifest_path"]));
        Self {
            name: short(word(&package["name"])),
            folder: manifest.parent().unwrap().to_owned(),
            dependencies: dependencies.collect(),
        }
    }

    /// The crates of the workspace that it uses outside tests.
    fn uses(&self) -> BTreeSet<String> {
        (self.dependencies.iter())
            .filter(|used| !used.only_for_tests && used.package.starts_with("albireo"))
            .map(|used| short(&used.package))
            .collect()
    }

    /// The texts of its sources in these folders.
    fn sources(&self, folders: &[&str]) -> Vec<String> {
        let mut files = Vec::new();
        for folder in folders {
            sources(&self.folder.join(folder), &mut files);
        }
        let texts = files.iter().map(std::fs::read_to_string);
        texts.map(Result::unwrap).collect()
    }
}

fn short(package: &str) -> String {
    let name = package.strip_prefix("albireo-");
    name.unwrap_or("the program").to_owned()
}

fn members() -> Vec<Member> {
    metadata(&["--no-deps"]).iter().map(Member::read).collect()
}

/// The first table of the page: each crate with the crates it uses.
fn table(page: &str) -> BTreeMap<String, BTreeSet<String>> {
    page.lines()
        .skip_while(|line| !line.starts_with("| crate |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(|line| {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let uses = cells[cells.len() - 2].split('`').skip(1).step_by(2);
            let name = cells[1].trim_matches(['`', '*']).to_owned();
            (name, uses.map(str::to_owned).collect())
        })
        .collect()
}

#[test]
fn the_architecture_page_has_the_crates_and_dependencies_of_cargo() {
    let there = members()
        .into_iter()
        .map(|member| (member.name.clone(), member.uses()));
    let page = table(&text("ARCHITECTURE.md"));
    assert_eq!(page, there.collect(), "left the page, right cargo");
}

#[test]
fn the_method_depends_on_numbers_and_data_alone() {
    let tree = "tree --package=albireo-core --edges=normal --prefix=none --offline";
    let method: BTreeSet<&str> = METHOD.split_whitespace().collect();
    let tree = cargo(&tree.split(' ').collect::<Vec<_>>());
    let used = tree.lines().filter_map(|line| line.split(' ').next());
    let used: BTreeSet<&str> = used.collect();
    let more: Vec<_> = used.difference(&method).collect();
    assert!(more.is_empty(), "albireo-core depends on {more:?}");
    assert!(used.len() > 4, "{used:?}");
}

/// clippy (`make lint`) rejects features newer than that version.
#[test]
fn the_method_requires_no_newer_rust_than_its_dependencies() {
    let version = cargo(&["-vV"]);
    let host = version.lines().find_map(|line| line.strip_prefix("host: "));
    let packages = metadata(&[&format!("--filter-platform={}", host.unwrap())]);
    let asked_by = |name: &str| -> Option<Vec<u32>> {
        let found = packages.iter().filter(|package| package["name"] == name);
        let versions = found.filter_map(|package| package["rust_version"].as_str());
        let parts = |version: &str| {
            let parts = version.split('.').map(|part| part.parse().unwrap());
            parts.take(2).collect()
        };
        versions.map(parts).max()
    };
    let needed = METHOD.split_whitespace().skip(1).filter_map(asked_by).max();
    assert_eq!(asked_by("albireo-core"), needed);
}

/// Collects the Rust sources under `folder`, without nested packages.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.join("Cargo.toml").exists() {
            sources(&path, found);
        } else if path.extension().is_some_and(|kind| kind == "rs") {
            found.push(path);
        }
    }
}

/// Returns whether code in `text` has `name::`.
fn says(text: &str, name: &str) -> bool {
    let path = format!("{name}::");
    let code = text
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"));
    code.into_iter().any(|line| {
        line.match_indices(&path).any(|(at, _)| {
            let before = line[..at].chars().next_back();
            !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':')
        })
    })
}

#[test]
fn every_dependency_is_used_and_libraries_have_typed_errors() {
    let mut wrong = Vec::new();
    for member in members() {
        let code = member.sources(&["src", "fuzz_targets"]);
        let tests = member.sources(&["src", "tests", "benches"]);
        assert!(!code.is_empty(), "{}: no sources", member.name);
        for used in &member.dependencies {
            // A second entry, for tests, only adds features to the first.
            let is_again =
                |other: &Dependency| !other.only_for_tests && other.package == used.package;
            let again = used.only_for_tests && member.dependencies.iter().any(is_again);
            let place = if used.only_for_tests { &tests } else { &code };
            let is_used = place.iter().any(|text| says(text, &used.name));
            let untyped = used.package == "anyhow" && member.name != "the program";
            if untyped || !(is_used || again || FOR_THEIR_FEATURES.contains(&&*used.package)) {
                wrong.push(format!("{}: {}", member.name, used.package));
            }
        }
    }
    let none: [String; 0] = [];
    assert_eq!(wrong, none, "unused, or anyhow in a library");
}

#[test]
fn every_ignored_test_names_needs_that_run_sh_knows() {
    let script = text("tests/run.sh");
    let mut seen = 0;
    let members = members();
    let sources = members
        .iter()
        .flat_map(|member| member.sources(&["src", "tests"]));
    for text in sources {
        let marks = concat!("#[", "ignore");
        for line in text
            .lines()
            .filter(|line| line.trim_start().starts_with(marks))
        {
            let needs = line.split_once("\"needs ");
            let (_, needs) = needs.unwrap_or_else(|| panic!("{line}"));
            for need in needs.trim_end_matches("\"]").split(" and ") {
                assert!(script.contains(&format!("\nneed \"{need}\" ")), "{line}");
                seen += 1;
            }
        }
    }
    assert!(seen > 0 && project("tests/run.sh").is_file());
}
