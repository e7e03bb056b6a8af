//! The promises of the whole program, with its default features, one per file.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

/// The limit of each test by rstest; cargo has it only in this project's folder.
const _: &str = env!("RSTEST_TIMEOUT");

mod support;

mod answers;
mod camera_mounts;
mod cameras;
mod command_line;
mod compare;
mod delivery;
mod demo;
mod deploy_access;
mod deploy_files;
mod deploy_systemd;
mod deploy_watching;
mod detector_exports;
mod detector_families;
mod detector_inputs;
mod detector_models;
mod detector_pixels;
mod detector_quantised;
mod detector_session;
mod documentation;
mod end_to_end;
mod eval_agreement;
mod eval_audit;
mod eval_board;
mod eval_coco;
mod eval_command;
mod eval_pictures;
mod eval_tracking;
mod expected_loss;
mod fleet;
mod fleet_targets;
mod forwarding;
mod frame_decoding;
mod frame_formats;
mod golden_traces;
mod head_fixtures;
mod http_api;
mod hub_faults;
mod hub_kills;
mod no_news;
mod node_frames;
mod pages;
mod policy;
mod power_cuts;
mod power_live;
mod power_tegrastats;
mod power_telemetry;
mod recordings;
mod replay;
mod ros2;
mod stopping;
mod structure;
mod supervision;
mod wheel;
