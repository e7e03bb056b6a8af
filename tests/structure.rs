//! The structure of the workspace: the crates match ARCHITECTURE.md, the method has few dependencies, every dependency is
//! used, and every ignored test names needs that `run.sh` knows.

use crate::support::{run_command, text};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

/// All direct and indirect dependencies of the method, each a part of every program that embeds it.
const METHOD: &str = "albireo-core approx bytemuck matrixmultiply nalgebra num-complex num-integer num-rational num-traits \
    rawpointer safe_arch simba typenum wide itoa memchr serde serde_core serde_derive serde_json strsim zmij thiserror \
    thiserror-impl proc-macro2 quote syn unicode-ident";

/// Dependencies that only enable features of others, see the program's feature `development`.
const FOR_THEIR_FEATURES: [&str; 2] = ["regex_automata", "regex_syntax"];

fn cargo(arguments: &str) -> String {
    run_command(Command::new(env!("CARGO")).args(arguments.split(' '))).succeeds()
}

fn members() -> Vec<Value> {
    let text = cargo("metadata --offline --format-version=1 --no-deps");
    let mut metadata: Value = serde_json::from_str(&text).unwrap();
    serde_json::from_value(metadata["packages"].take()).unwrap()
}

fn word(value: &Value) -> &str {
    value.as_str().unwrap()
}

/// The name without `albireo-`; the program is `the program`.
fn short(package: &Value) -> String {
    let name = word(&package["name"]).strip_prefix("albireo-");
    name.unwrap_or("the program").to_owned()
}

fn dependencies(package: &Value) -> &Vec<Value> {
    package["dependencies"].as_array().unwrap()
}

fn sources(package: &Value, folders: &[&str]) -> Vec<String> {
    let manifest = Path::new(word(&package["manifest_path"]));
    let folders = folders.iter().map(|name| manifest.with_file_name(name));
    folders.flat_map(|folder| sources_under(&folder)).collect()
}

/// The Rust sources under `folder`, without nested packages.
fn sources_under(folder: &Path) -> Vec<String> {
    let mut texts = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.join("Cargo.toml").exists() {
            texts.extend(sources_under(&path));
        } else if path.extension().is_some_and(|kind| kind == "rs") {
            texts.push(std::fs::read_to_string(path).unwrap());
        }
    }
    texts
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
            let name = cells[1].trim_matches('`').to_owned();
            (name, uses.map(str::to_owned).collect())
        })
        .collect()
}

#[test]
fn the_architecture_page_has_the_crates_and_dependencies_of_cargo() {
    let there = members().into_iter().map(|package| {
        let used = dependencies(&package).iter();
        let used = used.filter(|used| used["kind"] != "dev");
        let ours = used.filter(|used| word(&used["name"]).starts_with("albireo"));
        let ours: BTreeSet<String> = ours.map(short).collect();
        (short(&package), ours)
    });
    let page = table(&text("ARCHITECTURE.md"));
    assert_eq!(page, there.collect(), "left the page, right cargo");
}

#[test]
fn the_method_depends_on_numbers_and_data_alone() {
    let tree = cargo("tree --package=albireo-core --edges=normal --prefix=none --offline");
    let method: BTreeSet<&str> = METHOD.split(' ').collect();
    let used = tree.lines().filter_map(|line| line.split(' ').next());
    let used: BTreeSet<&str> = used.collect();
    let more: Vec<_> = used.difference(&method).collect();
    assert!(more.is_empty(), "albireo-core depends on {more:?}");
    assert!(used.len() > 4, "{used:?}");
}

/// The names with which paths in the code begin: crates, modules and types.
fn roots(texts: &[String]) -> BTreeSet<&str> {
    let lines = texts.iter().flat_map(|text| text.lines());
    let code = lines.filter(|line| !line.trim_start().starts_with("//"));
    let is_outside = |c: char| !(c.is_alphanumeric() || c == '_' || c == ':');
    let paths = code.flat_map(|line| line.split(is_outside));
    let roots = paths.filter_map(|path| path.split_once("::"));
    roots.map(|(root, _)| root).collect()
}

#[test]
fn every_dependency_is_used_and_libraries_have_typed_errors() {
    let mut wrong = Vec::new();
    for package in members() {
        let code = sources(&package, &["src", "fuzz_targets"]);
        let tests = sources(&package, &["src", "tests", "benches"]);
        let (code, tests) = (roots(&code), roots(&tests));
        assert!(!code.is_empty(), "{}: no sources", short(&package));
        for used in dependencies(&package) {
            let name = used["rename"].as_str().unwrap_or(word(&used["name"]));
            let name = name.replace('-', "_");
            let names = if used["kind"] == "dev" { &tests } else { &code };
            let untyped = name == "anyhow" && short(&package) != "the program";
            if untyped || !(names.contains(&*name) || FOR_THEIR_FEATURES.contains(&&*name)) {
                wrong.push(format!("{}: {name}", short(&package)));
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
    for package in members() {
        let texts = sources(&package, &["src", "tests"]);
        let lines = texts.iter().flat_map(|text| text.lines());
        for line in lines.filter(|line| line.trim_start().starts_with("#[ignore")) {
            let needs = line.split_once("\"needs ");
            let (_, needs) = needs.unwrap_or_else(|| panic!("{line}"));
            for need in needs.trim_end_matches("\"]").split(" and ") {
                assert!(script.contains(&format!("\nneed \"{need}\" ")), "{line}");
                seen += 1;
            }
        }
    }
    assert!(seen > 0);
}
