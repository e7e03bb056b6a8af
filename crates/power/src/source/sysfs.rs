//! Reads the small text files of sysfs and procfs, with errors that name the file and the remedy.

use crate::error::MeterError;
use std::io;
use std::path::{Path, PathBuf};

/// Reads the file as text, without surrounding white space.
pub(crate) fn text(path: &Path) -> Result<String, MeterError> {
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(text.trim().to_owned()),
        Err(error) => Err(failure(path, &error)),
    }
}

/// Reads the file as a number.
pub(crate) fn number<T: std::str::FromStr>(path: &Path) -> Result<T, MeterError> {
    let text = text(path)?;
    text.parse().map_err(|_| {
        let shown: String = text.chars().take(40).collect();
        MeterError::unreadable(path, format!("`{shown}` is not a number"))
    })
}

/// The entries of a directory, sorted by name; empty if it cannot be listed.
pub(crate) fn entries(directory: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = std::fs::read_dir(directory)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .collect();
    found.sort();
    found
}

/// The last component of a path as text.
pub(crate) fn name(path: &Path) -> &str {
    path.file_name().and_then(|n| n.to_str()).unwrap_or_default()
}

/// Converts an I/O error on `path` to a meter error.
pub(crate) fn failure(path: &Path, error: &io::Error) -> MeterError {
    match error.kind() {
        io::ErrorKind::PermissionDenied => {
            let remedy = format!(
                "let this user read it with `sudo chmod a+r {0}` (until the next boot; for every boot put \
                 `z {0} 0444` into /etc/tmpfiles.d/albireo.conf), or run as a user with permission",
                path.display()
            );
            MeterError::forbidden(path, remedy)
        }
        io::ErrorKind::NotFound => MeterError::missing(format!("there is no {}", path.display())),
        _ => MeterError::unreadable(path, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::assert_contains;

    #[test]
    fn an_unusable_file_is_named_with_its_text_or_the_remedy() {
        let path = Path::new("/sys/class/powercap/intel-rapl:0/energy_uj");
        let error = failure(path, &io::ErrorKind::PermissionDenied.into());
        let file = path.display();
        let denied = format!("may not read {file}");
        assert_contains(error, &[&denied, &format!("sudo chmod a+r {file}")]);

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("energy_uj");
        std::fs::write(&path, "many\n").unwrap();
        let error = number::<u64>(&path).unwrap_err();
        assert_contains(error, &["energy_uj: `many` is not a number"]);
    }
}
