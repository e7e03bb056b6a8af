//! The command lines with which ffmpeg and GStreamer extract pictures from a source.

use super::address::{Resolved, SourceAddress, SourceKind, SourceOptions};
use super::program::PictureProgram;
use albireo_vision::picture::FrameLimits;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Duration;

/// The programs.
pub(super) const FFMPEG: &str = "ffmpeg";
pub(super) const GSTREAMER: &str = "gst-launch-1.0";

/// How ffmpeg reads a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    /// Motion JPEG, whose pictures are passed on.
    Jpeg,
    /// Motion JPEG cut at the pictures themselves, because what stands between them is wrong.
    BareJpeg,
    /// Video that is decoded.
    Decoded,
    /// Video that comes as fast as it is read, decoded at the pace of its own clock.
    Paced,
}

impl Way {
    /// True if pictures are passed on as they come.
    pub(super) fn is_untouched(self) -> bool {
        matches!(self, Self::Jpeg | Self::BareJpeg)
    }
}

/// The version of ffmpeg: major and minor number.
pub(super) type Version = (u32, u32);

/// The first version that accepts options inside a script, and `-timeout` for RTSP.
const SCRIPT_OPTIONS: Version = (5, 0);
/// The first version with `-fps_mode`.
const FPS_MODE: Version = (5, 1);

/// The quality of encoded pictures (`-q:v`, 2 is the best).
const JPEG_QUALITY: &str = "3";

/// Memory of ffmpeg besides its largest blocks: libraries, threads, queues.
const WORKING_MEMORY: u64 = 512 << 20;

/// Protocols that a script may open.
const PROTOCOLS: &str = "async,subfile,file,pipe,fd,tcp,tls,udp,rtp,srtp,rtsp,rtsps,rtmp,rtmps,http,https,httpproxy,crypto,srt,data";

/// Before an address in a script, which cannot name a format: takes away the first three bytes of the stream and its type, so
/// that ffmpeg recognises it by its pictures. `subfile` skips by seeking, which `async` does for it by reading.
const WITHOUT_FORMAT: &str = "subfile,,start,3,end,0,,:async:";

/// Options for ffmpeg itself or a decoder, not for the camera: they stay on the command line.
const PROGRAM_OPTIONS: &str = "an autorotate c codec discard ec err_detect f flags flags2 hwaccel hwaccel_device \
    hwaccel_output_format init_hw_device itsoffset lowres noautorotate r re skip_frame skip_idct skip_loop_filter \
    thread_queue_size threads";

/// Frameworks to which ffmpeg delegates decoding (`ffmpeg -hwaccels`); any other name is a decoder's.
const ACCELERATIONS: &str =
    "auto cuda d3d11va drm dxva2 opencl qsv vaapi vdpau videotoolbox vulkan";

/// The transport of an RTSP camera's packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum RtspTransport {
    /// In the open connection: no packet is lost, and no firewall is in the way.
    #[default]
    Tcp,
    /// In datagrams: a lost one breaks pictures.
    Udp,
}

impl RtspTransport {
    const fn as_str(self) -> &'static str {
        match self {
            Self::Tcp => "tcp",
            Self::Udp => "udp",
        }
    }
}

/// A source to open, and how to open it.
#[derive(Clone, Debug)]
pub struct SourceSettings {
    /// The source.
    pub address: SourceAddress,
    /// Maximum frames per second.
    pub max_rate: Option<f64>,
    /// The transport of RTSP packets.
    pub transport: RtspTransport,
    /// Acceleration or decoder of ffmpeg.
    pub hardware: Option<String>,
    /// Options of ffmpeg for the source.
    pub options: SourceOptions,
    /// A source without a picture for this long is reopened.
    pub silence: Duration,
    /// True if decoded pictures are encoded as JPEG files; otherwise they stay pixels.
    pub as_jpeg: bool,
    /// Limits of the pictures.
    pub limits: FrameLimits,
}

/// The numbers in `ffmpeg version 5.1.9-0+deb12u1 …`. Builds between releases have none and count as newest.
pub(super) fn version(banner: &str) -> Version {
    let number = banner
        .strip_prefix("ffmpeg version ")
        .unwrap_or_default()
        .trim_start_matches('n');
    let mut parts = number.split(|c: char| !c.is_ascii_digit());
    let major = parts.next().and_then(|part| part.parse().ok());
    let minor = parts.next().and_then(|part| part.parse().ok()).unwrap_or(0);
    major.map_or((u32::MAX, 0), |major| (major, minor))
}

