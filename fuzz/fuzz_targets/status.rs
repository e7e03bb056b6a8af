//! Fuzzes a node's status and heartbeats.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("status", data));
