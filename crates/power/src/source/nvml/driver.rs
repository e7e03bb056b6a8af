//! The cards as NVIDIA's driver shows them.

use super::Cards;
use albireo_wire::BoardState;
use nvml_wrapper::Nvml;
use nvml_wrapper::bitmasks::device::ThrottleReasons;
use nvml_wrapper::enum_wrappers::device::{Clock, TemperatureSensor};
use nvml_wrapper::error::NvmlError;
use std::path::Path;

/// Loads the driver's library.
pub(super) fn load(library: &Path) -> Result<Nvml, String> {
    let loaded = Nvml::builder().lib_path(library.as_os_str()).init();
    loaded.map_err(|error| match error {
        NvmlError::LibloadingError(_) => {
            format!("no NVIDIA driver: {} cannot be loaded", library.display())
        }
        error => format!("NVML does not start: {error}"),
    })
}

/// Returns the card's answer, or `None` if it has none: a driver too old for a query lacks its symbol.
fn ask<T>(
    nvml: &Nvml,
    card: u32,
    question: impl FnOnce(&nvml_wrapper::Device<'_>) -> Result<T, NvmlError>,
) -> Result<Option<T>, String> {
    let device = nvml.device_by_index(card);
    match device.and_then(|device| question(&device)) {
        Ok(answer) => Ok(Some(answer)),
        Err(NvmlError::NotSupported | NvmlError::FailedToLoadSymbol(_)) => Ok(None),
        Err(error) => Err(error.to_string()),
    }
}

impl Cards for Nvml {
    fn count(&self) -> Result<u32, String> {
        self.device_count().map_err(|error| error.to_string())
    }

    fn name(&self, card: u32) -> Option<String> {
        ask(self, card, |device| device.name()).ok()?
    }

    fn energy_mj(&self, card: u32) -> Result<Option<u64>, String> {
        ask(self, card, |device| device.total_energy_consumption())
    }

    fn power_mw(&self, card: u32) -> Result<Option<u32>, String> {
        ask(self, card, |device| device.power_usage())
    }

    fn condition(&self, card: u32) -> BoardState {
        let held_back = ThrottleReasons::SW_POWER_CAP
            | ThrottleReasons::HW_SLOWDOWN
            | ThrottleReasons::SW_THERMAL_SLOWDOWN
            | ThrottleReasons::HW_THERMAL_SLOWDOWN
            | ThrottleReasons::HW_POWER_BRAKE_SLOWDOWN;
        let celsius = ask(self, card, |device| {
            device.temperature(TemperatureSensor::Gpu)
        });
        let reasons = ask(self, card, |device| device.current_throttle_reasons());
        let clock = ask(self, card, |device| device.clock_info(Clock::SM));
        let used = ask(self, card, |device| device.utilization_rates());
        let celsius = celsius.unwrap_or_default().map(f64::from);
        BoardState {
            hottest_celsius: celsius,
            hottest_sensor: celsius.map(|_| "gpu".to_owned()),
            throttled: reasons.unwrap_or_default().map(|r| r.intersects(held_back)),
            gpu_mhz: clock.unwrap_or_default().map(f64::from),
            gpu_utilisation: used.unwrap_or_default().map(|used| f64::from(used.gpu) / 100.0),
            ..BoardState::default()
        }
    }
}
