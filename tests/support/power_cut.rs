//! What a disk keeps at a power cut, told from a program's system calls: what was synced, and perhaps some of the rest.

mod trace;

use super::{process, until};
use rand_core::RngCore;
use rand_pcg::Pcg64Mcg;
use std::collections::BTreeMap;
use std::path::Path;
use tokio::process::Command;
use trace::{Call, Trace, What};

/// The piece that a disk writes as a whole, bytes.
const SECTOR: usize = 512;

/// The files of a folder.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// The program under `strace`, which writes the system calls that change files to `trace`.
pub(crate) fn traced(trace: &Path) -> Command {
    let mut command = process("strace");
    // With -D the program is the child process, so that it always ends with the test, and strace with it.
    command.args([
        "-D",
        "-f",
        "-y",
        "-xx",
        "-ttt",
        "-s",
        "16777216",
        "--seccomp-bpf",
    ]);
    command.args(["-e", &format!("trace={}", trace::CALLS), "-o"]);
    command.arg(trace).arg(env!("CARGO_BIN_EXE_albireo"));
    command
}

pub(crate) fn read_files(folder: &Path) -> Files {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let file = |path: std::path::PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        (name, std::fs::read(path).unwrap())
    };
    entries.map(file).collect()
}

/// Replaces the files of a folder.
pub(crate) fn write_files(folder: &Path, files: &Files) {
    drop(std::fs::remove_dir_all(folder));
    std::fs::create_dir_all(folder).unwrap();
    for (name, bytes) in files {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
}

/// What a program did to the files of a folder, from its start until it was killed.
pub(crate) struct Recording {
    start: Files,
    trace: Trace,
}

impl Recording {
    /// Reads the trace of a killed program that found the files `start` in the folder.
    pub(crate) async fn of(program: u32, trace: &Path, folder: &Path, start: Files) -> Self {
        let end = format!("{program} ");
        let is_whole = |text: &str| {
            text.lines()
                .filter(|line| line.starts_with(&end))
                .any(|line| line.ends_with("+++ killed by SIGKILL +++"))
        };
        until("the trace is whole", async || {
            is_whole(&std::fs::read_to_string(trace).unwrap_or_default())
        })
        .await;
        let trace = Trace::read(&std::fs::read_to_string(trace).unwrap(), folder);
        let recording = Self { start, trace };
        recording.assert_it_saw_everything(read_files(folder));
        recording
    }

    /// Nothing escapes the trace: with all that was not synced, the disk has what the folder has.
    fn assert_it_saw_everything(&self, mut found: Files) {
        if self.trace.calls.iter().any(|call| call.ended == usize::MAX) {
            // Nobody knows what came of a call in which the program was killed.
            return;
        }
        let mut told = self.disk(u64::MAX).with_all();
        for files in [&mut found, &mut told] {
            files.retain(|name, _| !is_shared_memory(name));
        }
        let names = |files: &Files| files.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&told), names(&found));
        for (name, bytes) in &told {
            assert!(*bytes == found[name], "{name}: a change was not traced");
        }
    }

    /// A moment at which a call began or ended, or just after it, µs since 1970.
    pub(crate) fn moment(&self, random: &mut Pcg64Mcg) -> u64 {
        let call = &self.trace.calls[below(random, self.trace.calls.len())];
        let line = [call.begun, call.ended.min(self.trace.times_us.len() - 1)][below(random, 2)];
        self.trace.times_us[line] + random.next_u64() % 2
    }

    /// The files after a power cut at `moment`: what was synced before, and a random part of the rest, often nothing.
    pub(crate) fn cut(&self, moment: u64, random: &mut Pcg64Mcg) -> Files {
        // In 16ths.
        let kept = [0, 0, 1, 8, 15][below(random, 5)];
        self.disk(moment).cut(|| below(random, 16) < kept)
    }

    fn disk(&self, moment: u64) -> Disk {
        let lines = self.trace.times_us.partition_point(|time| *time < moment);
        let mut disk = Disk::new(&self.start);
        for call in self.trace.calls.iter().filter(|call| call.begun < lines) {
            disk.take(call, lines);
        }
        disk
    }
}

