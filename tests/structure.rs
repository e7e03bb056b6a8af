//! The structure of the workspace: the crates match ARCHITECTURE.md, the method has few dependencies, every dependency is
//! used, and every ignored test names needs that `run.sh` knows.

use crate::support::{run_command, text};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

/// All direct and indirect dependencies of the method. Who embeds it builds and audits each of them, so nothing belongs here that
/// only describes messages or serves HTTP: such a crate has its place in `wire` or `service`.
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
    word(&package["name"])
        .strip_prefix("albireo-")
        .unwrap_or("the program")
        .to_owned()
}

fn dependencies(package: &Value) -> &Vec<Value> {
    package["dependencies"].as_array().unwrap()
}

fn sources(package: &Value, folders: &[&str]) -> Vec<String> {
    let manifest = Path::new(word(&package["manifest_path"]));
    folders
        .iter()
        .map(|name| manifest.with_file_name(name))
        .flat_map(|folder| sources_under(&folder))
        .collect()
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

/// A row of a table: a crate or a room, and those it uses.
type Row = (String, BTreeSet<String>);

/// The rows of the first table on the page whose head begins so.
fn table(page: &str, head: &str) -> Vec<Row> {
    page.lines()
        .skip_while(|line| !line.starts_with(head))
        // Below the head is its rule.
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(row)
        .collect()
}

/// The name in the first column, and the names in the last.
fn row(line: &str) -> Row {
    let cells: Vec<&str> = line.split('|').map(str::trim).collect();
    let name = cells[1].trim_matches('`').to_owned();
    // Every second part is inside of backquotes.
    let uses = cells[cells.len() - 2].split('`').skip(1).step_by(2);
    (name, uses.map(str::to_owned).collect())
}

#[test]
fn the_architecture_page_has_the_crates_and_dependencies_of_cargo() {
    let there = members().into_iter().map(|package| {
        let used = dependencies(&package).iter().filter(|used| used["kind"] != "dev");
        let ours: BTreeSet<String> = used
            .filter(|used| word(&used["name"]).starts_with("albireo"))
            .map(short)
            .collect();
        (short(&package), ours)
    });
    let page: BTreeMap<_, _> = table(&text("ARCHITECTURE.md"), "| crate |").into_iter().collect();
    assert_eq!(page, there.collect(), "left the page, right cargo");
}

#[test]
fn the_method_depends_on_numbers_and_data_alone() {
    let tree = cargo("tree --package=albireo-core --edges=normal --prefix=none --offline");
    let method: BTreeSet<&str> = METHOD.split(' ').collect();
    let used: BTreeSet<&str> = tree.lines().filter_map(|line| line.split(' ').next()).collect();
    let more: Vec<_> = used.difference(&method).collect();
    assert!(more.is_empty(), "albireo-core depends on {more:?}");
    assert!(used.len() > 4, "{used:?}");
}

/// The names with which paths in the code begin: crates, modules and types.
fn roots(texts: &[String]) -> BTreeSet<&str> {
    let is_outside = |c: char| !(c.is_alphanumeric() || c == '_' || c == ':');
    texts
        .iter()
        .flat_map(|text| text.lines())
        .filter(|line| !line.trim_start().starts_with("//"))
        .flat_map(|line| line.split(is_outside))
        .filter_map(|path| path.split_once("::"))
        .map(|(root, _)| root)
        .collect()
}

#[test]
fn every_dependency_is_used_and_libraries_have_typed_errors() {
    let mut wrong = Vec::new();
    for package in members() {
        let code = sources(&package, &["src", "fuzz_targets"]);
        let tests = sources(&package, &["src", "tests", "benches"]);
        let code = roots(&code);
        let tests = roots(&tests);
        assert!(!code.is_empty(), "{}: no sources", short(&package));
        for used in dependencies(&package) {
            let name = used["rename"].as_str().unwrap_or(word(&used["name"])).replace('-', "_");
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

/// The tables of floors on the page: for each crate its rooms, from the ground up.
fn floors(page: &str) -> Vec<(String, Vec<Row>)> {
    let mut floors = Vec::new();
    for section in page.split("\n### Floors of `").skip(1) {
        let (name, rest) = section.split_once('`').unwrap();
        floors.push((name.to_owned(), table(rest, "| room |")));
    }
    floors
}

/// The product code of a crate, by room: a module of the crate's root with the folder of its name.
fn rooms(source: &Path) -> BTreeMap<String, String> {
    let mut rooms = BTreeMap::<String, String>::new();
    for entry in std::fs::read_dir(source).unwrap() {
        let path = entry.unwrap().path();
        let room = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if room != "lib" && room != "main" {
            product_code(&path, rooms.entry(room).or_default());
        }
    }
    rooms
}

/// Adds the code of a file, or of the files in a folder, without tests and comments.
fn product_code(path: &Path, code: &mut String) {
    if path.is_dir() {
        if !path.ends_with("tests") {
            let entries = std::fs::read_dir(path).unwrap();
            for entry in entries {
                product_code(&entry.unwrap().path(), code);
            }
        }
        return;
    }
    let is_rust = path.extension().is_some_and(|kind| kind == "rs");
    if !is_rust || path.ends_with("tests.rs") {
        return;
    }
    let text = std::fs::read_to_string(path).unwrap();
    // Tests stand at the end of a file.
    let text = text.split("\n#[cfg(test)]\nmod tests {").next().unwrap();
    let lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    for line in lines {
        code.push_str(line);
        code.push('\n');
    }
}

/// The names that follow `crate::` in the code, also in braces.
fn crate_paths(code: &str) -> BTreeSet<&str> {
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    let first = |path: &'_ str| path.trim().find(|c| !is_name(c)).unwrap_or(path.trim().len());
    let mut names = BTreeSet::new();
    for path in code.split("crate::").skip(1) {
        if let Some(group) = path.strip_prefix('{') {
            let group = group.split('}').next().unwrap();
            names.extend(group.split(',').map(|path| &path.trim()[..first(path)]));
        } else {
            names.insert(&path[..first(path)]);
        }
    }
    names
}

/// The room of a type that the crate's `root` exports.
fn room_of_export<'a>(root: &'a str, name: &str) -> Option<&'a str> {
    let ending = format!("::{name};");
    root.lines()
        .filter_map(|line| line.strip_prefix("pub use "))
        .find(|path| path.ends_with(&ending))?
        .split("::")
        .next()
}

#[test]
fn rooms_use_the_floors_below_them_alone() {
    let page = text("ARCHITECTURE.md");
    let floors = floors(&page);
    assert!(!floors.is_empty(), "the page has no floors");
    for (name, table) in floors {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates").join(&name).join("src");
        let code = rooms(&source);
        let root = std::fs::read_to_string(source.join("lib.rs")).unwrap();
        let listed: BTreeSet<&str> = table.iter().map(|(room, _)| room.as_str()).collect();
        let there: BTreeSet<&str> = code.keys().map(String::as_str).collect();
        assert_eq!(listed, there, "{name}: left the page, right the code");
        let mut below = BTreeSet::new();
        for (room, uses) in &table {
            let mut found = BTreeSet::new();
            for path in crate_paths(&code[room]) {
                let used = room_of_export(&root, path).unwrap_or(path);
                if used != room && there.contains(used) {
                    found.insert(used.to_owned());
                }
            }
            assert_eq!(
                uses, &found,
                "{name}: {room} uses; left the page, right the code"
            );
            let above: Vec<_> = found.difference(&below).collect();
            assert!(
                above.is_empty(),
                "{name}: {room} uses {above:?} on no lower floor"
            );
            below.insert(room.clone());
        }
    }
}

/// The names of the types in a crate's code.
fn types(code: &str) -> Vec<&str> {
    code.lines().filter_map(declared_type).collect()
}

/// The name of the type that is declared in a line.
fn declared_type(line: &str) -> Option<&str> {
    let mut words = line.split_whitespace().skip_while(|word| word.starts_with("pub"));
    let is_type = match words.next()? {
        "struct" | "enum" | "trait" => true,
        // An indented `type` is the part of a trait.
        "type" => !line.starts_with(' '),
        _ => false,
    };
    if !is_type {
        return None;
    }
    words.next()?.split(|c: char| !c.is_alphanumeric()).next()
}

#[test]
fn no_two_types_of_a_crate_have_the_same_name() {
    let mut all = 0;
    for package in members() {
        let source = Path::new(word(&package["manifest_path"])).with_file_name("src");
        let code: String = rooms(&source).into_values().collect();
        let mut seen = BTreeSet::new();
        let twice: Vec<_> = types(&code).into_iter().filter(|name| !seen.insert(*name)).collect();
        assert!(twice.is_empty(), "{}: {twice:?}", short(&package));
        all += seen.len();
    }
    assert!(all > 800, "only {all} types were found");
}
