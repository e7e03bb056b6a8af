//! The resource usage of the process, under the names that Prometheus' own client libraries use.

use crate::metrics::MetricsPage;
use procfs::process::{LimitValue, Process};
use procfs::{ProcResult, boot_time_secs, page_size, ticks_per_second};

/// Adds the present resource usage of the process.
///
/// # Errors
/// If it cannot be read (hidden procfs); then nothing is added.
pub(crate) fn add(page: &mut MetricsPage) -> ProcResult<()> {
    let process = Process::myself()?;
    let stat = process.stat()?;
    let files = process.fd_count()?;
    let ticks = ticks_per_second() as f64;
    let boot_s = boot_time_secs()? as f64;
    let most_files = match process.limits()?.max_open_files.soft_limit {
        LimitValue::Value(most) => most as f64,
        LimitValue::Unlimited => f64::INFINITY,
    };
    page.counter(
        "process_cpu_seconds_total",
        "Processor time the process has used",
        (stat.utime + stat.stime) as f64 / ticks,
    );
    page.gauge(
        "process_resident_memory_bytes",
        "Memory of the process that is in RAM",
        (stat.rss * page_size()) as f64,
    );
    page.gauge(
        "process_threads",
        "Threads of the process",
        stat.num_threads as f64,
    );
    page.gauge(
        "process_open_fds",
        "Files and sockets the process has open",
        files as f64,
    );
    page.gauge(
        "process_max_fds",
        "Maximum number of files and sockets the process may have open",
        most_files,
    );
    page.gauge(
        "process_start_time_seconds",
        "Start time of the process, seconds since the Unix epoch",
        boot_s + stat.starttime as f64 / ticks,
    );
    Ok(())
}

/// Makes the system count the peak of the process's memory from now on; false if it cannot.
pub fn forget_peak_memory() -> bool {
    // proc_pid_clear_refs(5): 5 resets the peak.
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// The most memory of the process in RAM since [`forget_peak_memory`], or since its start; `None` if the system does not tell.
pub fn peak_memory_bytes() -> Option<u64> {
    let kibibytes = Process::myself().ok()?.status().ok()?.vmhwm?;
    Some(kibibytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures() -> Vec<f64> {
        let mut page = MetricsPage::default();
        add(&mut page).unwrap();
        let text = page.into_text();
        let samples = text.lines().filter(|line| !line.starts_with('#'));
        let value = |line: &str| line.split_once(' ').unwrap().1.parse::<f64>().unwrap();
        samples.map(value).collect()
    }

    #[test]
    fn all_six_figures_of_this_process_are_positive() {
        // Processor time has a resolution of 10 ms, so the first tick takes a while.
        let begun = std::time::Instant::now();
        while figures()[0] == 0.0 {
            assert!(begun.elapsed().as_secs() < 60, "no processor time");
        }
        let figures = figures();
        assert_eq!(figures.len(), 6, "{figures:?}");
        assert!(figures.iter().all(|value| *value > 0.0), "{figures:?}");
    }
}
