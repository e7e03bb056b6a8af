//! Promises of the whole program, one file each.

mod power_published;
mod power_sysfs;
mod power_tegrastats;
mod power_telemetry;
mod support;

mod command_line;
mod eval_agreement;
mod golden_traces;
mod http_api;

mod frame_decoding;
mod frame_formats;
mod replay;
