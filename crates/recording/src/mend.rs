//! Gives a recording that was cut by a power failure its end.

use crate::RecordingError;
use crate::file::create_writer;
use crate::read::{Definition, Messages};
use mcap::records::MessageHeader;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::{File, remove_file, rename};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// The number by which MCAP marks a channel without a schema.
const NO_SCHEMA: u16 = 0;

/// What became of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mended {
    /// It was whole.
    Whole,
    /// It ended without an index, and has one now.
    Mended {
        /// The messages that it holds.
        messages: u64,
    },
    /// It held no message, and was removed.
    Removed,
}

/// Copies what is whole in a recording without an end into a new file, which replaces the old one once it is on the disk;
/// until then both need room.
///
/// # Errors
/// If the disk refuses: the file is as it was.
pub fn mend(path: &Path) -> Result<Mended, RecordingError> {
    if has_end(path)? {
        return Ok(Mended::Whole);
    }
    let mut name = OsString::from(path);
    name.push(".part");
    let part = Path::new(&name);
    // An earlier call that was cut itself may have left one.
    let _ = remove_file(part);
    match copy_whole(path, part) {
        Ok(0) => {
            remove_file(part)?;
            remove_file(path)?;
            Ok(Mended::Removed)
        }
        Ok(messages) => {
            rename(part, path)?;
            Ok(Mended::Mended { messages })
        }
        Err(error) => {
            let _ = remove_file(part);
            Err(error)
        }
    }
}

/// True if the file ends as a finished one does.
fn has_end(path: &Path) -> Result<bool, RecordingError> {
    let mut file = File::open(path)?;
    let mut end = [0; mcap::MAGIC.len()];
    let length = file.metadata()?.len();
    // Beginning and end have the same signature.
    if length < 2 * end.len() as u64 {
        return Ok(false);
    }
    file.seek(SeekFrom::End(-(end.len() as i64)))?;
    file.read_exact(&mut end)?;
    Ok(end == mcap::MAGIC)
}

/// Copies the messages before the damage; returns how many there are.
fn copy_whole(from: &Path, to: &Path) -> Result<u64, RecordingError> {
    let (mut writer, file) = create_writer(to)?;
    let no_metadata = BTreeMap::new();
    let mut copied = 0;
    let mut messages = Messages::open(from)?;
    loop {
        let message = match messages.advance() {
            Ok(Some(message)) => message,
            Ok(None) => break,
            // The disk does not say what there is.
            Err(error @ RecordingError::Io(_)) => return Err(error),
            // Here it was cut.
            Err(_) => break,
        };
        let channel = &message.channel;
        let schema = if channel.schema.is_empty() {
            NO_SCHEMA
        } else {
            let Definition { encoding, text } = &channel.definition;
            writer.add_schema(&channel.schema, encoding, text)?
        };
        let channel_id =
            writer.add_channel(schema, &channel.topic, &channel.encoding, &no_metadata)?;
        let header = MessageHeader {
            channel_id,
            sequence: copied as u32,
            log_time: message.time_ns,
            publish_time: message.time_ns,
        };
        writer.write_to_known_channel(&header, &message.data)?;
        copied += 1;
    }
    writer.finish()?;
    file.sync_all()?;
    Ok(copied)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_that_cannot_be_read_is_no_end_of_a_recording() {
        let folder = tempfile::tempdir().unwrap();
        // Its first page is never there, and reading it is an error of the device.
        let unreadable = Path::new("/proc/self/mem");
        let copied = copy_whole(unreadable, &folder.path().join("a.mcap.part"));
        assert!(matches!(copied, Err(RecordingError::Io(_))), "{copied:?}");
    }
}
