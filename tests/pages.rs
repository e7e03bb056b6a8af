//! The web pages have current types and are small. `make browser` tests them in a browser against the program.

use crate::support::{project, run_command};
use serde_json::Value;
use std::collections::BTreeSet;
use std::process::Command;

/// The pages' types are made from these. `ALBIREO_UPDATE=1` overwrites them; then `npm run types` makes the types.
#[test]
fn the_descriptions_behind_the_pages_are_current_and_each_operation_has_its_own_id() {
    let node = serde_json::to_string_pretty(&albireo_node::api::http::openapi());
    let hub = serde_json::to_string_pretty(&albireo_hub::http::openapi());
    for (service, now) in [("node", node), ("hub", hub)] {
        let path = project(&format!("web/api/{service}.json"));
        let now = now.unwrap() + "\n";
        if std::env::var_os("ALBIREO_UPDATE").is_some() {
            std::fs::write(&path, &now).unwrap();
        }
        let kept = std::fs::read_to_string(&path).unwrap_or_default();
        let remedy =
            "is out of date: run this test with ALBIREO_UPDATE=1, then `npm run types` in web";
        assert!(kept == now, "{} {remedy}", path.display());
        let description: Value = serde_json::from_str(&now).unwrap();
        let ids: Vec<_> = description["paths"]
            .as_object()
            .unwrap()
            .values()
            .flat_map(|path| path.as_object().unwrap().values())
            .map(|operation| operation["operationId"].as_str())
            .collect();
        let names: BTreeSet<_> = ids.iter().map(|id| id.unwrap()).collect();
        assert!(ids.len() > 15);
        assert_eq!(names.len(), ids.len(), "{names:?}");
    }
}

fn run(program: &str, arguments: &[&str]) {
    let mut command = Command::new(program);
    run_command(command.args(arguments).current_dir(project("web"))).succeeds();
}

#[test]
#[ignore = "needs Node.js"]
fn the_pages_types_are_current_and_their_own_tests_pass() {
    run("node", &["scripts/types.mjs", "--check"]);
    run("npx", &["--no-install", "tsc", "--noEmit"]);
    run("npx", &["--no-install", "vitest", "run"]);
}

#[test]
#[ignore = "needs Node.js"]
fn both_pages_together_are_at_most_150_kilobytes_on_the_wire() {
    let folders = ["web/dist", "web/dist/assets"].map(project);
    let mut sizes = Vec::new();
    for folder in folders {
        for entry in std::fs::read_dir(folder).expect("`make web` builds the pages") {
            let entry = entry.unwrap();
            if entry.path().extension().is_some_and(|end| end == "gz") {
                sizes.push(entry.metadata().unwrap().len());
            }
        }
    }
    let total: u64 = sizes.iter().sum();
    assert!(sizes.len() >= 5, "the pages are not built: {sizes:?}");
    assert!(total <= 150_000, "{total} bytes");
}
