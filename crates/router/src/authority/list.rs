//! Keeps the list of the certificates that an authority has issued.

use super::{PRIVATE, read, write};
use crate::error::{RouterError, about, at, other};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs::File;
use std::path::{Path, PathBuf};

const LIST: &str = "list.json";
const LOCK: &str = "list.lock";

/// The version of the list's file format.
const VERSION: u32 = 1;

/// The role of a certificate's holder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Report under its own name.
    Node,
    /// Receive reports, tune, read all nodes.
    Hub,
    /// Forward everything.
    Router,
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Node => "node",
            Self::Hub => "hub",
            Self::Router => "router",
        })
    }
}

/// An issued common name with its newest certificate.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// The holder's role.
    pub role: Role,
    /// The holder's name.
    pub name: String,
    /// The number of the common name, incremented when the previous one is revoked.
    pub issue: u32,
    /// The holder's host names and addresses.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hosts: Vec<String>,
    /// The expiry of the newest certificate, seconds since the Unix epoch.
    pub ends_s: i64,
    /// The time of revocation, seconds since the Unix epoch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revoked_s: Option<i64>,
}

impl Entry {
    /// Its common name: `node/car-7/1`. Names contain no slash, so common names are unique.
    pub fn common_name(&self) -> String {
        format!("{}/{}/{}", self.role, self.name, self.issue)
    }

    /// The path of the newest certificate in the authority's folder.
    pub(crate) fn certificate(&self) -> PathBuf {
        format!("{}/{}.pem", self.role, self.name).into()
    }
}

#[derive(Serialize, Deserialize)]
struct Stored {
    v: u32,
    issued: Vec<Entry>,
}

/// The list, with the lock that keeps others from changing it.
pub(super) struct List {
    file: PathBuf,
    stored: Stored,
    /// Locked while the list exists.
    _lock: File,
}

fn lock(folder: &Path) -> Result<File, RouterError> {
    let file = folder.join(LOCK);
    let lock = File::create(&file).map_err(at(&file))?;
    lock.lock().map_err(at(&file))?;
    Ok(lock)
}

impl List {
    /// Writes an empty list where there is none.
    pub(super) fn begin(folder: &Path) -> Result<(), RouterError> {
        let file = folder.join(LIST);
        if file.exists() {
            return Ok(());
        }
        let empty = Self {
            _lock: lock(folder)?,
            file,
            stored: Stored {
                v: VERSION,
                issued: Vec::new(),
            },
        };
        empty.write()
    }

    /// Reads the list. A missing one is an error: with an empty one, names of revoked certificates would be issued again.
    pub(super) fn open(folder: &Path) -> Result<Self, RouterError> {
        let lock = lock(folder)?;
        let file = folder.join(LIST);
        let stored: Stored = serde_json::from_str(&read(&file)?).map_err(at(&file))?;
        if stored.v != VERSION {
            let found = stored.v;
            return Err(about(
                &file,
                format!("version {found} is not known, only {VERSION}"),
            ));
        }
        Ok(Self {
            file,
            stored,
            _lock: lock,
        })
    }

    pub(super) fn write(&self) -> Result<(), RouterError> {
        let text = serde_json::to_string_pretty(&self.stored).map_err(at(&self.file))?;
        write(&self.file, &(text + "\n"), PRIVATE)
    }

    pub(super) fn entries(&self) -> &[Entry] {
        &self.stored.issued
    }

    /// All entries with this role and name, revoked or not.
    fn entries_of(&self, role: Role, name: &str) -> impl Iterator<Item = &Entry> {
        self.stored
            .issued
            .iter()
            .filter(move |entry| entry.role == role && entry.name == name)
    }

    /// The unrevoked entry with this role and name.
    pub(super) fn unrevoked(&self, role: Role, name: &str) -> Result<&Entry, RouterError> {
        match self.entries_of(role, name).find(|entry| entry.revoked_s.is_none()) {
            Some(entry) => Ok(entry),
            None => other(format!("{role} `{name}` has no valid certificate")),
        }
    }

    /// The highest issue with this role and name; 0 if there is none.
    pub(super) fn last_issue(&self, role: Role, name: &str) -> u32 {
        self.entries_of(role, name).map(|entry| entry.issue).max().unwrap_or(0)
    }

    /// Adds an entry, replacing one with the same common name, and writes the list.
    pub(super) fn put(&mut self, entry: Entry) -> Result<(), RouterError> {
        let issued = &mut self.stored.issued;
        issued.retain(|known| known.common_name() != entry.common_name());
        issued.push(entry);
        issued.sort_by(|a, b| (a.role, &a.name, a.issue).cmp(&(b.role, &b.name, b.issue)));
        self.write()
    }
}
