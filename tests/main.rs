//! Promises of the whole program, one file each.

mod detector_models;
mod detector_session;
