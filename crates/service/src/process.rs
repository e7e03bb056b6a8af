//! The resource usage of the process, under the names that Prometheus' own client libraries use.

use procfs::process::{LimitValue, Process};
use procfs::{ProcResult, boot_time_secs, page_size, ticks_per_second};

/// Name, help and value of one figure. A name that ends in `_total` denotes a counter.
pub(crate) type ProcessFigure = (&'static str, &'static str, f64);

/// The present resource usage of the process; empty if it cannot be read (hidden procfs).
pub(crate) fn figures() -> Vec<ProcessFigure> {
    read().unwrap_or_default()
}

fn read() -> ProcResult<Vec<ProcessFigure>> {
    let process = Process::myself()?;
    let stat = process.stat()?;
    let ticks = ticks_per_second() as f64;
    let most = match process.limits()?.max_open_files.soft_limit {
        LimitValue::Value(most) => most as f64,
        LimitValue::Unlimited => f64::INFINITY,
    };
    Ok(vec![
        (
            "process_cpu_seconds_total",
            "Processor time the process has used",
            (stat.utime + stat.stime) as f64 / ticks,
        ),
        (
            "process_resident_memory_bytes",
            "Memory of the process that is in RAM",
            (stat.rss * page_size()) as f64,
        ),
        (
            "process_threads",
            "Threads of the process",
            stat.num_threads as f64,
        ),
        (
            "process_open_fds",
            "Files and sockets the process has open",
            process.fd_count()? as f64,
        ),
        (
            "process_max_fds",
            "Maximum number of files and sockets the process may have open",
            most,
        ),
        (
            "process_start_time_seconds",
            "Start time of the process, seconds since the Unix epoch",
            boot_time_secs()? as f64 + stat.starttime as f64 / ticks,
        ),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_six_figures_of_this_process_are_positive() {
        // Processor time has a resolution of 10 ms, so the first tick takes a while.
        let begun = std::time::Instant::now();
        while figures().first().is_some_and(|(.., cpu)| *cpu == 0.0) {
            assert!(begun.elapsed().as_secs() < 60, "no processor time");
        }
        let figures = figures();
        assert_eq!(figures.len(), 6, "{figures:?}");
        let are_positive = figures.iter().all(|(.., value)| *value > 0.0);
        assert!(are_positive, "{figures:?}");
    }
}
