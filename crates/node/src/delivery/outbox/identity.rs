//! Who numbers the reports: the instance, and the machine it is bound to.

use albireo_service::clock::unix_nanoseconds;
use sha3::{Digest, Sha3_256};
use std::hash::{BuildHasher, RandomState};
use std::path::Path;

/// A new instance: 32 hexadecimal digits that no other has.
pub(super) fn new_instance() -> String {
    // Each state is keyed by the operating system's random numbers.
    let half = || RandomState::new().hash_one((unix_nanoseconds(), std::process::id()));
    format!("{:016x}{:016x}", half(), half())
}

/// A short digest of the machine's identity in `file`; `None` where there is none. The identity itself is never
/// sent: it is to be treated as confidential (machine-id(5)).
pub(super) fn machine_digest(file: &Path) -> Option<String> {
    let id = std::fs::read_to_string(file).ok()?;
    let id = id.trim();
    if id.is_empty() || id == "uninitialized" {
        return None;
    }
    let mut hash = Sha3_256::new();
    hash.update(b"albireo machine ");
    hash.update(id.as_bytes());
    let digest = hash.finalize();
    Some(digest.iter().take(8).map(|b| format!("{b:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instances_differ_and_machines_are_told_apart_without_being_named() {
        let instance = new_instance();
        assert_eq!(instance.len(), 32);
        assert_ne!(instance, new_instance());
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("machine-id");
        assert_eq!(machine_digest(&file), None);
        std::fs::write(&file, "0123456789abcdef\n").unwrap();
        let digest = machine_digest(&file).unwrap();
        assert_eq!(digest.len(), 16);
        assert!(!digest.contains("0123456789abcdef"));
        std::fs::write(&file, "another\n").unwrap();
        assert_ne!(machine_digest(&file).unwrap(), digest);
    }
}
