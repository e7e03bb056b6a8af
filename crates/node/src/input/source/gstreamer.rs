//! The command line with which GStreamer extracts pictures from a source.

use super::address::{Resolved, SourceKind};
use super::program::PictureProgram;
use super::settings::SourceSettings;

/// The program.
pub(super) const GSTREAMER: &str = "gst-launch-1.0";

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
        SourceKind::Pipeline => {
            for word in words {
                add(&[word]);
            }
        }
        SourceKind::Device => add(&["v4l2src", &format!("device={text}")]),
        SourceKind::File | SourceKind::Files => add(&["filesrc", &format!("location={text}")]),
        kind if kind.is_rtsp() => add(&[
            "rtspsrc",
            &format!("location={text}"),
            &format!("protocols={}", settings.transport.as_str()),
            "latency=0",
        ]),
        SourceKind::Network(_) => add(&["uridecodebin", &format!("uri={text}")]),
    }
    if *kind != SourceKind::Pipeline {
        // `uridecodebin` decodes what it reads.
        let is_decoded = matches!(kind, SourceKind::Network(_)) && !kind.is_rtsp();
        if !is_decoded {
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

#[cfg(test)]
mod tests {
    use super::super::ffmpeg::tests::{assert_has, assert_lacks, settings};
    use super::*;

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
        let refused = gstreamer(&settings("rtsp://u:hidden@cam/s", "")).err().unwrap();
        assert_has(&refused, &["install ffmpeg"]);
        assert_lacks(&refused, &["hidden"]);
    }
}
