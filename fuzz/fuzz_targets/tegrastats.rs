//! Fuzzes the lines of `tegrastats`.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("tegrastats", data));
