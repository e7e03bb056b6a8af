//! The documentation: its message reference equals the code, the program accepts every command in it, and commands
//! marked `run` are run in their order.
//!
//! A block of commands is marked by the line before it: `<!-- run -->`, `<!-- not run: WHY -->`, or `<!-- by hand, DATE -->` where it needs
//! more than a test has.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod camera_page;

use crate::support::{Node, PATIENCE, free_port, python};
use albireo_node::state::board::ThresholdEvent;
use albireo_wire::{
    ClipReport, CountersMessage, Desired, DetectionsMessage, FrameAnswer, FrameAttachment,
    SettledMessage, ThresholdMessage,
};
use clap::CommandFactory;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use tokio::io::AsyncReadExt;
use tokio::process::{Child, Command};
use tokio::time::timeout;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn page(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// A block of commands.
struct Block {
    page: &'static str,
    /// The line before it.
    mark: String,
    /// Its lines, those that end with a backslash joined with the next.
    commands: Vec<String>,
}

/// Every page there is.
fn pages() -> Vec<&'static str> {
    let mut pages = Vec::new();
    for folder in [
        ".", "docs", "demo", "models", "config", "deploy", "benches", "web",
    ] {
        for entry in std::fs::read_dir(root().join(folder)).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            if name.ends_with(".md") {
                let path = if folder == "." {
                    name
                } else {
                    format!("{folder}/{name}")
                };
                pages.push(&*path.leak());
            }
        }
    }
    pages.sort_unstable();
    pages
}

/// Whether a line that is printed is a command: what begins with one of these is none of a program's output.
fn is_command(line: &str) -> bool {
    let programs = [
        "albireo",
        "apt-get",
        "cargo",
        "curl",
        "docker",
        "ffmpeg",
        "journalctl",
        "make",
        "npm",
        "pip",
        "promtool",
        "python",
        "rustup",
        "sudo",
        "systemctl",
        "tar",
        "yolo",
    ];
    let first = without_settings(line)
        .split_whitespace()
        .find(|word| !word.contains('='));
    first.is_some_and(|first| programs.contains(&first) || first.starts_with("benches/"))
}

fn blocks() -> Vec<Block> {
    let mut blocks = Vec::new();
    for name in pages() {
        let text = page(name);
        let mut before = String::new();
        let mut lines = text.lines();
        while let Some(line) = lines.next() {
            if line == "```sh" {
                let block: Vec<_> = lines.by_ref().take_while(|line| *line != "```").collect();
                blocks.push(Block {
                    page: name,
                    mark: before.clone(),
                    commands: (block.join("\n").replace("\\\n", " ").lines())
                        .map(|line| uncommented(line).trim().to_owned())
                        .filter(|line| !line.is_empty())
                        .collect(),
                });
            } else if line.starts_with("```") && line != "```" {
                // Another kind of block: its end is no beginning.
                lines.by_ref().find(|line| *line == "```");
            } else if line == "```" {
                let printed: Vec<_> = lines.by_ref().take_while(|line| *line != "```").collect();
                assert!(
                    !printed.first().is_some_and(|line| is_command(line)),
                    "{name}: these are commands, so the block is ```sh, with a mark before it: {}",
                    printed.join("; ")
                );
            }
            line.clone_into(&mut before);
        }
    }
    blocks
}

/// A command without the comment behind it.
fn uncommented(line: &str) -> &str {
    line.find(" # ")
        .or_else(|| line.starts_with("# ").then_some(0))
        .map_or(line, |at| &line[..at])
}

