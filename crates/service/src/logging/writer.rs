//! Writes the log on a thread of its own, so that a reader of standard error that does not read holds up nothing else.

use crate::session::plain;
use parking_lot::Mutex;
use std::io::{self, Write as _};
use std::sync::OnceLock;
use std::sync::mpsc::sync_channel;
use std::time::Duration;
use tracing::Metadata;
use tracing_appender::non_blocking::{ErrorCounter, NonBlocking, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::fmt::MakeWriter;

/// The number of lines that may wait to be written; further ones are dropped and counted.
const WAITING: usize = 4096;

/// The time limit for the waiting lines to be written at the end.
const PARTING: Duration = Duration::from_millis(1500);

/// A line of Zenoh that is left out: the error that Zenoh returns next is logged with the key to change.
const LOGGED_WITH_ITS_KEY: &str = "Unable to open listener ";

/// Interval at which the log is checked for dropped lines.
const COUNT_EVERY: Duration = Duration::from_secs(5);

struct Writer {
    lines: NonBlocking,
    dropped: ErrorCounter,
    /// Gone once the log has been finished.
    thread: Mutex<Option<WorkerGuard>>,
}

static WRITER: OnceLock<Writer> = OnceLock::new();

/// The writer of the log's lines: it never waits. The first call starts its thread.
pub(super) fn lines() -> Lines {
    Lines(writer().lines.clone())
}

/// Makes the writer of each line.
pub(super) struct Lines(NonBlocking);

/// Writes one line.
pub(super) struct WrittenLine {
    to: NonBlocking,
    is_zenohs: bool,
}

impl MakeWriter<'_> for Lines {
    type Writer = WrittenLine;

    fn make_writer(&self) -> WrittenLine {
        WrittenLine {
            to: self.0.clone(),
            is_zenohs: false,
        }
    }

    fn make_writer_for(&self, about: &Metadata<'_>) -> WrittenLine {
        WrittenLine {
            is_zenohs: is_zenohs(about.target()),
            ..self.make_writer()
        }
    }
}

impl io::Write for WrittenLine {
    fn write(&mut self, event: &[u8]) -> io::Result<usize> {
        if !self.is_zenohs {
            return self.to.write(event);
        }
        let line = plain(&String::from_utf8_lossy(event)) + "\n";
        if !line.contains(LOGGED_WITH_ITS_KEY) {
            self.to.write_all(line.as_bytes())?;
        }
        Ok(event.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

/// True for a target of Zenoh, whose messages name places in its source.
pub(super) fn is_zenohs(target: &str) -> bool {
    target.starts_with("zenoh")
}

/// The writer to standard error. The first call starts it.
fn writer() -> &'static Writer {
    WRITER.get_or_init(|| {
        let (lines, thread) = NonBlockingBuilder::default()
            .lossy(true)
            .buffered_lines_limit(WAITING)
            .thread_name("log")
            .finish(io::stderr());
        let dropped = lines.error_counter();
        let watched = dropped.clone();
        // If the thread cannot be started, the metric still counts the lines.
        let _ = std::thread::Builder::new()
            .name("log-watch".to_owned())
            .spawn(move || log_drops(&watched));
        Writer {
            dropped,
            lines,
            thread: Mutex::new(Some(thread)),
        }
    })
}

/// Says in the log how many lines it lacks, once it is written again.
fn log_drops(counter: &ErrorCounter) {
    let mut logged = 0;
    loop {
        std::thread::sleep(COUNT_EVERY);
        let dropped = counter.dropped_lines();
        if dropped == logged {
            continue;
        }
        tracing::warn!(
            dropped = dropped - logged,
            "the log lacks lines: nobody read standard error fast enough"
        );
        // If this line was dropped, too, it is repeated.
        if counter.dropped_lines() == dropped {
            logged = dropped;
        }
    }
}

/// The log lines that were not written since the start, because whatever reads standard error did not keep up.
pub fn dropped_lines() -> u64 {
    WRITER.get().map_or(0, |writer| writer.dropped.dropped_lines() as u64)
}

/// Writes the lines that wait, for 1.5 s at most. Later ones are dropped: call it at the end of the program.
pub fn finish() {
    let Some(thread) = WRITER.get().and_then(|writer| writer.thread.lock().take()) else {
        return;
    };
    // On a thread of its own: where the log cannot be finished, the library says so on standard output, which may be the
    // same pipe that nobody reads.
    let (finished, waiting) = sync_channel::<()>(1);
    let finishing = std::thread::Builder::new().spawn(move || {
        drop(thread);
        let _ = finished.send(());
    });
    if finishing.is_ok() {
        let _ = waiting.recv_timeout(PARTING);
    }
}

/// Writes one last line to standard error, through the log's thread if there is one.
pub fn last_words(text: &str) {
    match WRITER.get() {
        Some(writer) => {
            let _ = writer.lines.clone().write_all(format!("{text}\n").as_bytes());
        }
        None => eprintln!("{text}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// What was written.
    #[derive(Clone, Default)]
    struct Written(Arc<Mutex<Vec<u8>>>);

    impl io::Write for Written {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn of_zenoh_s_lines_places_in_its_source_and_what_is_logged_with_its_key_are_left_out() {
        let written = Written::default();
        let (to, thread) = NonBlockingBuilder::default().finish(written.clone());
        let mut line_of_zenoh = WrittenLine {
            to: to.clone(),
            is_zenohs: true,
        };
        let mut other_line = WrittenLine {
            to,
            is_zenohs: false,
        };
        let names_a_place = b"  WARN in use at /b/.cargo/a-1/tcp.rs:61.\n";
        let logged_with_its_key = b"  WARN Unable to open listener tcp/127.0.0.1:1: in use\n";
        line_of_zenoh.write_all(names_a_place).unwrap();
        line_of_zenoh.write_all(logged_with_its_key).unwrap();
        other_line.write_all(names_a_place).unwrap();
        // Waits until all lines are written.
        drop(thread);
        let text = String::from_utf8(written.0.lock().clone()).unwrap();
        assert_eq!(
            text,
            "WARN in use.\n  WARN in use at /b/.cargo/a-1/tcp.rs:61.\n"
        );
    }
}
