//! Fuzzes the metadata of a model.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("model_metadata", data));
