//! Finds the ONNX Runtime library and keeps the only environment of the process.

use super::{StartError, StartErrorKind};
use ort::environment::Environment;
use ort::logging::LogLevel;
use parking_lot::Mutex;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tracing::{debug, error, info, warn};

/// The environment variable that names the library, as in the `ort` crate.
const VARIABLE: &str = "ORT_DYLIB_PATH";

static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);

/// Returns the environment of this process, made from the library that `configured` names, or else from the first one
/// found. The first call decides which library the process uses.
///
/// # Errors
/// If there is no library, or it cannot be used.
pub(super) fn environment(configured: Option<&Path>) -> Result<Environment, StartError> {
    let mut kept = ENVIRONMENT.lock();
    if let Some(environment) = kept.as_ref() {
        return Ok(environment.clone());
    }
    let path = Search::here(configured).find()?;
    let unusable = |reason: &dyn Display| {
        StartError::new(
            StartErrorKind::Library,
            format_args!(
                "the ONNX Runtime library {} cannot be used: {reason}; version 1.22 or newer is needed",
                path.display()
            ),
        )
    };
    let environment = ort::init_from(&path)
        .map_err(|error| unusable(&error))?
        .with_name("albireo")
        .with_telemetry(false)
        .with_logger(Arc::new(log))
        .build()
        .map_err(|error| unusable(&error))?;
    environment.set_log_level(LogLevel::Warning);
    info!(library = %path.display(), "ONNX Runtime loaded");
    *kept = Some(environment.clone());
    Ok(environment)
}

/// Returns the path of the library that [`environment`] would load.
///
/// # Errors
/// If there is none; the error lists the places searched.
pub fn find_library(configured: Option<&Path>) -> Result<PathBuf, StartError> {
    Search::here(configured).find()
}

/// Logs ONNX Runtime's own warnings and errors; its other messages would flood the log.
fn log(level: LogLevel, category: &str, _id: &str, location: &str, message: &str) {
    match level {
        LogLevel::Verbose | LogLevel::Info => {}
        LogLevel::Warning => warn!(target: "onnxruntime", category, location, "{message}"),
        // The run was asked to end (`Interrupter`), and did.
        LogLevel::Error if message.contains("due to terminate flag") => {
            debug!(target: "onnxruntime", category, location, "{message}");
        }
        LogLevel::Error | LogLevel::Fatal => {
            error!(target: "onnxruntime", category, location, "{message}");
        }
    }
}

/// The places to search.
struct Search {
    /// What names a file or folder explicitly, and that file or folder. Then nothing else is searched.
    named: Option<(&'static str, PathBuf)>,
    folders: Vec<PathBuf>,
}

impl Search {
    fn here(configured: Option<&Path>) -> Self {
        let by_variable = std::env::var_os(VARIABLE).unwrap_or_default();
        let named = match configured {
            Some(path) => Some(("detector.onnxruntime", path.to_owned())),
            None if by_variable.is_empty() => None,
            None => Some((VARIABLE, PathBuf::from(by_variable))),
        };
        let mut folders = Vec::new();
        if let Ok(program) = std::env::current_exe()
            && let Some(beside) = program.parent()
        {
            folders.push(beside.to_owned());
        }
        folders.push(PathBuf::from(".cache/onnxruntime"));
        let for_loader = std::env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
        let of_loader = std::env::split_paths(&for_loader);
        folders.extend(of_loader.filter(|folder| !folder.as_os_str().is_empty()));
        let of_architecture = format!("/usr/lib/{}-linux-gnu", std::env::consts::ARCH);
        let usual = [
            "/usr/local/lib",
            &of_architecture,
            "/usr/lib64",
            "/usr/lib",
            "/opt/onnxruntime/lib",
        ];
        folders.extend(usual.map(PathBuf::from));
        Self { named, folders }
    }

