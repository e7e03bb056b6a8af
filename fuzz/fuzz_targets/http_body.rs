//! Fuzzes the bodies of requests to a node.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("http_body", data));
