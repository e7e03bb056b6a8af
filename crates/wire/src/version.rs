//! The version that every message carries as `v`; unknown versions are refused.

use crate::{LARGEST_BATCH_BYTES, REPORT_DICTIONARY};
use serde::Deserialize;

/// The version that this program writes and reads.
pub const VERSION: u32 = 1;

/// The error for a message that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// The message is not the expected JSON.
    #[error("not a valid message: {0}")]
    Malformed(#[from] serde_json::Error),
    /// The version is unknown to this program.
    #[error("message version {0} is not known here; this program reads version {VERSION}")]
    Version(u32),
    /// The batch is truncated or not compressed in a known way.
    #[error("cannot be decompressed: {0}")]
    Compression(#[from] std::io::Error),
    /// The batch uses a dictionary that this program does not have.
    #[error("compressed with dictionary {0}; this program has dictionary {REPORT_DICTIONARY}")]
    Dictionary(u8),
    /// The decompressed batch exceeds the limit.
    #[error("more than {LARGEST_BATCH_BYTES} bytes when decompressed")]
    TooLarge,
}

/// Reads a message of any type of this crate after checking its version.
///
/// # Errors
/// [`MessageError`] if the bytes are not JSON, have no `v`, have another version, or lack a field.
pub fn read<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, MessageError> {
    #[derive(Deserialize)]
    struct Versioned {
        v: u32,
    }
    // First the version alone: a message of another one may have other fields.
    let Versioned { v } = serde_json::from_slice(bytes)?;
    check_version(v)?;
    Ok(serde_json::from_slice(bytes)?)
}

/// Refuses a message whose version is unknown to this program.
///
/// # Errors
/// [`MessageError::Version`].
pub fn check_version(found: u32) -> Result<(), MessageError> {
    if found == VERSION {
        Ok(())
    } else {
        Err(MessageError::Version(found))
    }
}

pub(crate) const fn current_version() -> u32 {
    VERSION
}
