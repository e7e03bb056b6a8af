//! Runs the demonstration's hub in the same process, with its history in a temporary folder.

use albireo_hub::config::HubConfig;
use albireo_service::config::{Configuration, ZenohMode};
use anyhow::{Context, bail};
use std::fs::Permissions;
use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// A running hub. It outlives the node, so that the last clip reaches it.
pub(super) struct DemoHub {
    address: SocketAddr,
    stop: CancellationToken,
    running: JoinHandle<Result<(), albireo_hub::HubError>>,
    _folder: TempDir,
}

impl DemoHub {
    /// Starts a hub on `listener` that connects to the node at `node`. If it stops by itself, it ends the
    /// demonstration.
    pub(super) fn start(
        listener: TcpListener,
        node: &str,
        demonstration: CancellationToken,
    ) -> anyhow::Result<Self> {
        let address = listener.local_addr()?;
        let folder = tempfile::Builder::new()
            .prefix("albireo-demo-")
            .permissions(Permissions::from_mode(0o700))
            .tempdir()
            .context("the folder of the hub's database cannot be created")?;
        let mut config = HubConfig::default();
        config.zenoh.mode = ZenohMode::Peer;
        config.zenoh.connect = vec![node.to_owned()];
        config.zenoh.listen = Vec::new();
        config.database.url = format!("sqlite:{}", folder.path().join("hub.db").display());
        if let Some(problem) = config.findings().into_iter().next() {
            bail!("{problem}");
        }
        let stop = CancellationToken::new();
        let stopped = stop.clone();
        let running = tokio::spawn(async move {
            let ended = albireo_hub::run(&config, listener, stopped).await;
            demonstration.cancel();
            ended
        });
        Ok(Self {
            address,
            stop,
            running,
            _folder: folder,
        })
    }

    /// Prints its address, and how to query it.
    pub(super) fn banner(&self) {
        let address = self.address;
        println!("  hub      curl http://{address}/api/v1/clips");
        println!("  fleet    albireo fleet --hub http://{address} ls");
    }

    /// Stops the hub after it has committed all reports.
    pub(super) async fn stop(self) -> anyhow::Result<()> {
        self.stop.cancel();
        self.running.await.context("hub")?.context("hub")
    }
}
