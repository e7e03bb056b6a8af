//! The command line with which ffmpeg extracts pictures from a source.

use super::address::{Resolved, SourceKind};
use super::program::PictureProgram;
use super::settings::SourceSettings;
use albireo_vision::recordings::for_ffmpeg;
use std::path::Path;

/// The program.
pub(super) const FFMPEG: &str = "ffmpeg";

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
/// What counts for a build without a version.
const NEWEST: Version = (u32::MAX, 0);

/// The quality of encoded pictures (`-q:v`, 2 is the best).
const JPEG_QUALITY: &str = "3";

/// Memory of ffmpeg besides its largest blocks: libraries, threads, queues.
const WORKING_MEMORY: u64 = 512 << 20;

/// Protocols that a script may open.
const PROTOCOLS: &str = "async,subfile,file,pipe,fd,tcp,tls,udp,rtp,srtp,rtsp,rtsps,rtmp,rtmps,http,https,httpproxy,crypto,srt,data";

/// Before an address in a script, which cannot name a format: takes away the first three bytes of the stream and its type, so
/// that ffmpeg recognises it by its pictures. `subfile` skips by seeking, which `async` does for it by reading.
const WITHOUT_FORMAT: &str = "subfile,,start,3,end,0,,:async:";

/// The unit of the timestamps of decoded pictures.
const MICROSECONDS: &str = "1/1000000";

/// Endings by which ffmpeg takes an address for a file of one picture, and reads as much of it as its answer says.
const PICTURE_ENDINGS: [&str; 2] = [".jpg", ".jpeg"];

/// Options for ffmpeg itself or a decoder, not for the camera: they stay on the command line.
const PROGRAM_OPTIONS: &str = "an autorotate c codec discard ec err_detect f flags flags2 hwaccel hwaccel_device \
    hwaccel_output_format init_hw_device itsoffset lowres noautorotate r re skip_frame skip_idct skip_loop_filter \
    thread_queue_size threads";

/// Frameworks to which ffmpeg delegates decoding (`ffmpeg -hwaccels`); any other name is a decoder's.
const ACCELERATIONS: &str =
    "auto cuda d3d11va drm dxva2 opencl qsv vaapi vdpau videotoolbox vulkan";

/// The numbers in `ffmpeg version 5.1.9-0+deb12u1 …`. Builds between releases have none and count as newest.
pub(super) fn version(banner: &str) -> Version {
    let number = banner
        .strip_prefix("ffmpeg version ")
        .unwrap_or_default()
        .trim_start_matches('n');
    let mut parts = number.split(|c: char| !c.is_ascii_digit());
    let mut next = || parts.next().and_then(|part| part.parse().ok());
    let Some(major) = next() else {
        return NEWEST;
    };
    (major, next().unwrap_or(0))
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
        self.add(&["-hide_banner", "-nostats", "-v", "repeat+level+verbose"]);
        self.add(&["-max_alloc", &largest_block.to_string()]);
        let settings = self.settings;
        // Pictures that are passed on are not decoded.
        if !self.way.is_untouched()
            && let Some(name) = &settings.hardware
        {
            let option = if is_among(ACCELERATIONS, name) {
                "-hwaccel"
            } else {
                "-c:v"
            };
            self.add(&[option, name]);
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
            kind if kind.is_rtsp() => {
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
            kind if kind.is_http() => {
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
            // `c:v` is the option `c` for one kind of stream.
            let option = name.split(':').next().unwrap_or(name);
            let is_for_program = is_among(PROGRAM_OPTIONS, option);
            match value {
                Some(value) if scripted && !is_for_program => {
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
        if takes_options {
            for (name, value) in &self.camera {
                let value = value.replace('\'', "'\\''");
                script.push_str(&format!("option {name} '{value}'\n"));
            }
        }
        Ok(script)
    }

    /// The input is on the command line.
    fn add_input(&mut self, address: &str) {
        for (name, value) in std::mem::take(&mut self.camera) {
            self.add(&[&format!("-{name}"), &value]);
        }
        let input = if address.contains("://") {
            address.to_owned()
        } else {
            for_ffmpeg(Path::new(address)).to_string_lossy().into_owned()
        };
        self.add(&["-nostdin", "-i", &input]);
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
            self.add(&["-enc_time_base", MICROSECONDS]);
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

/// The ffmpeg command that reads a source, or one `file` of it, in that way. A secret address or option is passed in a
/// script on its input, not on its command line, which every user of the machine can see.
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
    let secret_options: Vec<&str> = settings.options.secrets().collect();
    let is_network = matches!(resolved.kind, SourceKind::Network(_));
    let hides_options = is_network && command.takes_options() && !secret_options.is_empty();
    let scripted = hidden_address || hides_options;
    if way == Way::BareJpeg {
        let lower = address.to_ascii_lowercase();
        if !scripted {
            command.add(&["-f", "mjpeg"]);
        } else if PICTURE_ENDINGS.iter().any(|ending| lower.ends_with(ending)) {
            // An empty query hides the ending.
            let sign = if address.contains('?') { '&' } else { '?' };
            address.push(sign);
        } else {
            address.insert_str(0, WITHOUT_FORMAT);
        }
    }
    for secret in secret_options {
        resolved.secrets.add(secret);
    }
    command.add_options(scripted);
    let input = if scripted {
        Some(command.add_script(&address)?)
    } else {
        command.add_input(&address);
        None
    };
    command.add_output();
    let max_memory = if settings.hardware.is_some() {
        // A graphics card's driver maps any amount of memory.
        None
    } else {
        Some(WORKING_MEMORY.saturating_add(4 * largest_block))
    };
    Ok(PictureProgram {
        program: FFMPEG,
        arguments: command.arguments,
        input,
        tells_broken: !way.is_untouched(),
        writes_ppm: !way.is_untouched() && !settings.as_jpeg,
        secrets: resolved.secrets,
        max_memory,
    })
}

/// The filters for decoded pictures. The first picture of each slot of time is taken, on average exactly the limit, by the
/// clock of this machine: cameras send any timestamps. Slots are compared for being different, so that a step of that
/// clock matters no more than one picture. The expression prints for each picture 1 for a key frame, plus 2 if it is taken,
/// which [`Messages`](super::messages::Messages) reads. Afterwards each picture gets as its timestamp the time of the
/// first plus its number, because encoders reject timestamps that do not grow. The number alone would not do: when the
/// size of the pictures changes, ffmpeg makes the filters anew, and they count from zero.
fn filters(max_rate: Option<f64>) -> String {
    let taken = match max_rate {
        Some(rate) => format!("not(eq(ld(0)\\,st(0\\,floor(time(0)*{rate}))))"),
        None => "1".to_owned(),
    };
    let select = format!("select=st(1\\,{taken})*0+print(key+2*ld(1))*0+ld(1)");
    let first = "st(0\\,if(ld(0)\\,ld(0)\\,time(0)*1000000))";
    format!("{select},settb={MICROSECONDS},setpts={first}+N")
}

/// True if `name` is one of the `words`.
fn is_among(words: &str, name: &str) -> bool {
    words.split_whitespace().any(|word| word == name)
}

#[cfg(test)]
pub(super) mod tests;
