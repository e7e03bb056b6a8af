//! Fuzzes batches of reports.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("report_batch", data));
