//! What the process itself uses, read from procfs, under the names that Prometheus' own client libraries give.

use std::fs;

/// One figure of the process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessFigure {
    /// Its name, without the `_total` of counters.
    pub name: &'static str,
    /// What it says.
    pub help: &'static str,
    /// Whether it only grows.
    pub counter: bool,
    /// Its value.
    pub value: f64,
}

/// What the process uses now. What cannot be read (another system than Linux, a procfs that is hidden) is left out.
pub fn figures() -> Vec<ProcessFigure> {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let system = fs::read_to_string("/proc/stat").unwrap_or_default();
    let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let descriptors = fs::read_dir("/proc/self/fd").ok().map(Iterator::count);
    read(
        &stat,
        &system,
        &limits,
        descriptors,
        rustix::param::clock_ticks_per_second() as f64,
        rustix::param::page_size() as f64,
    )
}

fn read(
    stat: &str,
    system: &str,
    limits: &str,
    descriptors: Option<usize>,
    ticks: f64,
    page: f64,
) -> Vec<ProcessFigure> {
    // The program's name is in brackets and may have blanks: count behind it. The first field is the third of
    // proc(5).
    let fields: Vec<&str> = stat
        .rsplit_once(')')
        .map(|(_, rest)| rest.split_whitespace().collect())
        .unwrap_or_default();
    let field = |number: usize| -> Option<f64> { fields.get(number.checked_sub(3)?)?.parse().ok() };
    let cpu = field(14)
        .zip(field(15))
        .map(|(user, sys)| (user + sys) / ticks);
    let booted = system
        .lines()
        .find_map(|line| line.strip_prefix("btime ")?.trim().parse::<f64>().ok());
    let started = booted
        .zip(field(22))
        .map(|(boot, after)| boot + after / ticks);
    let most = limits.lines().find_map(|line| {
        let soft = line
            .strip_prefix("Max open files")?
            .split_whitespace()
            .next()?;
        soft.parse::<f64>().ok()
    });
    [
        (
            "process_cpu_seconds",
            "Processor time the process has used",
            true,
            cpu,
        ),
        (
            "process_resident_memory_bytes",
            "Memory of the process that is in RAM",
            false,
            field(24).map(|pages| pages * page),
        ),
        (
            "process_threads",
            "Threads of the process",
            false,
            field(20),
        ),
        (
            "process_open_fds",
            "Files and sockets the process has open",
            false,
            descriptors.map(|open| open as f64),
        ),
        ("process_max_fds", "How many it may have open", false, most),
        (
            "process_start_time_seconds",
            "When the process started, seconds since the Unix epoch",
            false,
            started,
        ),
    ]
    .into_iter()
    .filter_map(|(name, help, counter, value)| {
        let value = value?;
        Some(ProcessFigure {
            name,
            help,
            counter,
            value,
        })
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_figures_are_those_of_proc() {
        let stat = "17 (a b) c) S 1 17 17 0 -1 4194304 100 0 0 0 250 50 0 0 20 0 12 0 6000 1000000 2048 184 1 1";
        let limits = "Limit Soft Hard Units\nMax open files            65536                524288       files\n";
        let figures = read(
            stat,
            "cpu 1\nbtime 1790000000\n",
            limits,
            Some(9),
            100.0,
            4096.0,
        );
        let values: Vec<_> = figures.iter().map(|one| (one.name, one.value)).collect();
        assert_eq!(
            values,
            [
                ("process_cpu_seconds", 3.0),
                ("process_resident_memory_bytes", 2048.0 * 4096.0),
                ("process_threads", 12.0),
                ("process_open_fds", 9.0),
                ("process_max_fds", 65536.0),
                ("process_start_time_seconds", 1_790_000_060.0),
            ]
        );
    }

    #[test]
    fn this_process_has_all_of_them() {
        let figures = figures();
        assert_eq!(figures.len(), 6, "{figures:?}");
        assert!(
            figures.iter().all(|figure| figure.value > 0.0),
            "{figures:?}"
        );
    }

    #[test]
    fn what_cannot_be_read_is_left_out() {
        assert_eq!(read("", "", "", None, 100.0, 4096.0), []);
        assert_eq!(
            read("1 (x) S 2", "btime", "Max open files", None, 100.0, 1.0),
            []
        );
    }
}
