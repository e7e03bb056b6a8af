//! How ffmpeg is told to open a source and hand its pictures over.

use super::address::{AddressError, Resolved, SourceAddress, SourceKind};
use super::program::{INSTALL_FFMPEG, Running, SourceError, is_missing, output_of};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

/// The two programs.
#[derive(Clone, Debug)]
pub struct Ffmpeg {
    /// The decoder.
    pub ffmpeg: PathBuf,
    /// The prober, of the same package.
    pub ffprobe: PathBuf,
}

impl Default for Ffmpeg {
    fn default() -> Self {
        Self {
            ffmpeg: PathBuf::from("ffmpeg"),
            ffprobe: PathBuf::from("ffprobe"),
        }
    }
}

/// How an RTSP camera sends its packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum RtspTransport {
    /// In the connection that is open already: none is lost, and no firewall is in the way.
    #[default]
    Tcp,
    /// In datagrams: a lost one breaks pictures.
    Udp,
}

impl RtspTransport {
    /// Its name.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Tcp => "tcp",
            Self::Udp => "udp",
        }
    }
}

/// The form in which pictures are handed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handover {
    /// JPEG files as the source has them, not decoded; parts of a multipart stream.
    Untouched,
    /// JPEG files of this quality (`-q:v`, 2 is the best); parts of a multipart stream.
    Jpeg(u8),
    /// PNG files, one behind the other.
    Png,
    /// PPM files, one behind the other: no coding at all.
    Ppm,
}

/// Frameworks that ffmpeg hands decoding to (`ffmpeg -hwaccels`); every other name is a decoder's.
const ACCELERATIONS: [&str; 11] = [
    "auto",
    "cuda",
    "d3d11va",
    "drm",
    "dxva2",
    "opencl",
    "qsv",
    "vaapi",
    "vdpau",
    "videotoolbox",
    "vulkan",
];

/// The first version that takes options inside a script, and knows `-timeout` for RTSP.
const SCRIPT_OPTIONS: (u32, u32) = (5, 0);

/// The first version with `-fps_mode`.
const FPS_MODE: (u32, u32) = (5, 1);

/// What ffmpeg opens.
#[derive(Clone, Debug)]
pub struct FfmpegInput<'a> {
    /// The source.
    pub address: &'a SourceAddress,
    /// How RTSP packets come.
    pub transport: RtspTransport,
    /// Acceleration or decoder.
    pub hardware: Option<&'a str>,
    /// Options put before the source.
    pub options: &'a [String],
    /// Frames per second at most.
    pub max_rate: Option<f64>,
    /// A file is read at its own speed, again and again, as a camera would send it.
    pub as_camera: bool,
    /// After so long without a word from the other side it gives up, in case nobody is left to kill it.
    pub silence: Duration,
}

impl<'a> FfmpegInput<'a> {
    /// A source with nothing special.
    pub fn new(address: &'a SourceAddress) -> Self {
        Self {
            address,
            transport: RtspTransport::default(),
            hardware: None,
            options: &[],
            max_rate: None,
            as_camera: false,
            silence: Duration::from_secs(15),
        }
    }
}

impl Ffmpeg {
    /// Runs `ffprobe` on a file with these arguments and gives what it says.
    ///
    /// # Errors
    /// When it is missing, or cannot read the file.
    pub fn probe(&self, arguments: &[&str], file: &str) -> Result<Vec<u8>, SourceError> {
        let mut command = Command::new(&self.ffprobe);
        command.args(arguments).arg(local(file));
        let probed = output_of(&mut command).map_err(|error| not_started(file, &command, error))?;
        if probed.status.success() {
            return Ok(probed.stdout);
        }
        let said = String::from_utf8_lossy(&probed.stderr);
        Err(SourceError::Unreadable {
            source_name: file.to_owned(),
            program: "ffprobe",
            reason: said.trim().to_owned(),
        })
    }

    /// Its version: major and minor number.
    ///
    /// # Errors
    /// When it is missing.
    pub(super) fn version(&self, source: &str) -> Result<(u32, u32), SourceError> {
        let mut command = Command::new(&self.ffmpeg);
        let said = output_of(command.arg("-version"))
            .map_err(|error| not_started(source, &command, error))?;
        let said = String::from_utf8_lossy(&said.stdout);
        Ok(version(said.lines().next().unwrap_or_default()))
    }

