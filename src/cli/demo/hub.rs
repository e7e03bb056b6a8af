//! The demonstration's hub: in the same process, with its history in a temporary folder that goes with it.

use albireo_hub::config::HubConfig;
use albireo_service::config::{Configuration, ZenohMode};
use anyhow::{Context, bail};
use std::net::SocketAddr;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// A running hub. It outlives the node, so that the last clip reaches it.
pub(super) struct DemoHub {
    address: SocketAddr,
    stop: CancellationToken,
    running: JoinHandle<Result<(), albireo_hub::HubError>>,
    _folder: Folder,
}

impl DemoHub {
    /// Starts a hub on `listener` that talks to the node at `node`. When it ends by itself, it ends the demonstration.
    pub(super) fn start(
        listener: TcpListener,
        node: &str,
        demonstration: CancellationToken,
    ) -> anyhow::Result<Self> {
        let address = listener.local_addr()?;
        let folder = Folder::make()?;
        let mut config = HubConfig::default();
        config.zenoh.mode = ZenohMode::Peer;
        config.zenoh.connect = vec![node.to_owned()];
        config.zenoh.listen = Vec::new();
        config.database.url = format!("sqlite:{}", folder.0.join("hub.db").display());
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

    /// Where its interface is.
    pub(super) const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Lets it commit what it has, and ends it.
    pub(super) async fn stop(self) -> anyhow::Result<()> {
        self.stop.cancel();
        self.running.await.context("hub")?.context("hub")
    }
}

/// A folder of this process alone, removed in the end.
struct Folder(PathBuf);

impl Folder {
    fn make() -> anyhow::Result<Self> {
        let mut builder = std::fs::DirBuilder::new();
        builder.mode(0o700);
        let base = std::env::temp_dir();
        // A folder that is there already may be somebody else's: it is left alone.
        for number in 0..1000 {
            let path = base.join(format!("albireo-demo-{}-{number}", std::process::id()));
            match builder.create(&path) {
                Ok(()) => return Ok(Self(path)),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error).context(in_words(&path)),
            }
        }
        bail!(in_words(&base))
    }
}

fn in_words(path: &Path) -> String {
    format!("no folder for the hub's database: {}", path.display())
}

impl Drop for Folder {
    fn drop(&mut self) {
        // The database's last connection may still be taking its files away.
        for _ in 0..20 {
            match std::fs::remove_dir_all(&self.0) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    std::thread::sleep(Duration::from_millis(50));
                }
                _ => return,
            }
        }
    }
}
