//! How a batch of reports is compressed: by Zstandard against an example batch that node and hub both have, so that names and
//! usual words are not sent at all.

use super::BatchError;
use std::io::{Read, Write};
use std::sync::LazyLock;
use zstd::dict::{DecoderDictionary, EncoderDictionary};

/// The dictionary that this program has: the first byte of every payload.
pub const REPORT_DICTIONARY: u8 = 1;

/// Dictionary 1: reports as several boards make them. What was once released is never changed; a better one gets the
/// next number.
static DICTIONARY: &[u8] = include_bytes!("dictionary-1.json");

/// Zstandard's level for a node: a batch is some ten kilobytes and goes out once in minutes, so that some milliseconds
/// are nothing beside a tenth of its bytes.
const BEST: i32 = 19;

/// The level for a program that plays thousands of nodes.
const QUICK: i32 = 9;

/// Largest window that is accepted of a sender, as a power of two: no more than a batch may hold.
const WINDOW_LOG: u32 = super::LARGEST_BATCH_BYTES.ilog2();

static BEST_ENCODER: LazyLock<EncoderDictionary<'static>> =
    LazyLock::new(|| EncoderDictionary::copy(DICTIONARY, BEST));
static QUICK_ENCODER: LazyLock<EncoderDictionary<'static>> =
    LazyLock::new(|| EncoderDictionary::copy(DICTIONARY, QUICK));
static DECODER: LazyLock<DecoderDictionary<'static>> =
    LazyLock::new(|| DecoderDictionary::copy(DICTIONARY));

/// How much effort goes into a batch's compression.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BatchCompression {
    /// The smallest payload.
    #[default]
    Best,
    /// Some 15 % larger, in a tenth of the time.
    Quick,
}

impl BatchCompression {
    /// The payload of a batch that is JSON already.
    ///
    /// # Errors
    /// None that can happen: memory takes all that is written.
    pub fn compress(self, json: &[u8]) -> std::io::Result<Vec<u8>> {
        match self {
            Self::Best => against(&BEST_ENCODER, json),
            Self::Quick => against(&QUICK_ENCODER, json),
        }
    }
}

fn against(dictionary: &EncoderDictionary<'_>, json: &[u8]) -> std::io::Result<Vec<u8>> {
    let payload = vec![REPORT_DICTIONARY];
    let mut encoder = zstd::Encoder::with_prepared_dictionary(payload, dictionary)?;
    encoder.include_checksum(true)?;
    encoder.set_pledged_src_size(Some(json.len() as u64))?;
    encoder.write_all(json)?;
    encoder.finish()
}

/// The JSON of a payload.
pub(super) fn decompress(payload: &[u8], most: u64) -> Result<Vec<u8>, BatchError> {
    let mut json = Vec::new();
    match payload.split_first() {
        Some((&REPORT_DICTIONARY, compressed)) => {
            let mut decoder = zstd::Decoder::with_prepared_dictionary(compressed, &DECODER)?;
            decoder.window_log_max(WINDOW_LOG)?;
            decoder.take(most + 1).read_to_end(&mut json)?;
        }
        Some((&number, _)) => return Err(BatchError::UnknownDictionary(number)),
        None => return Err(BatchError::Inconsistent("the payload is empty")),
    }
    if json.len() as u64 > most {
        return Err(BatchError::TooLarge);
    }
    Ok(json)
}
