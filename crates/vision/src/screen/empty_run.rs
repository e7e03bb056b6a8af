//! The longest run of empty frames before the detector looks whatever the screen says.

/// Counts empty verdicts in a row. The paper has no such limit; a screen that is wrong about a scene is
/// wrong about it for as long as the scene lasts.
#[derive(Clone, Copy, Debug)]
pub struct EmptyRun {
    /// Longest run; 0 for no limit.
    longest: u32,
    run: u32,
    forced: u64,
}

impl EmptyRun {
    /// At most `longest` empty frames in a row, 0 for any number.
    pub const fn new(longest: u32) -> Self {
        Self {
            longest,
            run: 0,
            forced: 0,
        }
    }

    /// What counts of the screen's verdict `empty`: "not empty" when the run would be too long.
    pub fn judge(&mut self, empty: bool) -> bool {
        if empty && self.longest != 0 && self.run >= self.longest {
            self.forced += 1;
            self.run = 0;
            return false;
        }
        self.run = if empty { self.run.saturating_add(1) } else { 0 };
        empty
    }

    /// The detector looked, for whatever reason: the run is over.
    pub fn looked(&mut self) {
        self.run = 0;
    }

    /// Frames on which the detector looked although the screen said "empty".
    pub const fn forced(&self) -> u64 {
        self.forced
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_detector_looks_after_the_longest_run_and_that_is_counted() {
        let mut run = EmptyRun::new(3);
        let judged: Vec<_> = (0..9).map(|_| run.judge(true)).collect();
        assert_eq!(
            judged,
            [true, true, true, false, true, true, true, false, true]
        );
        assert_eq!(run.forced(), 2);
    }

    #[test]
    fn a_verdict_of_not_empty_starts_the_run_anew_and_zero_is_no_limit() {
        let mut run = EmptyRun::new(2);
        for _ in 0..10 {
            assert!(run.judge(true));
            assert!(!run.judge(false));
        }
        let mut unlimited = EmptyRun::new(0);
        assert!((0..1000).all(|_| unlimited.judge(true)));
        assert_eq!(unlimited.forced(), 0);
    }
}
