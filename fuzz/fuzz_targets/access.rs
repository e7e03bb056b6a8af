//! Fuzzes a router's access rules, and its list of certificates.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("access", data));
