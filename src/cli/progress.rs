//! Shows progress on a terminal.

use indicatif::ProgressBar;
#[cfg(feature = "hub")]
use indicatif::ProgressStyle;
use std::time::Duration;

/// Makes a bar of `total` steps, or a spinner if their number is unknown; `unit` follows the count. It is hidden if
/// standard error is not a terminal.
#[cfg(feature = "hub")]
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
    let style = ProgressStyle::with_template(&style);
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Makes a spinner beside `message` for work of unknown length.
pub(super) fn spinner(message: String) -> ProgressBar {
    let spinner = ProgressBar::new_spinner().with_message(message);
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}
