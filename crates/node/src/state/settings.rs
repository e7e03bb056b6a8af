//! Keeps settings that are changed at run time in one file, so that they survive a restart.

use albireo_wire::SettingSource;
use parking_lot::Mutex;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The file in the state directory.
const FILE: &str = "settings.json";

/// The settings; clones share them.
#[derive(Clone, Debug)]
pub(crate) struct Settings(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    directory: Option<PathBuf>,
    /// Held while the disk is read or written: no async worker locks it.
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    values: BTreeMap<String, Value>,
    /// True once the file was read or found missing.
    read: bool,
    /// True if something is not in the file yet.
    unwritten: bool,
}

/// A value set at run time instead of a configured one.
#[derive(Serialize, Deserialize)]
struct SetValue<T, C> {
    value: T,
    source: SettingSource,
    /// The configured value at that time.
    configured: C,
}

impl Settings {
    /// Opens the settings in `directory`, or in memory without one. An unreadable file is tried again later.
    pub(crate) fn open(directory: Option<&Path>) -> Self {
        let mut state = State::default();
        match directory {
            Some(directory) => {
                if let Err(error) = state.read(directory) {
                    tracing::error!(%error, "the kept settings cannot be read");
                }
            }
            None => state.read = true,
        }
        Self(Arc::new(Shared {
            directory: directory.map(Path::to_owned),
            state: Mutex::new(state),
        }))
    }

    /// The setting kept under `name`.
    pub(crate) fn get<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        let value = self.0.state.lock().values.get(name)?.clone();
        serde_json::from_value(value)
            .inspect_err(|error| {
                tracing::warn!(name, %error, "a kept setting cannot be read and is not used");
            })
            .ok()
    }

    /// Keeps a setting and syncs the file. Returns true if it survives a restart. If it cannot be written now, it is
    /// written when the disk works again.
    pub(crate) fn set<T: Serialize>(&self, name: &str, setting: &T) -> bool {
        let Ok(value) = serde_json::to_value(setting) else {
            return false;
        };
        let mut state = self.0.state.lock();
        state.values.insert(name.to_owned(), value);
        state.unwritten = true;
        let is_kept = self.0.write(&mut state);
        if !is_kept && self.0.directory.is_some() {
            tracing::warn!(name, "a setting is not kept: it will not survive a restart");
        }
        is_kept
    }

    /// The value last kept under `name` and its source. If the configured value was edited since, that takes precedence,
    /// but not over the hub's value, which has a revision.
    pub(crate) fn kept<T: DeserializeOwned, C: DeserializeOwned + PartialEq>(
        &self,
        name: &str,
        configured: &C,
    ) -> Option<(T, SettingSource)> {
        let kept: SetValue<T, C> = self.get(name)?;
        let is_current = kept.configured == *configured || kept.source == SettingSource::Hub;
        is_current.then_some((kept.value, kept.source))
    }

    /// Keeps a value set at run time, as [`set`](Self::set) does.
    pub(crate) fn keep(
        &self,
        name: &str,
        value: impl Serialize,
        source: SettingSource,
        configured: impl Serialize,
    ) {
        let kept = SetValue {
            value,
            source,
            configured,
        };
        self.set(name, &kept);
    }

    /// Retries failed reads and writes. Settings that are read only now apply from the next start, except those set in
    /// the meantime.
    pub(crate) fn retry(&self) {
        let (mut state, directory) = (self.0.state.lock(), &self.0.directory);
        if !state.read
            && let Some(directory) = directory
        {
            let set_since = std::mem::take(&mut state.values);
            if state.read(directory).is_ok() {
                tracing::warn!(
                    "the kept settings could be read only now: they apply from the next start"
                );
            }
            state.values.extend(set_since);
        }
        if state.unwritten {
            self.0.write(&mut state);
        }
    }
}

impl Shared {
    fn write(&self, state: &mut State) -> bool {
        let Some(directory) = self.directory.as_ref().filter(|_| state.read) else {
            return false;
        };
        match write(directory, &state.values) {
            Ok(()) => state.unwritten = false,
            Err(error) => tracing::error!(%error, "settings cannot be written"),
        }
        !state.unwritten
    }
}

impl State {
    fn read(&mut self, directory: &Path) -> std::io::Result<()> {
        std::fs::create_dir_all(directory)?;
        let file = directory.join(FILE);
        self.values = match std::fs::read(&file) {
            Ok(bytes) => serde_json::from_slice(&bytes).or_else(|error| {
                let aside = file.with_extension("json.damaged");
                tracing::error!(
                    file = %file.display(), %error, aside = %aside.display(),
                    "kept settings cannot be read and were set aside; the configured ones are used"
                );
                std::fs::rename(&file, aside).map(|()| BTreeMap::new())
            })?,
            Err(error) if error.kind() == ErrorKind::NotFound => BTreeMap::new(),
            Err(error) => return Err(error),
        };
        self.read = true;
        Ok(())
    }
}

/// Writes a new file beside the old one, syncs it, and then replaces the old one.
fn write(directory: &Path, values: &BTreeMap<String, Value>) -> std::io::Result<()> {
    let (file, fresh) = (directory.join(FILE), directory.join("settings.json.new"));
    let mut written = File::create(&fresh)?;
    written.write_all(&serde_json::to_vec(values)?)?;
    written.sync_all()?;
    std::fs::rename(fresh, file)?;
    File::open(directory)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Settings {
        /// Stalls the disk until the result is dropped.
        pub(crate) fn stall(&self) -> impl Sized {
            self.0.state.lock()
        }
    }

    #[test]
    fn a_setting_survives_a_restart_and_a_broken_file_is_set_aside() {
        let folder = tempfile::tempdir().unwrap();
        for broken in ["", "{\"v\":1,\"cam", "[]"] {
            let file = folder.path().join(FILE);
            std::fs::write(&file, broken).unwrap();
            let settings = Settings::open(Some(folder.path()));
            assert!(!file.exists());
            assert_eq!(settings.get::<f64>("threshold/front"), None);
            assert!(settings.set("threshold/front", &9e-4));
            let again = Settings::open(Some(folder.path()));
            assert_eq!(again.get("threshold/front"), Some(9e-4));
        }
    }

    #[test]
    fn a_setting_made_before_the_disk_is_ready_does_not_overwrite_the_stored_one() {
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("disk/state");
        let first = Settings::open(Some(&state));
        assert!(first.set("target", &1) && first.set("threshold/front", &5));
        std::fs::rename(folder.path().join("disk"), folder.path().join("away")).unwrap();
        std::fs::write(folder.path().join("disk"), b"").unwrap();
        let settings = Settings::open(Some(&state));
        assert!(!settings.set("target", &2));
        settings.retry();
        std::fs::remove_file(folder.path().join("disk")).unwrap();
        std::fs::rename(folder.path().join("away"), folder.path().join("disk")).unwrap();
        settings.retry();
        let again = Settings::open(Some(&state));
        assert_eq!(again.get("target"), Some(2), "the newer value");
        assert_eq!(again.get("threshold/front"), Some(5), "not set meanwhile");
    }
}
