//! The last lines of the log, in memory: what a service can tell of its past when it is asked. Secrets that were told to
//! [`conceal`] are never among them.

use parking_lot::{Mutex, RwLock};
use serde::Serialize;
use std::collections::VecDeque;
use std::fmt::{self, Write};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;
use utoipa::ToSchema;

/// Lines that are kept, and the most bytes of one.
const KEPT: usize = 1000;
const LONGEST: usize = 4096;
/// What stands in place of a secret.
const MASK: &str = "(secret)";
/// Shorter ones would be found in ordinary words.
const SHORTEST_SECRET: usize = 4;

static LAST: Mutex<Lines> = Mutex::new(Lines::new());
static SECRETS: RwLock<Vec<String>> = RwLock::new(Vec::new());

/// One line of the log.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct LogLine {
    /// Its number since the start, from 1.
    pub number: u64,
    /// When, milliseconds since the Unix epoch.
    pub at_ms: i64,
    /// `ERROR`, `WARN`, `INFO`, `DEBUG` or `TRACE`.
    #[schema(value_type = String)]
    pub level: &'static str,
    /// Part of the program that says it.
    pub target: String,
    /// What it says, with what it says of it and where.
    pub text: String,
}

impl fmt::Display for LogLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = crate::clock::rfc3339(self.at_ms);
        write!(f, "{at} {:>5} {}: {}", self.level, self.target, self.text)
    }
}

/// The lines that are kept, the oldest first.
pub fn last_lines() -> Vec<LogLine> {
    lines_after(0, KEPT)
}

/// The newest lines after that number, at most so many, the oldest first.
pub fn lines_after(number: u64, most: usize) -> Vec<LogLine> {
    LAST.lock().after(number, most)
}

/// From now on `secret` does not stand in a line that is kept; nor in those that are there.
pub fn conceal(secret: &str) {
    let secret = secret.trim();
    if secret.len() < SHORTEST_SECRET {
        return;
    }
    let mut secrets = SECRETS.write();
    if !secrets.iter().any(|known| known == secret) {
        secrets.push(secret.to_owned());
    }
    drop(secrets);
    for line in &mut LAST.lock().lines {
        mask(&mut line.text);
    }
}

fn mask(text: &mut String) {
    for secret in SECRETS.read().iter() {
        if text.contains(secret.as_str()) {
            *text = text.replace(secret.as_str(), MASK);
        }
    }
}

#[derive(Debug)]
struct Lines {
    lines: VecDeque<LogLine>,
    number: u64,
}

impl Lines {
    const fn new() -> Self {
        Self {
            lines: VecDeque::new(),
            number: 0,
        }
    }

    fn keep(&mut self, mut line: LogLine) {
        self.number += 1;
        line.number = self.number;
        if self.lines.len() == KEPT {
            self.lines.pop_front();
        }
        self.lines.push_back(line);
    }

    fn after(&self, number: u64, most: usize) -> Vec<LogLine> {
        let new = self.lines.iter().filter(|line| line.number > number);
        let over = new.clone().count().saturating_sub(most);
        new.skip(over).cloned().collect()
    }
}

/// Keeps each event as a line.
pub(super) struct Tail;

/// The fields of a span, in words.
struct Words(String);

/// Writes fields as `name=value`, and the message as it is; never more than a line may have.
struct Writer<'a>(&'a mut String);

impl Visit for Writer<'_> {
    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            "message" => self.record_debug(field, &format_args!("{value}")),
            _ => self.record_debug(field, &value),
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        let text = &mut *self.0;
        if text.len() >= LONGEST {
            return;
        }
        let space = if text.is_empty() { "" } else { " " };
        // A string takes all that is written.
        let _ = match field.name() {
            "message" => write!(text, "{space}{value:?}"),
            name => write!(text, "{space}{name}={value:?}"),
        };
    }
}

