//! The list of the certificates that an authority has issued.

use super::AuthorityError;
use super::files::{read, write_private};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

const LIST: &str = "list.json";
const LOCK: &str = "list.lock";

/// The version of the list's file.
const VERSION: u32 = 1;

/// What the holder of a certificate may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Report under its own name.
    Node,
    /// Take reports, tune, hear everybody.
    Hub,
    /// Hand on everything.
    Router,
}

impl Role {
    /// Its name.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Node => "node",
            Self::Hub => "hub",
            Self::Router => "router",
        }
    }

    /// The common name of a certificate: `node/car-7/1`. Names have no slash, so no two are the same.
    pub fn common_name(self, name: &str, issue: u32) -> String {
        format!("{self}/{name}/{issue}")
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A common name that the authority has given, with the newest certificate of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// What the holder may do.
    pub role: Role,
    /// The holder's name.
    pub name: String,
    /// Number of the common name, counted up when the one before is revoked.
    pub issue: u32,
    /// Names and addresses the holder is reached at.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hosts: Vec<String>,
    /// When the newest certificate ends, seconds since the Unix epoch.
    pub ends_s: i64,
    /// When it was revoked, seconds since the Unix epoch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revoked_s: Option<i64>,
}

impl Entry {
    fn is_of(&self, role: Role, name: &str) -> bool {
        self.role == role && self.name == name
    }

    /// Its common name.
    pub fn common_name(&self) -> String {
        self.role.common_name(&self.name, self.issue)
    }

    /// Where the newest certificate is, in the authority's folder.
    pub(crate) fn certificate(&self) -> PathBuf {
        Path::new(self.role.as_str()).join(format!("{}.pem", self.name))
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
    issued: Vec<Entry>,
    /// Held while this lives.
    _lock: File,
}

impl List {
    pub(super) fn open(folder: &Path) -> Result<Self, AuthorityError> {
        let lock = folder.join(LOCK);
        let locked = File::create(&lock)
            .and_then(|file| {
                file.lock()?;
                Ok(file)
            })
            .map_err(|source| AuthorityError::File { file: lock, source })?;
        let file = folder.join(LIST);
        let issued = if file.exists() {
            let wrong = |reason| AuthorityError::Content {
                file: file.clone(),
                reason,
            };
            let stored: Stored =
                serde_json::from_str(&read(&file)?).map_err(|error| wrong(error.to_string()))?;
            if stored.v != VERSION {
                return Err(wrong(format!(
                    "version {} is not known; this program knows {VERSION}",
                    stored.v
                )));
            }
            stored.issued
        } else {
            Vec::new()
        };
        Ok(Self {
            file,
            issued,
            _lock: locked,
        })
    }

    pub(super) fn write(&self) -> Result<(), AuthorityError> {
        let stored = Stored {
            v: VERSION,
            issued: self.issued.clone(),
        };
        let text =
            serde_json::to_string_pretty(&stored).map_err(|error| AuthorityError::Content {
                file: self.file.clone(),
                reason: error.to_string(),
            })?;
        write_private(&self.file, &(text + "\n"))
    }

    pub(super) fn entries(&self) -> &[Entry] {
        &self.issued
    }

    /// The one of that name that is not revoked.
    pub(super) fn good(&self, role: Role, name: &str) -> Result<&Entry, AuthorityError> {
        (self.issued.iter())
            .find(|entry| entry.is_of(role, name) && entry.revoked_s.is_none())
            .ok_or_else(|| AuthorityError::Unknown {
                role,
                name: name.to_owned(),
            })
    }

    /// The highest issue of that name; 0 when there is none.
    pub(super) fn last_issue(&self, role: Role, name: &str) -> u32 {
        (self.issued.iter())
            .filter(|entry| entry.is_of(role, name))
            .map(|entry| entry.issue)
            .max()
            .unwrap_or(0)
    }

    /// Adds an entry; one with the same common name is replaced.
    pub(super) fn put(&mut self, entry: Entry) {
        let same =
            |known: &Entry| known.is_of(entry.role, &entry.name) && known.issue == entry.issue;
        self.issued.retain(|known| !same(known));
        self.issued.push(entry);
        self.issued
            .sort_by(|a, b| (a.role, &a.name, a.issue).cmp(&(b.role, &b.name, b.issue)));
    }

    pub(super) fn revoke(&mut self, role: Role, name: &str) -> Result<Entry, AuthorityError> {
        let mut entry = self.good(role, name)?.clone();
        let now = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        entry.revoked_s = Some(i64::try_from(now.as_secs()).unwrap_or(i64::MAX));
        self.put(entry.clone());
        Ok(entry)
    }
}
