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

/// The file in the state directory.
const FILE: &str = "settings.json";

/// The settings of a node.
#[derive(Debug)]
pub(crate) struct Settings {
    directory: Option<PathBuf>,
    /// Never held while the disk is read or written.
    values: Mutex<Values>,
    /// What the file has; `None` until it was read. Held while the disk is read or written: no async worker locks it.
    stored: Mutex<Option<Values>>,
}

/// Settings by name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Values(BTreeMap<String, Value>);

/// A value set at run time instead of a configured one.
#[derive(Serialize, Deserialize)]
struct SetValue<T, C> {
    value: T,
    source: SettingSource,
    /// The configured value at that time.
    configured: C,
}

impl Values {
    /// Replaces a setting.
    pub(crate) fn set(&mut self, name: &str, setting: &impl Serialize) {
        // Cannot fail: settings hold numbers and text.
        if let Ok(value) = serde_json::to_value(setting) {
            self.0.insert(name.to_owned(), value);
        }
    }

    /// Replaces a setting by a value set at run time.
    pub(crate) fn keep(
        &mut self,
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
}

impl Settings {
    /// Opens the settings in `directory`, or in memory without one. An unreadable file is tried again later.
    pub(crate) fn open(directory: Option<&Path>) -> Self {
        let stored = (directory.map(read).transpose()).unwrap_or_else(|error| {
            tracing::error!(%error, "the kept settings cannot be read");
            None
        });
        Self {
            directory: directory.map(Path::to_owned),
            values: Mutex::new(stored.clone().unwrap_or_default()),
            stored: Mutex::new(stored),
        }
    }

    /// The setting kept under `name`.
    pub(crate) fn get<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        let value = self.values.lock().0.get(name)?.clone();
        serde_json::from_value(value)
            .inspect_err(|error| {
                tracing::warn!(name, %error, "a kept setting cannot be read and is not used");
            })
            .ok()
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

    /// Makes a change: `change` puts it in force, at once and before any other change, and sets what is to be kept of it.
    /// That is written to the file together, or not at all. If it cannot be written now, it is written when the disk works
    /// again. Writes a small file.
    pub(crate) fn change<T>(&self, change: impl FnOnce(&mut Values) -> T) -> T {
        let changed = change(&mut self.values.lock());
        if let Err(error) = self.save() {
            tracing::error!(%error, "a setting is not kept: it will not survive a restart");
        }
        changed
    }

    /// Writes the file if it differs from the settings, after reading it if that failed before. Settings that are read
    /// only now apply from the next start, except those set in the meantime.
    ///
    /// # Errors
    /// The disk's error; call it again later.
    pub(crate) fn save(&self) -> std::io::Result<()> {
        let Some(directory) = &self.directory else {
            return Ok(());
        };
        let mut stored = self.stored.lock();
        if stored.is_none() {
            *stored = Some(read(directory)?);
            tracing::warn!(
                "the kept settings could be read only now: they apply from the next start"
            );
        }
        let mut values = stored.clone().unwrap_or_default();
        values.0.extend(self.values.lock().0.clone());
        if stored.as_ref() != Some(&values) {
            write(directory, &values)?;
            *stored = Some(values);
        }
        Ok(())
    }
}

fn read(directory: &Path) -> std::io::Result<Values> {
    std::fs::create_dir_all(directory)?;
    let file = directory.join(FILE);
    match std::fs::read(&file) {
        Ok(bytes) => serde_json::from_slice(&bytes).or_else(|error| {
            let aside = file.with_extension("json.damaged");
            tracing::error!(
                file = %file.display(), %error, aside = %aside.display(),
                "kept settings cannot be read and were set aside; the configured ones are used"
            );
            std::fs::rename(&file, aside).map(|()| Values::default())
        }),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Values::default()),
        Err(error) => Err(error),
    }
}

/// Writes a new file beside the old one, syncs it, and then replaces the old one.
fn write(directory: &Path, values: &Values) -> std::io::Result<()> {
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
            self.stored.lock()
        }

        /// Keeps a setting. Returns true if it survives a restart.
        fn set(&self, name: &str, setting: impl Serialize) -> bool {
            self.change(|values| values.set(name, &setting));
            self.save().is_ok()
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
            assert!(settings.set("threshold/front", 9e-4));
            let again = Settings::open(Some(folder.path()));
            assert_eq!(again.get("threshold/front"), Some(9e-4));
        }
    }

    #[test]
    fn a_setting_made_before_the_disk_is_ready_does_not_overwrite_the_stored_one() {
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("disk/state");
        let first = Settings::open(Some(&state));
        assert!(first.set("target", 1) && first.set("threshold/front", 5));
        std::fs::rename(folder.path().join("disk"), folder.path().join("away")).unwrap();
        std::fs::write(folder.path().join("disk"), b"").unwrap();
        let settings = Settings::open(Some(&state));
        assert!(!settings.set("target", 2));
        let _ = settings.save();
        std::fs::remove_file(folder.path().join("disk")).unwrap();
        std::fs::rename(folder.path().join("away"), folder.path().join("disk")).unwrap();
        let _ = settings.save();
        let again = Settings::open(Some(&state));
        assert_eq!(again.get("target"), Some(2), "the newer value");
        assert_eq!(again.get("threshold/front"), Some(5), "not set meanwhile");
    }
}
