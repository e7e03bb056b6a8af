//! The cards as NVIDIA's driver shows them.

use super::{Cards, Condition};
use nvml_wrapper::Nvml;
use nvml_wrapper::bitmasks::device::ThrottleReasons;
use nvml_wrapper::enum_wrappers::device::{Clock, TemperatureSensor};
use nvml_wrapper::error::NvmlError;
use std::ffi::OsStr;

/// Possible names of the library: machines without development files lack the link without a version.
pub(super) const LIBRARIES: [&str; 2] = ["libnvidia-ml.so.1", "libnvidia-ml.so"];

pub(super) struct Driver {
    nvml: Nvml,
}

impl Driver {
    /// Loads the first of `libraries` that can be loaded.
    pub(super) fn load(libraries: &[&str]) -> Result<Self, String> {
        let mut why = String::new();
        for library in libraries {
            match Nvml::builder().lib_path(OsStr::new(library)).init() {
                Ok(nvml) => return Ok(Self { nvml }),
                Err(NvmlError::LibloadingError(_)) => {
                    "no NVIDIA driver: libnvidia-ml.so.1 cannot be loaded".clone_into(&mut why);
                }
                Err(error) => return Err(format!("NVML does not start: {error}")),
            }
        }
        Err(why)
    }

    /// Returns the answer, or `None` if the card has none: a driver too old for a query lacks its symbol.
    fn ask<T>(
        &self,
        card: u32,
        question: impl FnOnce(&nvml_wrapper::Device<'_>) -> Result<T, NvmlError>,
    ) -> Result<Option<T>, String> {
        let device = self.nvml.device_by_index(card);
        match device.and_then(|device| question(&device)) {
            Ok(answer) => Ok(Some(answer)),
            Err(NvmlError::NotSupported | NvmlError::FailedToLoadSymbol(_)) => Ok(None),
            Err(error) => Err(error.to_string()),
        }
    }
}

impl Cards for Driver {
    fn count(&self) -> Result<u32, String> {
        self.nvml.device_count().map_err(|error| error.to_string())
    }

    fn name(&self, card: u32) -> Option<String> {
        self.ask(card, |device| device.name()).ok()?
    }

    fn energy_mj(&self, card: u32) -> Result<Option<u64>, String> {
        self.ask(card, |device| device.total_energy_consumption())
    }

    fn power_mw(&self, card: u32) -> Result<Option<u32>, String> {
        self.ask(card, |device| device.power_usage())
    }

    fn condition(&self, card: u32) -> Condition {
        let held_back = ThrottleReasons::SW_POWER_CAP
            | ThrottleReasons::HW_SLOWDOWN
            | ThrottleReasons::SW_THERMAL_SLOWDOWN
            | ThrottleReasons::HW_THERMAL_SLOWDOWN
            | ThrottleReasons::HW_POWER_BRAKE_SLOWDOWN;
        let celsius = self.ask(card, |device| device.temperature(TemperatureSensor::Gpu));
        let reasons = self.ask(card, |device| device.current_throttle_reasons());
        let clock = self.ask(card, |device| device.clock_info(Clock::SM));
        Condition {
            hottest: (celsius.unwrap_or_default()).map(|c| ("gpu".into(), f64::from(c))),
            throttled: (reasons.unwrap_or_default()).map(|r| r.intersects(held_back)),
            gpu_mhz: clock.unwrap_or_default().map(f64::from),
            ..Condition::default()
        }
    }
}
