//! Packs a service's diagnostics into one file: a tar archive of a megabyte or two, built in memory.

use crate::http::Problem;
use crate::logging;
use axum::http::StatusCode;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use tar::{Builder, Header};

/// Returns the archive `NAME-SECONDS.tar` with these files, in order, followed by the last lines of the log. All files
/// have the time `at_s` (seconds since the Unix epoch).
pub fn diagnostics(name: &str, files: &[(&str, Vec<u8>)], at_s: u64) -> Response {
    let text: String = logging::lines_after(0, usize::MAX)
        .into_iter()
        .map(|line| format!("{line}\n"))
        .collect();
    let log = ("log.txt", text.into_bytes());
    let disposition = format!("attachment; filename=\"{name}-{at_s}.tar\"");
    let headers = [
        (CONTENT_TYPE, "application/x-tar".to_owned()),
        (CONTENT_DISPOSITION, disposition),
    ];
    match pack(files.iter().chain([&log]), at_s) {
        Ok(archive) => (headers, archive).into_response(),
        Err(error) => {
            Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response()
        }
    }
}

/// Packs the files into an archive.
fn pack<'a>(
    files: impl Iterator<Item = &'a (&'a str, Vec<u8>)>,
    at_s: u64,
) -> std::io::Result<Vec<u8>> {
    let mut archive = Builder::new(Vec::new());
    for (name, content) in files {
        let mut header = Header::new_ustar();
        header.set_size(content.len() as u64);
        header.set_mode(0o600);
        header.set_mtime(at_s);
        archive.append_data(&mut header, name, content.as_slice())?;
    }
    archive.into_inner()
}
