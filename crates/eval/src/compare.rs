//! Compares policies on the live node: schedules the runs, summarises their figures, and writes the results. The
//! command `albireo compare` plays the runs.
//!
//! ```text
//! variants ─▶ schedule ─▶ (a run on the node) ─▶ Run ─▶ summary ─▶ table, JSON, CSV
//! ```

mod agreement;
mod files;
mod run;
mod schedule;
mod summary;
mod table;
mod variant;
mod verdict;

pub use agreement::{Agreement, Boxes, ClassNumbers, agreement, agreement_with_truth};
pub use files::write;
pub use run::{Comparison, Playback, Run, Suggestion, TruthSize};
pub use schedule::{ScheduledRun, schedule};
pub use summary::{Change, Figure, Mean, Summary, VariantSummary, summarise};
pub use table::render;
pub use variant::variants;
