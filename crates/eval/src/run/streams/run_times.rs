//! Reads the times of the detector's runs.

use std::path::Path;

/// The longest time of a run, milliseconds.
const MAX_MS: f64 = 60_000.0;

/// At least one time of a detector run; the times are used in turn.
#[derive(Clone, Debug, PartialEq)]
pub struct RunTimes {
    /// The times in seconds.
    seconds: Vec<f64>,
}

impl RunTimes {
    /// Reads `text`: milliseconds, or the path of a file with the milliseconds of one measured run on each line.
    ///
    /// # Errors
    /// A message with the fault and its line.
    pub fn read(text: &str) -> Result<Self, String> {
        if text.parse::<f64>().is_ok() {
            return Self::parse([text].into_iter());
        }
        let file = Path::new(text);
        let lines = std::fs::read_to_string(file).map_err(|error| {
            format!("this is neither a number of milliseconds nor a file that can be read: {error}")
        })?;
        Self::parse(lines.lines())
            .map_err(|reason| format!("a file has one run's milliseconds on each line: {reason}"))
    }

    fn parse<'a>(lines: impl Iterator<Item = &'a str>) -> Result<Self, String> {
        let mut seconds = Vec::new();
        for (index, line) in lines.enumerate() {
            let line = line.trim();
            if line.is_empty() {
                continue;
            }
            match line.parse::<f64>() {
                Ok(run) if run > 0.0 && run <= MAX_MS => seconds.push(run / 1e3),
                _ => {
                    return Err(format!(
                        "line {}: {line:?} is not above 0 and at most {MAX_MS}",
                        index + 1
                    ));
                }
            }
        }
        if seconds.is_empty() {
            return Err("it has no numbers".to_owned());
        }
        Ok(Self { seconds })
    }

    /// The time of run number `run`, seconds.
    pub(super) fn seconds_of(&self, run: usize) -> f64 {
        self.seconds[run % self.seconds.len()]
    }

    /// Describes the times for a title.
    pub(super) fn describe(&self) -> String {
        let mut sorted = self.seconds.clone();
        sorted.sort_by(f64::total_cmp);
        let ms = |index: usize| format!("{:.0}", 1e3 * sorted[index]);
        match sorted.len() {
            1 => format!("{} ms", ms(0)),
            count => format!(
                "{} to {} ms ({count} measured runs, median {})",
                ms(0),
                ms(count - 1),
                ms(count / 2)
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads the times of a file with this content.
    fn read_file(content: &str) -> Result<RunTimes, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), content).unwrap();
        RunTimes::read(file.path().to_str().unwrap())
    }

    #[test]
    fn a_number_is_the_time_of_every_run() {
        let always = RunTimes::read("113").unwrap();
        assert_eq!(always.seconds_of(0), 0.113);
        assert_eq!(always.seconds_of(7), 0.113);
        assert_eq!(always.describe(), "113 ms");
    }

    #[test]
    fn the_measured_runs_of_a_file_are_used_in_turn() {
        let measured = read_file("20\n100.5\n\n40\n").unwrap();
        let runs: Vec<_> = (0..4).map(|run| measured.seconds_of(run)).collect();
        assert_eq!(runs, [0.02, 0.1005, 0.04, 0.02]);
    }

    #[test]
    fn measured_runs_are_described_by_their_range_and_median() {
        let measured = read_file("20\n100.5\n\n40\n").unwrap();
        let described = "20 to 100 ms (3 measured runs, median 40)";
        assert_eq!(measured.describe(), described);
    }

    #[test]
    fn an_impossible_time_is_rejected() {
        for wrong in ["0", "-3", "60001", "nan", "inf"] {
            assert!(RunTimes::read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_line_that_is_no_time_is_named_with_its_number() {
        let reason = read_file("20\nfast\n").unwrap_err();
        assert!(reason.contains("line 2: \"fast\""), "{reason}");
    }

    #[test]
    fn a_file_without_numbers_is_rejected() {
        assert!(read_file("\n").is_err());
    }

    #[test]
    fn a_file_that_is_not_there_is_rejected() {
        assert!(RunTimes::read("no such file").is_err());
    }
}
