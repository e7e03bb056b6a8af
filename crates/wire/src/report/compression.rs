//! How a batch of reports is made small: by gzip, which every hub reads, or by Zstandard against an example batch that
//! node and hub both have, so that names and usual words are not sent at all.

use super::BatchError;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use std::io::{Read, Write};
use std::sync::LazyLock;
use zstd::dict::{DecoderDictionary, EncoderDictionary};

/// The newest dictionary that this program has. A hub says it in
/// [`Desired::report_dictionary`](crate::Desired::report_dictionary), and reads those before it as well.
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

/// How a batch is compressed. The first byte of a payload tells it: gzip begins with 0x1f, and what is compressed against
/// a dictionary with the dictionary's number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BatchCompression {
    /// gzip: what every hub reads.
    #[default]
    Gzip,
    /// Zstandard against dictionary 1.
    Dictionary,
    /// The same with less effort: some 15 % larger, in a tenth of the time.
    QuickDictionary,
}

impl BatchCompression {
    /// The best that a hub reads which says that it has dictionaries up to `known`.
    pub fn for_hub(known: Option<u8>) -> Self {
        match known {
            Some(REPORT_DICTIONARY..) => Self::Dictionary,
            _ => Self::Gzip,
        }
    }

    pub(super) fn compress(self, json: &[u8]) -> std::io::Result<Vec<u8>> {
        match self {
            Self::Gzip => {
                let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
                encoder.write_all(json)?;
                encoder.finish()
            }
            Self::Dictionary => against(&BEST_ENCODER, json),
            Self::QuickDictionary => against(&QUICK_ENCODER, json),
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
        Some((&number, _)) if number < 0x1f => {
            return Err(BatchError::UnknownDictionary(number));
        }
        _ => {
            GzDecoder::new(payload)
                .take(most + 1)
                .read_to_end(&mut json)?;
        }
    }
    if json.len() as u64 > most {
        return Err(BatchError::TooLarge);
    }
    Ok(json)
}
