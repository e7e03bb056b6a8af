//! Thresholds that were changed while running, kept in a file so that they survive a restart.

use super::lock;
use albireo_core::policy::Knob;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

/// Version of the file.
const VERSION: u32 = 1;

/// One camera's kept threshold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Kept {
    /// Whose value: a value of `u` is no value of `lambda`.
    knob: String,
    /// The value.
    value: f64,
    /// What the configuration said when it was changed. Once that is edited, the configuration is the
    /// newer word and wins.
    configured: f64,
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Contents {
    v: u32,
    cameras: BTreeMap<String, Kept>,
}

/// The file `thresholds.json` of a state directory.
#[derive(Debug)]
pub(super) struct ThresholdStore {
    file: PathBuf,
    contents: Mutex<Contents>,
    good: AtomicBool,
}

impl ThresholdStore {
    /// Reads the file if there is one. A broken one is logged and overwritten with the next change.
    pub(crate) fn open(directory: &Path) -> Self {
        let file = directory.join("thresholds.json");
        let contents = match read(&file) {
            Ok(contents) => contents,
            Err(error) => {
                tracing::warn!(
                    file = %file.display(), error,
                    "kept thresholds cannot be read; the configured ones are used"
                );
                Contents::default()
            }
        };
        Self {
            file,
            contents: Mutex::new(contents),
            good: AtomicBool::new(true),
        }
    }

    /// The value kept for a camera, if it still fits its knob and its configuration.
    pub(crate) fn kept(&self, camera: &str, knob: &Knob, configured: f64) -> Option<f64> {
        let contents = lock(&self.contents);
        let kept = contents.cameras.get(camera)?;
        (kept.knob == knob.name && kept.configured == configured)
            .then(|| knob.check(kept.value).ok())
            .flatten()
    }

    /// Keeps a value; when it cannot be written, logs that and goes on.
    pub(crate) fn keep(&self, camera: &str, knob: &Knob, configured: f64, value: f64) {
        let mut contents = lock(&self.contents);
        contents.v = VERSION;
        contents.cameras.insert(
            camera.to_owned(),
            Kept {
                knob: knob.name.to_owned(),
                value,
                configured,
            },
        );
        let written = write(&self.file, &contents);
        self.good.store(written.is_ok(), Ordering::Relaxed);
        if let Err(error) = written {
            tracing::warn!(
                file = %self.file.display(), %error,
                "threshold changed but not kept: it will not survive a restart"
            );
        }
    }

    /// Whether the last write went well, or none was needed yet.
    pub(crate) fn is_good(&self) -> bool {
        self.good.load(Ordering::Relaxed)
    }
}

fn read(file: &Path) -> Result<Contents, String> {
    let bytes = match fs::read(file) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Contents::default()),
        Err(error) => return Err(error.to_string()),
    };
    let contents: Contents = serde_json::from_slice(&bytes).map_err(|error| error.to_string())?;
    if contents.v == VERSION {
        Ok(contents)
    } else {
        Err(format!("version {} is not known here", contents.v))
    }
}

/// Writes beside the file and renames, so that a crash leaves the old contents or the new, never half.
fn write(file: &Path, contents: &Contents) -> io::Result<()> {
    if let Some(directory) = file.parent() {
        fs::create_dir_all(directory)?;
    }
    let beside = file.with_extension("json.new");
    let mut out = fs::File::create(&beside)?;
    out.write_all(&serde_json::to_vec_pretty(contents)?)?;
    out.write_all(b"\n")?;
    out.sync_all()?;
    drop(out);
    fs::rename(&beside, file)
}