pub(crate) fn below(random: &mut Pcg64Mcg, bound: usize) -> usize {
    (random.next_u64() % bound as u64) as usize
}

/// The index of a database's log is in shared memory, which a power cut empties.
fn is_shared_memory(name: &str) -> bool {
    name.ends_with("-shm")
}

/// A change of a file's content.
enum Change {
    Write(usize, Vec<u8>),
    Size(usize),
}

impl Change {
    fn apply(&self, content: &mut Vec<u8>) {
        match self {
            Self::Size(size) => content.resize(*size, 0),
            Self::Write(at, bytes) => {
                let end = at + bytes.len();
                content.resize(content.len().max(end), 0);
                content[*at..end].copy_from_slice(bytes);
            }
        }
    }

    /// The parts that reach the disk each on its own.
    fn sectors(self) -> Vec<Self> {
        let Self::Write(at, bytes) = self else {
            return vec![self];
        };
        let mut parts = Vec::new();
        let mut from = 0;
        while from < bytes.len() {
            let to = bytes.len().min(from + SECTOR - (at + from) % SECTOR);
            parts.push(Self::Write(at + from, bytes[from..to].to_vec()));
            from = to;
        }
        parts
    }
}

#[derive(Default)]
struct File {
    synced: Vec<u8>,
    size: usize,
    /// Changes since the last sync, and the line at which each ended.
    unsynced: Vec<(usize, Change)>,
}

/// A change of the folder.
#[derive(Clone)]
enum NameChange {
    /// A file gets a name.
    Created { name: String, file: usize },
    /// A file gets another name.
    Renamed {
        from: String,
        to: String,
        file: usize,
    },
    /// A name goes.
    Removed { name: String },
}

fn rename(names: &mut BTreeMap<String, usize>, change: NameChange) {
    match change {
        NameChange::Created { name, file } => {
            names.insert(name, file);
        }
        NameChange::Renamed { from, to, file } => {
            names.remove(&from);
            names.insert(to, file);
        }
        NameChange::Removed { name } => {
            names.remove(&name);
        }
    }
}

/// A folder on a disk.
#[derive(Default)]
struct Disk {
    files: Vec<File>,
    names: BTreeMap<String, usize>,
    synced_names: BTreeMap<String, usize>,
    unsynced_names: Vec<(usize, NameChange)>,
}

impl Disk {
    fn new(start: &Files) -> Self {
        let mut disk = Self::default();
        for (name, bytes) in start {
            disk.names.insert(name.clone(), disk.files.len());
            disk.files.push(File {
                synced: bytes.clone(),
                size: bytes.len(),
                unsynced: Vec::new(),
            });
        }
        disk.synced_names = disk.names.clone();
        disk
    }

    fn change_name(&mut self, ended: usize, change: NameChange) {
        rename(&mut self.names, change.clone());
        self.unsynced_names.push((ended, change));
    }

    /// Takes a call; a sync counts if it ended before `lines`, and for what ended before it began.
    fn take(&mut self, call: &Call, lines: usize) {
        let known = |name: &str| self.names.get(name).copied();
        match &call.what {
            What::Open(name) | What::Empty(name) if known(name).is_none() => {
                let created = NameChange::Created {
                    name: name.clone(),
                    file: self.files.len(),
                };
                self.files.push(File::default());
                self.change_name(call.ended, created);
            }
            What::Empty(name) => self.change(name, call, Change::Size(0)),
            What::Open(_) => {}
            What::Write(name, at, bytes) => {
                let end = self.files[self.names[name]].size;
                self.change(name, call, Change::Write(at.unwrap_or(end), bytes.clone()));
            }
            What::Size(name, size) => self.change(name, call, Change::Size(*size)),
            What::Rename(from, to) => {
                let renamed = NameChange::Renamed {
                    from: from.clone(),
                    to: to.clone(),
                    file: self.names[from],
                };
                self.change_name(call.ended, renamed);
            }
            What::Remove(name) => {
                let removed = NameChange::Removed { name: name.clone() };
                self.change_name(call.ended, removed);
            }
            What::Sync(_) | What::SyncFolder if call.ended >= lines => {}
            What::Sync(name) => {
                let file = &mut self.files[self.names[name]];
                let is_old = |(ended, _): &mut (usize, Change)| *ended < call.begun;
                for (_, change) in file.unsynced.extract_if(.., is_old) {
                    change.apply(&mut file.synced);
                }
            }
            What::SyncFolder => {
                let is_old = |(ended, _): &mut (usize, NameChange)| *ended < call.begun;
                for (_, change) in self.unsynced_names.extract_if(.., is_old) {
                    rename(&mut self.synced_names, change);
                }
            }
        }
    }