/// The words of a command as a shell takes them, with quoted text as one.
fn words(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    for letter in line.chars() {
        match quote {
            Some(open) if letter == open => quote = None,
            None if matches!(letter, '\'' | '"') => quote = Some(letter),
            None if letter.is_whitespace() => words.push(String::new()),
            _ => words.last_mut().unwrap().push(letter),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// A command without the variables that are set for it.
fn without_settings(command: &str) -> &str {
    match command.split_once(" albireo ") {
        Some((settings, _)) if settings.contains('=') => &command[settings.len() + 1..],
        _ => command,
    }
}

#[test]
fn every_block_of_commands_is_run_or_says_when_it_was_run_by_hand() {
    let blocks = blocks();
    assert!(blocks.len() >= 10, "{}", blocks.len());
    for block in blocks {
        let dated = block
            .mark
            .strip_prefix("<!-- by hand, ")
            .and_then(|rest| rest.strip_suffix(" -->"))
            .is_some_and(|date| date.len() == 10 && date.starts_with("20"));
        let not_run = block.mark.starts_with("<!-- not run: ");
        assert!(
            dated || not_run || block.mark == "<!-- run -->",
            "{}: `{}` is marked `{}`",
            block.page,
            block.commands.join("; "),
            block.mark
        );
    }
}

#[test]
fn every_command_that_is_printed_is_one_the_program_takes() {
    let mut seen = 0;
    for block in blocks() {
        for command in &block.commands {
            let command = without_settings(command.trim_end_matches('&').trim());
            let Some(arguments) = command.strip_prefix("albireo ") else {
                continue;
            };
            seen += 1;
            let words = std::iter::once("albireo".to_owned()).chain(words(arguments));
            if let Err(error) = albireo::cli::Arguments::command().try_get_matches_from(words) {
                panic!("{}: {command}\n{error}", block.page);
            }
        }
    }
    assert!(seen >= 10, "{seen}");
}

#[test]
fn the_readme_is_short() {
    let lines = page("README.md").lines().count();
    assert!(lines <= 120, "{lines}");
}

#[test]
fn the_docs_are_at_most_twelve_pages_and_the_readme_links_each() {
    let readme = page("README.md");
    let docs: Vec<_> = (pages().into_iter())
        .filter(|name| name.starts_with("docs/"))
        .collect();
    assert!(docs.len() <= 12, "{docs:?}");
    let mut lines = 0;
    for name in docs {
        assert!(readme.contains(&format!("({name})")), "{name}");
        lines += page(name).lines().count();
    }
    assert!(lines <= 2000, "{lines}");
}

/// The words of a schema's type.
fn type_of(schema: &Value) -> String {
    if let Some(reference) = schema["$ref"].as_str() {
        return format!("`{}`", reference.rsplit('/').next().unwrap_or(reference));
    }
    for one_of in ["oneOf", "anyOf", "allOf"] {
        if let Some(options) = schema[one_of].as_array() {
            let words: Vec<_> = (options.iter())
                .filter(|option| option["type"] != "null")
                .map(type_of)
                .collect();
            return words.join(" or ");
        }
    }
    let name = match &schema["type"] {
        Value::Array(names) => names
            .iter()
            .filter_map(Value::as_str)
            .find(|name| *name != "null")
            .unwrap_or_default()
            .to_owned(),
        Value::String(name) => name.clone(),
        _ => String::new(),
    };
    match name.as_str() {
        "array" => format!("list of {}", type_of(&schema["items"])),
        "object" if schema["additionalProperties"].is_object() => {
            format!("names to {}", type_of(&schema["additionalProperties"]))
        }
        "integer" => "whole number".to_owned(),
        "boolean" => "true or false".to_owned(),
        "string" if schema["enum"].is_array() => {
            let names = schema["enum"].as_array().unwrap();
            let names: Vec<_> = (names.iter().filter_map(Value::as_str))
                .map(|name| format!("`{name}`"))
                .collect();
            names.join(", ")
        }
        "string" => "text".to_owned(),
        other => other.to_owned(),
    }
}

/// What a schema says of itself, in one line.
fn description(schema: &Value) -> String {
    let text = schema["description"].as_str().unwrap_or_default();
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    // Links of the code's own documentation lead nowhere here.
    text.replace("[`", "`")
        .replace("`]", "`")
        .replace('|', "\\|")
}

/// The fields of a schema, with whether each must be there; parts that are flattened into it among them.
fn fields<'a>(schemas: &'a Value, schema: &'a Value, into: &mut Vec<(String, &'a Value, bool)>) {
    for part in schema["allOf"].as_array().into_iter().flatten() {
        let part = match part["$ref"].as_str() {
            Some(reference) => &schemas[reference.rsplit('/').next().unwrap()],
            None => part,
        };
        fields(schemas, part, into);
    }
    let required: BTreeSet<_> = (schema["required"].as_array().into_iter().flatten())
        .filter_map(Value::as_str)
        .collect();
    for (name, field) in schema["properties"].as_object().into_iter().flatten() {
        into.push((format!("`{name}`"), field, required.contains(name.as_str())));
    }
    if schema["additionalProperties"].is_object() {
        into.push(("`u`, `lambda`, …".to_owned(), schema, false));
    }
}

/// Messages whose fields the page lists; those of the others are in `/openapi.json`.
const IN_FULL: [&str; 8] = [
    "DetectionsMessage",
    "BoxMessage",
    "Latency",
    "ClipReport",
    "ClipEnergy",
    "DroppedFrames",
    "CountersMessage",
    "FrameAttachment",
];

/// Text in lines of at most 128 characters; with `bullet`, an entry of a list.
fn wrapped(bullet: &str, text: &str) -> String {
    let mut lines = vec![bullet.to_owned()];
    for word in text.split_whitespace() {
        if lines.last().unwrap().len() + word.len() >= 128 {
            lines.push(" ".repeat(bullet.len()));
        }
        let line = lines.last_mut().unwrap();
        if !line.is_empty() && !line.ends_with(' ') {
            line.push(' ');
        }
        line.push_str(word);
    }
    lines.join("\n")
}

/// What goes over Zenoh: key, who writes it, message.
const MESSAGES: [(&str, &str, &str); 19] = [
    (
        "…/{camera}/frame",
        "in",
        "the picture; as its attachment, optional: FrameAttachment",
    ),
    (
        "…/{camera}/frame",
        "answer, with `delivery = \"every\"`",
        "FrameAnswer",
    ),
    (
        "…/{camera}/detections",
        "out, per frame",
        "DetectionsMessage",
    ),
    (
        "…/{camera}/late",
        "out, per frame whose first answer was `pending`",
        "DetectionsMessage",
    ),
    (
        "…/{camera}/settled",
        "out, per frame, with `settle.enabled`",
        "SettledMessage",
    ),
    ("…/{camera}/clip", "out, per clip", "ClipReport"),
    (
        "…/{camera}/counters",
        "out, every second",
        "CountersMessage",
    ),
    (
        "…/{camera}/threshold",
        "in by put; in and out by query",
        "ThresholdMessage",
    ),
    ("…/target", "in by put; in by query", "TargetMessage"),
    ("…/target", "answer to a query", "TargetReport"),
    (
        "{prefix}/@report/{node}",
        "query to the hub, compressed",
        "ReportBatch",
    ),
    (
        "{prefix}/@report/{node}",
        "the hub's answer",
        "ReportAnswer",
    ),
    (
        "{prefix}/@status/{node}",
        "out, at a change and as a heartbeat",
        "StatusMessage",
    ),
    ("{prefix}/@pull/{node}", "query to the hub", "PullRequest"),
    ("{prefix}/@pull/{node}", "the hub's answer", "Desired"),
    (
        "{prefix}/@changed/{node}",
        "put by the hub",
        "ConfigChanged",
    ),
    ("HTTP `/api/v1/events`", "event `frame`", "FrameEvent"),
    (
        "HTTP `/api/v1/events`",
        "event `late`: the final answer of a frame that was `pending`",
        "FrameEvent",
    ),
    (
        "HTTP `/api/v1/events`",
        "event `threshold`",
        "ThresholdEvent",
    ),
];

/// The page's table of messages, and the fields of those that [`IN_FULL`] names.
fn message_reference() -> String {
    let document = serde_json::to_value(albireo_node::api::http::openapi()).unwrap();
    let schemas = &document["components"]["schemas"];
    let mut text = "| key | direction | message |\n| --- | --- | --- |\n".to_owned();
    for (key, direction, message) in MESSAGES {
        let name = message.rsplit(' ').next().unwrap();
        assert!(schemas[name].is_object(), "{name} is not described");
        let key = if key.starts_with("HTTP") {
            key.to_owned()
        } else {
            format!("`{key}`")
        };
        let message = message.replace(name, &format!("`{name}`"));
        writeln!(text, "| {key} | {direction} | {message} |").unwrap();
    }
    for name in IN_FULL {
        let schema = &schemas[name];
        writeln!(
            text,
            "\n### {name}\n\n{}\n",
            wrapped("", &description(schema))
        )
        .unwrap();
        let mut found = Vec::new();
        fields(schemas, schema, &mut found);
        for (field, schema, required) in found {
            let shown = if required {
                field
            } else {
                format!("*{field}*")
            };
            let kind = type_of(schema);
            let line = format!("{shown} ({kind}): {}", description(schema));
            writeln!(text, "{}", wrapped("- ", line.trim_end_matches([':', ' ']))).unwrap();
        }
    }
    text
}

/// Where the generated part of the page begins and ends.
const GENERATED: [&str; 2] = ["<!-- generated -->\n\n", "\n<!-- end -->\n"];

#[test]
fn the_message_reference_is_what_the_code_says() {
    let now = message_reference();
    let path = root().join("docs/messages.md");
    let kept = page("docs/messages.md");
    let parts = kept.split_once(GENERATED[0]).and_then(|(before, rest)| {
        let (generated, after) = rest.split_once(GENERATED[1])?;
        Some((before, generated, after))
    });
    let (before, generated, after) = parts.expect("docs/messages.md has both markers");
    if std::env::var_os("ALBIREO_UPDATE").is_some() {
        let page = [before, GENERATED[0], &now, GENERATED[1], after].concat();
        std::fs::write(&path, page).unwrap();
    } else {
        assert!(
            generated == now,
            "docs/messages.md is not what the program says: run this test with ALBIREO_UPDATE=1"
        );
    }
}

/// What the program writes of an example that it read as a `T`.
fn read_and_written<T: DeserializeOwned + Serialize>(
    example: &str,
) -> Result<Value, serde_json::Error> {
    let message: T = serde_json::from_str(example)?;
    serde_json::from_str(&serde_json::to_string(&message)?)
}

/// As [`read_and_written`], of an event, which the program only writes.
fn event_written(example: &str) -> Result<Value, serde_json::Error> {
    let example: Value = serde_json::from_str(example)?;
    serde_json::to_value(ThresholdEvent {
        camera: example["camera"].as_str().unwrap().into(),
        threshold: serde_json::from_value(example["threshold"].clone())?,
    })
}

/// An example is marked by the line before it, `<!-- example: NAME -->`.
#[test]
fn the_examples_of_messages_are_messages() {
    let text = page("docs/messages.md");
    let mut seen = 0;
    for part in text.split("<!-- example: ").skip(1) {
        let (name, rest) = part.split_once(" -->\n```json\n").unwrap();
        let (example, _) = rest.split_once("```").unwrap();
        let written = match name {
            "DetectionsMessage" => read_and_written::<DetectionsMessage>(example),
            "SettledMessage" => read_and_written::<SettledMessage>(example),
            "ClipReport" => read_and_written::<ClipReport>(example),
            "CountersMessage" => read_and_written::<CountersMessage>(example),
            "ThresholdMessage" => read_and_written::<ThresholdMessage>(example),
            "ThresholdEvent" => event_written(example),
            "FrameAttachment" => read_and_written::<FrameAttachment>(example),
            "FrameAnswer" => read_and_written::<FrameAnswer>(example),
            "Desired" => read_and_written::<Desired>(example),
            other => panic!("{other}: name its type in this test"),
        };
        let written = written.unwrap_or_else(|error| panic!("{name}: {error}"));
        // What the program does not know would not be written.
        let example: Value = serde_json::from_str(example).unwrap();
        assert_eq!(example, written, "{name}");
        seen += 1;
    }
    assert!(seen >= 6, "{seen}");
}

/// A message as it is sent has no field that the reference does not name.
#[test]
fn a_real_message_has_the_fields_of_the_reference() {
    let message = crate::http_api::sample_detections();
    let sent: Map<String, Value> =
        serde_json::from_value(serde_json::to_value(message).unwrap()).unwrap();
    let document = serde_json::to_value(albireo_node::api::http::openapi()).unwrap();
    let schemas = &document["components"]["schemas"];
    let mut found = Vec::new();
    fields(schemas, &schemas["DetectionsMessage"], &mut found);
    let known: BTreeSet<_> = found
        .iter()
        .map(|(name, ..)| name.trim_matches('`'))
        .collect();
    for name in sent.keys() {
        assert!(known.contains(name.as_str()), "{name} is not in {known:?}");
    }
    assert!(known.len() > 9, "{known:?}");
}

/// A folder with what the commands want of a checkout: models and pages.
fn workshop() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["demo", "models", "docs"] {
        std::os::unix::fs::symlink(root().join(name), folder.path().join(name)).unwrap();
    }
    let config = "[[camera]]\nname = \"front\"\n";
    std::fs::write(folder.path().join("node.toml"), config).unwrap();
    folder
}

