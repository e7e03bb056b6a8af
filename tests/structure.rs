//! The structure of the workspace: which crate may use which, the dependencies of the method, that every dependency is
//! used, and that the files which pages name exist.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The crates that each crate of the workspace may use, tests aside.
const MAY_USE: &[(&str, &[&str])] = &[
    (
        "fuzz",
        &["core", "hub", "node", "power", "service", "vision", "wire"],
    ),
    ("core", &[]),
    ("wire", &["core"]),
    ("service", &["wire"]),
    ("vision", &["core", "service"]),
    ("power", &["service", "wire"]),
    ("node", &["core", "power", "service", "vision", "wire"]),
    ("hub", &["service", "wire"]),
    ("router", &["service", "wire"]),
    ("simulate", &["wire"]),
    ("eval", &["core", "vision", "wire"]),
    (
        "the program",
        &[
            "core", "eval", "hub", "node", "power", "router", "service", "simulate", "vision",
            "wire",
        ],
    ),
    ("scene", &["core"]),
];

/// All that the method depends on, with what its dependencies bring. Whoever adds a name here puts it into every program
/// that embeds the method: an API, command-line, runtime, network or file crate does not belong here.
const METHOD: &[&str] = &[
    "albireo-core",
    // Matrices.
    "approx",
    "bytemuck",
    "matrixmultiply",
    "nalgebra",
    "num-complex",
    "num-integer",
    "num-rational",
    "num-traits",
    "rawpointer",
    "safe_arch",
    "simba",
    "typenum",
    "wide",
    // Settings and outcomes as data.
    "itoa",
    "memchr",
    "serde",
    "serde_core",
    "serde_derive",
    "serde_json",
    "strsim",
    "zmij",
    // Errors.
    "thiserror",
    "thiserror-impl",
    // What derives are made with.
    "proc-macro2",
    "quote",
    "syn",
    "unicode-ident",
];

/// Pages that tell where things are.
const PAGES: &[&str] = &["ARCHITECTURE.md", "CONTRIBUTING.md", "README.md"];