    fn change(&mut self, name: &str, call: &Call, change: Change) {
        let file = &mut self.files[self.names[name]];
        file.size = match &change {
            Change::Size(size) => *size,
            Change::Write(at, bytes) => file.size.max(at + bytes.len()),
        };
        file.unsynced.push((call.ended, change));
    }

    fn with_all(self) -> Files {
        self.cut(|| true)
    }

    /// The files with those unsynced sectors and names that are kept. Names reach a disk in their order, sectors in none.
    fn cut(self, mut is_kept: impl FnMut() -> bool) -> Files {
        let mut names = self.synced_names;
        let mut files = Vec::new();
        for (_, change) in self.unsynced_names {
            if !is_kept() {
                break;
            }
            rename(&mut names, change);
        }
        for mut file in self.files {
            for sector in file.unsynced.into_iter().flat_map(|(_, change)| change.sectors()) {
                if is_kept() {
                    sector.apply(&mut file.synced);
                }
            }
            files.push(file.synced);
        }
        let mut kept = Files::new();
        for (name, file) in names {
            let bytes = if is_shared_memory(&name) {
                vec![0xa5; 32 << 10]
            } else {
                files[file].clone()
            };
            kept.insert(name, bytes);
        }
        kept
    }
}

#[test]
fn a_power_cut_takes_what_was_not_synced_and_a_name_whose_folder_was_not() {
    let hex = |text: &str| text.bytes().map(|byte| format!("\\x{byte:02x}")).collect::<String>();
    let folder = hex("/d");
    let new = hex("/d/new");
    let file = hex("/d/file");
    let old = hex("old");
    let next = hex("next");
    let text = [
        format!(
            r#"openat(AT_FDCWD<{folder}>, "{new}", O_WRONLY|O_CREAT|O_TRUNC, 0666) = 3<{new}>"#
        ),
        format!(r#"write(3<{new}>, "{old}", 3) = 3"#),
        format!("fsync(3<{new}>) = 0"),
        format!(r#"rename("{new}", "{file}") = 0"#),
        format!("fsync(4<{folder}>) = 0"),
        format!(r#"pwrite64(3<{file}>, "{next}", 4, 1) = 4"#),
        format!("fdatasync(3<{file}> <unfinished ...>"),
        "<... fdatasync resumed>) = 0".to_owned(),
    ];
    let lines: String = text
        .iter()
        .enumerate()
        .map(|(time, line)| format!("7  0.{time:06} {line}\n"))
        .collect();
    let recording = Recording {
        start: Files::new(),
        trace: Trace::read(&lines, Path::new("/d")),
    };
    let left = |moment: u64, all: bool| {
        let files = recording.disk(moment).cut(|| all);
        let shown = |(name, bytes)| format!("{name}={}", String::from_utf8(bytes).unwrap());
        files.into_iter().map(shown).collect::<Vec<_>>().join(" ")
    };
    for (moment, synced, all) in [
        (1, "", "new="),
        (2, "", "new=old"),
        (4, "", "file=old"),
        (5, "file=old", "file=old"),
        (6, "file=old", "file=onext"),
        (7, "file=old", "file=onext"),
        (8, "file=onext", "file=onext"),
    ] {
        assert_eq!(
            [left(moment, false), left(moment, true)],
            [synced, all],
            "{moment}"
        );
    }
}
