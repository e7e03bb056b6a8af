//! Promises of the whole program, one file each.
mod eval_agreement;
mod eval_coco;
mod eval_paper;
mod golden_traces;
