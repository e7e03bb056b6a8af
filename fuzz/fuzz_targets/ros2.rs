//! Fuzzes the pictures of ROS 2.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| albireo_fuzz::fuzz("ros2", data));
