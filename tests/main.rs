//! Promises of the whole program, one file each.

mod command_line;
mod golden_traces;
mod http_api;