/// A command line of ffmpeg that is being made.
struct CommandLine<'a> {
    settings: &'a SourceSettings,
    way: Way,
    version: Version,
    arguments: Vec<String>,
    /// The options with which the camera is opened: on the command line, or in a script.
    camera: Vec<(&'a str, String)>,
}

impl<'a> CommandLine<'a> {
    fn add(&mut self, words: &[&str]) {
        self.arguments.extend(words.iter().map(ToString::to_string));
    }

    /// True if a script may have options of the camera.
    fn takes_options(&self) -> bool {
        self.version >= SCRIPT_OPTIONS
    }

    /// The largest block of memory that ffmpeg may take at once, bytes.
    fn largest_block(&self) -> u64 {
        let limits = &self.settings.limits;
        let packets = limits.max_payload_bytes.saturating_mul(4);
        if self.way.is_untouched() {
            return packets as u64;
        }
        // Rows of decoded pictures are padded.
        let rows = usize::try_from(limits.max_pixels.saturating_mul(5)).unwrap_or(usize::MAX);
        packets.max(rows) as u64
    }

    /// How ffmpeg itself behaves, and how it decodes.
    fn add_program(&mut self, largest_block: u64, live: bool) {
        // Verbose: it says how far a connection has come.
        self.add(&[
            "-hide_banner",
            "-nostats",
            "-v",
            "repeat+level+verbose",
            "-max_alloc",
        ]);
        self.add(&[&largest_block.to_string()]);
        let untouched = self.way.is_untouched();
        match self.settings.hardware.as_deref().filter(|_| !untouched) {
            Some(name) if is_among(ACCELERATIONS, name) => self.add(&["-hwaccel", name]),
            Some(name) => self.add(&["-c:v", name]),
            None => {}
        }
        if live {
            // Decoding with several threads, each with its own frame, delays frames.
            self.add(&["-flags", "low_delay"]);
            self.camera.push(("analyzeduration", "2000000".to_owned()));
        }
    }

    /// How a source of this kind is opened. Returns its address for ffmpeg.
    fn add_source(&mut self, resolved: &Resolved, hidden_address: bool) -> String {
        // In case this process is killed and cannot end ffmpeg.
        let silence = (2 * self.settings.silence).as_micros().to_string();
        let mut address = resolved.text().to_owned();
        match &resolved.kind {
            SourceKind::Network(scheme) if scheme.starts_with("rtsp") => {
                let transport = self.settings.transport.as_str();
                let takes_options = self.takes_options();
                if takes_options || !hidden_address {
                    let timeout = if takes_options { "timeout" } else { "stimeout" };
                    self.camera.push(("rtsp_transport", transport.to_owned()));
                    self.camera.push((timeout, silence));
                } else {
                    // Older versions accept it only at the end of the address.
                    let sign = if address.contains('?') { '&' } else { '?' };
                    address = format!("{address}{sign}{transport}");
                }
            }
            SourceKind::Network(scheme) if scheme.starts_with("http") => {
                self.camera.push(("rw_timeout", silence));
            }
            SourceKind::Device => {
                self.add(&["-f", "v4l2"]);
                if self.way.is_untouched() {
                    self.camera.push(("input_format", "mjpeg".to_owned()));
                }
            }
            // One of several is played once.
            SourceKind::File if self.way == Way::Decoded => {
                self.add(&["-re", "-stream_loop", "-1"]);
            }
            SourceKind::File | SourceKind::Files => {}
            SourceKind::Network(_) | SourceKind::Pipeline => {}
        }
        if self.way == Way::Paced {
            self.add(&["-re"]);
        }
        address
    }

    /// The user's own options: those of the camera go into the script, if there is one.
    fn add_options(&mut self, scripted: bool) {
        for (name, value) in self.settings.options.pairs() {
            let of_program = is_among(PROGRAM_OPTIONS, name.split(':').next().unwrap_or(name));
            match value {
                Some(value) if scripted && !of_program => {
                    self.camera.push((name, value.to_owned()));
                }
                _ => {
                    self.add(&[&format!("-{name}")]);
                    self.add(value.as_slice());
                }
            }
        }
    }

