//! Reads the system calls on the files of one folder from the output of `strace -f -y -xx -ttt`.

use std::collections::BTreeMap;
use std::path::Path;

/// The calls that change or sync files, and those by which a change would escape: they are refused by name.
pub(super) const CALLS: &str = "?open,openat,?creat,write,writev,pwrite64,pwritev,pwritev2,truncate,ftruncate,fallocate,\
    fsync,fdatasync,sync,syncfs,sync_file_range,?rename,?renameat,renameat2,?unlink,unlinkat,?link,linkat,copy_file_range,sendfile";

/// A call on a file, which has its name in the folder.
pub(super) enum What {
    /// Creates the file if it is missing.
    Open(String),
    /// Creates the file if it is missing, and empties it.
    Empty(String),
    /// Writes at a place, or at the end.
    Write(String, Option<usize>, Vec<u8>),
    Size(String, usize),
    Rename(String, String),
    Remove(String),
    Sync(String),
    SyncFolder,
}

/// A call, with the lines at which it began and ended.
pub(super) struct Call {
    pub(super) begun: usize,
    /// `usize::MAX` if it never did.
    pub(super) ended: usize,
    pub(super) what: What,
}

pub(super) struct Trace {
    /// In the order in which they began.
    pub(super) calls: Vec<Call>,
    /// The time of each line, µs since 1970.
    pub(super) times_us: Vec<u64>,
}

impl Trace {
    pub(super) fn read(text: &str, folder: &Path) -> Self {
        let folder = folder.to_str().unwrap();
        let mut calls = Vec::new();
        let mut times_us = Vec::new();
        let mut open = BTreeMap::new();
        for (line, text) in text.lines().enumerate() {
            let (thread, text) = text.split_once(' ').unwrap();
            let (time, text) = text.trim_start().split_once(' ').unwrap();
            times_us.push(time.replace('.', "").parse().unwrap());
            if let Some(begin) = text.strip_suffix(" <unfinished ...>") {
                open.insert(thread, (line, begin));
            } else if text.starts_with("<... ") {
                let (_, rest) = text.split_once(" resumed>").unwrap();
                if let Some((begun, begin)) = open.remove(thread) {
                    calls.extend(call(&format!("{begin}{rest}"), folder, begun, line));
                }
            } else {
                calls.extend(call(text, folder, line, line));
            }
        }
        for (begun, begin) in open.into_values() {
            calls.extend(call(begin, folder, begun, usize::MAX));
        }
        calls.sort_by_key(|call| call.begun);
        Self { calls, times_us }
    }
}

/// Reads a call such as `pwrite64(11<\x2f…>, "\x00…", 24, 32) = 24`; its result is missing if it never ended.
fn call(text: &str, folder: &str, begun: usize, ended: usize) -> Option<Call> {
    let (name, rest) = text.split_once('(')?;
    let (arguments, result) = rest.rsplit_once(" = ").unwrap_or((rest, "?"));
    if result.starts_with('-') {
        return None;
    }
    // A killed program does not see the end of its last calls.
    let ended = if result.starts_with('?') {
        usize::MAX
    } else {
        ended
    };
    let mut quoted = arguments.split('"').skip(1).step_by(2).map(bytes);
    let in_folder = |path: Vec<u8>| {
        let path = String::from_utf8(path).ok()?;
        let name = path.strip_prefix(folder)?;
        Some(name.trim_start_matches('/').to_owned())
    };
    let opened = || {
        let (_, rest) = arguments.split_once('<')?;
        let (path, rest) = rest.split_once('>')?;
        if rest.starts_with("(deleted)") {
            return None;
        }
        in_folder(bytes(path))
    };
    let last = || arguments.trim_end_matches([')', ' ']).rsplit_once(", ")?.1.parse().ok();
    let what = match name {
        "open" | "openat" | "creat" => {
            let name = in_folder(quoted.next()?)?;
            if arguments.contains("O_TRUNC") {
                What::Empty(name)
            } else if arguments.contains("O_CREAT") {
                What::Open(name)
            } else {
                return None;
            }
        }
        "write" | "pwrite64" => {
            let file = opened()?;
            let at = if name == "write" { None } else { Some(last()?) };
            let mut bytes = quoted.next()?;
            bytes.truncate(result.parse().unwrap_or(usize::MAX));
            What::Write(file, at, bytes)
        }
        "ftruncate" => What::Size(opened()?, last()?),
        "fsync" | "fdatasync" => match opened()? {
            name if name.is_empty() => What::SyncFolder,
            name => What::Sync(name),
        },
        "rename" | "renameat" | "renameat2" => {
            What::Rename(in_folder(quoted.next()?)?, in_folder(quoted.next()?)?)
        }
        "unlink" | "unlinkat" => What::Remove(in_folder(quoted.next()?)?),
        _ => {
            let touched = quoted.find_map(in_folder).or_else(opened);
            assert!(touched.is_none(), "not understood: {text}");
            return None;
        }
    };
    Some(Call { begun, ended, what })
}

/// The bytes of `\x2f\x74…`.
fn bytes(hex: &str) -> Vec<u8> {
    hex.split("\\x")
        .skip(1)
        .map(|two| u8::from_str_radix(two, 16).unwrap())
        .collect()
}
