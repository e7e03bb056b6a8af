//! Shows progress on a terminal, and what is waited for.

#[cfg(feature = "eval")]
use super::terminal;
#[cfg(feature = "eval")]
use albireo_service::clock::unix_milliseconds;
use indicatif::ProgressBar;
#[cfg(feature = "hub")]
use indicatif::ProgressStyle;
use std::time::Duration;

/// Makes a bar of `total` steps, or a spinner if their number is unknown; `unit` follows the count. It is hidden if
/// standard error is not a terminal.
#[cfg(feature = "hub")]
pub(super) fn bar(total: Option<u64>, unit: &str) -> ProgressBar {
    let bar = match total {
        Some(total) => ProgressBar::new(total),
        None => ProgressBar::new_spinner(),
    };
    let template = match total {
        Some(_) => {
            format!("{{prefix}}{{bar:30}} {{pos}}/{{len}} {unit}  {{per_sec}}  {{eta}} left")
        }
        None => format!("{{prefix}}{{spinner}} {{pos}} {unit}  {{per_sec}}  {{elapsed}}"),
    };
    let style = ProgressStyle::with_template(&template);
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// How long a command may wait without a word.
#[cfg(feature = "eval")]
const SILENCE: Duration = Duration::from_millis(500);

/// Awaits `work`. If it takes longer than a moment, says on standard error what is waited for, and that Ctrl-C ends the
/// wait.
#[cfg(feature = "eval")]
pub(super) async fn waiting<T>(what: &str, work: impl Future<Output = T>) -> T {
    tokio::pin!(work);
    if let Ok(done) = tokio::time::timeout(SILENCE, &mut work).await {
        return done;
    }
    let said = format!("albireo: waiting {what}; Ctrl-C ends the wait");
    eprintln!("{}", terminal::error(&said));
    work.await
}

/// A limit in words: `at most 60 s, until 14:05:09 UTC`.
#[cfg(feature = "eval")]
pub(super) fn at_most(limit: Duration) -> String {
    let seconds = limit.as_secs();
    let now = u64::try_from(unix_milliseconds()).unwrap_or(0) / 1000;
    let end = now.saturating_add(seconds);
    let hour = end / 3600 % 24;
    let minute = end / 60 % 60;
    let second = end % 60;
    format!("at most {seconds} s, until {hour:02}:{minute:02}:{second:02} UTC")
}

/// Makes a spinner beside `message` for work of unknown length.
pub(super) fn spinner(message: String) -> ProgressBar {
    let spinner = ProgressBar::new_spinner().with_message(message);
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}
