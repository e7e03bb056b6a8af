//! Promises of the whole program, one file each.

mod power_sysfs;
mod power_tegrastats;
mod power_telemetry;
