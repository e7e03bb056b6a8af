//! Cameras that send pictures over HTTP, each in its own form.

use super::{Open, camera};
use crate::config::CameraConfig;
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use std::fs;
use std::io::{self, BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::Duration;

/// Frames per second of the cameras.
const RATE: u64 = 20;

fn picture() -> Vec<u8> {
    BoxScene::new(3, PictureSize::new(320, 180)).frame(0).jpeg(80).unwrap()
}

/// Answers each request on a free port with `answer`, which gets the path. Returns the address.
fn serve(
    answer: impl Fn(&str, &mut TcpStream) -> io::Result<()> + Clone + Send + 'static,
) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        for client in listener.incoming() {
            let answer = answer.clone();
            // It ends when the client leaves.
            thread::spawn(move || {
                let mut client = client?;
                let mut head = String::new();
                let mut request = BufReader::new(client.try_clone()?);
                while !head.ends_with("\r\n\r\n") {
                    if request.read_line(&mut head)? == 0 {
                        break;
                    }
                }
                let path = head.split(' ').nth(1).unwrap_or_default();
                answer(path, &mut client)
            });
        }
    });
    address
}

/// Motion JPEG as five kinds of servers write it.
fn motion_jpeg(path: &str, client: &mut TcpStream) -> io::Result<()> {
    let picture = picture();
    let length = picture.len();
    client.write_all(
        b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=cut\r\n\r\n",
    )?;
    for frame in 0_u64.. {
        let kind = match path.split('?').next().unwrap_or_default() {
            "/jpg" => "Content-Type: image/jpg\r\n",
            "/parameter" => "Content-Type: image/jpeg; charset=utf-8\r\n",
            "/no-type" => "",
            _ => "Content-Type: image/jpeg\r\n",
        };
        let boundary = if path.starts_with("/no-boundary") && frame == 0 {
            ""
        } else {
            "--cut\r\n"
        };
        let length = if path.starts_with("/too-short") {
            length - 300
        } else {
            length
        };
        write!(client, "{boundary}{kind}Content-Length: {length}\r\n\r\n")?;
        client.write_all(&picture)?;
        client.write_all(b"\r\n")?;
        thread::sleep(Duration::from_millis(1000 / RATE));
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn motion_jpeg_is_read_in_every_form_that_servers_give_it() {
    let server = serve(motion_jpeg);
    for path in [
        "/right",
        "/jpg",
        "/parameter",
        "/no-type",
        "/no-boundary",
        "/too-short",
    ] {
        let login = "http://viewer:hidden@";
        for server in [server.clone(), server.replace("http://", login)] {
            let mut source = Open::at(&format!("{server}{path}?a=1,2")).await;
            for taken in source.pictures(20).await {
                let size = taken.picture.size;
                assert_eq!(size, PictureSize::new(320, 180), "{server}{path}");
            }
            source.stop().await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn an_address_of_one_picture_is_fetched_at_the_rate_asked_for() {
    let server = serve(|_, client| {
        let picture = picture();
        let length = picture.len();
        write!(
            client,
            "HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
        )?;
        client.write_all(&picture)
    });
    let config = CameraConfig {
        max_rate: Some(2.0),
        ..camera(&format!("{server}/snap.jpg"))
    };
    let mut source = Open::new(config).await;
    let taken = source.rates(Duration::from_secs(10)).await.taken;
    println!("{taken:.2} pictures per second");
    // A busy machine fetches fewer.
    assert!((0.5..=2.2).contains(&taken), "{taken} per second");
    source.stop().await;
}

/// Serves the files of a folder.
fn serve_folder(folder: &Path) -> String {
    let folder = folder.to_owned();
    serve(move |path, client| {
        let file = fs::read(folder.join(path.trim_start_matches('/')))?;
        let length = file.len();
        write!(
            client,
            "HTTP/1.1 200 OK\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
        )?;
        client.write_all(&file)
    })
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn recordings_and_segments_on_a_server_are_played_at_their_own_pace() {
    let folder = tempfile::tempdir().unwrap();
    let film = "testsrc2=size=320x180:rate=15:duration=6";
    for output in [
        &["-movflags", "faststart", "drive.mp4"][..],
        &["-hls_time", "2", "-hls_list_size", "0", "live.m3u8"],
    ] {
        let status = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi", "-i", film])
            .args(["-c:v", "libx264", "-g", "30"])
            .args(output)
            .current_dir(folder.path())
            .status()
            .unwrap();
        assert!(status.success(), "{output:?}");
    }
    let server = serve_folder(folder.path());
    for file in ["drive.mp4", "live.m3u8"] {
        let mut source = Open::at(&format!("{server}/{file}")).await;
        let taken = source.rates(Duration::from_secs(5)).await.taken;
        println!("{file}: {taken:.2} pictures per second");
        // Read as fast as possible they would be hundreds; a busy machine plays more slowly.
        assert!((3.0..=16.5).contains(&taken), "{file}: {taken} per second");
        source.stop().await;
    }
    // A recording begins again when it ends.
    let mut source = Open::at(&format!("{server}/drive.mp4")).await;
    source.pictures(110).await;
    source.stop().await;
}
