//! Reads the messages of a program that opens a source: why it fails, what the source sends, how far the connection has
//! come, and which pictures are broken.

use super::secrets::Secrets;
use crate::input::arrivals::Arrivals;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, BufReader};
use tokio::process::ChildStderr;

/// The number of a program's error messages kept.
const MAX_COMPLAINTS: usize = 12;
/// The maximum length of a line, bytes.
const MAX_LINE: u64 = 4096;
/// The most pictures whose messages may be read before the pictures.
const MAX_AHEAD: usize = 256;

/// Formats of recordings and of segments, by ffmpeg's name before its messages: they come as fast as they are read.
const PACED: [&str; 3] = ["[hls @ ", "[dash @ ", "[mov,mp4,m4a,3gp,3g2,mj2 @ "];

/// Before the address of a file of one picture. Its length is that of one frame.
const ONE_PICTURE: &str = "[info] Input #0, image2, ";

/// Before the type of a part that is no picture, at which ffmpeg ends a multipart stream.
const OTHER_PART: &str = "Unexpected Content-Type : ";

/// How ffmpeg writes the length of an answer that does not say it. Such an answer always ends too early.
const UNKNOWN_LENGTH: &str = "should be 18446744073709551615";

/// What ffmpeg says after the cause of a failure.
const CONSEQUENCES: [&str; 5] = [
    "Consider increasing the value for the ",
    "Could not write header for output file",
    "Error initializing output stream",
    "Cannot determine format of input stream",
    "Error marking filters as finished",
];

/// How far a connection has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Stage {
    /// The program says nothing about it.
    #[default]
    Unknown,
    /// An address is being connected.
    Connecting,
    /// The connection is accepted.
    Connected,
    /// The camera has described its streams.
    Described,
    /// Packets arrive.
    Opened,
    /// Pictures were decoded.
    Decoded,
}

/// What the filter of [`super::ffmpeg`] adds for a decoded picture that is a key frame.
const KEY: u8 = 1;
/// What it adds for one that is taken.
const TAKEN: u8 = 2;

/// The lines that a program writes to its error output.
#[derive(Default)]
pub(super) struct Messages {
    /// `None` once it has ended.
    pipe: Option<BufReader<ChildStderr>>,
    secrets: Secrets,
    arrivals: Arc<Arrivals>,
    /// What has been read of the present line.
    line: Vec<u8>,
    /// The codec of the input, which ffmpeg reports before that of its output.
    codec: Option<String>,
    /// True if the input is a file of one picture.
    is_one_picture: bool,
    /// True if the input comes as fast as it is read.
    is_paced: bool,
    /// True once the camera has offered sound.
    offers_sound: bool,
    /// True once it has offered pictures.
    offers_pictures: bool,
    stage: Stage,
    complaints: VecDeque<String>,
    /// True if the decoder has complained since the last picture.
    is_damaged: bool,
    /// True from a complaint to the next whole key frame.
    is_broken: bool,
    /// For each picture that was taken and not yet read: whether it is broken.
    ahead: VecDeque<bool>,
}

impl Messages {
    pub(super) fn new(
        pipe: Option<ChildStderr>,
        secrets: Secrets,
        arrivals: Arc<Arrivals>,
    ) -> Self {
        Self {
            pipe: pipe.map(BufReader::new),
            secrets,
            arrivals,
            ..Self::default()
        }
    }

    /// The codec of the input, once reported.
    pub(super) fn codec(&self) -> Option<&str> {
        self.codec.as_deref()
    }

    /// True if the source waits for its reader, as a recording does, and a camera does not.
    pub(super) fn is_paced(&self) -> bool {
        self.is_paced
    }

    /// The type of a part of a multipart stream that is no picture: ffmpeg has ended there.
    pub(super) fn other_part(&self) -> Option<&str> {
        self.complaints.iter().find_map(|complaint| complaint.strip_prefix(OTHER_PART))
    }

    /// True if a recording has no pictures where its index says that there are some.
    pub(super) fn is_partial(&self) -> bool {
        self.complaints.iter().any(|complaint| complaint.ends_with(": partial file"))
    }

    /// How far the connection has come.
    pub(super) fn stage(&self) -> Stage {
        self.stage
    }

