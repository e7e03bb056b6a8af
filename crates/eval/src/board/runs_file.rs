//! Keeps the runs of a setup in a file, one line each, so that a measurement of many hours goes on where it was
//! stopped.

use super::published;
use super::run::{ClipRun, Setup, SetupRuns};
use crate::error::EvalError;
use crate::footage::unused_name;
use serde::{Deserialize, Serialize};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// The version of the file's form.
const VERSION: u32 = 1;

/// What can be done about a file whose runs do not go with new ones.
const WAY_OUT: &str = "Set that back to go on, write to another folder with --out, or measure all again with --restart.";

/// A line of the file: the first is the setup, each other one a run.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Line {
    Setup { v: u32, setup: Box<Setup> },
    Run { run: Box<ClipRun> },
}

/// The file of a setup's runs, open for more.
#[derive(Debug)]
pub struct RunsFile {
    path: PathBuf,
    file: File,
    runs: Vec<ClipRun>,
    kept: Option<PathBuf>,
}

impl RunsFile {
    /// Opens the file of `setup` in `folder`, or creates it. A last line that was cut off, because the program or the
    /// machine stopped while it was written, is removed: its run is played again. With `restart` the runs before are
    /// kept in a new file beside it, and all are played again.
    ///
    /// # Errors
    /// When the file cannot be read or written, or holds runs of another setup.
    pub fn open(folder: &Path, setup: &Setup, restart: bool) -> Result<Self, EvalError> {
        let path = folder.join(setup.file_name());
        let failed = |error: std::io::Error| EvalError::write(&path, error);
        std::fs::create_dir_all(folder).map_err(failed)?;
        let mut file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(&path)
            .map_err(failed)?;
        file.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => EvalError::content(
                &path,
                "another run of this command writes it: stop that one first",
            ),
            TryLockError::Error(error) => failed(error),
        })?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(failed)?;
        let mut kept = None;
        if restart {
            let lines = bytes.iter().filter(|byte| **byte == b'\n').count();
            // The first line is the setup, and a restart that was stopped before its first run has no other.
            if lines > 1 {
                kept = Some(keep_beside(&path, &bytes)?);
            }
            bytes.clear();
        }
        let length = whole_lines(&bytes);
        let text = String::from_utf8_lossy(&bytes[..length]);
        file.set_len(length as u64).map_err(failed)?;
        file.seek(SeekFrom::End(0)).map_err(failed)?;
        let mut opened = Self {
            path: path.clone(),
            file,
            runs: Vec::new(),
            kept,
        };
        match parse(&path, &text)? {
            Some(before) => {
                if let Some(what) = before.setup.difference(setup) {
                    return Err(EvalError::content(&path, format!("{what}\n{WAY_OUT}")));
                }
                opened.runs = before.runs;
            }
            None => opened.append(&Line::Setup {
                v: VERSION,
                setup: Box::new(setup.clone()),
            })?,
        }
        Ok(opened)
    }

    /// The file's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file in which a restart has kept the runs before, if there were any.
    pub fn kept(&self) -> Option<&Path> {
        self.kept.as_deref()
    }

    /// The runs so far.
    pub fn runs(&self) -> &[ClipRun] {
        &self.runs
    }

    /// Refuses a clip of which the file has runs, if these were of other pictures or another ground truth.
    ///
    /// # Errors
    /// Both contents in words, and the way out.
    pub fn check_clip(&self, clip: &str, content: &str) -> Result<(), EvalError> {
        let mut of_clip = self.runs.iter().filter(|run| run.clip == clip);
        if let Some(run) = of_clip.find(|run| run.content != content) {
            let what = format!(
                "its runs of the clip {clip} were of {}, and now it is of {content}\n{WAY_OUT}",
                run.content
            );
            return Err(EvalError::content(&self.path, what));
        }
        Ok(())
    }

    /// True if the clip was played under the policy.
    pub fn has(&self, clip: &str, policy: &str) -> bool {
        self.runs.iter().any(|run| run.clip == clip && run.policy == policy)
    }

    /// Adds a run. It survives a power loss once this returns.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add(&mut self, run: ClipRun) -> Result<(), EvalError> {
        self.append(&Line::Run {
            run: Box::new(run.clone()),
        })?;
        self.runs.push(run);
        Ok(())
    }

    fn append(&mut self, line: &Line) -> Result<(), EvalError> {
        let mut text =
            serde_json::to_string(line).map_err(|error| EvalError::content(&self.path, error))?;
        text.push('\n');
        let failed = |error: std::io::Error| EvalError::write(&self.path, error);
        self.file.write_all(text.as_bytes()).map_err(failed)?;
        self.file.sync_data().map_err(failed)
    }
}

