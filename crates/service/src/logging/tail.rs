//! Keeps the last log lines in memory, for the page and for diagnostics, without the secrets given to [`conceal`].

use super::writer::is_zenohs;
use crate::config::MASK;
use crate::session::plain;
use parking_lot::{Mutex, RwLock};
use serde::Serialize;
use std::collections::{BTreeSet, VecDeque};
use std::ops::Range;
use std::time::{Duration, UNIX_EPOCH};
use std::{fmt, io};
use tracing::{Level, Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::field::RecordFields;
use tracing_subscriber::fmt::format::{DefaultFields, Writer};
use tracing_subscriber::fmt::{FormatFields, MakeWriter};
use tracing_subscriber::registry::LookupSpan;
use utoipa::ToSchema;

/// The number of lines kept.
const KEPT: usize = 1000;
/// The maximum length of a line in bytes; what exceeds it is replaced by an ellipsis.
const LONGEST: usize = 4096;
/// The number of a line before it is kept.
const NOT_NUMBERED: u64 = 0;
/// The minimum length of a concealed secret: shorter ones would match in ordinary words.
const SHORTEST_SECRET: usize = 4;

/// Locked before [`SECRETS`] wherever both are needed.
static LAST: Mutex<VecDeque<LogLine>> = Mutex::new(VecDeque::new());
static SECRETS: RwLock<BTreeSet<String>> = RwLock::new(BTreeSet::new());

/// One line of the log.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct LogLine {
    /// Its number, from 1 at the start.
    pub number: u64,
    /// Its time, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// `ERROR`, `WARN`, `INFO`, `DEBUG` or `TRACE`.
    #[schema(value_type = String)]
    pub level: &'static str,
    /// Part of the program that wrote it.
    pub target: String,
    /// Spans, message and fields.
    pub text: String,
}

impl fmt::Display for LogLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let since = Duration::from_millis(self.at_ms.unsigned_abs());
        let at = humantime::format_rfc3339_millis(UNIX_EPOCH + since);
        write!(f, "{at} {:>5} {}: {}", self.level, self.target, self.text)
    }
}

/// Returns at most `most` of the newest lines with a number above `number`, oldest first.
pub fn lines_after(number: u64, most: usize) -> Vec<LogLine> {
    after(&LAST.lock(), number, most)
}

/// Masks `secret` in all lines, including those already kept.
pub fn conceal(secret: &str) {
    let secret = secret.trim();
    if secret.len() < SHORTEST_SECRET {
        return;
    }
    conceal_in(&mut LAST.lock(), secret);
}

/// Masks `secret` in the kept `lines` and in all later ones.
fn conceal_in(lines: &mut VecDeque<LogLine>, secret: &str) {
    let is_new = SECRETS.write().insert(secret.to_owned());
    if is_new {
        let secrets = SECRETS.read();
        for line in lines {
            line.text = masked(&line.text, &secrets);
        }
    }
}

/// Returns `text` with a mask for each secret in it. Secrets that overlap share a mask, so that no part of one is left.
fn masked(text: &str, secrets: &BTreeSet<String>) -> String {
    let mut found: Vec<Range<usize>> = Vec::new();
    for secret in secrets {
        for (start, _) in text.match_indices(secret.as_str()) {
            found.push(start..start + secret.len());
        }
    }
    found.sort_unstable_by_key(|range| range.start);
    let mut shown = String::with_capacity(text.len());
    let mut end = 0;
    for range in found {
        if range.start >= end {
            shown.push_str(&text[end..range.start]);
            shown.push_str(MASK);
        }
        end = end.max(range.end);
    }
    shown.push_str(&text[end..]);
    shown
}

/// Adds a line under the next number, in place of the oldest one if there are many.
fn keep(lines: &mut VecDeque<LogLine>, mut line: LogLine) {
    line.number = lines.back().map_or(1, |last| last.number + 1);
    if lines.len() == KEPT {
        lines.pop_front();
    }
    lines.push_back(line);
}

fn after(lines: &VecDeque<LogLine>, number: u64, most: usize) -> Vec<LogLine> {
    let new = lines.iter().filter(|line| line.number > number);
    let too_many = new.clone().count().saturating_sub(most);
    new.skip(too_many).cloned().collect()
}

/// Creates the layer that keeps each event as a line.
pub(super) fn layer<S: Subscriber + for<'a> LookupSpan<'a>>() -> impl Layer<S> {
    tracing_subscriber::fmt::layer()
        .with_ansi(false)
        .without_time()
        .with_level(false)
        .with_target(false)
        .fmt_fields(PlainFields)
        .with_writer(Tail)
}

/// Formats span fields without colours: layers with a formatter of the same type share the formatted fields.
struct PlainFields;

impl<'w> FormatFields<'w> for PlainFields {
    fn format_fields<R: RecordFields>(&self, writer: Writer<'w>, fields: R) -> fmt::Result {
        DefaultFields::new().format_fields(writer, fields)
    }
}

/// Makes a log line from the text of an event.
struct Tail;

/// A line of which the text is not known yet.
struct Line {
    level: Level,
    target: String,
}

impl MakeWriter<'_> for Tail {
    type Writer = Line;

    fn make_writer(&self) -> Line {
        Line {
            level: Level::INFO,
            target: String::new(),
        }
    }

    fn make_writer_for(&self, about: &Metadata<'_>) -> Line {
        Line {
            level: *about.level(),
            target: about.target().to_owned(),
        }
    }
}