    /// The input is a script on ffmpeg's own input, which is returned.
    fn add_script(&mut self, address: &str) -> Result<String, String> {
        let takes_options = self.takes_options();
        if !takes_options && !self.settings.options.0.is_empty() {
            return Err(format!(
                "{}: ffmpeg before version 5 accepts no options for an address with a password: install a newer version, or \
                 remove source_options",
                self.settings.address
            ));
        }
        self.add(&["-f", "concat", "-safe", "0"]);
        self.add(&["-protocol_whitelist", PROTOCOLS, "-i", "pipe:0"]);
        let address = address.replace('\\', "%5C").replace('\'', "%27");
        let mut script = format!("ffconcat version 1.0\nfile '{address}'\n");
        for (name, value) in self.camera.iter().filter(|_| takes_options) {
            let value = value.replace('\'', "'\\''");
            script.push_str(&format!("option {name} '{value}'\n"));
        }
        Ok(script)
    }

    /// The input is on the command line.
    fn add_input(&mut self, address: &str) {
        for (name, value) in std::mem::take(&mut self.camera) {
            self.add(&[&format!("-{name}"), &value]);
        }
        // Otherwise a file name that begins with `-` would be an option.
        let sign = if address.starts_with('-') { "./" } else { "" };
        self.add(&["-nostdin", "-i", &format!("{sign}{address}")]);
    }

    /// What goes out: every picture, untouched or decoded.
    fn add_output(&mut self) {
        self.add(&["-map", "0:v:0"]);
        // Whatever a camera's timestamps are, no picture is left out or repeated for them.
        let fps_mode = if self.version >= FPS_MODE {
            "-fps_mode"
        } else {
            "-vsync"
        };
        self.add(&[fps_mode, "passthrough"]);
        if self.way.is_untouched() {
            self.add(&["-c:v", "copy", "-f", "mpjpeg"]);
        } else {
            self.add(&["-vf", &filters(self.settings.max_rate)]);
            self.add(&["-enc_time_base", "1/90000"]);
            if self.settings.as_jpeg {
                self.add(&["-c:v", "mjpeg", "-q:v", JPEG_QUALITY, "-f", "mpjpeg"]);
            } else {
                // Video of 10 or 16 bits would become files of 16 bits.
                self.add(&["-pix_fmt", "rgb24", "-c:v", "ppm", "-f", "image2pipe"]);
            }
        }
        self.add(&["-flush_packets", "1", "pipe:1"]);
    }
}

/// The ffmpeg command that reads a source, or one `file` of it, in that way. A secret address or option is passed in a script on its input, not
/// on its command line, which every user of the machine can see.
///
/// # Errors
/// If the address is invalid.
pub(super) fn ffmpeg(
    settings: &SourceSettings,
    file: Option<&Path>,
    way: Way,
    version: Version,
) -> Result<PictureProgram, String> {
    let mut command = CommandLine {
        settings,
        way,
        version,
        arguments: Vec::new(),
        camera: Vec::new(),
    };
    let mut resolved = match file {
        Some(file) => Resolved::file(file),
        None => settings.address.resolved()?,
    };
    let hidden_address = !resolved.secrets.is_empty();
    let largest_block = command.largest_block();
    command.add_program(largest_block, resolved.kind != SourceKind::File);
    let mut address = command.add_source(&resolved, hidden_address);
    let mut secrets = settings.options.secrets().peekable();
    let networked = matches!(resolved.kind, SourceKind::Network(_));
    let has_secret = secrets.peek().is_some();
    let scripted = hidden_address || (networked && command.takes_options() && has_secret);
    match (way, scripted) {
        (Way::BareJpeg, true) => address.insert_str(0, WITHOUT_FORMAT),
        (Way::BareJpeg, false) => command.add(&["-f", "mjpeg"]),
        _ => {}
    }
    secrets.for_each(|secret| resolved.secrets.add(secret));
    command.add_options(scripted);
    let input = if scripted {
        Some(command.add_script(&address)?)
    } else {
        command.add_input(&address);
        None
    };
    command.add_output();
    Ok(PictureProgram {
        program: FFMPEG,
        arguments: command.arguments,
        input,
        tells_broken: !way.is_untouched(),
        ppm: !way.is_untouched() && !settings.as_jpeg,
        secrets: resolved.secrets,
        // A graphics card's driver maps any amount of memory.
        max_memory: settings
            .hardware
            .is_none()
            .then(|| WORKING_MEMORY.saturating_add(4 * largest_block)),
    })
}

