//! Fuzzes a hub's configuration.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("hub_toml", data));
