//! Limits the number of empty verdicts in a row.

/// Counts a camera's consecutive empty verdicts; after the longest such run the detector runs regardless of the
/// screen. The paper has no such limit, but a screen that misjudges a scene does so for as long as the scene lasts.
#[derive(Clone, Copy, Debug)]
pub struct EmptyRun {
    /// The longest run; 0 for no limit.
    longest: u32,
    run: u32,
}

impl EmptyRun {
    /// Allows at most `longest` consecutive empty frames; 0 for no limit.
    pub const fn new(longest: u32) -> Self {
        Self { longest, run: 0 }
    }

    /// Counts the screen's verdict `empty` and limits it: returns false, and ends the run, if it would be too long.
    pub fn limit(&mut self, empty: bool) -> bool {
        let may_go_on = self.longest == 0 || self.run < self.longest;
        if empty && may_go_on {
            self.run = self.run.saturating_add(1);
            true
        } else {
            self.run = 0;
            false
        }
    }

    /// Ends the run, because the detector ran for any reason.
    pub fn detector_ran(&mut self) {
        self.run = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verdict_beyond_the_longest_run_is_overruled() {
        let mut run = EmptyRun::new(2);
        // "Not empty" ends a run, and so does an overruled verdict.
        let verdicts = [true, false, true, true, true, true, true, true];
        let limited = verdicts.map(|empty| run.limit(empty));
        assert_eq!(limited, [true, false, true, true, false, true, true, false]);
    }

    #[test]
    fn without_a_longest_run_no_verdict_is_overruled() {
        let mut unlimited = EmptyRun::new(0);
        for _ in 0..1000 {
            let empty = unlimited.limit(true);
            assert!(empty);
        }
    }

    #[test]
    fn a_run_of_the_detector_ends_the_run_of_empty_verdicts() {
        let mut run = EmptyRun::new(2);
        for _ in 0..10 {
            let empty = run.limit(true);
            assert!(empty);
            run.detector_ran();
        }
    }
}
