//! The load of a GPU, where sysfs tells it: Jetson boards (0 to 1000) and AMD cards (percent).

use super::config::PowerConfig;
use super::sysfs;
use std::path::PathBuf;

const SOURCE: &str = "estimate";

/// Where Jetson boards tell their GPU's load, by kernel.
const JETSON: [&str; 3] = [
    "devices/platform/gpu.0/load",
    "devices/gpu.0/load",
    "devices/platform/bus@0/17000000.gpu/load",
];

/// A file with a GPU's load.
#[derive(Debug)]
pub(super) struct GpuLoad {
    file: PathBuf,
    full: f64,
}

impl GpuLoad {
    /// Looks for one that can be read.
    pub(super) fn find(config: &PowerConfig) -> Option<Self> {
        let jetson = JETSON.iter().map(|file| Self {
            file: config.sysfs.join(file),
            full: 1000.0,
        });
        let amd = sysfs::entries(&config.sysfs.join("class/drm"))
            .into_iter()
            .map(|card| Self {
                file: card.join("device/gpu_busy_percent"),
                full: 100.0,
            });
        jetson.chain(amd).find(|load| load.read().is_some())
    }

    /// Load now, 0 to 1.
    pub(super) fn read(&self) -> Option<f64> {
        let load: f64 = sysfs::number(SOURCE, &self.file).ok()?;
        Some((load / self.full).clamp(0.0, 1.0))
    }
}
