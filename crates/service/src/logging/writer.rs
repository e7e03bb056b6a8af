//! Writes the log on a thread of its own, so that a reader of standard error that does not read holds up nothing else.

use parking_lot::Mutex;
use std::io::{self, Write as _};
use std::sync::OnceLock;
use tracing_appender::non_blocking::{ErrorCounter, NonBlocking, NonBlockingBuilder, WorkerGuard};

/// The number of lines that may wait to be written; further ones are dropped and counted.
const WAITING: usize = 4096;

struct Writer {
    lines: NonBlocking,
    dropped: ErrorCounter,
    /// Gone once the log has been finished.
    thread: Mutex<Option<WorkerGuard>>,
}

static WRITER: OnceLock<Writer> = OnceLock::new();

/// The writer of the log's lines: it never waits. The first call starts its thread.
pub(super) fn lines() -> NonBlocking {
    writer(io::stderr()).lines.clone()
}

fn writer(to: impl io::Write + Send + 'static) -> &'static Writer {
    WRITER.get_or_init(|| {
        let builder = NonBlockingBuilder::default();
        let builder = builder.lossy(true).buffered_lines_limit(WAITING);
        let (lines, thread) = builder.thread_name("log").finish(to);
        Writer {
            dropped: lines.error_counter(),
            lines,
            thread: Mutex::new(Some(thread)),
        }
    })
}

/// The log lines that were not written since the start, because whatever reads standard error did not keep up.
pub fn dropped_lines() -> u64 {
    WRITER.get().map_or(0, |writer| writer.dropped.dropped_lines() as u64)
}

/// Writes the lines that wait, for about a second at most. Later ones are dropped: call it at the end of the program.
pub fn finish() {
    if let Some(writer) = WRITER.get() {
        drop(writer.thread.lock().take());
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
