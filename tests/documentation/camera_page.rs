//! The page about cameras: its configuration and its commands, with cameras that really send instead of those in it.

use super::{blocks, page, run_line, shell, workshop};
use crate::support::live_camera::RtspCamera;
use crate::support::{Node, PATIENCE, free_port};
use std::time::Duration;
use tokio::time::{sleep, timeout};

/// The camera that the page speaks of.
const ITS_CAMERA: &str = "192.168.0.20/stream1";
/// The node that the page speaks of.
const ITS_NODE: &str = "tcp/192.168.0.5:7447";

/// The page's command that begins like this, of a block that is to be run.
fn command(begins: &str) -> String {
    let found = (blocks().iter())
        .filter(|block| block.page == "docs/cameras.md" && block.mark == "<!-- run -->")
        .flat_map(|block| block.commands.clone())
        .find(|command| command.starts_with(begins));
    found.unwrap_or_else(|| panic!("docs/cameras.md has no command `{begins}`"))
}

/// Waits until the camera `gate` of the node at `http` has answered frames.
async fn until_frames(http: &str) {
    let address = format!("{http}/api/v1/cameras/gate");
    let waiting = async {
        loop {
            if let Ok(told) = reqwest::get(&address).await
                && let Ok(told) = told.json::<serde_json::Value>().await
                && told["frames"].as_u64() > Some(2)
            {
                return;
            }
            sleep(Duration::from_millis(50)).await;
        }
    };
    timeout(PATIENCE, waiting)
        .await
        .unwrap_or_else(|_| panic!("{http} gets frames of its camera"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and ffmpeg and RTSP server"]
async fn a_node_of_the_camera_page_opens_its_camera_with_user_and_password() {
    let camera = RtspCamera::start("h264", &["viewer", "a b@c"]).await;
    let text = page("docs/cameras.md");
    let (_, config) = text.split_once("```toml\n").unwrap();
    let (config, _) = config.split_once("```").unwrap();
    assert!(config.contains(ITS_CAMERA), "{config}");
    let stream = format!("127.0.0.1:{}/stream", camera.port);
    let folder = workshop();
    std::fs::write(
        folder.path().join("node.toml"),
        config.replace(ITS_CAMERA, &stream),
    )
    .unwrap();
    let http = format!("127.0.0.1:{}", free_port());
    let settings = [
        ("ALBIREO_HTTP__LISTEN", http.clone()),
        ("ALBIREO_ZENOH__LISTEN", "[\"tcp/127.0.0.1:0\"]".to_owned()),
    ];
    let mut node = shell(folder.path(), &command("GATE_USER="), &settings);
    until_frames(&format!("http://{http}")).await;
    node.kill().await.unwrap();
    camera.kill().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and ffmpeg and RTSP server"]
async fn the_publisher_of_the_camera_page_sends_a_camera_to_a_node_elsewhere() {
    let camera = RtspCamera::start("h264", &[]).await;
    let folder = workshop();
    let model = folder.path().join("models/yolox_nano.onnx");
    let node = Node::start(&format!(
        "node.name = \"car-7\"\n[detector]\nmodel = \"{}\"\n[[camera]]\nname = \"gate\"\n",
        model.display()
    ))
    .await;
    let line = command("albireo publish ");
    assert!(
        line.contains(ITS_CAMERA) && line.contains(ITS_NODE),
        "{line}"
    );
    let line = line
        .replace(ITS_CAMERA, &format!("127.0.0.1:{}/stream", camera.port))
        .replace(ITS_NODE, &node.zenoh);
    let mut publisher = shell(folder.path(), &line, &[]);
    until_frames(&node.http).await;
    publisher.kill().await.unwrap();
    camera.kill().await;
    // What the page names is there to be read.
    let help = run_line(folder.path(), "albireo publish --help", &[]).await;
    for option in [
        "--rate",
        "--rtsp-transport",
        "--hardware",
        "--source-option",
        "--source-timeout",
    ] {
        assert!(help.contains(option), "{option}");
    }
}
