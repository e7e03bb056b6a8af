//! `albireo demo`: runs a camera, a node and a hub in one process over real Zenoh sessions, with live output.

mod show;

use super::frames::{FrameSender, Pacing, close, open_session};
use super::replay::{PublishOptions, publish};
use albireo_eval::footage::{FrameSource, SourceName, VideoEncoding};
use albireo_hub::config::HubConfig;
use albireo_node::PreparedNode;
use albireo_node::config::{CameraConfig, NodeConfig};
use albireo_service::config::{Configuration, LogConfig, ZenohMode};
use albireo_service::{logging, signals};
use anyhow::{Context, bail};
use show::Show;
use std::fs::Permissions;
use std::io::ErrorKind;
use std::net::Ipv4Addr;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// The camera of the demonstration.
const CAMERA: &str = "dashcam";

/// Longest wait of the camera for the node, whose model is loaded and warmed up first.
const PATIENCE: Duration = Duration::from_secs(60);

/// Arguments of `albireo demo`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  albireo demo                      until Ctrl-C
  albireo demo --seconds 60         one minute, then a summary
  albireo demo --u 1e-3             a higher threshold
  albireo demo --clip drive.mp4     your own road; needs ffmpeg
  albireo demo --policy expected-loss:0.5
                                    our own policy, a detector call priced at
                                    0.5
  albireo demo --port 8081          where another program has port 8080

It prints the addresses of its pages, and commands to try in another terminal.")]
pub(super) struct DemoArguments {
    /// Stop this many seconds after the camera starts [default: run until Ctrl-C]
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<u64>,
    /// Frames per second [default: the clip's own, 25 for `demo`]
    #[arg(long, value_name = "FPS", value_parser = super::values::parse_rate)]
    rate: Option<f64>,
    /// A video file, a folder of pictures, or a tar archive of such folders; `demo` is demo/road.tar
    #[arg(long, value_name = "FILE", default_value = "demo")]
    clip: SourceName,
    /// The policy, with the value of its threshold if not the default
    #[arg(long, value_name = "NAME[:VALUE]", default_value = "albireo")]
    policy: String,
    /// Uncertainty threshold at the start
    #[arg(long)]
    u: Option<f64>,
    /// The detector, an ONNX file
    #[arg(
        long,
        alias = "model",
        value_name = "FILE",
        default_value = "models/yolox_nano.onnx"
    )]
    detector: PathBuf,
    /// Port of the HTTP interface; if it is in use, another free one
    #[arg(long, default_value_t = 8080)]
    port: u16,
    /// Port of the hub's HTTP interface; if it is in use, another free one
    #[arg(long, default_value_t = 8090)]
    hub_port: u16,
}

/// Runs the demonstration.
///
/// # Errors
/// When a part cannot start.
pub(super) async fn run(arguments: DemoArguments) -> anyhow::Result<()> {
    logging::start(&LogConfig {
        // A warning, even from a library, would break the table. The summary counts the dropped frames.
        level: "error,tower_http=off,zenoh=off,zenoh_transport=off,zenoh_link=off,zenoh_ext=off,ort=off,hyper=off"
            .to_owned(),
        ..LogConfig::default()
    })?;
    let shutdown = signals::shutdown()?;
    let clip = arguments.clip.open(arguments.rate, VideoEncoding::default())?;
    let mut moved = Vec::new();
    let listener = listen("page", arguments.port, &mut moved).await?;
    let hub_listener = listen("fleet's page", arguments.hub_port, &mut moved).await?;
    // Only finds a free port: it is closed again, so that the node's session can listen there.
    let free = listen("camera", 7447, &mut moved).await?;
    let endpoint = format!("tcp/{}", free.local_addr()?);
    drop(free);
    let page = listener.local_addr()?;
    let hub_page = hub_listener.local_addr()?;
    let mut config = configuration(&arguments, &endpoint)?;
    let labels = &mut config.node.labels;
    labels.insert("page".to_owned(), format!("http://{page}/"));
    labels.insert("hub".to_owned(), format!("http://{hub_page}/"));
    let prepared = PreparedNode::new(&config)?;
    println!(
        "loading {}: seconds on a PC, up to a minute on a board",
        config.detector.model.display()
    );
    let show = Show::new(prepared.board(), shutdown.clone());
    // Printed once the node works: before, an error may be all there is to say.
    let banner = show.banner(&config, page, hub_page, &moved);

    // Each part is a task: opening a Zenoh session blocks its thread, and no part may wait for another.
    // The part that ends first ends the others.
    let stop_hub = CancellationToken::new();
    let hub_task = tokio::spawn(ending(
        shutdown.clone(),
        hub(hub_listener, endpoint.clone(), stop_hub.clone()),
    ));
    let node_config = config.clone();
    let node_shutdown = shutdown.clone();
    let node = async move {
        albireo_node::run(&node_config, Some(prepared), listener, node_shutdown).await
    };
    let node_task = tokio::spawn(ending(shutdown.clone(), node));
    let camera_task = tokio::spawn(ending(
        shutdown.clone(),
        camera(clip, arguments, config, endpoint, banner, shutdown.clone()),
    ));
    let show_task = tokio::spawn(show.run());
    let node_ended = node_task.await.context("node")?;
    let camera_ended = camera_task.await.context("camera")?;
    let summary = show_task.await.context("output")?;
    // The hub ends last, so that the last clip has arrived.
    stop_hub.cancel();
    let hub_ended = hub_task.await.context("hub")?;
    camera_ended?;
    node_ended?;
    hub_ended?;
    summary.print();
    Ok(())
}

