//! Promises of the whole program, one file each.
mod golden_traces;