/// Runs a line of a page in `folder`.
fn shell(folder: &Path, line: &str, settings: &[(&str, String)]) -> Child {
    // Variables before a command are the shell's to set.
    let through = if without_settings(line) == line {
        "exec "
    } else {
        "exec env "
    };
    let programs = Path::new(env!("CARGO_BIN_EXE_albireo")).parent().unwrap();
    let path = std::env::var("PATH").unwrap_or_default();
    // As the README has it, from a folder that is not the checkout.
    let library = std::env::var_os("ORT_DYLIB_PATH")
        .unwrap_or_else(|| root().join(".cache/onnxruntime").into_os_string());
    Command::new("sh")
        .args(["-c", &format!("{through}{line}")])
        .current_dir(folder)
        .env("PATH", format!("{}:{path}", programs.display()))
        .env("ORT_DYLIB_PATH", library)
        .envs(settings.iter().map(|(name, value)| (*name, value)))
        .kill_on_drop(true)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

async fn run_line(folder: &Path, line: &str, settings: &[(&str, String)]) -> String {
    let child = shell(folder, line, settings);
    let output = timeout(4 * PATIENCE, child.wait_with_output())
        .await
        .unwrap_or_else(|_| panic!("{line} does not end"))
        .unwrap();
    let (said, failed) = (
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    );
    println!("$ {line}\n{said}\n{failed}");
    assert!(output.status.success(), "{line}\n{said}\n{failed}");
    said
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and curl"]
async fn the_commands_of_the_pages_run_in_their_order() {
    let folder = workshop();
    let (http, zenoh) = (free_port(), free_port());
    let settings = [
        ("ALBIREO_HTTP__LISTEN", format!("127.0.0.1:{http}")),
        (
            "ALBIREO_ZENOH__LISTEN",
            format!("[\"tcp/127.0.0.1:{zenoh}\"]"),
        ),
    ];
    // As the page says before: a node runs in another terminal.
    let mut node = shell(folder.path(), "albireo node --config node.toml", &settings);
    let ready = format!("http://127.0.0.1:{http}/readyz");
    let waiting = async {
        while !reqwest::get(&ready)
            .await
            .is_ok_and(|said| said.status().is_success())
        {
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    };
    timeout(PATIENCE, waiting)
        .await
        .expect("the node gets ready");
    let mut ran = 0;
    for block in blocks() {
        // Those of the page about cameras want cameras.
        if block.page == "docs/cameras.md" || block.mark != "<!-- run -->" {
            continue;
        }
        for command in &block.commands {
            let own = format!("127.0.0.1:{http}");
            let mut line = command
                .replace("localhost:8080", &own)
                .replace("127.0.0.1:8080", &own);
            if let Some(rest) = line.strip_prefix("curl ") {
                line = format!("curl -sSf {rest}");
            }
            if line.starts_with("albireo replay ") {
                line = format!("{line} --connect tcp/127.0.0.1:{zenoh}");
            }
            let said = run_line(folder.path(), &line, &[]).await;
            if line.starts_with("albireo compare ") {
                // Its lines are broken where they fit.
                let words: Vec<&str> = said.split_whitespace().collect();
                let words = words.join(" ");
                assert!(words.contains("against the boxes of vanilla"), "{said}");
            }
            ran += 1;
        }
    }
    assert!(ran >= 9, "{ran}");
    assert!(folder.path().join("results/report.html").is_file());
    node.kill().await.unwrap();
    let mut log = String::new();
    let mut stderr = node.stderr.take().unwrap();
    stderr.read_to_string(&mut log).await.unwrap();
    assert!(log.contains("first frame"), "{log}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn the_python_examples_publish_and_listen() {
    let folder = workshop();
    run_line(folder.path(), "tar -xf demo/road.tar busy", &[]).await;
    let models = root().join("models");
    let node = Node::start(&format!(
        "[detector]\nmodel = \"{}\"\n[[camera]]\nname = \"front\"\n",
        models.join("yolox_nano.onnx").display()
    ))
    .await;
    let example = |name: &str| -> PathBuf { root().join("docs/examples").join(name) };
    let listen = format!(
        "{} {} 'albireo/*/*/detections' {} 10",
        python(),
        example("listen.py").display(),
        node.zenoh
    );
    let listening = shell(folder.path(), &listen, &[]);
    let publish = format!(
        "{} {} busy albireo/node/front/frame {}",
        python(),
        example("publish.py").display(),
        node.zenoh
    );
    // The listener may come late: play until it has heard enough.
    let heard = tokio::spawn(listening.wait_with_output());
    while !heard.is_finished() {
        let said = run_line(folder.path(), &publish, &[]).await;
        assert!(
            said.contains("88 frames sent on albireo/node/front/frame"),
            "{said}"
        );
    }
    let output = timeout(PATIENCE, heard).await.unwrap().unwrap().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert_eq!(said.lines().count(), 10, "{said}");
}
