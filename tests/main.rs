//! Promises of the whole program, one file each.

mod command_line;
mod http_api;
mod golden_traces;
