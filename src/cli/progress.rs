//! Shows progress on a terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// Makes a bar of `total` steps, or a spinner if their number is unknown; `unit` follows the count. It is hidden if
/// standard error is not a terminal.
pub(super) fn bar(total: Option<u64>, unit: &str) -> ProgressBar {
    let (bar, style) = match total {
        Some(total) => (
            ProgressBar::new(total),
            format!("{{prefix}}{{bar:30}} {{pos}}/{{len}} {unit}  {{per_sec}}  {{eta}} left"),
        ),
        None => (
            ProgressBar::new_spinner(),
            format!("{{prefix}}{{spinner}} {{pos}} {unit}  {{per_sec}}  {{elapsed}}"),
        ),
    };
    match ProgressStyle::with_template(&style) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