impl io::Write for Line {
    /// Takes a whole event, which is written at once.
    fn write(&mut self, event: &[u8]) -> io::Result<usize> {
        let mut text = String::from_utf8_lossy(event).trim_end().to_owned();
        if is_zenohs(&self.target) {
            text = plain(&text);
        }
        // Locked until the line is kept: a secret that is concealed meanwhile is then masked in it, too.
        let mut lines = LAST.lock();
        // Before truncation: the first half of a secret is also secret.
        text = masked(&text, &SECRETS.read());
        if text.len() > LONGEST {
            text.truncate(text.floor_char_boundary(LONGEST));
            text.push('…');
        }
        let line = LogLine {
            number: NOT_NUMBERED,
            at_ms: crate::clock::unix_milliseconds(),
            level: self.level.as_str(),
            target: std::mem::take(&mut self.target),
            text,
        };
        keep(&mut lines, line);
        Ok(event.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;
    use std::sync::Barrier;
    use tracing_subscriber::layer::SubscriberExt;

    #[test]
    fn the_last_lines_are_kept_and_can_be_read_after_a_number() {
        let mut lines = VecDeque::new();
        for number in 1..=KEPT + 3 {
            let line = LogLine {
                number: NOT_NUMBERED,
                at_ms: 1_800_000_000_007,
                level: "INFO",
                target: "albireo".to_owned(),
                text: number.to_string(),
            };
            keep(&mut lines, line);
        }
        let all = after(&lines, 0, usize::MAX);
        assert_eq!(all.len(), KEPT);
        assert_eq!(all[0].number, 4);
        assert_eq!(all[0].text, "4");
        let last = after(&lines, 1000, 2);
        assert_eq!([last[0].number, last[1].number], [1002, 1003]);
        assert_eq!(after(&lines, 1003, 10), []);
        let expected = "2027-01-15T08:00:00.007Z  INFO albireo: 4";
        assert_eq!(all[0].to_string(), expected);
    }

    // The lines and the secrets are global to the process: each test has a target and secrets of its own.
    #[test]
    fn a_line_names_its_span_and_hides_secrets() {
        let _alone = super::super::tests::ONE_SUBSCRIBER.lock();
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer()), || {
            let span = tracing::info_span!("camera", name = "front");
            let _inside = span.enter();
            tracing::warn!(target: "tail_test", password = "hush-hush-7", "asked with hush-hush-7 for {}", 3);
            conceal("hush-hush-7");
            // Too short to be concealed: `asked` stays.
            conceal("ask");
            tracing::error!(target: "tail_test", error = %"no way with hush-hush-7", "refused");
            // With the 22 bytes of the span before it, the secret begins 8 bytes before the longest line ends.
            let filling = "x".repeat(LONGEST - 30);
            let long = filling + "hush-hush-7 and much more than fits into one line of it";
            tracing::info!(target: "tail_test", "{long}");
        });
        let kept = lines_after(0, KEPT);
        let mine: Vec<_> = kept.iter().filter(|line| line.target == "tail_test").collect();
        let [asked, refused, long] = mine[..] else {
            panic!("{mine:?}")
        };
        let expected = r#"camera{name="front"}: asked with (secret) for 3 password="(secret)""#;
        assert_eq!(asked.text, expected);
        assert_eq!(refused.level, "ERROR");
        let expected = "refused error=no way with (secret)";
        assert!(refused.text.contains(expected), "{refused}");
        assert!(!long.text.contains("hush"), "{long}");
        assert_eq!(long.text.len(), LONGEST + '…'.len_utf8(), "{long}");
        assert!(kept.iter().all(|line| !line.text.contains("hush-hush-7")));
    }

    #[test]
    fn of_secrets_that_overlap_no_part_is_left() {
        let secrets = BTreeSet::from(["bcd1", "abcd1e", "1e23", "next"].map(str::to_owned));
        assert_eq!(masked("a abcd1e, bcd1", &secrets), "a (secret), (secret)");
        assert_eq!(masked("abcd1e23 and more", &secrets), "(secret) and more");
        assert_eq!(masked("bcd1next", &secrets), "(secret)(secret)");
        assert_eq!(masked("no secret", &secrets), "no secret");
    }

    #[test]
    fn a_line_that_is_written_while_its_secret_is_concealed_is_masked() {
        const TARGET: &str = "tail_race_test";
        for round in 0..100 {
            let secret = format!("hush-while-{round:03}");
            let event = format!("asked with {secret}");
            let both = Barrier::new(2);
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    let mut line = Line {
                        level: Level::INFO,
                        target: TARGET.to_owned(),
                    };
                    both.wait();
                    line.write_all(event.as_bytes()).unwrap();
                });
                let mut lines = LAST.lock();
                both.wait();
                // Lets the writer come as far as it can without the lines.
                for _ in 0..20 {
                    std::thread::yield_now();
                }
                conceal_in(&mut lines, &secret);
            });
        }
        let kept = lines_after(0, KEPT);
        let mine: Vec<_> = kept.iter().filter(|line| line.target == TARGET).collect();
        assert_eq!(mine.len(), 100);
        for line in mine {
            assert_eq!(line.text, "asked with (secret)");
        }
    }
}