fn cut(text: &mut String) {
    if text.len() > LONGEST {
        let end = (0..=LONGEST).rev().find(|end| text.is_char_boundary(*end));
        text.truncate(end.unwrap_or_default());
        text.push('…');
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Tail {
    fn on_new_span(&self, attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        if let Some(span) = context.span(id) {
            let mut words = String::new();
            attributes.record(&mut Writer(&mut words));
            span.extensions_mut().insert(Words(words));
        }
    }

    fn on_record(&self, id: &Id, values: &Record<'_>, context: Context<'_, S>) {
        if let Some(span) = context.span(id)
            && let Some(Words(words)) = span.extensions_mut().get_mut::<Words>()
        {
            values.record(&mut Writer(words));
        }
    }

    fn on_event(&self, event: &Event<'_>, context: Context<'_, S>) {
        let mut text = String::new();
        for span in context
            .event_scope(event)
            .into_iter()
            .flat_map(|s| s.from_root())
        {
            text.push_str(span.name());
            if let Some(Words(words)) = span.extensions().get::<Words>()
                && !words.is_empty()
            {
                let _ = write!(text, "{{{words}}}");
            }
            text.push_str(": ");
        }
        let mut said = String::new();
        event.record(&mut Writer(&mut said));
        text.push_str(&said);
        // Before it is cut: a secret's first half is no less a secret.
        mask(&mut text);
        cut(&mut text);
        let about = event.metadata();
        LAST.lock().keep(LogLine {
            number: 0,
            at_ms: crate::clock::unix_milliseconds(),
            level: about.level().as_str(),
            target: about.target().to_owned(),
            text,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing_subscriber::layer::SubscriberExt;

    fn line(text: &str) -> LogLine {
        LogLine {
            number: 0,
            at_ms: 1_800_000_000_007,
            level: "INFO",
            target: "albireo".to_owned(),
            text: text.to_owned(),
        }
    }

    #[test]
    fn the_last_lines_are_kept_and_those_after_a_number_can_be_had() {
        let mut lines = Lines::new();
        for number in 1..=KEPT + 3 {
            lines.keep(line(&number.to_string()));
        }
        let all = lines.after(0, usize::MAX);
        assert_eq!(all.len(), KEPT);
        assert_eq!((all[0].number, all[0].text.as_str()), (4, "4"));
        let last: Vec<_> = lines
            .after(1000, 2)
            .iter()
            .map(|line| line.number)
            .collect();
        assert_eq!(last, [1002, 1003]);
        assert_eq!(lines.after(1003, 10), []);
        assert_eq!(
            all[0].to_string(),
            "2027-01-15T08:00:00.007Z  INFO albireo: 4"
        );
    }

    // One test, for the lines and the secrets are those of the process.
    #[test]
    fn a_line_says_where_it_comes_from_and_no_secret_is_in_it() {
        tracing::subscriber::with_default(tracing_subscriber::registry().with(Tail), || {
            let span = tracing::info_span!("camera", name = "front");
            let _inside = span.enter();
            tracing::warn!(target: "tail_test", password = "hush-hush-7", "asked with hush-hush-7 for {}", 3);
            conceal("hush-hush-7");
            conceal("ask");
            tracing::error!(target: "tail_test", error = %"no way with hush-hush-7", "refused");
            let long = "x".repeat(LONGEST - 30)
                + "hush-hush-7 and much more than fits into one line of it";
            tracing::info!(target: "tail_test", "{long}");
        });
        let kept = last_lines();
        let mine: Vec<_> = kept
            .iter()
            .filter(|line| line.target == "tail_test")
            .collect();
        let [asked, refused, long] = mine[..] else {
            panic!("{mine:?}")
        };
        assert_eq!(
            asked.text,
            "camera{name=\"front\"}: asked with (secret) for 3 password=\"(secret)\""
        );
        assert_eq!(refused.level, "ERROR");
        assert!(
            refused.text.contains("refused error=no way with (secret)"),
            "{refused}"
        );
        assert!(
            !long.text.contains("hush") && long.text.len() <= LONGEST + 4,
            "{long}"
        );
        assert!(kept.iter().all(|line| !line.text.contains("hush-hush-7")));
    }
}
