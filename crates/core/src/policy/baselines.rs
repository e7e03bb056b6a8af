//! Policies for comparison only: the paper's baselines and ablations.

mod ablation;
mod changed_region;
mod ctd;
mod erd_only;
mod statues;

pub(crate) use ablation::Ablation;
pub use ctd::{Ctd, CtdSettings};
pub(crate) use erd_only::ErdOnly;
pub use statues::{Statues, StatuesSettings};
