//! The documentation: the files that it names exist, its messages match the code, the program accepts its commands, and
//! commands marked `run` are run in order.
//!
//! The line before a block of commands marks it: `<!-- run -->`, `<!-- not run: WHY -->`, or `<!-- by hand, DATE -->`
//! where it needs more than a test has.

use crate::support::live_camera::RtspCamera;
use crate::support::{
    Ended, Node, PATIENCE, assert_contains, free_port, json_at, process, project, python, text,
    until, until_ready,
};
use albireo_node::state::board::ThresholdEvent;
use albireo_wire::{
    ClipReport, ClipTravel, CountersMessage, Desired, DetectionsMessage, FrameAnswer,
    FrameAttachment, SettledMessage, Sighting, ThresholdMessage,
};
use clap::CommandFactory;
use rstest::rstest;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use tokio::process::Child;

#[derive(Debug)]
struct Block {
    page: String,
    /// The line before it.
    mark: String,
    commands: Vec<String>,
}

fn pages() -> Vec<String> {
    let folders = [
        "", "docs/", "demo/", "models/", "config/", "deploy/", "benches/", "web/",
    ];
    let mut pages = Vec::new();
    for folder in folders {
        for entry in std::fs::read_dir(project(folder)).unwrap() {
            let page = format!("{folder}{}", entry.unwrap().file_name().display());
            if page.ends_with(".md") {
                pages.push(page);
            }
        }
    }
    pages
}

fn blocks() -> Vec<Block> {
    let mut blocks = Vec::new();
    for page in pages() {
        let text = text(&page);
        let mut parts = text.split("\n```");
        let mut before = parts.next().unwrap();
        while let (Some(inside), Some(outside)) = (parts.next(), parts.next()) {
            let (kind, lines) = inside.split_once('\n').unwrap();
            let mut commands = Vec::new();
            for line in lines.replace("\\\n", " ").lines() {
                if !words(line.trim()).is_empty() {
                    commands.push(line.trim().to_owned());
                }
            }
            let is_command = |line: &String| {
                ["albireo", "make", "cargo", "curl", "docker"].contains(&&*words(line)[0])
            };
            if kind == "sh" || (kind.is_empty() && commands.first().is_some_and(is_command)) {
                let mark = before.lines().last().unwrap().to_owned();
                blocks.push(Block {
                    page: page.clone(),
                    mark,
                    commands,
                });
            }
            before = outside;
        }
    }
    blocks
}

fn commands_to_run(is_wanted: impl Fn(&str) -> bool) -> Vec<String> {
    let mut blocks = blocks();
    blocks.retain(|block| block.mark == "<!-- run -->" && is_wanted(&block.page));
    blocks.into_iter().flat_map(|block| block.commands).collect()
}

/// The words of a command, without variables before it and a comment after it.
fn words(line: &str) -> Vec<String> {
    shlex::split(line.trim_end_matches('&'))
        .unwrap_or_default()
        .into_iter()
        .skip_while(|word| word.contains('='))
        .collect()
}

#[test]
fn every_command_parses_and_every_block_is_run_or_says_when_it_was_run_by_hand() {
    let marks = ["<!-- by hand, 20", "<!-- not run: ", "<!-- run -->"];
    let mut seen = 0;
    for block in blocks() {
        let marked = marks.iter().any(|start| block.mark.starts_with(start));
        assert!(marked, "{block:?}");
        let commands = block.commands.iter().map(|command| words(command));
        for command in commands.filter(|command| command[0] == "albireo") {
            let refused = albireo::cli::Arguments::command()
                .try_get_matches_from(&command)
                .err()
                .map(|error| error.to_string());
            assert_eq!(refused, None, "{}: {command:?}", block.page);
            seen += 1;
        }
    }
    assert!(seen >= 10, "{seen}");
}

