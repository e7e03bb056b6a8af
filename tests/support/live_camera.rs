//! Cameras as a network has them: a real RTSP server, and one that sends motion JPEG by HTTP.

use super::{PATIENCE, free_port};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpListener;
use tokio::process::{Child, Command};
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// GStreamer's RTSP server.
pub(crate) struct RtspCamera {
    child: Child,
    pub(crate) port: u16,
}

impl RtspCamera {
    /// A camera on a free port that sends `codec`: h264 or jpeg.
    pub(crate) async fn start(codec: &str, login: &[&str]) -> Self {
        Self::start_at(free_port(), codec, login).await
    }

    /// The same on a port of one's own.
    pub(crate) async fn start_at(port: u16, codec: &str, login: &[&str]) -> Self {
        let mut child = Command::new("/usr/bin/python3")
            .arg(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/tests/clients/rtsp_camera.py"
            ))
            .args([&port.to_string(), codec])
            .args(login)
            .kill_on_drop(true)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("Debian's Python starts");
        let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let line = timeout(PATIENCE, lines.next_line()).await;
        let line = line
            .expect("the camera is there in time")
            .expect("its output");
        assert_eq!(line.as_deref(), Some("ready"), "run `make debian`");
        Self { child, port }
    }

    /// Cuts its power.
    pub(crate) async fn kill(mut self) {
        self.child.kill().await.expect("the camera can be killed");
    }
}

/// A camera that sends one JPEG file again and again by HTTP.
pub(crate) struct MotionJpegCamera {
    pub(crate) address: String,
    clients: Arc<AtomicU64>,
    serving: JoinHandle<()>,
}

impl MotionJpegCamera {
    /// A camera that sends `picture` every `period`.
    pub(crate) async fn start(picture: Vec<u8>, period: Duration) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("its address");
        let clients = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&clients);
        let serving = tokio::spawn(async move {
            while let Ok((mut client, _)) = listener.accept().await {
                counted.fetch_add(1, Ordering::SeqCst);
                let picture = picture.clone();
                tokio::spawn(async move {
                    let mut request = [0; 1024];
                    let _ = client.read(&mut request).await;
                    let head = "HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=cut\r\n\r\n";
                    let part = format!(
                        "--cut\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n",
                        picture.len()
                    );
                    let mut out = client.write_all(head.as_bytes()).await;
                    while out.is_ok() {
                        let whole = [part.as_bytes(), &picture, b"\r\n"].concat();
                        out = client.write_all(&whole).await;
                        tokio::time::sleep(period).await;
                    }
                });
            }
        });
        Self {
            address: format!("http://{address}/video.mjpg"),
            clients,
            serving,
        }
    }

    /// How many clients came so far.
    pub(crate) fn clients(&self) -> u64 {
        self.clients.load(Ordering::SeqCst)
    }
}

impl Drop for MotionJpegCamera {
    fn drop(&mut self) {
        self.serving.abort();
    }
}
