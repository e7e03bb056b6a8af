//! Cameras that send pictures over HTTP, each in its own form.

use super::{Open, SourceEvent, camera};
use crate::config::CameraConfig;
use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use albireo_vision::picture::{FrameLimits, Picture, PixelLayout, decode};
use std::fs;
use std::io::{self, BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::Duration;

/// Frames per second of the cameras.
const RATE: u64 = 20;

/// The beginning of a multipart stream with the boundary `cut`.
const MULTIPART: &[u8] =
    b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=cut\r\n\r\n";

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
    client.write_all(MULTIPART)?;
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
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("snap.png");
    let status = Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi", "-i", "testsrc2=size=320x180"])
        .args(["-frames:v", "1"])
        .arg(&file)
        .status()
        .unwrap();
    assert!(status.success());
    let png = fs::read(&file).unwrap();
    let server = serve(move |path, client| {
        let picture = if path.ends_with(".png") {
            png.clone()
        } else {
            picture()
        };
        client.write_all(b"HTTP/1.1 200 OK\r\nConnection: close\r\n")?;
        if !path.starts_with("/no-length") {
            write!(client, "Content-Length: {}\r\n", picture.len())?;
        }
        client.write_all(b"\r\n")?;
        client.write_all(&picture)
    });
    let with_login = server.replace("http://", "http://viewer:hidden@");
    let addresses = [
        format!("{server}/snap"),
        format!("{server}/snap.jpg"),
        format!("{server}/snap.JPEG"),
        format!("{server}/no-length"),
        format!("{server}/no-length.jpg"),
        format!("{server}/snap.png"),
        format!("{with_login}/snap.jpg"),
        format!("{with_login}/no-length.jpg"),
    ];
    let runs = addresses.map(|address| {
        tokio::spawn(async move {
            let config = CameraConfig {
                max_rate: Some(0.5),
                ..camera(&address)
            };
            let mut source = Open::new(config).await;
            let taken = source.rates(Duration::from_secs(16)).await.taken;
            source.stop().await;
            (address, taken)
        })
    });
    for run in runs {
        let (address, taken) = run.await.unwrap();
        println!("{address}: {taken:.2} pictures per second");
        // A busy machine fetches fewer.
        assert!((0.2..=0.65).contains(&taken), "{address}: {taken}");
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn half_a_picture_is_not_taken_for_a_whole_one_whatever_its_address_ends_in() {
    let server = serve(|_, client| {
        let picture = picture();
        let length = picture.len();
        write!(
            client,
            "HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
        )?;
        client.write_all(&picture[..length / 2])
    });
    for path in ["/snap", "/snap.jpg"] {
        let mut source = Open::at(&format!("{server}{path}")).await;
        let SourceEvent::Picture(taken) = source.next().await else {
            panic!("{path}: no picture");
        };
        let picture = taken.picture.unwrap();
        let limits = FrameLimits::default();
        let mut decoded = Picture::default();
        let is_decoded = decode(&picture, &limits, PixelLayout::Rgb8, None, &mut decoded).is_ok();
        assert!(!is_decoded, "{path}");
        source.stop().await;
    }
}

/// Writes a part of a multipart stream with the boundary `cut`.
fn write_part(client: &mut TcpStream, kind: &str, content: &[u8]) -> io::Result<()> {
    let length = content.len();
    write!(
        client,
        "--cut\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n\r\n"
    )?;
    client.write_all(content)?;
    client.write_all(b"\r\n")
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn text_between_the_pictures_of_motion_jpeg_is_passed_over() {
    let server = serve(|_, client| {
        client.write_all(MULTIPART)?;
        loop {
            write_part(client, "image/jpeg", &picture())?;
            write_part(client, "text/plain", b"motion=1")?;
            thread::sleep(Duration::from_millis(1000 / RATE));
        }
    });
    let with_login = server.replace("http://", "http://viewer:hidden@");
    for server in [server, with_login] {
        let mut source = Open::at(&format!("{server}/mixed.mjpg")).await;
        let taken = source.rates(Duration::from_secs(5)).await.taken;
        // One picture for each connection would be one per second; a busy machine sends fewer than twenty.
        assert!(taken >= 3.0, "{server}: {taken} per second");
        source.stop().await;
    }
}

/// Answers as servers do that are no camera.
fn no_pictures(path: &str, client: &mut TcpStream) -> io::Result<()> {
    match path {
        "/page" => client
            .write_all(b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<html>Log in!</html>"),
        "/nothing" => client.write_all(b"HTTP/1.1 204 No Content\r\n\r\n"),
        "/elsewhere" => client.write_all(b"HTTP/1.1 302 Found\r\nLocation: /elsewhere\r\n\r\n"),
        _ => {
            client.write_all(MULTIPART)?;
            // As many as ffmpeg looks at.
            for _ in 0..1000 {
                write_part(client, "text/html", b"<html>busy</html>")?;
            }
            Ok(())
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn an_answer_without_pictures_is_told_by_what_it_is() {
    let server = serve(no_pictures);
    for (path, said) in [
        (
            "/page",
            "it answers text/html: a web page, not the camera's stream",
        ),
        ("/nothing", "it answers 204 No Content: no picture"),
        ("/elsewhere", "it answers 302 Found: it sends to another"),
        (
            "/busy",
            "its parts are text/html, and only JPEG pictures can be read",
        ),
    ] {
        let mut source = Open::at(&format!("{server}{path}")).await;
        let (reason, _) = source.failure().await;
        assert!(reason.starts_with(said), "{path}: {reason}");
        source.stop().await;
    }
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

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_recording_on_a_server_that_is_cut_short_says_so_when_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("drive.mp4");
    let status = Command::new("ffmpeg")
        .args(["-v", "error", "-f", "lavfi"])
        .args(["-i", "testsrc2=size=320x180:rate=15:duration=4"])
        .args(["-c:v", "libx264", "-movflags", "faststart"])
        .arg(&file)
        .status()
        .unwrap();
    assert!(status.success());
    let whole = fs::read(&file).unwrap();
    fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    let server = serve_folder(folder.path());
    let mut source = Open::at(&format!("{server}/drive.mp4")).await;
    let mut pictures = 0;
    let reason = loop {
        match source.next().await {
            SourceEvent::Picture(_) => pictures += 1,
            SourceEvent::Failed { reason, .. } => break reason,
            SourceEvent::PassedOver(file) => panic!("passed over {file}"),
        }
        assert!(pictures < 60, "it has begun again");
    };
    assert!(pictures > 0, "{reason}");
    assert!(reason.starts_with("it is cut short"), "{reason}");
    source.stop().await;
}
