//! Promises of the whole program, one file each.
mod eval_agreement;
mod golden_traces;