    /// Why no picture came for that long.
    pub(super) fn silence(&self, silence: Duration) -> String {
        if self.has_only_sound() {
            return ONLY_SOUND.to_owned();
        }
        let seconds = silence.as_secs_f64();
        match self.stage {
            Stage::Unknown | Stage::Decoded => format!("no picture for more than {seconds} s"),
            Stage::Connecting => {
                format!("it cannot be reached: no answer for more than {seconds} s")
            }
            Stage::Connected => {
                format!("it accepts the connection, but says nothing for {seconds} s")
            }
            Stage::Described => {
                format!("it answers, but sends no picture for more than {seconds} s")
            }
            Stage::Opened => format!("it sends no key frame for more than {seconds} s"),
        }
    }

    fn has_only_sound(&self) -> bool {
        self.offers_sound && !self.offers_pictures
    }

    /// Notes that a picture was read.
    pub(super) fn picture_taken(&mut self) {
        self.stage = Stage::Decoded;
    }

    /// True while there is more to read.
    pub(super) fn is_open(&self) -> bool {
        self.pipe.is_some()
    }

    /// Reads no more.
    pub(super) fn close(&mut self) {
        self.pipe = None;
    }

    /// Reads the next line, or the beginning of a longer one; waits forever once nothing more comes. Cancel safe.
    pub(super) async fn listen(&mut self) {
        let Some(pipe) = &mut self.pipe else {
            return std::future::pending().await;
        };
        let mut room = pipe.take(MAX_LINE - self.line.len() as u64);
        match room.read_until(b'\n', &mut self.line).await {
            Ok(1..) => self.take_line(),
            _ => self.pipe = None,
        }
    }

    /// True if the next picture is broken; `None` as long as its line has not been read.
    pub(super) fn next_is_broken(&mut self) -> Option<bool> {
        self.ahead.pop_front()
    }

    fn take_line(&mut self) {
        let bytes = std::mem::take(&mut self.line);
        let line = String::from_utf8_lossy(&bytes);
        let text = line.trim();
        if let Some(picture) = decoded(text) {
            self.take_picture(picture);
        } else if let Some(complaint) = complaint(text) {
            self.take_complaint(text, &complaint);
        } else {
            self.take_news(text);
        }
    }

    /// Notes a decoded picture. What the decoder said since the one before concerns this one.
    fn take_picture(&mut self, picture: u8) {
        // Before the first picture, ffmpeg has looked at the stream from the middle of it.
        let counts = self.is_damaged && self.stage == Stage::Decoded;
        let is_key = picture & KEY != 0;
        self.is_damaged = false;
        self.stage = Stage::Decoded;
        self.is_broken = counts || (self.is_broken && !is_key);
        self.arrivals.frame(self.is_broken);
        if picture & TAKEN != 0 {
            self.ahead.push_back(self.is_broken);
        }
        if self.ahead.len() > MAX_AHEAD {
            self.ahead.pop_front();
        }
    }

    fn take_complaint(&mut self, text: &str, complaint: &str) {
        let complaint = self.secrets.redact(complaint);
        tracing::debug!(complaint, "message from the source's program");
        if self.stage == Stage::Decoded && self.is_damage(text) {
            self.is_damaged = true;
            self.arrivals.complaint(&complaint);
        }
        if !self.complaints.contains(&complaint) {
            self.complaints.push_back(complaint);
        }
        if self.complaints.len() > MAX_COMPLAINTS {
            self.complaints.pop_front();
        }
    }

    /// True for the error of a decoder, such as `[h264 @ 0x1] [error] error while decoding MB 3 4`, and where ffmpeg names a
    /// picture corrupt.
    fn is_damage(&self, line: &str) -> bool {
        if line.contains("corrupt decoded frame") {
            return true;
        }
        let Some(codec) = &self.codec else {
            return false;
        };
        let message = line.strip_prefix('[').and_then(|line| line.split_once(" @ "));
        message.is_some_and(|(decoder, rest)| {
            decoder.contains(codec.as_str()) && rest.contains("] [error] ")
        })
    }

    /// Notes what is no complaint: how far the connection has come, and what the source is.
    fn take_news(&mut self, text: &str) {
        let stage = if text.contains("Starting connection attempt to ") {
            Stage::Connecting
        } else if text.contains("Successfully connected to ") {
            Stage::Connected
        } else if text.ends_with("[verbose] SDP:") {
            Stage::Described
        } else if text.starts_with("[info] Input #0, ") {
            Stage::Opened
        } else {
            Stage::Unknown
        };
        self.stage = self.stage.max(stage);
        let stream = text.split_once("Stream #").map_or(text, |(_, stream)| stream);
        self.offers_sound |= stream.starts_with("m=audio ") || stream.contains(": Audio: ");
        self.offers_pictures |= stream.starts_with("m=video ") || stream.contains(": Video: ");
        let has_end = text
            .strip_prefix("[info]   Duration: ")
            .is_some_and(|length| length.starts_with(|c: char| c.is_ascii_digit()));
        self.is_one_picture |= text.starts_with(ONE_PICTURE);
        self.is_paced |= has_end && !self.is_one_picture;
        self.is_paced |= PACED.iter().any(|format| text.starts_with(format));
        if self.codec.is_none() {
            self.codec = codec(text);
        }
    }

