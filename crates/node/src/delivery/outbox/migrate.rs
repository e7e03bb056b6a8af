//! Takes over what earlier versions kept in files of their own, once.

use super::state::{Shared, State};
use super::store::Store;
use super::to_json;
use albireo_wire::ClipReport;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// `thresholds.json`: into the settings `threshold/{camera}`, and then it is gone.
pub(super) fn thresholds(store: &mut Store, directory: &Path) {
    #[derive(Deserialize)]
    struct Thresholds {
        cameras: BTreeMap<String, serde_json::Value>,
    }
    let file = directory.join("thresholds.json");
    let Ok(bytes) = fs::read(&file) else { return };
    let taken_over = match serde_json::from_slice::<Thresholds>(&bytes) {
        Ok(thresholds) => thresholds
            .cameras
            .into_iter()
            .try_for_each(|(camera, kept)| {
                let name = format!("threshold/{camera}");
                match store.setting(&name) {
                    Ok(None) => store.set(&name, &kept.to_string()),
                    Ok(Some(_)) => Ok(()),
                    Err(error) => Err(error),
                }
            }),
        Err(error) => {
            let aside = file.with_extension("json.damaged");
            tracing::warn!(
                file = %file.display(), %error, aside = %aside.display(),
                "kept thresholds cannot be read and were set aside; the configured ones are used"
            );
            let _ = fs::rename(&file, aside);
            return;
        }
    };
    match taken_over {
        Ok(()) => {
            let _ = fs::remove_file(&file);
            let _ = fs::remove_file(file.with_extension("json.new"));
        }
        Err(error) => {
            tracing::warn!(%error, "kept thresholds not taken over; tried again at the next start")
        }
    }
}

/// `clip-reports/{camera}/*.json`: into the outbox, oldest first, and then they are gone.
pub(super) fn spool(shared: &Shared, state: &mut State, directory: &Path) {
    let folder = directory.join("clip-reports");
    let mut files: Vec<PathBuf> = entries(&folder).iter().flat_map(|f| entries(f)).collect();
    files.sort_by_key(|file| file.file_name().map(ToOwned::to_owned));
    for file in files {
        if file.extension().is_some_and(|ending| ending == "part") {
            let _ = fs::remove_file(&file);
            continue;
        }
        let Ok(bytes) = fs::read(&file) else { continue };
        let Ok(report) = serde_json::from_slice::<ClipReport>(&bytes) else {
            tracing::warn!(file = %file.display(), "not a clip report: left where it is");
            continue;
        };
        state.current.last += 1;
        let number = state.current.last;
        let row = (
            number,
            to_json(&ClipReport {
                report: number,
                ..report
            }),
        );
        shared.store_rows(state, vec![row]);
        if state.failing.is_some() {
            return;
        }
        let _ = fs::remove_file(&file);
    }
    for camera in entries(&folder) {
        let _ = fs::remove_dir(camera);
    }
    let _ = fs::remove_dir(folder);
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    fs::read_dir(folder).map_or_else(
        |_| Vec::new(),
        |entries| entries.flatten().map(|entry| entry.path()).collect(),
    )
}