/// Dependencies of the program that only switch on features of others, see its feature `development`.
const FOR_THEIR_FEATURES: [&str; 2] = ["regex-automata", "regex-syntax"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn cargo(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO"))
        .current_dir(root())
        .args(arguments)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

/// A dependency as a manifest has it.
struct Dependency {
    /// Its name as the registry or the workspace has it.
    package: String,
    /// Its name in the sources.
    name: String,
    only_for_tests: bool,
}

/// A crate of the workspace.
struct Member {
    /// Without `albireo-`; the program is `the program`.
    name: String,
    folder: PathBuf,
    dependencies: Vec<Dependency>,
}

impl Member {
    fn read(package: &Value) -> Self {
        let manifest = Path::new(package["manifest_path"].as_str().unwrap());
        let dependencies = package["dependencies"].as_array().unwrap();
        Self {
            name: short(package["name"].as_str().unwrap()),
            folder: manifest.parent().unwrap().to_owned(),
            dependencies: dependencies
                .iter()
                .map(|dependency| Dependency {
                    package: dependency["name"].as_str().unwrap().to_owned(),
                    name: dependency["rename"]
                        .as_str()
                        .unwrap_or(dependency["name"].as_str().unwrap())
                        .replace('-', "_"),
                    only_for_tests: dependency["kind"] == "dev",
                })
                .collect(),
        }
    }

    /// The crates of the workspace that it uses, tests aside.
    fn uses(&self) -> BTreeSet<String> {
        self.dependencies
            .iter()
            .filter(|dependency| !dependency.only_for_tests)
            .filter(|dependency| dependency.package.starts_with("albireo"))
            .map(|dependency| short(&dependency.package))
            .collect()
    }
}

fn short(package: &str) -> String {
    package
        .strip_prefix("albireo-")
        .unwrap_or("the program")
        .to_owned()
}

fn members() -> Vec<Member> {
    let text = cargo(&["metadata", "--no-deps", "--offline", "--format-version=1"]);
    let metadata: Value = serde_json::from_str(&text).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    packages.iter().map(Member::read).collect()
}

#[test]
fn a_crate_uses_only_the_crates_it_may() {
    let may_use: BTreeMap<&str, BTreeSet<&str>> = MAY_USE
        .iter()
        .map(|(name, may)| (*name, may.iter().copied().collect()))
        .collect();
    for member in members() {
        let may = may_use
            .get(member.name.as_str())
            .unwrap_or_else(|| panic!("{}: say in MAY_USE what it may use", member.name));
        for used in member.uses() {
            assert!(
                may.contains(used.as_str()),
                "{} uses {used} and may not",
                member.name
            );
        }
    }
}

#[test]
fn the_method_depends_on_numbers_and_data_alone() {
    let tree = cargo(&[
        "tree",
        "--package=albireo-core",
        "--edges=normal",
        "--prefix=none",
        "--offline",
    ]);
    let mut seen = 0;
    for line in tree.lines() {
        let name = line.split_whitespace().next().unwrap_or_default();
        assert!(METHOD.contains(&name), "albireo-core depends on {name}");
        seen += 1;
    }
    assert!(seen > 4, "{tree}");
}

/// clippy (`make lint`) refuses what the standard library did not have in that version.
#[test]
fn the_method_asks_for_the_oldest_rust_that_its_dependencies_take() {
    let version = cargo(&["-vV"]);
    let host = version.lines().find_map(|line| line.strip_prefix("host: "));
    let platform = format!("--filter-platform={}", host.unwrap());
    let text = cargo(&["metadata", "--offline", "--format-version=1", &platform]);
    let metadata: Value = serde_json::from_str(&text).unwrap();
    let asked_by = |name: &str| -> Option<(u32, u32)> {
        let packages = metadata["packages"].as_array().unwrap().iter();
        let found = packages.filter(|package| package["name"] == name);
        let versions = found.filter_map(|package| package["rust_version"].as_str());
        let parts = versions.map(|version| {
            let mut parts = version.split('.').map(|part| part.parse().unwrap());
            (parts.next().unwrap(), parts.next().unwrap_or(0))
        });
        parts.max()
    };
    let others = METHOD.iter().filter(|name| **name != "albireo-core");
    let needed = others.filter_map(|name| asked_by(name)).max();
    assert_eq!(asked_by("albireo-core"), needed);
}

/// The first table of the page: crate, and the crates it uses.
fn table(page: &str) -> BTreeMap<String, BTreeSet<String>> {
    let names = |cell: &str| -> BTreeSet<String> {
        cell.split('`')
            .skip(1)
            .step_by(2)
            .map(str::to_owned)
            .collect()
    };
    page.lines()
        .skip_while(|line| !line.starts_with("| crate |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(|line| {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let name = cells[1].trim_matches(['`', '*']).to_owned();
            (name, names(cells[cells.len() - 2]))
        })
        .collect()
}

#[test]
fn the_crates_and_arrows_in_the_architecture_are_those_of_cargo() {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let there: BTreeMap<String, BTreeSet<String>> = members()
        .iter()
        .map(|member| (member.name.clone(), member.uses()))
        .collect();
    assert_eq!(table(&page), there, "left the page, right cargo");
}

/// The Rust sources under `folder`, but for those of packages inside it.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    for entry in entries {
        let path = entry.unwrap().path();
        if path.is_dir() {
            if !path.join("Cargo.toml").exists() {
                sources(&path, found);
            }
        } else if path.extension().is_some_and(|kind| kind == "rs") {
            found.push(path);
        }
    }
}

/// Whether code in `text` says `name::`.
fn says(text: &str, name: &str) -> bool {
    let path = format!("{name}::");
    text.lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .any(|line| {
            line.match_indices(&path).any(|(at, _)| {
                let before = line[..at].chars().next_back();
                !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':')
            })
        })
}

#[test]
fn the_errors_of_libraries_are_typed() {
    let untyped: Vec<String> = (members().iter())
        .filter(|member| member.name != "the program")
        .filter(|member| {
            (member.dependencies.iter()).any(|dependency| dependency.package == "anyhow")
        })
        .map(|member| member.name.clone())
        .collect();
    assert!(untyped.is_empty(), "anyhow in libraries: {untyped:?}");
}