/// The filters for decoded pictures. The first picture of each slot of time is taken, on average exactly the limit, by the
/// clock of this machine: cameras send any timestamps. Slots are compared for being different, so that a step of that
/// clock matters no more than one picture. The expression prints for each picture 1 for a key frame, plus 2 if it is taken,
/// which [`Messages`](super::messages::Messages) reads. Afterwards each picture gets its number as its timestamp, because
/// encoders reject equal ones.
fn filters(max_rate: Option<f64>) -> String {
    let taken = match max_rate {
        Some(rate) => format!("not(eq(ld(0)\\,st(0\\,floor(time(0)*{rate}))))"),
        None => "1".to_owned(),
    };
    format!("select=st(1\\,{taken})*0+print(key+2*ld(1))*0+ld(1),setpts=N")
}

/// The GStreamer command for a source: the user's own pipeline, or a generated one if there is no ffmpeg. Its pictures
/// are JPEG files.
///
/// # Errors
/// If the address is invalid, or would show a password that the user has not put on a command line.
pub(super) fn gstreamer(settings: &SourceSettings) -> Result<PictureProgram, String> {
    let resolved = settings.address.resolved()?;
    let Resolved {
        kind,
        words,
        secrets,
    } = &resolved;
    // GStreamer accepts an address only on its command line.
    if *kind != SourceKind::Pipeline && !secrets.is_empty() {
        return Err(format!(
            "{}: without ffmpeg its password would show in the list of processes: install ffmpeg, or give your own \
             GStreamer pipeline",
            settings.address
        ));
    }
    let text = resolved.text();
    let mut arguments = Vec::new();
    let mut add = |words: &[&str]| arguments.extend(words.iter().map(ToString::to_string));
    add(&["-q"]);
    match kind {
        SourceKind::Pipeline => words.iter().for_each(|word| add(&[word])),
        SourceKind::Device => add(&["v4l2src", &format!("device={text}")]),
        SourceKind::File | SourceKind::Files => add(&["filesrc", &format!("location={text}")]),
        SourceKind::Network(scheme) if scheme.starts_with("rtsp") => add(&[
            "rtspsrc",
            &format!("location={text}"),
            &format!("protocols={}", settings.transport.as_str()),
            "latency=0",
        ]),
        SourceKind::Network(_) => add(&["uridecodebin", &format!("uri={text}")]),
    }
    if *kind != SourceKind::Pipeline {
        if !matches!(kind, SourceKind::Network(scheme) if !scheme.starts_with("rtsp")) {
            add(&["!", "decodebin"]);
        }
        add(&["!", "videoconvert", "!", "jpegenc"]);
    }
    // Each picture is preceded by its length.
    add(&["!", "multipartmux", "!", "fdsink", "fd=1"]);
    if *kind == SourceKind::File {
        add(&["sync=true"]);
    }
    Ok(PictureProgram {
        program: GSTREAMER,
        arguments,
        secrets: resolved.secrets,
        ..PictureProgram::default()
    })
}

