//! An RTSP camera with faults: it sends H.264 inside its connection (RFC 2326, RFC 6184).

use std::io::{self, BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Frames per second that it sends.
pub(super) const RATE: f64 = 15.0;
/// Ticks of RTP time per second.
const TICKS: f64 = 90_000.0;

/// The NAL units of a picture.
type Picture = Vec<Vec<u8>>;

/// A camera's faults.
#[derive(Clone)]
pub(super) struct Faults {
    /// The time stamped on the frame with that number, seconds.
    pub stamp: fn(u64) -> f64,
    /// Packets left out, in a thousand.
    pub lost: u64,
    /// Key frames are left out for this long.
    pub no_key_frame: Duration,
    /// The request that it does not answer, or `media`.
    pub silent_at: &'static str,
    /// True if it has only sound.
    pub only_sound: bool,
    /// The header with which it refuses every login.
    pub refuses: Option<&'static str>,
}

impl Default for Faults {
    fn default() -> Self {
        Self {
            stamp: |frame| frame as f64 / RATE,
            lost: 0,
            no_key_frame: Duration::ZERO,
            silent_at: "",
            only_sound: false,
            refuses: None,
        }
    }
}

/// A running camera.
pub(super) struct Camera {
    pub address: String,
    /// The requests with a login.
    pub logins: Arc<AtomicU64>,
}

/// Encodes moving boxes as H.264, with a key frame every `key_frames` frames.
pub(super) fn film(source: &[&str], key_frames: &str) -> Vec<Picture> {
    let output = Command::new("ffmpeg")
        .args(["-v", "error"])
        .args(source)
        .args([
            "-c:v", "libx264", "-preset", "veryfast", "-bf", "0", "-g", key_frames,
        ])
        .args([
            "-x264-params",
            "aud=1:scenecut=0",
            "-pix_fmt",
            "yuv420p",
            "-f",
            "h264",
            "pipe:1",
        ])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let bytes = output.stdout;
    let starts: Vec<_> =
        (0..bytes.len() - 3).filter(|at| bytes[*at..].starts_with(&[0, 0, 1])).collect();
    let ends = starts.iter().skip(1).copied().chain([bytes.len()]);
    let mut pictures: Vec<Picture> = Vec::new();
    for (start, end) in starts.iter().zip(ends) {
        let padded = &bytes[start + 3..end];
        let padding = padded.iter().rev().take_while(|byte| **byte == 0).count();
        let unit = &padded[..padded.len() - padding];
        // An access unit delimiter begins a picture.
        match kind(unit) {
            9 => pictures.push(Vec::new()),
            _ => pictures.last_mut().unwrap().push(unit.to_vec()),
        }
    }
    pictures
}

fn kind(unit: &[u8]) -> u8 {
    unit[0] & 31
}

impl Camera {
    /// A camera that plays the film in a loop, from the beginning for each client.
    pub(super) fn start(film: &Arc<Vec<Picture>>, faults: Faults) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("rtsp://{}/stream", listener.local_addr().unwrap());
        let logins = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&logins);
        let film = Arc::clone(film);
        thread::spawn(move || {
            for client in listener.incoming() {
                let film = Arc::clone(&film);
                let faults = faults.clone();
                let counted = Arc::clone(&counted);
                // It ends when the client leaves.
                thread::spawn(move || serve(client?, &film, &faults, &counted));
            }
        });
        Self { address, logins }
    }
}