    /// Starts ffmpeg on a source. Where the address has secrets, ffmpeg reads it from its input and not from its command
    /// line, which every user of the machine can see.
    ///
    /// # Errors
    /// When it is missing, or the address cannot be used.
    pub fn open(
        &self,
        input: &FfmpegInput<'_>,
        handover: Handover,
    ) -> Result<Running, SourceError> {
        let shown = input.address.to_string();
        let version = self.version(&shown)?;
        let resolved = input.address.resolved()?;
        let (arguments, script) = arguments(input, &resolved, handover, version)?;
        let mut command = Command::new(&self.ffmpeg);
        command.args(&arguments);
        for variable in &resolved.variables {
            command.env_remove(variable);
        }
        Running::start(&mut command, script.as_deref(), resolved.secrets)
            .map_err(|error| not_started(&shown, &command, error))
    }
}

fn not_started(source: &str, command: &Command, error: std::io::Error) -> SourceError {
    if is_missing(&error) {
        return SourceError::Missing {
            source_name: source.to_owned(),
            programs: "no `ffmpeg`",
            remedy: INSTALL_FFMPEG,
        };
    }
    SourceError::NotStarted {
        program: command.get_program().to_string_lossy().into_owned(),
        error,
    }
}

/// The numbers in `ffmpeg version 5.1.9-0+deb12u1 …`. Builds between releases have none; they are young.
fn version(line: &str) -> (u32, u32) {
    let number = line
        .strip_prefix("ffmpeg version ")
        .unwrap_or_default()
        .trim_start_matches('n');
    let mut parts = number.split(|c: char| !c.is_ascii_digit());
    let major = parts.next().and_then(|part| part.parse().ok());
    let minor = parts.next().and_then(|part| part.parse().ok()).unwrap_or(0);
    major.map_or((u32::MAX, 0), |major| (major, minor))
}

/// A file's name as ffmpeg takes it for one, whatever it begins with.
fn local(file: &str) -> String {
    if file.starts_with('-') {
        format!("./{file}")
    } else {
        file.to_owned()
    }
}

/// The arguments, and what is to be read from the input.
fn arguments(
    input: &FfmpegInput<'_>,
    resolved: &Resolved,
    handover: Handover,
    version: (u32, u32),
) -> Result<(Vec<String>, Option<String>), AddressError> {
    let mut all: Vec<String> = words(&["-hide_banner", "-nostats", "-v", "level+info"]);
    let decoded = handover != Handover::Untouched;
    let mut of_input: Vec<(&str, String)> = Vec::new();
    match input.hardware.filter(|_| decoded) {
        Some(name) if ACCELERATIONS.contains(&name) => {
            all.extend(words(&["-hwaccel", name]));
        }
        Some(name) => all.extend(words(&["-c:v", name])),
        None => {}
    }
    let live = !matches!(resolved.kind, SourceKind::File);
    if live {
        // Decoding by several threads, each with a frame of its own, holds frames back.
        all.extend(words(&["-flags", "low_delay"]));
        of_input.push(("analyzeduration", "2000000".to_owned()));
    }
    let silence = input.silence.as_micros().to_string();
    let mut address = resolved.text().to_owned();
    let hidden = !resolved.secrets.is_empty();
    match &resolved.kind {
        SourceKind::Network(scheme) if scheme.starts_with("rtsp") => {
            if version >= SCRIPT_OPTIONS {
                of_input.push(("rtsp_transport", input.transport.as_str().to_owned()));
                of_input.push(("timeout", silence));
            } else if hidden {
                // Older ones take it at the end of the address.
                let sign = if address.contains('?') { '&' } else { '?' };
                address = format!("{address}{sign}{}", input.transport.as_str());
            } else {
                of_input.push(("rtsp_transport", input.transport.as_str().to_owned()));
                of_input.push(("stimeout", silence));
            }
        }
        SourceKind::Network(scheme) if scheme.starts_with("http") => {
            of_input.push(("rw_timeout", silence));
        }
        SourceKind::Device => {
            all.extend(words(&["-f", "v4l2"]));
            if !decoded {
                of_input.push(("input_format", "mjpeg".to_owned()));
            }
        }
        SourceKind::File if input.as_camera => {
            all.extend(words(&["-re", "-stream_loop", "-1"]));
        }
        _ => {}
    }
    all.extend(input.options.iter().cloned());
    let script = if hidden {
        all.extend(words(&[
            "-f",
            "concat",
            "-safe",
            "0",
            "-protocol_whitelist",
        ]));
        all.push("file,pipe,fd,tcp,tls,udp,rtp,srtp,rtsp,rtsps,rtmp,rtmps,http,https,httpproxy,crypto,srt,data".to_owned());
        all.extend(words(&["-i", "pipe:0"]));
        let address = address.replace('\\', "%5C").replace('\'', "%27");
        let mut script = format!("ffconcat version 1.0\nfile '{address}'\n");
        if version >= SCRIPT_OPTIONS {
            for (name, value) in &of_input {
                script.push_str(&format!("option {name} {value}\n"));
            }
        }
        Some(script)
    } else {
        for (name, value) in of_input {
            all.push(format!("-{name}"));
            all.push(value);
        }
        all.extend(words(&["-nostdin", "-i"]));
        all.push(local(&address));
        None
    };
    all.extend(words(&["-map", "0:v:0"]));
    all.extend(words(if version >= FPS_MODE {
        &["-fps_mode"]
    } else {
        &["-vsync"]
    }));
    // Cameras send frames of one time twice, which encoders refuse; a file's frames are each wanted.
    all.extend(words(if live || input.as_camera {
        &["vfr"]
    } else {
        &["passthrough"]
    }));
    if decoded {
        if let Some(rate) = input.max_rate {
            all.push("-vf".to_owned());
            all.push(format!(
                "select=isnan(prev_t)+gt(floor(t*{rate})\\,floor(prev_t*{rate}))"
            ));
        }
        if live || input.as_camera {
            // Fine enough that no two frames fall on one tick.
            all.extend(words(&["-enc_time_base", "1/90000"]));
        }
    }
    match handover {
        Handover::Untouched => all.extend(words(&["-c:v", "copy", "-f", "mpjpeg"])),
        Handover::Jpeg(quality) => {
            let quality = quality.to_string();
            all.extend(words(&["-c:v", "mjpeg", "-q:v", &quality, "-f", "mpjpeg"]));
        }
        Handover::Png => all.extend(words(&["-c:v", "png", "-f", "image2pipe"])),
        Handover::Ppm => all.extend(words(&["-c:v", "ppm", "-f", "image2pipe"])),
    }
    all.extend(words(&["-flush_packets", "1", "pipe:1"]));
    Ok((all, script))
}

fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|word| (*word).to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(address: &str, handover: Handover, version: (u32, u32)) -> (String, Option<String>) {
        let address = SourceAddress::new(address);
        let mut input = FfmpegInput::new(&address);
        input.max_rate = Some(5.0);
        input.hardware = Some("cuda");
        let resolved = address.resolved().unwrap();
        let (arguments, script) = arguments(&input, &resolved, handover, version).unwrap();
        (arguments.join(" "), script)
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
    fn rtsp_comes_by_tcp_and_frames_of_one_time_are_no_error() {
        let (line, script) = line("rtsp://cam/s", Handover::Ppm, (5, 1));
        assert!(line.contains("-rtsp_transport tcp"), "{line}");
        assert!(line.contains("-i rtsp://cam/s"), "{line}");
        assert!(line.contains("-fps_mode vfr"), "{line}");
        assert!(line.contains("-hwaccel cuda"), "{line}");
        assert!(line.contains("floor(t*5)"), "{line}");
        assert_eq!(script, None);
        let (old, _) = self::line("rtsp://cam/s", Handover::Ppm, (4, 4));
        assert!(
            old.contains("-vsync vfr") && old.contains("-stimeout"),
            "{old}"
        );
    }

    #[test]
    fn a_password_is_never_in_the_command_line() {
        for version in [(4, 4), (5, 1), (7, 1)] {
            let (line, script) = line("rtsp://viewer:hidden'@cam/s", Handover::Ppm, version);
            assert!(
                !line.contains("hidden") && !line.contains("viewer"),
                "{line}"
            );
            let script = script.unwrap();
            assert!(
                script.contains("file 'rtsp://viewer:hidden%27@cam/s"),
                "{script}"
            );
            assert!(script.contains("tcp"), "{script}");
        }
    }

    #[test]
    fn motion_jpeg_is_not_decoded() {
        let (line, _) = line("http://cam/v.mjpg", Handover::Untouched, (5, 1));
        assert!(line.contains("-c:v copy"), "{line}");
        assert!(!line.contains("cuda") && !line.contains("select"), "{line}");
    }
}