#[test]
fn every_dependency_is_used() {
    let mut unused = Vec::new();
    for member in members() {
        let read = |folders: &[&str]| -> Vec<String> {
            let mut files = Vec::new();
            for folder in folders {
                sources(&member.folder.join(folder), &mut files);
            }
            files
                .iter()
                .map(|file| std::fs::read_to_string(file).unwrap())
                .collect()
        };
        let code = read(&["src", "fuzz_targets"]);
        let tests = read(&["src", "tests", "benches"]);
        assert!(!code.is_empty(), "{}: no sources", member.name);
        for dependency in &member.dependencies {
            let where_used = if dependency.only_for_tests {
                &tests
            } else {
                &code
            };
            // A second entry for tests only adds features to the first.
            let again = dependency.only_for_tests
                && (member.dependencies.iter())
                    .any(|other| !other.only_for_tests && other.package == dependency.package);
            let named_for_features =
                member.name == "the program" && FOR_THEIR_FEATURES.contains(&&*dependency.package);
            if !again
                && !named_for_features
                && !where_used.iter().any(|text| says(text, &dependency.name))
            {
                unused.push(format!("{}: {}", member.name, dependency.package));
            }
        }
    }
    assert!(unused.is_empty(), "unused dependencies: {unused:#?}");
}

/// Paths that a page names: the targets of its links, and text in backticks that begins with a folder of the
/// project.
fn paths(page: &str) -> BTreeSet<String> {
    let folders = [
        "crates/", "src/", "tests/", "benches/", "config/", "deploy/", "docs/", "models/", "web/",
    ];
    let links = page
        .split("](")
        .skip(1)
        .filter_map(|rest| rest.split([')', '#']).next())
        .filter(|target| !target.is_empty() && !target.contains("://"));
    let quoted = page
        .lines()
        .flat_map(|line| line.split('`').skip(1).step_by(2))
        .filter(|text| folders.iter().any(|folder| text.starts_with(folder)))
        .filter(|text| !text.contains([' ', '*', '{', '<']));
    links.chain(quoted).map(str::to_owned).collect()
}

#[test]
fn every_file_that_a_page_names_is_there() {
    let mut missing = Vec::new();
    for page in PAGES {
        let text = std::fs::read_to_string(root().join(page)).unwrap();
        let named = paths(&text);
        assert!(!named.is_empty(), "{page} names no file");
        for path in named {
            if !root().join(&path).exists() {
                missing.push(format!("{page}: {path}"));
            }
        }
    }
    assert!(missing.is_empty(), "not there: {missing:#?}");
}

#[test]
fn a_test_that_wants_more_than_the_clone_says_what_in_words_that_run_sh_knows() {
    let known = [
        "../shared",
        "ONNX Runtime",
        "Python",
        "ffmpeg",
        "RTSP server",
        "promtool",
        "curl",
        "PostgreSQL",
        "strace",
        "Node.js",
        "systemd",
        "Caddy",
        "Docker Compose",
        "hadolint",
        "shellcheck",
        "the wheel",
    ];
    let script = std::fs::read_to_string(root().join("tests/run.sh")).unwrap();
    for need in known {
        assert!(script.contains(&format!("\"{need}\"")), "run.sh: {need}");
    }
    let mut files = Vec::new();
    for member in members() {
        sources(&member.folder.join("src"), &mut files);
        sources(&member.folder.join("tests"), &mut files);
    }
    let mut seen = 0;
    let mark = concat!("#[", "ignore");
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        for line in text
            .lines()
            .filter(|line| line.trim_start().starts_with(mark))
        {
            let needs = line
                .trim()
                .strip_prefix(&format!("{mark} = \"needs "))
                .and_then(|rest| rest.strip_suffix("\"]"))
                .unwrap_or_else(|| panic!("{}: {line}", file.display()));
            for need in needs.split(" and ") {
                assert!(known.contains(&need), "{}: {line}", file.display());
                seen += 1;
            }
        }
    }
    assert!(seen > 0);
}
