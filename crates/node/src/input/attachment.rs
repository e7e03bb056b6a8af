//! Reads the attachment of a frame: JSON from this program, or the format of ROS 2's rmw_zenoh.

use super::PayloadFormat;
use albireo_vision::picture::FrameFault;
use albireo_wire::FrameAttachment;

/// The longest attachment that is read, bytes.
const MAX_ATTACHMENT_BYTES: usize = 4096;
/// The longest clip id, bytes: it goes into every message of the clip.
const MAX_CLIP_BYTES: usize = 200;

/// Reads the attachment. A ROS 2 camera's attachment is not this program's, so its contents are understood or
/// ignored.
pub(super) fn read_attachment(
    attachment: Option<&[u8]>,
    format: PayloadFormat,
) -> Result<FrameAttachment, FrameFault> {
    let Some(bytes) = attachment.filter(|bytes| !bytes.is_empty()) else {
        return Ok(FrameAttachment::default());
    };
    match format {
        PayloadFormat::Encoding => read_json(bytes),
        // JSON of 32 bytes could be read as rmw_zenoh's numbers, which are never JSON.
        PayloadFormat::Ros2 => {
            Ok(read_json(bytes).ok().or_else(|| read_rmw_zenoh(bytes)).unwrap_or_default())
        }
    }
}

fn read_json(bytes: &[u8]) -> Result<FrameAttachment, FrameFault> {
    if bytes.len() > MAX_ATTACHMENT_BYTES {
        return Err(FrameFault::unknown_format(format!(
            "the attachment has {} bytes; at most {MAX_ATTACHMENT_BYTES} are accepted",
            bytes.len()
        )));
    }
    let attachment: FrameAttachment = albireo_wire::read(bytes).map_err(|error| {
        FrameFault::unknown_format(format!(
            "the attachment cannot be read: {error}; it should look like \
             {{\"v\":1,\"seq\":7,\"t_ns\":1700000000000000000,\"clip\":\"drive-1\"}}"
        ))
    })?;
    if let Some(clip) = &attachment.clip
        && (clip.is_empty() || clip.len() > MAX_CLIP_BYTES || clip.chars().any(char::is_control))
    {
        return Err(FrameFault::unknown_format(format!(
            "the attachment's clip id must be 1 to {MAX_CLIP_BYTES} bytes without control characters"
        )));
    }
    Ok(attachment)
}

/// Reads the attachment of rmw_zenoh (ros2/rmw_zenoh, rmw_zenoh_cpp/src/detail/attachment_helpers.cpp):
/// sequence number and source time in nanoseconds as little-endian `int64`, then the sender's 16-byte
/// id, with a length prefix in some releases. In the first releases, each of the three is preceded by a
/// name with a length prefix.
fn read_rmw_zenoh(bytes: &[u8]) -> Option<FrameAttachment> {
    let (sequence, rest) = take_i64(without_name(bytes, b"sequence_number"))?;
    let (time_ns, rest) = take_i64(without_name(rest, b"source_timestamp"))?;
    let sender = without_name(rest, b"source_gid");
    if !matches!(sender.len(), 16 | 17) {
        return None;
    }
    // A restarted publisher has another id, and numbers from the start.
    let stream = sender.last_chunk::<16>().map(|bytes| {
        let id = u128::from_le_bytes(*bytes);
        let upper_half = (id >> 64) as u64;
        upper_half ^ id as u64
    });
    Some(FrameAttachment {
        seq: Some(u64::try_from(sequence).ok()?),
        stream,
        t_ns: u64::try_from(time_ns).ok().filter(|time| *time > 0),
        ..FrameAttachment::default()
    })
}

fn without_name<'a>(bytes: &'a [u8], name: &[u8]) -> &'a [u8] {
    match bytes.split_first() {
        Some((&length, rest)) if usize::from(length) == name.len() => {
            rest.strip_prefix(name).unwrap_or(bytes)
        }
        _ => bytes,
    }
}

fn take_i64(bytes: &[u8]) -> Option<(i64, &[u8])> {
    let (number, rest) = bytes.split_first_chunk::<8>()?;
    Some((i64::from_le_bytes(*number), rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rmw(named: bool, length_byte: bool) -> Vec<u8> {
        let name = |text: &str| {
            if named {
                [&[text.len() as u8][..], text.as_bytes()].concat()
            } else {
                Vec::new()
            }
        };
        let parts = [
            name("sequence_number"),
            41_i64.to_le_bytes().to_vec(),
            name("source_timestamp"),
            1_700_000_000_123_456_789_i64.to_le_bytes().to_vec(),
            name("source_gid"),
            vec![16; usize::from(length_byte)],
            vec![7; 16],
        ];
        parts.concat()
    }

    #[test]
    fn every_release_of_rmw_zenoh_is_understood() {
        for (named, length_byte) in [(false, false), (false, true), (true, false), (true, true)] {
            let bytes = rmw(named, length_byte);
            let attachment = read_attachment(Some(&bytes), PayloadFormat::Ros2).unwrap();
            assert_eq!(attachment.seq, Some(41), "{named} {length_byte}");
            assert_eq!(attachment.t_ns, Some(1_700_000_000_123_456_789));
            assert!(attachment.stream.is_some(), "a publisher's id");
        }
    }

    #[test]
    fn a_ros_attachment_of_another_kind_is_ignored() {
        for bytes in [&b"\0"[..], b"{", &[0xFF; 32], &[0; 500], b"sequence_number"] {
            let attachment = read_attachment(Some(bytes), PayloadFormat::Ros2);
            assert_eq!(attachment.unwrap(), FrameAttachment::default());
        }
    }

    #[test]
    fn json_is_json_also_in_the_length_of_ros_numbers() {
        for (json, seq) in [
            (&br#"{"v":1,"seq":3}"#[..], 3),
            (br#"{"v":1,"seq":4,"clip":"drive-1"}"#, 4),
            (br#"{"v":1,"seq":41,"clip":"drive-1"}"#, 41),
        ] {
            let attachment = read_attachment(Some(json), PayloadFormat::Ros2).unwrap();
            assert_eq!(attachment.seq, Some(seq), "{} bytes", json.len());
        }
    }

    #[test]
    fn an_invalid_json_attachment_is_explained() {
        for (bytes, part) in [
            (&br#"{"v":2}"#[..], "version 2"),
            (b"\x01\x02", "cannot be read"),
            (br#"{"v":1,"seq":-1}"#, "cannot be read"),
            (br#"{"v":1,"clip":""}"#, "clip id"),
            (br#"{"v":1,"clip":"a\nb"}"#, "clip id"),
            (&[b' '; 5000], "5000 bytes"),
        ] {
            let fault = read_attachment(Some(bytes), PayloadFormat::Encoding).unwrap_err();
            assert_eq!(fault.kind(), "unknown_format");
            assert!(fault.to_string().contains(part), "{fault}");
        }
    }
}
