use super::super::address::SourceAddress;
use super::super::options::SourceOptions;
use super::*;
use crate::config::CameraConfig;
use albireo_vision::picture::FrameLimits;

/// The settings of a source, with options as on a command line.
pub(in crate::input::source) fn settings(address: &str, options: &str) -> SourceSettings {
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
pub(in crate::input::source) fn assert_has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "no {part} in {text}");
    }
}

#[track_caller]
pub(in crate::input::source) fn assert_lacks(text: &str, parts: &[&str]) {
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
fn the_ending_of_an_address_with_a_password_does_not_make_it_a_file() {
    for (address, hidden) in [
        ("http://u:hidden@cam/snap.JPG", "snap.JPG?'"),
        ("http://u:hidden@cam/get?file=snap.jpeg", "snap.jpeg&'"),
        ("http://u:hidden@cam/v.mjpg", "v.mjpg'"),
    ] {
        let program = ffmpeg(&settings(address, ""), None, Way::BareJpeg, (5, 1)).unwrap();
        assert_has(&program.input.unwrap(), &[hidden]);
    }
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