    fn find(&self) -> Result<PathBuf, StartError> {
        if let Some((what, path)) = &self.named {
            if path.is_file() {
                return Ok(path.clone());
            }
            let looked_at = format!("{} (named by {what})", path.display());
            return library_in(path).ok_or_else(|| not_found(&looked_at));
        }
        if let Some(library) = self.folders.iter().find_map(|folder| library_in(folder)) {
            return Ok(library);
        }
        let looked_at: Vec<String> =
            self.folders.iter().map(|folder| folder.display().to_string()).collect();
        Err(not_found(&looked_at.join(", ")))
    }
}

fn not_found(looked_at: &str) -> StartError {
    StartError::new(
        StartErrorKind::Library,
        format_args!(
            "no ONNX Runtime library was found; looked at {looked_at}. Run `make onnxruntime`, or name the library in \
             detector.onnxruntime or ORT_DYLIB_PATH"
        ),
    )
}

/// Returns the library in `folder`: the plain name, else the highest version. The path is absolute, because the loader
/// resolves relative paths in its own way.
fn library_in(folder: &Path) -> Option<PathBuf> {
    let mut found: Vec<(Vec<u32>, PathBuf)> = Vec::new();
    for entry in std::fs::read_dir(folder).ok()?.flatten() {
        let path = entry.path();
        let name = entry.file_name();
        if let Some(version) = name.to_str().and_then(library_version)
            && path.is_file()
        {
            found.push((version, path));
        }
    }
    found.sort();
    let (_, path) = found.pop()?;
    std::path::absolute(path).ok()
}

/// The version at the end of a library's name, `libonnxruntime.so.1.22.0`; the plain name is above all of them. `None` for
/// another file.
fn library_version(name: &str) -> Option<Vec<u32>> {
    let plain = format!(
        "{}onnxruntime{}",
        std::env::consts::DLL_PREFIX,
        std::env::consts::DLL_SUFFIX
    );
    let rest = name.strip_prefix(&plain)?;
    if rest.is_empty() {
        return Some(vec![u32::MAX]);
    }
    let mut version = Vec::new();
    for part in rest.strip_prefix('.')?.split('.') {
        version.push(part.parse().ok()?);
    }
    Some(version)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(named: Option<&Path>, folders: &[&Path]) -> Search {
        Search {
            named: named.map(|path| (VARIABLE, path.to_owned())),
            folders: folders.iter().map(|&folder| folder.to_owned()).collect(),
        }
    }

    fn put(folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, b"").unwrap();
        path
    }

    #[test]
    fn without_a_library_all_places_and_the_ways_out_are_named() {
        let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        let paths = folders.each_ref().map(|folder| folder.path());
        put(paths[0], "libonnxruntime_providers_shared.so");
        let error = search(None, &paths).find().unwrap_err().to_string();
        let places = paths.iter().map(|path| path.to_str().unwrap());
        for part in places.chain(["make onnxruntime", VARIABLE]) {
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn the_first_folder_with_a_library_wins() {
        let empty = tempfile::tempdir().unwrap();
        let first = tempfile::tempdir().unwrap();
        let second = tempfile::tempdir().unwrap();
        let folders = [empty.path(), first.path(), second.path()];
        let library = put(first.path(), "libonnxruntime.so.1.9.0");
        put(second.path(), "libonnxruntime.so");
        assert_eq!(search(None, &folders).find().unwrap(), library);
    }

    #[test]
    fn in_a_folder_the_plain_name_wins_or_else_the_highest_version() {
        let folder = tempfile::tempdir().unwrap();
        put(folder.path(), "libonnxruntime.so.1.9.0");
        let newest = put(folder.path(), "libonnxruntime.so.1.31.1");
        assert_eq!(search(None, &[folder.path()]).find().unwrap(), newest);
        let plain = put(folder.path(), "libonnxruntime.so");
        assert_eq!(search(None, &[folder.path()]).find().unwrap(), plain);
    }

    #[test]
    fn a_named_file_or_folder_is_used() {
        let named = tempfile::tempdir().unwrap();
        let library = put(named.path(), "libonnxruntime.so.1.31.1");
        assert_eq!(search(Some(named.path()), &[]).find().unwrap(), library);
        assert_eq!(search(Some(&library), &[]).find().unwrap(), library);
    }

    #[test]
    fn if_a_place_is_named_no_other_is_searched() {
        let named = tempfile::tempdir().unwrap();
        let other = tempfile::tempdir().unwrap();
        put(other.path(), "libonnxruntime.so");
        assert!(search(Some(named.path()), &[other.path()]).find().is_err());
        let error = search(Some(&named.path().join("gone.so")), &[other.path()])
            .find()
            .unwrap_err()
            .to_string();
        for part in ["gone.so", VARIABLE] {
            assert!(error.contains(part), "{error}");
        }
    }
}
