//! The configuration and commands of the camera page, run with real camera servers in place of its addresses.

use super::{commands_to_run, run_line, shell, workshop};
use crate::support::live_camera::RtspCamera;
use crate::support::{Node, assert_contains, free_port, json_at, project, text, until};

/// The camera address on the page.
const ITS_CAMERA: &str = "192.168.0.20/stream1";
/// The node address on the page.
const ITS_NODE: &str = "tcp/192.168.0.5:7447";

/// The page's command, marked `run`, that begins with this text.
fn command(begins: &str) -> String {
    let mut commands = commands_to_run(|page| page == "docs/cameras.md").into_iter();
    let found = commands.find(|command| command.starts_with(begins));
    found.unwrap_or_else(|| panic!("docs/cameras.md has no command `{begins}`"))
}

/// Waits until the camera `gate` of the node at `http` has answered frames.
async fn until_frames(http: &str) {
    let address = format!("{http}/api/v1/cameras/gate");
    until("frames of the camera", async || {
        json_at(&address).await["frames"].as_u64() > Some(2)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "needs ONNX Runtime and ffmpeg and RTSP server"]
async fn the_node_of_the_camera_page_opens_its_camera_with_user_and_password() {
    let camera = RtspCamera::start("h264", &["viewer", "a b@c"]).await;
    let text = text("docs/cameras.md");
    let (_, config) = text.split_once("```toml\n").unwrap();
    let (config, _) = config.split_once("```").unwrap();
    assert_contains(config, &[ITS_CAMERA]);
    let config = config.replace(ITS_CAMERA, &format!("127.0.0.1:{}/stream", camera.port));
    let folder = workshop();
    std::fs::write(folder.path().join("node.toml"), config).unwrap();
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
async fn the_publisher_of_the_camera_page_sends_frames_to_a_remote_node() {
    let camera = RtspCamera::start("h264", &[]).await;
    let folder = workshop();
    let model = project("models/yolox_nano.onnx");
    let settings = "[[camera]]\nname = \"gate\"\n[node]\nname = \"car-7\"\n";
    let node = Node::start(&format!("detector.model = {model:?}\n{settings}")).await;
    let line = command("albireo publish ");
    assert_contains(&line, &[ITS_CAMERA, ITS_NODE]);
    let line = line
        .replace(ITS_CAMERA, &format!("127.0.0.1:{}/stream", camera.port))
        .replace(ITS_NODE, &node.zenoh);
    let mut publisher = shell(folder.path(), &line, &[]);
    until_frames(&node.http).await;
    publisher.kill().await.unwrap();
    camera.kill().await;
    // The help has the options that the page names.
    let help = run_line(folder.path(), "albireo publish --help", &[]).await;
    let page = text("docs/cameras.md");
    for option in page.split('`').filter(|quoted| quoted.starts_with("--")) {
        assert_contains(&help, &[option]);
    }
}
