//! Energy from samples: trapezoids over power, differences of counters, exactly clipped to a span.
//!
//! Times are seconds on any common scale. Two rules hold for both kinds of samples:
//!
//! - A gap between two samples longer than `longest_gap` is not bridged: its time is not covered and adds
//!   no energy. A counter, though, counts on while nobody looks: a gap of its samples that lies wholly
//!   inside the span is exact, and covered.
//! - Where the span reaches beyond the first or the last sample known by at most `longest_gap`, the power
//!   at that edge is taken to hold. It is so when a clip has just ended and the next sample is not in yet.

/// What came out of an integration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Integral {
    /// Energy over the covered part of the span, joules.
    pub joules: f64,
    /// Length of the covered part, seconds.
    pub covered_s: f64,
}

/// Integrates power samples `(seconds, watts)`, in order of time, over `[start, end]`.
pub fn power(
    samples: impl IntoIterator<Item = (f64, f64)>,
    start: f64,
    end: f64,
    longest_gap: f64,
) -> Integral {
    let mut sum = Sum::new(start, end);
    let mut before: Option<(f64, f64)> = None;
    for (at, watts) in samples {
        match before {
            None => {
                if at - start <= longest_gap {
                    sum.constant(start, at, watts);
                }
            }
            Some((then, previous)) if at - then <= longest_gap && at > then => {
                let (from, to) = (then.max(start), at.min(end));
                if to > from {
                    let slope = (watts - previous) / (at - then);
                    let middle = previous + slope * (0.5 * (from + to) - then);
                    sum.constant(from, to, middle);
                }
            }
            Some(_) => {}
        }
        before = Some((at, watts));
    }
    if let Some((last, watts)) = before
        && end - last <= longest_gap
    {
        sum.constant(last, end, watts);
    }
    sum.integral
}

/// Integrates counter samples `(seconds, joules counted so far)`, in order of time, over `[start, end]`.
/// Between two samples the counter is taken to rise evenly.
pub fn counter(
    samples: impl IntoIterator<Item = (f64, f64)>,
    start: f64,
    end: f64,
    longest_gap: f64,
) -> Integral {
    let mut sum = Sum::new(start, end);
    let mut first_edge: Option<f64> = None;
    let mut before: Option<(f64, f64)> = None;
    let mut last_rate: Option<f64> = None;
    for (at, joules) in samples {
        match before {
            None => first_edge = Some(at),
            Some((then, counted)) if at > then => {
                let whole = then >= start && at <= end;
                if whole || at - then <= longest_gap {
                    let rate = (joules - counted) / (at - then);
                    sum.constant(then, at, rate);
                    if let Some(first) = first_edge.take()
                        && first - start <= longest_gap
                    {
                        sum.constant(start, first, rate);
                    }
                    last_rate = Some(rate);
                } else {
                    last_rate = None;
                    first_edge = None;
                }
            }
            Some(_) => {}
        }
        before = Some((at, joules));
    }
    if let (Some((last, _)), Some(rate)) = (before, last_rate)
        && end - last <= longest_gap
    {
        sum.constant(last, end, rate);
    }
    sum.integral
}

/// Adds up rectangles clipped to a span.
struct Sum {
    start: f64,
    end: f64,
    integral: Integral,
}

impl Sum {
    fn new(start: f64, end: f64) -> Self {
        Self {
            start,
            end,
            integral: Integral::default(),
        }
    }

    fn constant(&mut self, from: f64, to: f64, watts: f64) {
        let (from, to) = (from.max(self.start), to.min(self.end));
        if to > from {
            self.integral.joules += watts * (to - from);
            self.integral.covered_s += to - from;
        }
    }
}
