//! Where TensorRT keeps the engines of one model: a folder that is named for everything an engine is built from.
//!
//! ONNX Runtime names an engine's file for the names in the graph and the versions of the libraries and the GPU, not for
//! the weights (`TRTGenerateId` in `core/providers/tensorrt`): a model that was trained again would get the old engine. Its
//! own prefix for the names would replace the versions, so each model gets a folder instead.

use super::{SessionSettings, StartError, external_files};
use sha2::{Digest, Sha256};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use tracing::{info, warn};

/// Engines of this many models are kept, those used last.
const KEPT: usize = 4;
/// Written at each use of a folder: the model that it belongs to.
const MODEL: &str = "model.txt";
/// The seconds that the last build took, beside the folders.
const LAST_BUILD: &str = "last-build-seconds";

/// The engines of one model.
#[derive(Clone, Debug)]
pub(crate) struct EngineCache {
    root: PathBuf,
    folder: PathBuf,
    is_built: bool,
}

impl EngineCache {
    /// Finds or creates the folder for the engines of `model`, the bytes of the file in `settings`, with their precision and
    /// shapes, and removes those of models that were not used lately. `None` if the settings name no folder.
    ///
    /// # Errors
    /// If the model's weights cannot be read or the folder not be created.
    pub(crate) fn open(
        settings: &SessionSettings,
        model: &[u8],
    ) -> Result<Option<Self>, StartError> {
        let Some(root) = &settings.gpu.engine_cache else {
            return Ok(None);
        };
        let folder_name = key(settings, model)
            .map_err(|error| StartError::unreadable(&settings.model, &error).because(error))?;
        let folder = root.join(folder_name);
        let unwritable = |error: std::io::Error| {
            let reason = format!("{} cannot be written: {error}", folder.display());
            StartError::configuration("detector.gpu.engine_cache", reason)
        };
        std::fs::create_dir_all(&folder).map_err(unwritable)?;
        let model_name = settings.model.display().to_string();
        std::fs::write(folder.join(MODEL), model_name).map_err(unwritable)?;
        forget_all_but_the_last(root, &folder);
        Ok(Some(Self {
            is_built: has_engine(&folder),
            root: root.clone(),
            folder,
        }))
    }

    /// The folder for engines.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The folder of the folders of all models.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// True if an engine was there when the cache was opened.
    pub(crate) fn is_built(&self) -> bool {
        self.is_built
    }

    /// How long the last build of an engine took on this machine, of this model or of another.
    pub(crate) fn last_build(&self) -> Option<Duration> {
        last_build(&self.root)
    }

    /// Keeps how long a build took.
    pub(crate) fn built_in(&self, took: Duration) {
        let written = std::fs::write(self.root.join(LAST_BUILD), took.as_secs().to_string());
        if let Err(error) = written {
            warn!(%error, "how long the engine took to build could not be kept");
        }
    }
}

/// How long the last build took of an engine under `root`.
pub(crate) fn last_build(root: &Path) -> Option<Duration> {
    let text = std::fs::read_to_string(root.join(LAST_BUILD)).ok()?;
    let seconds = text.trim().parse().ok()?;
    Some(Duration::from_secs(seconds))
}

fn has_engine(folder: &Path) -> bool {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return false;
    };
    entries
        .flatten()
        .any(|entry| entry.path().extension().is_some_and(|it| it == "engine"))
}

/// Removes the folders of engines that were not used lately, but not `used`.
fn forget_all_but_the_last(root: &Path, used: &Path) {
    let Ok(entries) = std::fs::read_dir(root) else {
        return;
    };
    let mut others: Vec<(SystemTime, PathBuf)> = Vec::new();
    for entry in entries.flatten() {
        let folder = entry.path();
        if folder != used
            && let Some(used_at) = last_use(&folder)
        {
            others.push((used_at, folder));
        }
    }
    others.sort();
    let too_many = (others.len() + 1).saturating_sub(KEPT);
    for (_, folder) in &others[..too_many] {
        match std::fs::remove_dir_all(folder) {
            Ok(()) => {
                info!(folder = %folder.display(), "removed engines of a model not used lately")
            }
            Err(error) => {
                warn!(folder = %folder.display(), %error, "old engines could not be removed")
            }
        }
    }
}

/// When the engines in `folder` were last used; `None` of a folder without the file [`MODEL`], which is not ours.
fn last_use(folder: &Path) -> Option<SystemTime> {
    let of_model = folder.join(MODEL).metadata().ok()?;
    of_model.modified().ok()
}

