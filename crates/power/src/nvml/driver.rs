//! The cards as NVIDIA's driver shows them.

use super::{CardError, Cards, Condition};
use nvml_wrapper::Nvml;
use nvml_wrapper::bitmasks::device::ThrottleReasons;
use nvml_wrapper::enum_wrappers::device::{Clock, TemperatureSensor};
use nvml_wrapper::error::NvmlError;
use std::ffi::OsStr;

/// Names the library may have: machines that only run programs have no link without a version.
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

    fn ask<T>(
        &self,
        card: u32,
        question: impl FnOnce(&nvml_wrapper::Device<'_>) -> Result<T, NvmlError>,
    ) -> Result<T, CardError> {
        let device = self.nvml.device_by_index(card).map_err(failure)?;
        question(&device).map_err(failure)
    }
}

fn failure(error: NvmlError) -> CardError {
    match error {
        // A driver too old for a question lacks its symbol.
        NvmlError::NotSupported | NvmlError::FailedToLoadSymbol(_) => CardError::NotSupported,
        other => CardError::Failed(other.to_string()),
    }
}

impl Cards for Driver {
    fn count(&self) -> Result<u32, CardError> {
        self.nvml.device_count().map_err(failure)
    }

    fn name(&self, card: u32) -> Result<String, CardError> {
        self.ask(card, |device| device.name())
    }

    fn energy_mj(&self, card: u32) -> Result<u64, CardError> {
        self.ask(card, |device| device.total_energy_consumption())
    }

    fn power_mw(&self, card: u32) -> Result<u32, CardError> {
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
            hottest: celsius.ok().map(|c| ("gpu".into(), f64::from(c))),
            throttled: reasons.ok().map(|r| r.intersects(held_back)),
            gpu_mhz: clock.ok().map(f64::from),
            ..Condition::default()
        }
    }
}
