//! Promises of the whole program, one file each.

mod frame_decoding;
mod frame_formats;
mod replay;