/// What an engine is built from, as hexadecimal digits: the bytes of the model and of the files that it keeps its weights
/// in, the shapes, and the precision. The versions of the libraries and the kind of GPU are in ONNX Runtime's file names.
fn key(settings: &SessionSettings, model: &[u8]) -> std::io::Result<String> {
    let mut digest = Sha256::new();
    let mut add = |part: &[u8]| {
        digest.update((part.len() as u64).to_le_bytes());
        digest.update(part);
    };
    add(model);
    let beside = settings.model.parent().unwrap_or(Path::new(""));
    for name in external_files(model) {
        add(name.as_bytes());
        add(&std::fs::read(beside.join(&name))?);
    }
    let fp16 = settings.gpu.fp16;
    add(format!("fp16 {fp16}, {:?}", settings.shapes).as_bytes());
    let mut text = String::new();
    for byte in digest.finalize() {
        // Writing to a string does not fail.
        let _ = write!(text, "{byte:02x}");
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::DetectorConfig;
    use crate::onnx::ShapeRange;
    use std::collections::BTreeSet;

    fn fixture(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../tests/fixtures/models")
            .join(name)
    }

    fn settings(model: PathBuf) -> SessionSettings {
        let config = DetectorConfig {
            model,
            ..DetectorConfig::default()
        };
        config.session_settings()
    }

    /// Settings of a model in `folder` whose engines are kept there, too.
    fn settings_with_cache(folder: &Path) -> SessionSettings {
        let mut settings = settings(folder.join("model.onnx"));
        settings.gpu.engine_cache = Some(folder.join("engines"));
        settings
    }

    /// The key of the model that is in its file now.
    fn key_now(settings: &SessionSettings) -> std::io::Result<String> {
        key(settings, &std::fs::read(&settings.model)?)
    }

    /// The cache of a model of these bytes, which are written to its file.
    fn cache_of(settings: &SessionSettings, weights: &str) -> EngineCache {
        std::fs::write(&settings.model, weights).unwrap();
        cache_now(settings)
    }

    /// The cache of the model that is in its file now.
    fn cache_now(settings: &SessionSettings) -> EngineCache {
        let model = std::fs::read(&settings.model).unwrap();
        EngineCache::open(settings, &model).unwrap().unwrap()
    }

    #[track_caller]
    fn assert_all_differ(keys: &[String]) {
        let distinct: BTreeSet<_> = keys.iter().collect();
        assert_eq!(distinct.len(), keys.len(), "{keys:?}");
    }

    /// Writes a model to `model` whose weights are in a file beside it, and returns the path of that file, which is not
    /// there yet.
    fn write_model_with_weights_beside(model: &Path) -> PathBuf {
        let mut bytes = std::fs::read(fixture("outside.onnx")).unwrap();
        let names = Vec::from_iter(external_files(&bytes));
        let [old_name] = names.as_slice() else {
            panic!("the fixture names one file, not {names:?}");
        };
        // The fixture's name leads out of its folder. This one is as long, so that the lengths in the file stay right.
        let new_name = "w".repeat(old_name.len());
        let start = bytes.windows(old_name.len()).position(|it| it == old_name.as_bytes()).unwrap();
        bytes[start..start + old_name.len()].copy_from_slice(new_name.as_bytes());
        std::fs::write(model, bytes).unwrap();
        model.with_file_name(new_name)
    }

    #[test]
    fn a_model_keeps_its_engine_when_it_is_renamed() {
        let folder = tempfile::tempdir().unwrap();
        let old_name = folder.path().join("model.onnx");
        let new_name = folder.path().join("renamed.onnx");
        std::fs::write(&old_name, "weights").unwrap();
        std::fs::write(&new_name, "weights").unwrap();
        let old_key = key_now(&settings(old_name)).unwrap();
        assert_eq!(key_now(&settings(new_name)).unwrap(), old_key);
    }

    #[test]
    fn an_engine_belongs_to_weights_precision_and_shapes() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.onnx");
        std::fs::write(&model, "first").unwrap();
        let first = settings(model.clone());
        let mut keys = vec![key_now(&first).unwrap()];
        // Trained again, under the old name.
        std::fs::write(&model, "again").unwrap();
        keys.push(key_now(&first).unwrap());
        let mut half = first.clone();
        half.gpu.fp16 = true;
        keys.push(key_now(&half).unwrap());
        for batch in [4, 8] {
            let of_batch = |batch| format!("images:{batch}x3x32x64");
            let shapes = ShapeRange {
                least: of_batch(1),
                usual: of_batch(batch),
                most: of_batch(batch),
            };
            let batched = SessionSettings {
                shapes: Some(shapes),
                ..first.clone()
            };
            keys.push(key_now(&batched).unwrap());
        }
        assert_all_differ(&keys);
    }

    #[test]
    fn weights_beside_a_model_belong_to_its_engine() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.onnx");
        let weights = write_model_with_weights_beside(&model);
        let settings = settings(model);
        let mut keys = Vec::new();
        for values in ["first", "again"] {
            std::fs::write(&weights, values).unwrap();
            keys.push(key_now(&settings).unwrap());
        }
        assert_all_differ(&keys);
    }

    #[test]
    fn a_model_without_its_weights_has_no_key_so_that_no_engine_is_taken_for_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.onnx");
        write_model_with_weights_beside(&model);
        assert!(key_now(&settings(model)).is_err());
    }

    #[test]
    fn the_time_of_the_last_build_is_that_of_any_model() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings_with_cache(folder.path());
        let one = cache_of(&settings, "one");
        let other = cache_of(&settings, "other");
        assert_eq!(one.last_build(), None);
        one.built_in(Duration::from_secs(570));
        assert_eq!(other.last_build(), Some(Duration::from_secs(570)));
    }

    #[test]
    fn a_cache_is_built_if_it_is_opened_with_an_engine() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings_with_cache(folder.path());
        let cache = cache_of(&settings, "weights");
        assert!(!cache.is_built());
        std::fs::write(cache.folder().join("part_sm87.engine"), "").unwrap();
        assert!(cache_now(&settings).is_built());
    }

    #[test]
    fn engines_of_the_models_used_last_are_kept_in_the_configured_folder() {
        let folder = tempfile::tempdir().unwrap();
        let settings = settings_with_cache(folder.path());
        let mut caches = Vec::new();
        for number in 0..6_u64 {
            let cache = cache_of(&settings, &number.to_string());
            assert!(cache.folder().starts_with(folder.path().join("engines")));
            let used = SystemTime::UNIX_EPOCH + Duration::from_secs(number);
            std::fs::File::options()
                .append(true)
                .open(cache.folder().join(MODEL))
                .unwrap()
                .set_modified(used)
                .unwrap();
            caches.push(cache);
        }
        let kept: Vec<_> = caches.iter().map(|cache| cache.folder().exists()).collect();
        assert_eq!(kept, [false, false, true, true, true, true]);
    }
}
