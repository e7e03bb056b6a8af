//! Policies for comparison only: the paper's baselines and ablations, and two based on other papers.

mod ablation;
mod adaptive_rate;
mod changed_region;
mod ctd;
mod erd_only;
mod frame_drop;
mod statues;

pub(crate) use ablation::Ablation;
pub use adaptive_rate::{AdaptiveRate, AdaptiveRateSettings};
pub use ctd::{Ctd, CtdSettings};
pub(crate) use erd_only::ErdOnly;
pub use frame_drop::{FrameDrop, FrameDropSettings};
pub use statues::{Statues, StatuesSettings};