#[test]
fn the_pages_are_few_and_the_readme_links_each() {
    let readme = text("README.md");
    let mut docs = pages();
    docs.retain(|name| name.starts_with("docs/"));
    assert!(docs.len() <= 14, "{docs:?}");
    for name in docs {
        assert_contains(&readme, &[&format!("({name})")]);
    }
}

/// The anchors of a page's headings, as code hosts generate them.
fn anchors(page: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(page).unwrap();
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let is_kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
    let anchor = |heading: &str| {
        let words = heading.trim_start_matches('#').trim().to_lowercase();
        let kept: String = words.chars().filter(is_kept).collect();
        kept.replace(' ', "-")
    };
    headings.map(anchor).collect()
}

/// Also of the text in backticks that begins with a folder of the project, except the output of `make gpu`.
#[test]
fn every_linked_or_named_file_exists_with_the_heading_of_the_link() {
    let folders = "crates/ src/ tests/ benches/ config/ deploy/ docs/ models/ web/";
    let folders: Vec<_> = folders.split(' ').collect();
    let mut seen = 0;
    let mut missing = Vec::new();
    for name in pages() {
        let text = text(&name);
        let page = project(&name);
        for rest in text.split("](").skip(1) {
            let (link, _) = rest.split_once(')').unwrap_or((rest, ""));
            if link.contains("://") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => page.clone(),
                file => page.parent().unwrap().join(file),
            };
            let has_anchor =
                || anchor.is_empty() || anchors(&target).iter().any(|known| known == anchor);
            if !target.exists() || !has_anchor() {
                missing.push(format!("{name}: {link}"));
            }
            seen += 1;
        }
        let quoted = text.lines().flat_map(|line| line.split('`').skip(1).step_by(2));
        let named = quoted.filter(|text| folders.iter().any(|folder| text.starts_with(folder)));
        for file in named.filter(|text| !text.contains([' ', '*', '{', '<'])) {
            if !project(file).exists() && file != "benches/gpu.md" {
                missing.push(format!("{name}: {file}"));
            }
        }
    }
    assert!(seen > 10, "{seen}");
    assert!(missing.is_empty(), "missing: {missing:#?}");
}

/// Reads an example as a `T` and writes it again.
fn read_and_written<T: DeserializeOwned + Serialize>(example: &str) -> serde_json::Result<Value> {
    let message: T = serde_json::from_str(example)?;
    serde_json::from_str(&serde_json::to_string(&message)?)
}

/// Like [`read_and_written`], for an event, which the program only writes.
fn event_written(example: &str) -> serde_json::Result<Value> {
    let example: Value = serde_json::from_str(example)?;
    serde_json::to_value(ThresholdEvent {
        camera: example["camera"].as_str().unwrap().into(),
        threshold: serde_json::from_value(example["threshold"].clone())?,
    })
}

/// The line `<!-- example: NAME -->` marks an example.
#[test]
fn the_messages_named_are_described_and_their_examples_are_valid() {
    let document = serde_json::to_value(albireo_node::api::http::openapi()).unwrap();
    let schemas = &document["components"]["schemas"];
    let page = text("docs/messages.md");
    let (examples, table) = page.split_once("| key | direction | message |\n").unwrap();
    for row in table.lines().skip(1) {
        let message = row.rsplit('`').nth(1).unwrap();
        assert!(schemas[message].is_object(), "{row}");
    }
    let examples: Vec<_> = examples.split("<!-- example: ").skip(1).collect();
    assert!(examples.len() >= 6);
    for part in examples {
        let (name, rest) = part.split_once(" -->\n```json\n").unwrap();
        let (example, _) = rest.split_once("```").unwrap();
        let written = match name {
            "DetectionsMessage" => read_and_written::<DetectionsMessage>(example),
            "SettledMessage" => read_and_written::<SettledMessage>(example),
            "Sighting" => read_and_written::<Sighting>(example),
            "ClipReport" => read_and_written::<ClipReport>(example),
            "CountersMessage" => read_and_written::<CountersMessage>(example),
            "ThresholdMessage" => read_and_written::<ThresholdMessage>(example),
            "ThresholdEvent" => event_written(example),
            "FrameAttachment" => read_and_written::<FrameAttachment>(example),
            "FrameAnswer" => read_and_written::<FrameAnswer>(example),
            "ClipTravel" => read_and_written::<ClipTravel>(example),
            "Desired" => read_and_written::<Desired>(example),
            other => panic!("{other}: add its type to this test"),
        };
        // A field unknown to the program would not be written.
        let example: Value = serde_json::from_str(example).unwrap();
        let written = written.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(written, example, "{name}");
        for field in example.as_object().unwrap().keys() {
            let described = &schemas[name]["properties"][field];
            assert!(described.is_object(), "{name}: {field}");
        }
    }
}

