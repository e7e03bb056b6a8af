//! Network cameras: a real RTSP server, and a motion JPEG server over HTTP.

use super::free_port;
use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::process::Child;

pub(crate) struct RtspCamera {
    child: Child,
    pub(crate) port: u16,
}

impl RtspCamera {
    /// A camera on a free port that sends `codec`: h264 or jpeg.
    pub(crate) async fn start(codec: &str, login: &[&str]) -> Self {
        Self::start_at(free_port(), codec, login).await
    }

    pub(crate) async fn start_at(port: u16, codec: &str, login: &[&str]) -> Self {
        let at = port.to_string();
        let arguments = [&[&*at, codec][..], login].concat();
        let (child, _) = super::client("/usr/bin/python3", "rtsp_camera.py", &arguments).await;
        Self { child, port }
    }

    pub(crate) fn address(&self) -> String {
        format!("rtsp://127.0.0.1:{}/stream", self.port)
    }

    pub(crate) async fn kill(mut self) {
        self.child.kill().await.expect("the camera can be killed");
    }
}

pub(crate) struct MotionJpegCamera {
    pub(crate) address: String,
    requests: Arc<Mutex<Vec<String>>>,
}

impl MotionJpegCamera {
    /// A camera that sends these parts to each client, again and again, a hundred per second.
    pub(crate) async fn start(parts: Vec<Vec<u8>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("its address");
        let requests = Arc::new(Mutex::new(Vec::new()));
        let noted = Arc::clone(&requests);
        tokio::spawn(async move {
            while let Ok((mut client, _)) = listener.accept().await {
                let parts = parts.clone();
                let noted = Arc::clone(&noted);
                tokio::spawn(async move {
                    let mut request = [0; 4096];
                    let length = client.read(&mut request).await.unwrap_or(0);
                    let request = String::from_utf8_lossy(&request[..length]).into_owned();
                    noted.lock().expect("no test failed").push(request);
                    let head = "HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=cut\r\n\r\n";
                    if client.write_all(head.as_bytes()).await.is_ok() {
                        // It fails when the client disconnects.
                        let _ = play(&mut client, &parts).await;
                    }
                });
            }
        });
        Self {
            address: format!("http://{address}/video.mjpg"),
            requests,
        }
    }

    pub(crate) fn requests(&self) -> Vec<String> {
        self.requests.lock().expect("no test failed").clone()
    }
}

async fn play(client: &mut TcpStream, parts: &[Vec<u8>]) -> io::Result<()> {
    for part in parts.iter().cycle() {
        let length = part.len();
        let head = format!("--cut\r\nContent-Type: image/jpeg\r\nContent-Length: {length}\r\n\r\n");
        let whole = [head.as_bytes(), part, b"\r\n"].concat();
        client.write_all(&whole).await?;
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    Ok(())
}