/// True if `name` is one of the `words`.
fn is_among(words: &str, name: &str) -> bool {
    words.split_whitespace().any(|word| word == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::CameraConfig;

    /// The settings of a source, with options as on a command line.
    fn settings(address: &str, options: &str) -> SourceSettings {
        let camera = CameraConfig {
            source: Some(SourceAddress::new(address)),
            source_options: SourceOptions(shlex::split(options).unwrap()),
            max_rate: Some(5.0),
            ..CameraConfig::default()
        };
        camera.source_settings(FrameLimits::default()).unwrap()
    }

    /// The command line and the script of ffmpeg for a source that is decoded.
    fn decoding(settings: &SourceSettings, version: Version) -> (String, Option<String>) {
        let program = ffmpeg(settings, None, Way::Decoded, version).unwrap();
        (program.arguments.join(" "), program.input)
    }

    #[track_caller]
    fn assert_has(text: &str, parts: &[&str]) {
        for part in parts {
            assert!(text.contains(part), "no {part} in {text}");
        }
    }

    #[track_caller]
    fn assert_lacks(text: &str, parts: &[&str]) {
        for part in parts {
            assert!(!text.contains(part), "{part} in {text}");
        }
    }

    #[test]
    fn the_version_is_read_from_releases_and_builds_between_them() {
        for (line, numbers) in [
            ("ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright", (4, 4)),
            ("ffmpeg version 5.0", (5, 0)),
            ("ffmpeg version 5.1.9-0+deb12u1 Copyright", (5, 1)),
            ("ffmpeg version n7.1", (7, 1)),
            ("ffmpeg version N-118000-gabc", (u32::MAX, 0)),
        ] {
            assert_eq!(version(line), numbers, "{line}");
        }
    }

    #[test]
    fn rtsp_uses_tcp_and_equal_timestamps_are_no_error() {
        let mut settings = settings("rtsp://cam/s", "");
        settings.hardware = Some("cuda".to_owned());
        let (line, script) = decoding(&settings, (5, 1));
        assert_has(&line, &["-rtsp_transport tcp", "-i rtsp://cam/s"]);
        assert_has(
            &line,
            &["-fps_mode passthrough", "-hwaccel cuda", "time(0)*5"],
        );
        assert_eq!(script, None);
        let (old, _) = decoding(&settings, (4, 4));
        assert_has(&old, &["-vsync passthrough", "-stimeout"]);
    }

    #[test]
    fn no_password_or_secret_option_is_in_the_command_line() {
        let with_password = settings("rtsp://viewer:hidden'@cam/s", "");
        for version in [(4, 4), (5, 1), (7, 1)] {
            let (line, script) = decoding(&with_password, version);
            assert_lacks(&line, &["hidden", "viewer"]);
            let file = "file 'rtsp://viewer:hidden%27@cam/s";
            assert_has(&script.unwrap(), &[file, "tcp"]);
        }
        let options = "-headers 'Authorization: Bearer abc'";
        let program = ffmpeg(&settings("http://cam/v", options), None, Way::Jpeg, (5, 1)).unwrap();
        assert_lacks(&program.arguments.join(" "), &["Bearer"]);
        let option = "option headers 'Authorization: Bearer abc'\n";
        assert_has(&program.input.unwrap(), &[option]);
        let said = program.secrets.redact("sent Authorization: Bearer abc");
        assert_eq!(said, "sent ***");
    }

    #[test]
    fn options_reach_the_camera_even_if_its_address_has_a_password() {
        let options = "-rtsp_flags prefer_tcp -skip_frame nokey";
        let quoted = format!("{options} -user_agent \"it's me\"");
        let hidden = settings("rtsp://u:hidden@cam/s", &quoted);
        let (line, script) = decoding(&hidden, (5, 1));
        let of_camera = "\noption rtsp_flags 'prefer_tcp'\n";
        let quoted = "\noption user_agent 'it'\\''s me'\n";
        assert_has(&script.unwrap(), &[of_camera, quoted]);
        // A decoder's option.
        assert_has(&line, &["-skip_frame nokey"]);
        assert_lacks(&line, &["rtsp_flags"]);
        let plain = settings("rtsp://cam/s", options);
        let (line, script) = decoding(&plain, (5, 1));
        assert_has(&line, &[options]);
        assert_eq!(script, None);
        let old = ffmpeg(&hidden, None, Way::Decoded, (4, 4)).err().unwrap().to_string();
        assert_has(&old, &["version 5"]);
        assert_lacks(&old, &["hidden"]);
    }

    #[test]
    fn memory_is_limited_unless_a_driver_needs_it() {
        let mut settings = settings("http://cam/v.mjpg", "");
        let program = ffmpeg(&settings, None, Way::Jpeg, (5, 1)).unwrap();
        assert_has(&program.arguments.join(" "), &["-max_alloc 67108864"]);
        assert_eq!(program.max_memory, Some((512 + 4 * 64) << 20));
        settings.hardware = Some("cuda".to_owned());
        assert_eq!(
            ffmpeg(&settings, None, Way::Jpeg, (5, 1)).unwrap().max_memory,
            None
        );
    }

    #[test]
    fn a_pipeline_gets_an_end_that_sends_lengths_and_shows_no_password() {
        let rtsp = "rtspsrc location=rtsp://cam/s protocols=tcp latency=0 ! decodebin ! videoconvert ! jpegenc";
        let http = "uridecodebin uri=http://cam/s ! videoconvert ! jpegenc";
        for (address, pipeline) in [
            ("videotestsrc ! jpegenc", "videotestsrc ! jpegenc"),
            ("rtsp://cam/s", rtsp),
            ("http://cam/s", http),
        ] {
            let program = gstreamer(&settings(address, "")).unwrap();
            let expected = format!("-q {pipeline} ! multipartmux ! fdsink fd=1");
            assert_eq!(program.arguments.join(" "), expected);
        }
        let refused = gstreamer(&settings("rtsp://u:hidden@cam/s", ""));
        let refused = refused.err().unwrap().to_string();
        assert_has(&refused, &["install ffmpeg"]);
        assert_lacks(&refused, &["hidden"]);
    }
}