    /// Why it failed: the camera's answer, or else its last messages.
    pub(super) fn reason(&mut self) -> Option<String> {
        self.take_line();
        if self.has_only_sound() {
            return Some(ONLY_SOUND.to_owned());
        }
        let complaints = &self.complaints;
        if let Some(answer) = complaints.iter().find_map(|complaint| refusal(complaint)) {
            return Some(answer);
        }
        if let Some(said) = complaints.iter().find_map(|complaint| of_element(complaint)) {
            return Some(said);
        }
        if let Some(kind) = self.other_part() {
            return Some(format!(
                "its parts are {kind}, and only JPEG pictures can be read"
            ));
        }
        if self.is_partial() && self.stage < Stage::Decoded {
            return Some(NO_RANGES.to_owned());
        }
        let mut newest_first = complaints.iter().rev().filter(|said| !is_consequence(said));
        let last = newest_first.next().or(complaints.back())?;
        match newest_first.next() {
            Some(before) => Some(joined(before, last)),
            None => Some(last.clone()),
        }
    }
}

/// The last two complaints in one text. Programs end with what they said before: ffmpeg repeats the cause behind the address.
fn joined(before: &str, last: &str) -> String {
    // The address of a camera with a password goes to ffmpeg by its input.
    if before.starts_with("Impossible to open ")
        && let Some(cause) = last.strip_prefix("pipe:0: ")
    {
        return format!("it cannot be opened: {cause}");
    }
    let cause = last.rsplit(": ").next().unwrap_or(last);
    if before.contains(cause) || cause == "Input/output error" {
        before.to_owned()
    } else {
        format!("{before}; {last}")
    }
}

/// The error of a GStreamer element. What follows says only that the pipeline does not start without it.
fn of_element(complaint: &str) -> Option<String> {
    let (_, error) = complaint.strip_prefix("ERROR: from element ")?.split_once(": ")?;
    Some(error.trim_end_matches('.').to_owned())
}

/// True for what is said only because of another complaint.
fn is_consequence(complaint: &str) -> bool {
    complaint.is_empty() || CONSEQUENCES.iter().any(|begin| complaint.starts_with(begin))
}

const NO_RANGES: &str = "its pictures cannot be reached: it is cut short, or its index is at its end and the server gives \
    no parts of it (HTTP ranges); then make it with `-movflags faststart`";

const ONLY_SOUND: &str = "it sends sound, but no pictures: is this the address of its video?";

/// The answer of a camera that refuses, such as `401 Unauthorized`.
fn refusal(complaint: &str) -> Option<String> {
    for before in ["failed: ", "returned ", "HTTP error "] {
        let Some((_, after)) = complaint.split_once(before) else {
            continue;
        };
        // ffmpeg adds words of its own in parentheses.
        let answer = after.split(" (").next().unwrap_or(after);
        if is_refusal(answer) {
            return Some(answer.to_owned());
        }
    }
    None
}

/// True if a reason begins with the status of an answer, such as `404 Not Found`.
pub(super) fn is_refusal(reason: &str) -> bool {
    let status = reason.split(' ').next().and_then(|status| status.parse().ok());
    status.is_some_and(|status: u16| (400..600).contains(&status))
}

/// The error message in a line: the whole line unless ffmpeg marks it as information (`-v level+verbose`), without the
/// memory addresses that ffmpeg puts in front.
fn complaint(line: &str) -> Option<String> {
    // A password may contain any word; only the beginning is ffmpeg's.
    let is_information =
        line.starts_with('[') && (line.contains("[info]") || line.contains("[verbose]"));
    // A line of the camera's own description, `m=video 0 RTP/AVP 96`, which ffmpeg shows as it is.
    let is_description = line.as_bytes().get(1) == Some(&b'=');
    if line.is_empty()
        || is_information
        || is_description
        || line.ends_with(UNKNOWN_LENGTH)
        || line.contains("deprecated pixel format")
    {
        return None;
    }
    let behind = ["[error]", "[fatal]", "[warning]", "[panic]"]
        .iter()
        .find_map(|level| line.split_once(level));
    let said = behind.map_or(line, |(_, behind)| behind).trim();
    // The time limit that we set, in microseconds.
    let Some((address, limit_and_rest)) = said.split_once("?timeout=") else {
        return Some(said.to_owned());
    };
    let rest = limit_and_rest.trim_start_matches(|c: char| c.is_ascii_digit());
    Some(format!("{address}{rest}"))
}

