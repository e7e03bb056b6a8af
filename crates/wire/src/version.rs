//! The version that every message carries as `v`; an unknown one is refused.

use serde::Deserialize;

/// The version this program writes and reads.
pub const VERSION: u32 = 1;

/// Why a message cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// Not the JSON expected.
    #[error("not a valid message: {0}")]
    Malformed(#[from] serde_json::Error),
    /// A version this program does not know.
    #[error("message version {found} is not known here; this program reads version {VERSION}")]
    Version {
        /// The version found.
        found: u32,
    },
}

/// Reads a message of any type of this crate after checking its version.
///
/// # Errors
/// [`MessageError`] when the bytes are not JSON, have no `v`, have another version, or lack a field.
pub fn read<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, MessageError> {
    #[derive(Deserialize)]
    struct Versioned {
        v: u32,
    }
    let Versioned { v } = serde_json::from_slice(bytes)?;
    check_version(v)?;
    Ok(serde_json::from_slice(bytes)?)
}

/// Refuses a message of a version that this program does not know.
///
/// # Errors
/// [`MessageError::Version`].
pub fn check_version(found: u32) -> Result<(), MessageError> {
    match found {
        VERSION => Ok(()),
        found => Err(MessageError::Version { found }),
    }
}

pub(crate) const fn current_version() -> u32 {
    VERSION
}
