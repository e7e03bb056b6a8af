//! The file that keeps settings changed at run time, so that they survive a restart.

use crate::state_files::create_directory;
use albireo_wire::SettingSource;
use parking_lot::Mutex;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The file in the state directory.
const FILE: &str = "settings.json";

/// The beginning of the file: the checksum of all bytes behind the closing quote follows, in eight digits.
const CHECKSUM: &str = r#"{"~checksum":""#;

/// The name of the checksum. An earlier version of the program, which keeps it, writes it as the last of the sorted settings,
/// where it is ignored.
const CHECKSUM_NAME: &str = "~checksum";

/// The time for which it is shown that the settings were damaged.
const DAMAGE_SHOWN_FOR: Duration = Duration::from_secs(600);

/// The kept settings of a node.
#[derive(Debug)]
pub(crate) struct SettingsFile {
    directory: Option<PathBuf>,
    /// Never held while the disk is read or written.
    values: Mutex<KeptValues>,
    /// What was last read from the file or written to it; `None` until it was read. Held while the disk is read or written:
    /// no async worker locks it.
    stored: Mutex<Option<KeptValues>>,
    /// The outcome of the last reading or writing. Never held while the disk is read or written.
    disk: Mutex<DiskState>,
}

/// What the disk did with the settings.
#[derive(Debug, Default)]
struct DiskState {
    /// The reason why the settings are not on the disk now.
    failing: Option<String>,
    /// The time at which they were found damaged.
    damaged: Option<Instant>,
}

/// Settings by name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct KeptValues(BTreeMap<String, Value>);

/// A value set at run time instead of a configured one.
#[derive(Serialize, Deserialize)]
struct SetValue<T, C> {
    value: T,
    source: SettingSource,
    /// The configured value at that time.
    configured: C,
}

impl KeptValues {
    /// Replaces a setting.
    pub(crate) fn set(&mut self, name: &str, setting: &impl Serialize) {
        // Cannot fail: settings hold numbers and text.
        if let Ok(value) = serde_json::to_value(setting) {
            self.0.insert(name.to_owned(), value);
        }
    }

    /// Replaces a setting by a value set at run time.
    pub(super) fn keep(
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

impl SettingsFile {
    /// Opens the settings in `directory`, or in memory without one. An unreadable file is tried again later.
    pub(crate) fn open(directory: Option<&Path>) -> Self {
        let settings = Self {
            directory: directory.map(Path::to_owned),
            values: Mutex::default(),
            stored: Mutex::default(),
            disk: Mutex::default(),
        };
        if let Some(directory) = directory {
            let stored = settings.read(directory);
            match &stored {
                Ok(stored) => stored.clone_into(&mut settings.values.lock()),
                Err(error) => tracing::error!(%error, "the kept settings cannot be read"),
            }
            settings.note(stored.as_ref().map(drop));
            *settings.stored.lock() = stored.ok();
        }
        settings
    }

    /// True if the settings survive a restart: they are in a file, and the last attempt to write it succeeded.
    pub(super) fn survive_restart(&self) -> bool {
        self.directory.is_some() && self.disk.lock().failing.is_none()
    }

    /// What is wrong with the file, in words.
    pub(crate) fn fault(&self) -> Option<String> {
        let disk = self.disk.lock();
        if let Some(reason) = &disk.failing {
            return Some(reason.clone());
        }
        if disk.damaged?.elapsed() >= DAMAGE_SHOWN_FOR {
            return None;
        }
        Some(format!(
            "{FILE} was damaged and set aside: the configured values are used"
        ))
    }

    /// Notes the outcome of reading or writing the file.
    fn note(&self, outcome: Result<(), &std::io::Error>) {
        self.disk.lock().failing = outcome.err().map(|error| {
            format!("what was set at run time is not kept over a restart: {FILE}: {error}")
        });
    }

    /// Reads the file; sets it aside if it is damaged.
    fn read(&self, directory: &Path) -> std::io::Result<KeptValues> {
        create_directory(directory)?;
        let file = directory.join(FILE);
        let bytes = match std::fs::read(&file) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(KeptValues::default()),
            read => read?,
        };
        let error = match parse(&bytes) {
            Ok(values) => return Ok(values),
            Err(error) => error,
        };
        let aside = file.with_extension("json.damaged");
        tracing::error!(
            file = %file.display(), error, aside = %aside.display(),
            "kept settings are damaged and were set aside; the configured ones are used"
        );
        self.disk.lock().damaged = Some(Instant::now());
        std::fs::rename(&file, aside)?;
        Ok(KeptValues::default())
    }

    /// The setting kept under `name`.
    pub(crate) fn get<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        let value = self.values.lock().0.get(name)?.clone();
        match serde_json::from_value(value) {
            Ok(setting) => Some(setting),
            Err(error) => {
                tracing::warn!(name, %error, "a kept setting cannot be read and is not used");
                None
            }
        }
    }