fn serve(
    mut client: TcpStream,
    film: &[Picture],
    faults: &Faults,
    logins: &AtomicU64,
) -> io::Result<()> {
    client.set_nodelay(true)?;
    let mut requests = BufReader::new(client.try_clone()?);
    loop {
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            if requests.read_line(&mut head)? == 0 {
                return Ok(());
            }
        }
        let method = head.split(' ').next().unwrap_or_default();
        let header = |name: &str| {
            let line = head.lines().find(|line| line.starts_with(name));
            line.and_then(|line| line.split_once(": ")).map_or("", |(_, value)| value)
        };
        let number = header("CSeq");
        if head.contains("Authorization: ") {
            logins.fetch_add(1, Ordering::Relaxed);
        }
        if method == faults.silent_at {
            continue;
        }
        let (status, more, body) = match (method, faults.refuses) {
            ("DESCRIBE", Some(offer)) => (
                "401 Unauthorized",
                format!("WWW-Authenticate: {offer}\r\n"),
                String::new(),
            ),
            ("DESCRIBE", None) => {
                let body = description(film, faults.only_sound);
                let kind = "Content-Type: application/sdp\r\n";
                (
                    "200 OK",
                    format!("{kind}Content-Length: {}\r\n", body.len()),
                    body,
                )
            }
            ("SETUP", _) => {
                let transport = header("Transport");
                (
                    "200 OK",
                    format!("Session: 1\r\nTransport: {transport}\r\n"),
                    String::new(),
                )
            }
            _ => ("200 OK", "Session: 1\r\n".to_owned(), String::new()),
        };
        write!(
            client,
            "RTSP/1.0 {status}\r\nCSeq: {number}\r\n{more}\r\n{body}"
        )?;
        if method == "PLAY" && faults.silent_at != "media" && !faults.only_sound {
            return play(&mut client, film, faults);
        }
    }
}

fn description(film: &[Picture], only_sound: bool) -> String {
    let head =
        "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=cam\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\na=control:*\r\n";
    if only_sound {
        return format!(
            "{head}m=audio 0 RTP/AVP 0\r\na=rtpmap:0 PCMU/8000\r\na=control:track1\r\n"
        );
    }
    let set = |wanted| film[0].iter().find(|unit| kind(unit) == wanted).unwrap();
    let sets = format!("{},{}", base64(set(7)), base64(set(8)));
    format!(
        "{head}m=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\n\
         a=fmtp:96 packetization-mode=1;sprop-parameter-sets={sets}\r\na=control:track1\r\n"
    )
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut letters = String::new();
    for chunk in bytes.chunks(3) {
        let read = chunk.iter().fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte));
        let bits = read << (8 * (3 - chunk.len()));
        for place in 0..4 {
            let letter = if place <= chunk.len() {
                char::from(LETTERS[(bits >> (18 - 6 * place)) as usize & 63])
            } else {
                '='
            };
            letters.push(letter);
        }
    }
    letters
}

fn play(client: &mut TcpStream, film: &[Picture], faults: &Faults) -> io::Result<()> {
    let begun = Instant::now();
    let mut packets = 0_u64;
    for (frame, picture) in film.iter().cycle().enumerate() {
        let due = Duration::from_secs_f64(frame as f64 / RATE);
        thread::sleep(due.saturating_sub(begun.elapsed()));
        let ticks = ((faults.stamp)(frame as u64) * TICKS) as i64 as u32;
        if due < faults.no_key_frame && picture.iter().any(|unit| kind(unit) == 5) {
            continue;
        }
        let fragments: Vec<Vec<u8>> = picture.iter().flat_map(|unit| fragments(unit)).collect();
        for (place, payload) in fragments.iter().enumerate() {
            packets += 1;
            // Spread as by chance, and the same in each run.
            let chance = (packets.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32) & 0x3FF;
            if chance < faults.lost {
                continue;
            }
            let marker = if place + 1 == fragments.len() {
                0x80
            } else {
                0
            };
            let mut packet = vec![b'$', 0];
            packet.extend(u16::try_from(payload.len() + 12).unwrap().to_be_bytes());
            packet.extend([0x80, marker | 96]);
            packet.extend((packets as u16).to_be_bytes());
            packet.extend(ticks.to_be_bytes());
            packet.extend(7_u32.to_be_bytes());
            packet.extend(payload);
            client.write_all(&packet)?;
        }
    }
    Ok(())
}

/// A NAL unit as the payloads of packets: whole, or in fragments (FU-A).
fn fragments(unit: &[u8]) -> Vec<Vec<u8>> {
    const MOST: usize = 1400;
    if unit.len() <= MOST {
        return vec![unit.to_vec()];
    }
    let parts: Vec<_> = unit[1..].chunks(MOST).collect();
    let last = parts.len() - 1;
    let fragment = |(place, part): (usize, &&[u8])| {
        let begin = if place == 0 { 0x80 } else { 0 };
        let end = if place == last { 0x40 } else { 0 };
        let indicator = (unit[0] & 0xE0) | 28;
        let header = begin | end | kind(unit);
        [&[indicator, header], *part].concat()
    };
    parts.iter().enumerate().map(fragment).collect()
}