/// A folder with the parts of a checkout that commands and examples use.
pub(crate) fn workshop() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["demo", "models", "docs"] {
        std::os::unix::fs::symlink(project(name), folder.path().join(name)).unwrap();
    }
    let config = "[[camera]]\nname = \"front\"\n";
    std::fs::write(folder.path().join("node.toml"), config).unwrap();
    folder
}

fn shell(folder: &Path, line: &str) -> Child {
    let programs = Path::new(env!("CARGO_BIN_EXE_albireo")).parent().unwrap();
    let path = std::env::var("PATH").unwrap_or_default();
    // As in the README, from a folder other than the checkout.
    let library = std::env::var_os("ORT_DYLIB_PATH")
        .unwrap_or_else(|| project(".cache/onnxruntime").into_os_string());
    // `env` sets the variables before the command, and `exec` replaces the shell with it.
    process("sh")
        .args(["-c", &format!("exec env {line}")])
        .current_dir(folder)
        .env("PATH", format!("{}:{path}", programs.display()))
        .env("ORT_DYLIB_PATH", library)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// The node that a command starts.
struct Started {
    child: Child,
    http: String,
    zenoh: String,
}

/// Starts the node of a command on free ports.
fn node_of(folder: &Path, command: &str) -> Started {
    let http = format!("127.0.0.1:{}", free_port());
    let zenoh = format!("tcp/127.0.0.1:{}", free_port());
    let ports = format!("ALBIREO_HTTP__LISTEN={http} ALBIREO_ZENOH__LISTEN='[\"{zenoh}\"]'");
    Started {
        child: shell(folder, &format!("{ports} {command}")),
        http,
        zenoh,
    }
}

async fn run_line(folder: &Path, line: &str) -> String {
    println!("$ {line}");
    Ended::from(shell(folder, line).wait_with_output().await.unwrap()).succeeds()
}

#[rstest]
#[timeout(2 * PATIENCE)]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and curl"]
async fn the_documented_commands_run_in_order() {
    let folder = workshop();
    // The page asks for a node in another terminal.
    let mut node = node_of(folder.path(), "albireo node --config node.toml");
    until_ready(&format!("http://{}", node.http)).await;
    // The commands of the camera page need cameras.
    let commands = commands_to_run(|page| page != "docs/cameras.md");
    assert!(commands.len() >= 9, "{commands:?}");
    // Independent commands run in parallel.
    let mut with_node = Vec::new();
    let mut comparing = Vec::new();
    let mut others = Vec::new();
    for command in commands {
        if command.contains("curl ") || command.contains(" replay ") {
            with_node.push(command);
        } else if command.contains(" compare ") {
            comparing.push(command);
        } else {
            others.push(command);
        }
    }
    let run = async |commands: Vec<String>| {
        for command in commands {
            let mut line = command
                .replace("localhost:8080", &node.http)
                .replace("127.0.0.1:8080", &node.http)
                .replace("curl ", "curl -sSf ");
            if line.starts_with("albireo replay ") {
                line = format!("{line} --connect {}", node.zenoh);
            }
            run_line(folder.path(), &line).await;
        }
    };
    tokio::join!(run(with_node), run(comparing), run(others));
    assert!(folder.path().join("results/report.html").is_file());
    node.child.start_kill().unwrap();
    let log = Ended::from(node.child.wait_with_output().await.unwrap()).err;
    assert_contains(&log, &["first frame"]);
}

#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and Python"]
async fn the_python_examples_publish_and_listen() {
    let folder = workshop();
    run_line(folder.path(), "tar -xf demo/road.tar busy").await;
    let model = project("models/yolox_nano.onnx");
    let camera = "[[camera]]\nname = \"front\"\n";
    let node = Node::start(&format!("detector.model = {model:?}\n{camera}")).await;
    let example = |name: &str, more: &str| {
        let script = project("docs/examples").join(name);
        format!("{} {} {more}", python(), script.display())
    };
    let listen = format!("'albireo/*/*/detections' {} 10", node.zenoh);
    let listening = shell(folder.path(), &example("listen.py", &listen));
    let publish = format!("busy albireo/node/front/frame {}", node.zenoh);
    // The listener may start late: publish until it has received enough.
    let heard = tokio::spawn(listening.wait_with_output());
    while !heard.is_finished() {
        let said = run_line(folder.path(), &example("publish.py", &publish)).await;
        assert_contains(&said, &["221 frames sent on albireo/node/front/frame"]);
    }
    let said = Ended::from(heard.await.unwrap().unwrap()).succeeds();
    assert_eq!(said.lines().count(), 10, "{said}");
}

/// The configuration and commands of the camera page, with real camera servers in place of its addresses.
#[rstest]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and ffmpeg and RTSP server"]
async fn the_camera_page_opens_a_camera_with_a_password_and_publishes_one_to_a_remote_node() {
    let page = text("docs/cameras.md");
    let commands = commands_to_run(|page| page == "docs/cameras.md");
    let command = |begins: &str| {
        commands
            .iter()
            .find(|command| command.starts_with(begins))
            .unwrap_or_else(|| panic!("docs/cameras.md has no command `{begins}`"))
    };
    let replaced = |text: &str, theirs: &str, ours: &str| {
        assert_contains(text, &[theirs]);
        text.replace(theirs, ours)
    };
    let to_camera = |text: &str, camera: &RtspCamera| {
        let ours = format!("127.0.0.1:{}/stream", camera.port);
        replaced(text, "192.168.0.20/stream1", &ours)
    };
    let until_frames = async |http: &str| {
        let address = format!("{http}/api/v1/cameras/gate");
        let come = async || json_at(&address).await["frames"].as_u64() > Some(2);
        until("frames of the camera", come).await;
    };

    let camera = RtspCamera::start("h264", &["viewer", "a b@c"]).await;
    let (_, config) = page.split_once("```toml\n").unwrap();
    let (config, _) = config.split_once("```").unwrap();
    let folder = workshop();
    std::fs::write(folder.path().join("node.toml"), to_camera(config, &camera)).unwrap();
    let mut node = node_of(folder.path(), command("GATE_USER="));
    until_frames(&format!("http://{}", node.http)).await;
    node.child.kill().await.unwrap();

    let camera = RtspCamera::start("h264", &[]).await;
    let model = project("models/yolox_nano.onnx");
    let settings = "[[camera]]\nname = \"gate\"\n[node]\nname = \"car-7\"\n";
    let node = Node::start(&format!("detector.model = {model:?}\n{settings}")).await;
    let line = to_camera(command("albireo publish "), &camera);
    let line = replaced(&line, "tcp/192.168.0.5:7447", &node.zenoh);
    let mut publisher = shell(folder.path(), &line);
    until_frames(&node.http).await;
    publisher.kill().await.unwrap();
    // The help has the options that the page names.
    let help = run_line(folder.path(), "albireo publish --help").await;
    for option in page.split('`').filter(|quoted| quoted.starts_with("--")) {
        assert_contains(&help, &[option]);
    }
}