    /// The value last kept under `name` and its source. If the configured value was edited since, that takes precedence,
    /// but not over the hub's value, which has a revision.
    pub(super) fn kept<T: DeserializeOwned, C: DeserializeOwned + PartialEq>(
        &self,
        name: &str,
        configured: &C,
    ) -> Option<(T, SettingSource)> {
        let kept: SetValue<T, C> = self.get(name)?;
        let is_current = kept.configured == *configured || kept.source == SettingSource::Hub;
        is_current.then_some((kept.value, kept.source))
    }

    /// Sets settings: `settings` puts them in force, at once and before any others, and sets what is to be kept of them.
    /// That is written to the file together, or not at all. If it cannot be written now, it is written when the disk works
    /// again. Writes a small file.
    pub(crate) fn edit<T>(&self, settings: impl FnOnce(&mut KeptValues) -> T) -> T {
        let set = settings(&mut self.values.lock());
        if let Err(error) = self.save() {
            tracing::error!(%error, "a setting is not kept: it will not survive a restart");
        }
        set
    }

    /// Writes the file if a setting has changed since, or if it is not there: somebody removed it, or an empty disk is in
    /// its place. A file that somebody restores by hand stays until a setting changes: it applies from the next start.
    /// Reads the file first if that failed before: settings that are read only now apply from the next start, except those
    /// set in the meantime.
    ///
    /// # Errors
    /// The disk's error; call it again later.
    pub(super) fn save(&self) -> std::io::Result<()> {
        let Some(directory) = &self.directory else {
            return Ok(());
        };
        let saved = self.save_in(directory);
        self.note(saved.as_ref().map(drop));
        saved
    }

    fn save_in(&self, directory: &Path) -> std::io::Result<()> {
        let mut stored = self.stored.lock();
        if stored.is_none() {
            *stored = Some(self.read(directory)?);
            tracing::warn!(
                "the kept settings could be read only now: they apply from the next start"
            );
        }
        let known = stored.clone().unwrap_or_default();
        let mut values = known.clone();
        values.0.extend(self.values.lock().0.clone());
        let is_missing = !directory.join(FILE).try_exists()?;
        if values != known || (is_missing && !values.0.is_empty()) {
            write(directory, &values)?;
            *stored = Some(values);
        }
        Ok(())
    }
}

/// Reads the settings in a file, and checks them if it has a checksum.
fn parse(bytes: &[u8]) -> Result<KeptValues, String> {
    let checked = bytes.strip_prefix(CHECKSUM.as_bytes());
    if let Some((digits, rest)) = checked.and_then(|checked| checked.split_at_checked(8)) {
        let found = crc32fast::hash(rest);
        if format!("{found:08x}").as_bytes() != digits {
            return Err("its checksum is wrong".to_owned());
        }
    }
    let mut values: KeptValues =
        serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    values.0.remove(CHECKSUM_NAME);
    Ok(values)
}

/// The file with these settings: its first key is the checksum of what follows it.
fn text(values: &KeptValues) -> std::io::Result<String> {
    let json = serde_json::to_string(values)?;
    // Behind the checksum its closing quote, and a comma if a setting follows.
    let begin = if json == "{}" { "\"" } else { "\"," };
    let rest = format!("{begin}{}", json.trim_start_matches('{'));
    let checksum = crc32fast::hash(rest.as_bytes());
    Ok(format!("{CHECKSUM}{checksum:08x}{rest}"))
}

