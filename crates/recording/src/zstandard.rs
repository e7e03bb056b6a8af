//! Decompresses chunks with the Zstandard library that the program has already.

use mcap::McapResult;
use mcap::sans_io::decompressor::{DecompressResult, Decompressor};
use std::io::Result as IoResult;
use zstd::stream::raw::{Decoder, InBuffer, Operation, OutBuffer};

/// Decompresses chunks marked `zstd`.
pub(crate) struct Zstandard(Decoder<'static>);

impl Zstandard {
    pub(crate) fn new() -> IoResult<Self> {
        Ok(Self(Decoder::new()?))
    }
}

impl Decompressor for Zstandard {
    /// Any amount.
    fn next_read_size(&self) -> usize {
        0
    }

    fn decompress(&mut self, src: &[u8], dst: &mut [u8]) -> McapResult<DecompressResult> {
        let mut input = InBuffer::around(src);
        let mut output = OutBuffer::around(dst);
        self.0.run(&mut input, &mut output)?;
        Ok(DecompressResult {
            consumed: input.pos,
            wrote: output.pos(),
        })
    }

    fn reset(&mut self) -> McapResult<()> {
        Ok(self.0.reinit()?)
    }

    fn name(&self) -> &'static str {
        "zstd"
    }
}
