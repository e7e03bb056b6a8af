//! Compresses batches with Zstandard and a dictionary shared by node and hub, so that names and frequent words are not
//! sent.

use crate::{LARGEST_BATCH_BYTES, MessageError};
use std::io::{Read, Write};
use std::sync::LazyLock;
use zstd::dict::{DecoderDictionary, EncoderDictionary};

/// The dictionary of this program; its number is the first byte of each payload.
pub const REPORT_DICTIONARY: u8 = 1;

/// Dictionary 1: typical reports of several boards. Once released it never changes; a better one gets the next number.
static DICTIONARY: &[u8] = include_bytes!("dictionary-1.json");

/// Maximum window size accepted from a sender, as a power of two: no more than a batch may hold.
const WINDOW_LOG: u32 = LARGEST_BATCH_BYTES.ilog2();

// Levels of Zstandard, which has 1 to 22.
static BEST_ENCODER: LazyLock<EncoderDictionary<'static>> =
    LazyLock::new(|| EncoderDictionary::copy(DICTIONARY, 19));
static QUICK_ENCODER: LazyLock<EncoderDictionary<'static>> =
    LazyLock::new(|| EncoderDictionary::copy(DICTIONARY, 9));
static DECODER: LazyLock<DecoderDictionary<'static>> =
    LazyLock::new(|| DecoderDictionary::copy(DICTIONARY));

/// The effort of compressing a batch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BatchCompression {
    /// For a node: a batch of some ten kilobytes is sent once every few minutes, so saving a tenth of its bytes is
    /// worth a few milliseconds.
    #[default]
    Best,
    /// For a program that simulates thousands of nodes: some 15 % larger, in a tenth of the time.
    Quick,
}

impl BatchCompression {
    pub(super) fn compress(self, json: &[u8]) -> std::io::Result<Vec<u8>> {
        let dictionary = match self {
            Self::Best => &BEST_ENCODER,
            Self::Quick => &QUICK_ENCODER,
        };
        let payload = vec![REPORT_DICTIONARY];
        let mut encoder = zstd::Encoder::with_prepared_dictionary(payload, dictionary)?;
        encoder.include_checksum(true)?;
        encoder.set_pledged_src_size(Some(json.len() as u64))?;
        encoder.write_all(json)?;
        encoder.finish()
    }
}

/// Returns the JSON of a batch's payload, at most [`LARGEST_BATCH_BYTES`].
///
/// # Errors
/// [`MessageError`] if it is not compressed with a known dictionary, is truncated, or is too large.
pub fn decompress_batch(payload: &[u8]) -> Result<Vec<u8>, MessageError> {
    let Some((dictionary, compressed)) = payload.split_first() else {
        return Err(MessageError::Dictionary(0));
    };
    if *dictionary != REPORT_DICTIONARY {
        return Err(MessageError::Dictionary(*dictionary));
    }
    let mut decoder = zstd::Decoder::with_prepared_dictionary(compressed, &DECODER)?;
    decoder.window_log_max(WINDOW_LOG)?;
    let mut json = Vec::new();
    // One byte more than allowed, to tell a batch of the largest size from a larger one.
    decoder.take(LARGEST_BATCH_BYTES as u64 + 1).read_to_end(&mut json)?;
    if json.len() > LARGEST_BATCH_BYTES {
        return Err(MessageError::TooLarge);
    }
    Ok(json)
}
