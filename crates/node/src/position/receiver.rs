//! Reads a receiver, and opens it again when it ends.

use super::sentences::{Reading, gpsd, nmea};
use super::{PositionSource, Positions, SILENT};
use rustix::termios::{OptionalActions, isatty, tcgetattr, tcsetattr};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::net::unix::pipe::Receiver;
use tokio::time::{sleep, timeout};

/// The pause before a receiver is opened again.
const PAUSE: Duration = Duration::from_secs(5);
/// The pause before the end of a file is looked at again.
const GROWTH_PAUSE: Duration = Duration::from_secs(1);
/// The time limit for a connection.
const CONNECTING: Duration = Duration::from_secs(10);
/// The longest line, bytes: gpsd's lists of satellites are the longest.
const LONGEST_LINE: u64 = 16 << 10;
/// Asks gpsd for its reports.
const WATCH: &[u8] = b"?WATCH={\"enable\":true,\"json\":true};\n";

/// Reads the receiver for as long as it is polled.
pub(crate) async fn follow(positions: Arc<Positions>) {
    loop {
        let reason = match read(&positions).await {
            Ok(()) => "it ended the connection".to_owned(),
            Err(error) => error.to_string(),
        };
        let seconds = PAUSE.as_secs();
        positions.failing(format!("{reason}; next attempt in {seconds} s"));
        sleep(PAUSE).await;
    }
}

/// Opens the receiver and reads it to its end.
async fn read(positions: &Positions) -> io::Result<()> {
    match &positions.source {
        PositionSource::Off | PositionSource::Frames => Ok(()),
        PositionSource::Gpsd(place) => {
            let mut stream = connect(place).await?;
            stream.write_all(WATCH).await?;
            lines(stream, positions, AtTheEnd::Stops, gpsd).await
        }
        PositionSource::Tcp(place) => {
            let mut has_rmc = false;
            let stream = connect(place).await?;
            let read = |line: &str| nmea(line, &mut has_rmc);
            lines(stream, positions, AtTheEnd::Stops, read).await
        }
        PositionSource::Path(path) => {
            let mut has_rmc = false;
            let read = |line: &str| nmea(line, &mut has_rmc);
            match open(path)? {
                Opened::Stream(stream) => lines(stream, positions, AtTheEnd::Stops, read).await,
                Opened::File(file) => lines(file, positions, AtTheEnd::Waits, read).await,
            }
        }
    }
}

async fn connect(place: &str) -> io::Result<TcpStream> {
    let error = match timeout(CONNECTING, TcpStream::connect(place)).await {
        Ok(Ok(stream)) => return Ok(stream),
        Ok(Err(error)) => error,
        Err(_) => io::ErrorKind::TimedOut.into(),
    };
    Err(io::Error::new(
        error.kind(),
        format!("cannot connect: {error}"),
    ))
}

/// An open path.
enum Opened {
    /// A serial port or a FIFO, which gives lines as they come.
    Stream(Receiver),
    /// A file, which may grow.
    File(tokio::fs::File),
}

/// Opens a path without waiting for whoever writes.
fn open(path: &Path) -> io::Result<Opened> {
    let kind = std::fs::metadata(path)?.file_type();
    if kind.is_file() {
        return Ok(Opened::File(tokio::fs::File::from_std(File::open(path)?)));
    }
    // Opened for writing too, a FIFO does not end when a writer goes and the next one comes.
    let file = OpenOptions::new()
        .read(true)
        .write(kind.is_fifo())
        .custom_flags((rustix::fs::OFlags::NONBLOCK | rustix::fs::OFlags::NOCTTY).bits() as i32)
        .open(path)?;
    if isatty(&file) {
        // Otherwise the system would send each line back to the receiver. Its speed stays as it is.
        let mut settings = tcgetattr(&file)?;
        settings.make_raw();
        tcsetattr(&file, OptionalActions::Now, &settings)?;
    }
    Receiver::from_file_unchecked(file).map(Opened::Stream)
}

/// What a reader does at the end of its input.
#[derive(Clone, Copy, PartialEq, Eq)]
enum AtTheEnd {
    Stops,
    /// The input is a file, which may grow.
    Waits,
}

/// Reads lines to the end.
async fn lines(
    stream: impl AsyncRead + Unpin,
    positions: &Positions,
    at_the_end: AtTheEnd,
    mut read: impl FnMut(&str) -> Reading,
) -> io::Result<()> {
    let mut stream = BufReader::new(stream);
    let mut line = Vec::new();
    // The first line of a receiver that is already sending is a part of one.
    let mut is_first = true;
    loop {
        let room = LONGEST_LINE - line.len() as u64;
        let mut limited = AsyncReadExt::take(&mut stream, room);
        let bytes = match timeout(SILENT, limited.read_until(b'\n', &mut line)).await {
            Ok(bytes) => bytes?,
            Err(_) => {
                let words = format!("it has sent nothing for {} s", SILENT.as_secs());
                return Err(io::Error::new(io::ErrorKind::TimedOut, words));
            }
        };
        let is_whole = line.ends_with(b"\n") || line.len() as u64 == LONGEST_LINE;
        if !is_whole && bytes == 0 {
            if at_the_end == AtTheEnd::Stops {
                return Ok(());
            }
            sleep(GROWTH_PAUSE).await;
            continue;
        }
        if !is_whole {
            continue;
        }
        match read(&String::from_utf8_lossy(&line)) {
            Reading::Fix(position) => positions.found(position),
            Reading::NoFix(words) => positions.searching(words),
            Reading::Unreadable(_) if is_first => {}
            Reading::Unreadable(reason) => {
                positions.answering(&reason);
                positions.refuse(reason);
            }
            Reading::Other => positions.answering("it answers without positions"),
        }
        is_first = false;
        line.clear();
    }
}