/// What the filter says of a decoded picture: `[info] 3.000000`.
fn decoded(line: &str) -> Option<u8> {
    line.strip_prefix("[info] ")?.strip_suffix(".000000")?.parse().ok()
}

/// The codec in a line such as `[info]   Stream #0:0: Video: h264 (High), yuv420p`.
fn codec(line: &str) -> Option<String> {
    let (_, stream) = line.split_once("Stream #")?;
    let (_, video) = stream.split_once("Video: ")?;
    let end = video.find(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    Some(video[..end.unwrap_or(video.len())].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codecs_and_errors_are_distinguished_from_other_output() {
        let stream = "[info]   Stream #0:0[0x1](und): Video: mjpeg (Baseline), yuvj420p, 25 fps";
        let failed = "method DESCRIBE failed: 401 Unauthorized";
        let error = format!("[rtsp @ 0x5566] [error] {failed}");
        let plain = "ERROR: pipeline could not be constructed";
        assert_eq!(codec(stream).as_deref(), Some("mjpeg"));
        assert_eq!(complaint(stream), None);
        assert_eq!(complaint(&error).as_deref(), Some(failed));
        assert_eq!(complaint(plain).as_deref(), Some(plain));
    }

    #[test]
    fn the_answer_of_the_camera_is_the_reason() {
        for (before, answer, after) in [
            ("method DESCRIBE failed: ", "401 Unauthorized", ""),
            ("rtsp://cam/s: Server returned ", "404 Not Found", ""),
            ("x: Server returned ", "403 Forbidden", " (access denied)"),
            ("HTTP error ", "503 Service Unavailable", ""),
        ] {
            let complaint = format!("{before}{answer}{after}");
            assert_eq!(refusal(&complaint).as_deref(), Some(answer));
        }
        for other in [
            "rtsp://cam/s: Connection refused",
            "connect failed: 4",
            "it failed: 40 pictures",
        ] {
            assert_eq!(refusal(other), None);
        }
    }

    fn heard(lines: &[&str]) -> Messages {
        let mut messages = Messages::default();
        for line in lines {
            messages.line = line.as_bytes().to_vec();
            messages.take_line();
        }
        messages
    }

    #[test]
    fn a_reason_does_not_repeat_its_cause() {
        for (lines, reason) in [
            (
                &[
                    "[video4linux2,v4l2 @ 0x1] [error] Cannot open video device /dev/video9: No such file or directory",
                    "[error] /dev/video9: No such file or directory",
                ][..],
                "Cannot open video device /dev/video9: No such file or directory",
            ),
            (
                &[
                    "[tcp @ 0x1] [error] Connection to tcp://10.0.0.5:554?timeout=30000000 failed: Connection refused",
                    "[error] rtsp://10.0.0.5/x: Connection refused",
                ],
                "Connection to tcp://10.0.0.5:554 failed: Connection refused",
            ),
            (
                &[
                    "[tcp @ 0x1] [error] Failed to resolve hostname cam: Name or service not known",
                    "[error] rtsp://cam/x: Input/output error",
                ],
                "Failed to resolve hostname cam: Name or service not known",
            ),
            (
                &[
                    "[concat @ 0x1] [error] Impossible to open 'rtsp://10.0.0.5/x'",
                    "[error] pipe:0: Connection refused",
                ],
                "it cannot be opened: Connection refused",
            ),
            (
                &[
                    "ERROR: from element /GstPipeline:pipeline0/GstV4l2Src:v4l2src0: Cannot identify device '/dev/video9'.",
                    "Additional debug info:",
                    "ERROR: pipeline doesn't want to preroll.",
                    "Failed to set pipeline to PAUSED.",
                ],
                "Cannot identify device '/dev/video9'",
            ),
            (
                &["[error] moov atom not found", "[error] x.mp4: Invalid data"],
                "moov atom not found; x.mp4: Invalid data",
            ),
            (
                &[
                    "[http @ 0x1] [error] Stream ends prematurely at 0, should be 18446744073709551615",
                    "[error] http://cam/x: Input/output error",
                ],
                "http://cam/x: Input/output error",
            ),
            (
                &[
                    "[mpjpeg @ 0x1] [error] Unexpected Content-Type : image/png",
                    "[mpjpeg @ 0x1] [error] dimensions not set",
                    "[error] Error initializing output stream 0:0 --",
                    "[error] ",
                ],
                "its parts are image/png, and only JPEG pictures can be read",
            ),
            (
                &[
                    "[mov,mp4,m4a,3gp,3g2,mj2 @ 0x1] [error] stream 0, offset 0x30: partial file",
                    "[error] Cannot determine format of input stream 0:0 after EOF",
                    "[fatal] Error marking filters as finished",
                ],
                NO_RANGES,
            ),
            (
                &[
                    "[mjpeg @ 0x1] [error] unspecified size",
                    "[error] Error initializing output stream 0:0 --",
                    "[error] ",
                ],
                "unspecified size",
            ),
        ] {
            assert_eq!(heard(lines).reason().as_deref(), Some(reason));
        }
    }

    const H264: &str = "[info]   Stream #0:0: Video: h264 (High), yuv420p, 640x360";
    const DAMAGE: &str = "[h264 @ 0x5566] [error] error while decoding MB 3 4, bytestream 5";

    #[test]
    fn pictures_are_broken_from_a_complaint_to_the_next_whole_key_frame() {
        let key = "[info] 3.000000";
        let other = "[info] 2.000000";
        let key_left_out = "[info] 1.000000";
        let sound = "[aac @ 0x5566] [error] channel element 1.0 is not allocated";
        let corrupt = "[warning] rtsp://cam/s: corrupt decoded frame in stream 0";
        let mut messages = heard(&[
            H264,
            DAMAGE,
            key,
            other,
            DAMAGE,
            other,
            sound,
            other,
            key,
            other,
            corrupt,
            key,
            other,
            key_left_out,
            other,
        ]);
        let broken: Vec<_> = std::iter::from_fn(|| messages.next_is_broken()).collect();
        let expected = [false, false, true, true, false, false, true, true, false];
        assert_eq!(broken, expected);
        let arrived = messages.arrivals.now();
        assert_eq!(arrived.frames, 10);
        assert_eq!(arrived.broken, 4);
        assert_eq!(arrived.complaints, 2);
    }

    #[test]
    fn silence_has_the_words_of_how_far_the_connection_has_come() {
        let start = "[tcp @ 0x1] [verbose] Starting connection attempt to 127.0.0.1 port 1";
        let connected = "[tcp @ 0x1] [verbose] Successfully connected to 127.0.0.1 port 1";
        let described = "[rtsp @ 0x1] [verbose] SDP:";
        let opened = "[info] Input #0, rtsp, from 'x':";
        for (lines, said) in [
            (&[][..], "no picture"),
            (&[start], "cannot be reached"),
            (
                &[start, connected],
                "accepts the connection, but says nothing",
            ),
            (
                &[connected, described, "m=video 0 RTP/AVP 96"],
                "answers, but sends no picture",
            ),
            (&[connected, described, opened, H264], "no key frame"),
            (
                &[connected, described, "m=audio 0 RTP/AVP 0"],
                "sound, but no pictures",
            ),
            (
                &[connected, described, opened, H264, "[info] 3.000000"],
                "no picture",
            ),
        ] {
            let silence = heard(lines).silence(Duration::from_secs(15));
            assert!(silence.contains(said), "{lines:?}: {silence}");
        }
    }

    #[test]
    fn recordings_and_segments_are_paced_and_cameras_are_not() {
        for (line, paced) in [
            (
                "[info]   Duration: 00:00:06.00, start: 1.4, bitrate: 0 kb/s",
                true,
            ),
            ("[info]   Duration: N/A, start: 0.06, bitrate: N/A", false),
            (
                "[hls @ 0x55] [info] Opening 'http://cam/1.ts' for reading",
                true,
            ),
            ("[mpjpeg @ 0x55] [verbose] …", false),
        ] {
            assert_eq!(heard(&[line]).is_paced(), paced, "{line}");
        }
    }

    #[test]
    fn a_file_of_one_picture_is_no_recording() {
        let opened = "[info] Input #0, image2, from 'http://cam/snap.jpg':";
        let length = "[info]   Duration: 00:00:00.04, start: 0.000000, bitrate: 2537 kb/s";
        assert!(!heard(&[opened, length]).is_paced());
        assert!(heard(&[length]).is_paced());
    }
}
