//! Policies side by side on the live node: in which order runs are played, what is made of their figures,
//! and how it is written. Playing them is the command's part (`albireo compare`).
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

pub use agreement::{Agreement, Boxes, ClassNumbers, agreement};
pub use files::write;
pub use run::{Advice, Comparison, Playing, Run};
pub use schedule::{Turn, schedule};
pub use summary::{Change, Figure, Mean, PolicySummary, Summary, summarise};
pub use table::render;
pub use variant::variants;
pub use verdict::{Verdict, verdicts};
