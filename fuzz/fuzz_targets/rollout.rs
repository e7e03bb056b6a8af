//! Fuzzes selectors of nodes and plans of rollouts.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("rollout", data));