/// Writes a new file beside the old one, syncs it, and then replaces the old one.
fn write(directory: &Path, values: &KeptValues) -> std::io::Result<()> {
    create_directory(directory)?;
    let file = directory.join(FILE);
    let fresh = directory.join("settings.json.new");
    let mut written = File::create(&fresh)?;
    written.write_all(text(values)?.as_bytes())?;
    written.sync_all()?;
    std::fs::rename(fresh, file)?;
    File::open(directory)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    impl SettingsFile {
        /// Stalls the disk until the result is dropped.
        pub(crate) fn stall(&self) -> impl Sized {
            self.stored.lock()
        }

        /// Keeps a setting. Returns true if it survives a restart.
        fn set(&self, name: &str, setting: impl Serialize) -> bool {
            self.edit(|values| values.set(name, &setting));
            self.save().is_ok()
        }
    }

    #[test]
    fn a_setting_survives_a_restart_and_a_broken_file_is_set_aside() {
        let folder = tempfile::tempdir().unwrap();
        for broken in ["", "{\"v\":1,\"cam", "[]"] {
            let file = folder.path().join(FILE);
            std::fs::write(&file, broken).unwrap();
            let settings = SettingsFile::open(Some(folder.path()));
            assert!(!file.exists());
            assert_eq!(settings.get::<f64>("threshold/front"), None);
            assert!(settings.set("threshold/front", 9e-4));
            assert!(settings.fault().unwrap().contains("was damaged"));
            let again = SettingsFile::open(Some(folder.path()));
            assert_eq!(again.get("threshold/front"), Some(9e-4));
            assert_eq!(again.fault(), None);
        }
    }

    #[test]
    fn a_file_without_a_checksum_is_read_and_one_with_a_wrong_checksum_is_not() {
        let mut values = KeptValues::default();
        assert_eq!(parse(text(&values).unwrap().as_bytes()), Ok(values.clone()));
        values.set("threshold/front", &9e-4);
        let written = text(&values).unwrap();
        assert_eq!(parse(written.as_bytes()), Ok(values.clone()));
        assert_eq!(parse(br#"{"threshold/front":9e-4}"#), Ok(values.clone()));
        // An earlier version keeps the key and sorts it.
        let old = br#"{"threshold/front":9e-4,"~checksum":"0123abcd"}"#;
        assert_eq!(parse(old), Ok(values.clone()));
        let flipped = written.replace("0.0009", "0.0008");
        assert_eq!(
            parse(flipped.as_bytes()),
            Err("its checksum is wrong".to_owned())
        );
    }

    #[test]
    fn settings_survive_a_restart_only_if_their_own_file_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(FILE);
        let new = folder.path().join("settings.json.new");
        let settings = SettingsFile::open(Some(folder.path()));
        assert!(settings.set("target", 1));
        assert!(settings.survive_restart());
        // No file can be created in the place of a folder, as on a full disk.
        std::fs::create_dir(&new).unwrap();
        assert!(!settings.set("target", 2));
        assert!(!settings.survive_restart());
        let fault = settings.fault().unwrap();
        assert!(fault.contains("not kept over a restart"), "{fault}");
        std::fs::remove_dir(new).unwrap();
        settings.save().unwrap();
        assert!(settings.survive_restart());
        assert_eq!(settings.fault(), None);
        // Nor can a folder be read as a file.
        std::fs::remove_file(&file).unwrap();
        std::fs::create_dir(&file).unwrap();
        let settings = SettingsFile::open(Some(folder.path()));
        assert!(!settings.survive_restart());
        assert!(settings.fault().is_some());
        assert!(!SettingsFile::open(None).survive_restart());
    }

    #[test]
    fn settings_survive_a_restart_although_their_file_was_removed() {
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("state");
        let settings = SettingsFile::open(Some(&state));
        let kept = || SettingsFile::open(Some(&state)).get::<i32>("target");
        assert!(settings.set("target", 1));
        std::fs::remove_file(state.join(FILE)).unwrap();
        settings.save().unwrap();
        assert_eq!(kept(), Some(1));
        std::fs::remove_dir_all(&state).unwrap();
        settings.save().unwrap();
        assert_eq!(kept(), Some(1));
        // An empty disk takes the place of the first.
        std::fs::rename(&state, folder.path().join("first")).unwrap();
        std::fs::create_dir(&state).unwrap();
        settings.save().unwrap();
        assert_eq!(kept(), Some(1));
        // A disk that is not there at all is a fault, although nothing new is set.
        std::fs::rename(&state, folder.path().join("second")).unwrap();
        std::fs::write(&state, b"").unwrap();
        assert!(settings.save().is_err());
        assert!(!settings.survive_restart());
    }

    #[test]
    fn a_file_restored_by_hand_stays_until_a_setting_changes_and_is_not_written_again() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(FILE);
        let settings = SettingsFile::open(Some(folder.path()));
        let kept = || SettingsFile::open(Some(folder.path())).get::<i32>("target");
        assert!(settings.set("target", 1));
        let backup = std::fs::read(&file).unwrap();
        assert!(settings.set("target", 2));
        // As another file, which is what it also seems to be on a disk whose numbers of files change.
        let copy = folder.path().join("copy");
        std::fs::write(&copy, &backup).unwrap();
        std::fs::rename(&copy, &file).unwrap();
        for _ in 0..2 {
            settings.save().unwrap();
            assert_eq!(std::fs::read(&file).unwrap(), backup);
        }
        assert_eq!(kept(), Some(1));
        assert!(settings.set("target", 3));
        assert_eq!(kept(), Some(3));
    }

    #[test]
    fn a_setting_made_before_the_disk_is_ready_does_not_overwrite_the_stored_one() {
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("disk/state");
        let first = SettingsFile::open(Some(&state));
        assert!(first.set("target", 1));
        assert!(first.set("threshold/front", 5));
        std::fs::rename(folder.path().join("disk"), folder.path().join("away")).unwrap();
        std::fs::write(folder.path().join("disk"), b"").unwrap();
        let settings = SettingsFile::open(Some(&state));
        assert!(!settings.set("target", 2));
        let _ = settings.save();
        std::fs::remove_file(folder.path().join("disk")).unwrap();
        std::fs::rename(folder.path().join("away"), folder.path().join("disk")).unwrap();
        let _ = settings.save();
        let again = SettingsFile::open(Some(&state));
        assert_eq!(again.get("target"), Some(2), "the newer value");
        assert_eq!(again.get("threshold/front"), Some(5), "not set meanwhile");
    }
}