/// Runs a part of the demonstration; its end ends the others by `shutdown`.
async fn ending<T>(shutdown: CancellationToken, work: impl Future<Output = T>) -> T {
    let ended = work.await;
    shutdown.cancel();
    ended
}

/// Opens a listener on this port of the loopback interface, or else on any free one, and then notes in `moved` which
/// and why.
async fn listen(whose: &str, port: u16, moved: &mut Vec<String>) -> anyhow::Result<TcpListener> {
    let error = match TcpListener::bind((Ipv4Addr::LOCALHOST, port)).await {
        Ok(listener) => return Ok(listener),
        Err(error) => error,
    };
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
        .await
        .context("no port of the loopback interface can be listened on")?;
    let why = match error.kind() {
        ErrorKind::AddrInUse => "is in use, by another demo or node perhaps".to_owned(),
        _ => format!("cannot be listened on ({error})"),
    };
    let instead = listener.local_addr()?.port();
    moved.push(format!("port {port} {why}: the {whose} has port {instead}"));
    Ok(listener)
}

fn configuration(arguments: &DemoArguments, endpoint: &str) -> anyhow::Result<NodeConfig> {
    let mut config = NodeConfig::default();
    config.node.name = "demo".to_owned();
    config.zenoh.listen = vec![endpoint.to_owned()];
    // In a demonstration each clip should arrive immediately.
    config.outbox.gather_s = 0;
    config.uplink.pictures = true;
    config.detector.model.clone_from(&arguments.detector);
    config.policy.select(&arguments.policy)?;
    if let Some(u) = arguments.u {
        config.policy.u = u;
    }
    config.cameras = vec![CameraConfig::named(CAMERA)];
    if !config.detector.model.exists() {
        bail!(
            "{} does not exist: run the demo in the project's folder, or set a detector with --detector",
            config.detector.model.display()
        );
    }
    if let Some(problem) = config.findings().into_iter().next() {
        bail!("{problem}");
    }
    Ok(config)
}

/// Runs a hub that connects to the node at `endpoint`, with its history in a temporary folder, until `stop`. All
/// reports that it received are committed before it ends.
async fn hub(
    listener: TcpListener,
    endpoint: String,
    stop: CancellationToken,
) -> anyhow::Result<()> {
    let folder = tempfile::Builder::new()
        .prefix("albireo-demo-")
        .permissions(Permissions::from_mode(0o700))
        .tempdir()
        .context("the folder of the hub's database cannot be created")?;
    let mut config = HubConfig::default();
    config.zenoh.mode = ZenohMode::Peer;
    config.zenoh.connect = vec![endpoint];
    config.zenoh.listen = Vec::new();
    config.database.url = format!("sqlite:{}", folder.path().join("hub.db").display());
    albireo_hub::run(&config, listener, stop).await.context("hub")
}

/// Plays the camera until `shutdown`, and prints the `banner` when the node takes its frames. Where `--seconds` limits
/// the demonstration, cancels `shutdown` that long after the banner.
async fn camera(
    clip: Box<dyn FrameSource>,
    arguments: DemoArguments,
    config: NodeConfig,
    endpoint: String,
    banner: String,
    shutdown: CancellationToken,
) -> anyhow::Result<()> {
    let options = PublishOptions {
        rate: arguments.rate,
        repeat: true,
        ..PublishOptions::default()
    };
    let key = config.keys()?.camera(CAMERA)?.frame();
    let playing = async {
        let session = open_session(&[endpoint], &[], PATIENCE).await?;
        let sender = FrameSender::declare(&session, &key, Pacing::Drop).await?;
        sender.wait_for_receiver(PATIENCE).await?;
        show::print(&banner, &shutdown);
        if let Some(seconds) = arguments.seconds {
            let shutdown = shutdown.clone();
            tokio::spawn(async move {
                tokio::time::sleep(Duration::from_secs(seconds)).await;
                shutdown.cancel();
            });
        }
        let send = |frame| sender.send(frame);
        publish(clip, send, &options, |_| {}, &shutdown).await?;
        close(session).await
    };
    let played = shutdown.run_until_cancelled(playing).await;
    match played {
        Some(ended) => ended.context("camera"),
        None => Ok(()),
    }
}
