//! How GStreamer is told to open a source: a pipeline of the user's own, or, where there is no ffmpeg, one made here.

use super::address::{Resolved, SourceAddress, SourceKind};
use super::ffmpeg::RtspTransport;
use super::program::{INSTALL_GSTREAMER, Running, SourceError, is_missing, output_of};
use std::process::Command;

/// The program that runs pipelines.
const LAUNCH: &str = "gst-launch-1.0";

/// What every pipeline ends with: each picture with its length before it.
const END: [&str; 5] = ["!", "multipartmux", "!", "fdsink", "fd=1"];

/// Whether GStreamer is there.
pub(super) fn is_there() -> bool {
    output_of(Command::new(LAUNCH).arg("--version")).is_ok_and(|output| output.status.success())
}

pub(super) fn missing(address: &SourceAddress) -> SourceError {
    SourceError::Missing {
        source_name: address.to_string(),
        programs: "no `gst-launch-1.0`",
        remedy: INSTALL_GSTREAMER,
    }
}

/// Starts a pipeline whose pictures are parts of a multipart stream.
///
/// # Errors
/// When GStreamer is missing, or the address cannot be used.
pub(super) fn open(
    address: &SourceAddress,
    transport: RtspTransport,
) -> Result<Running, SourceError> {
    let resolved = address.resolved()?;
    let mut command = Command::new(LAUNCH);
    command
        .arg("-q")
        .args(pipeline(address, &resolved, transport)?);
    for variable in &resolved.variables {
        command.env_remove(variable);
    }
    Running::start(&mut command, None, resolved.secrets).map_err(|error| {
        if is_missing(&error) {
            return missing(address);
        }
        SourceError::NotStarted {
            program: LAUNCH.to_owned(),
            error,
        }
    })
}

/// The words of the pipeline.
fn pipeline(
    address: &SourceAddress,
    resolved: &Resolved,
    transport: RtspTransport,
) -> Result<Vec<String>, SourceError> {
    let text = resolved.text();
    // The program has no way to take an address but its command line.
    if resolved.kind != SourceKind::Pipeline && !resolved.secrets.is_empty() {
        return Err(SourceError::WouldShow(address.to_string()));
    }
    let begin: Vec<String> = match &resolved.kind {
        SourceKind::Pipeline => resolved.words.clone(),
        SourceKind::Device => decoded(vec!["v4l2src".to_owned(), format!("device={text}")]),
        SourceKind::File => decoded(vec!["filesrc".to_owned(), format!("location={text}")]),
        SourceKind::Network(scheme) if scheme.starts_with("rtsp") => decoded(vec![
            "rtspsrc".to_owned(),
            format!("location={text}"),
            format!("protocols={}", transport.as_str()),
            "latency=0".to_owned(),
        ]),
        SourceKind::Network(_) => {
            let mut words = vec!["uridecodebin".to_owned(), format!("uri={text}")];
            words.extend(encoder());
            words
        }
    };
    let mut all = begin;
    all.extend(END.map(str::to_owned));
    if resolved.kind == SourceKind::File {
        all.push("sync=true".to_owned());
    }
    Ok(all)
}

fn decoded(source: Vec<String>) -> Vec<String> {
    let mut words = source;
    words.extend(["!", "decodebin"].map(str::to_owned));
    words.extend(encoder());
    words
}

fn encoder() -> [String; 4] {
    ["!", "videoconvert", "!", "jpegenc"].map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(text: &str) -> Result<String, SourceError> {
        let address = SourceAddress::new(text);
        let resolved = address.resolved().unwrap();
        pipeline(&address, &resolved, RtspTransport::Tcp).map(|words| words.join(" "))
    }

    #[test]
    fn a_pipeline_gets_an_end_that_tells_lengths() {
        assert_eq!(
            line("videotestsrc ! jpegenc").unwrap(),
            "videotestsrc ! jpegenc ! multipartmux ! fdsink fd=1"
        );
        let camera = line("rtsp://cam/s").unwrap();
        assert!(
            camera.contains("rtspsrc location=rtsp://cam/s protocols=tcp"),
            "{camera}"
        );
    }

    #[test]
    fn no_password_is_put_into_a_command_line_that_was_not_written_so() {
        let refused = line("rtsp://u:hidden@cam/s").unwrap_err().to_string();
        assert!(
            refused.contains("install ffmpeg") && !refused.contains("hidden"),
            "{refused}"
        );
    }
}