impl Drop for RunsFile {
    fn drop(&mut self) {
        // Closing it would not free the file while a program that is being started, such as ffmpeg, has a copy of the
        // handle. If this fails, the file is free once they are all closed.
        let _ = self.file.unlock();
    }
}

/// Writes the content of a runs file to the first free name beside it, `FILE.before`, `FILE.before-2` and so on, and
/// returns that. The copy survives a power loss.
fn keep_beside(path: &Path, bytes: &[u8]) -> Result<PathBuf, EvalError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let is_taken = |name: &str| path.with_file_name(name).exists();
    let beside = path.with_file_name(unused_name(&format!("{name}.before"), is_taken));
    let failed = |error: std::io::Error| EvalError::write(&beside, error);
    // Only one program writes to the runs file, which is locked: the name stays free.
    let mut file = File::create_new(&beside).map_err(failed)?;
    file.write_all(bytes).map_err(failed)?;
    file.sync_all().map_err(failed)?;
    Ok(beside)
}

/// Returns the length of the lines that were written to their end; the last one may have been cut off.
fn whole_lines(bytes: &[u8]) -> usize {
    bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1)
}

/// Parses the lines of a file; `None` if there are none.
fn parse(path: &Path, text: &str) -> Result<Option<SetupRuns>, EvalError> {
    let mut found: Option<SetupRuns> = None;
    for (number, json) in (1..).zip(text.lines()) {
        let wrong = |what: String| EvalError::line(path, number, what);
        let line = serde_json::from_str::<Line>(json)
            .map_err(|_| wrong("this is not a line of `albireo eval board`".to_owned()))?;
        match line {
            Line::Setup { .. } if found.is_some() => {
                let what = "a second setup in one file: join the files instead";
                return Err(wrong(what.to_owned()));
            }
            Line::Setup { v, .. } if v != VERSION => {
                let what = format!("its form has version {v}, and this albireo reads {VERSION}");
                return Err(wrong(what));
            }
            Line::Setup { setup, .. } => {
                found = Some(SetupRuns {
                    setup: *setup,
                    runs: Vec::new(),
                });
            }
            Line::Run { run } => {
                let Some(before) = &mut found else {
                    let what = "a run before the setup: the file's beginning is missing";
                    return Err(wrong(what.to_owned()));
                };
                before.runs.push(*run);
            }
        }
    }
    Ok(found)
}

/// What is joined, for errors.
const JOINED: &str = "give files of `albireo eval board`, such as results/yolo26n.fp16.orin.jsonl, or summary.csv files of the \
                      paper's published results";

/// The files to join: those that are named, and for a folder its `.jsonl` files, in the order of their names.
///
/// # Errors
/// When a folder cannot be read or has none.
pub fn files_of(named: &[PathBuf]) -> Result<Vec<PathBuf>, EvalError> {
    let is_runs = |path: &Path| path.extension().is_some_and(|extension| extension == "jsonl");
    let mut all = Vec::new();
    for path in named {
        if !path.is_dir() {
            all.push(path.clone());
            continue;
        }
        let found = crate::files::entries(path, is_runs)
            .map_err(|error| EvalError::read(path, error, JOINED))?;
        if found.is_empty() {
            let what = format!("this is a folder, and it has no .jsonl file; {JOINED}");
            return Err(EvalError::content(path, what));
        }
        all.extend(found);
    }
    Ok(all)
}

/// Reads a file of `albireo eval board`, or the published rows of the paper (CSV). A last line that was cut off is left
/// out.
///
/// # Errors
/// When the file cannot be read, is neither, or has no run.
pub fn read(path: &Path) -> Result<SetupRuns, EvalError> {
    let mut bytes = std::fs::read(path).map_err(|error| EvalError::read(path, error, JOINED))?;
    let is_of_lines = bytes.starts_with(b"{");
    if is_of_lines {
        bytes.truncate(whole_lines(&bytes));
    }
    let text = String::from_utf8(bytes).map_err(|error| EvalError::read(path, error, JOINED))?;
    let found = if is_of_lines {
        parse(path, &text)?
    } else {
        Some(published::parse(path, &text)?)
    };
    match found {
        Some(found) if !found.runs.is_empty() => Ok(found),
        _ => Err(EvalError::content(
            path,
            format!("it has no rows; {JOINED}"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_free_after_its_use_although_a_child_process_still_has_its_handle() {
        let folder = tempfile::tempdir().unwrap();
        let setup = Setup {
            detector: "yolo".to_owned(),
            precision: "fp16".to_owned(),
            power_mode: String::new(),
            machine: "board".to_owned(),
            settings: [].into(),
        };
        let restart = false;
        let first = RunsFile::open(folder.path(), &setup, restart).unwrap();
        let _copy = first.file.try_clone().unwrap();
        drop(first);
        RunsFile::open(folder.path(), &setup, restart).unwrap();
    }
}
