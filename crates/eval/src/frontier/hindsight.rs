//! The best fixed N in hindsight: every clip gets the N that serves it best, known after the fact.
//!
//! An oracle, not a policy: it has seen the clip and its ground truth. What a policy gains over it is what it gains by
//! choosing *when* to call within a clip, beyond choosing how often to call in it.

use super::operating_point::{Candidate, ClipFigures, FrontierError, OperatingPoint};
use super::view::ViewedClip;

/// The intervals the oracle chooses from, in frames; they need not be whole.
pub(super) const INTERVALS: [f64; 12] =
    [1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0];

/// A clip's figures with every interval.
pub(super) struct Hindsight {
    name: String,
    /// By clip, then interval.
    clips: Vec<Vec<ClipFigures>>,
}

impl Hindsight {
    /// Runs every interval over every clip; `candidate` makes the policy with an interval. `name` is the oracle's.
    pub(super) fn new(
        name: &str,
        candidate: impl Fn(f64) -> Result<Candidate, FrontierError>,
        viewed: &[ViewedClip],
    ) -> Result<Self, FrontierError> {
        let mut clips = vec![Vec::with_capacity(INTERVALS.len()); viewed.len()];
        for interval in INTERVALS {
            for (clip, figures) in clips
                .iter_mut()
                .zip(candidate(interval)?.run(viewed)?.clips)
            {
                clip.push(figures);
            }
        }
        Ok(Self {
            name: name.to_owned(),
            clips,
        })
    }

    /// The choice whose mean skip rate is nearest to `skip_rate`. Every clip takes the interval with the largest
    /// `AP@50 + price · skip rate`, with one price for all of them: of all choices that skip as much, this one has the
    /// largest mean AP@50.
    pub(super) fn at_skip_rate(&self, skip_rate: f64) -> OperatingPoint {
        let (mut low, mut high) = (0.0, 10.0);
        let mut best = self.at_price(0.0);
        for _ in 0..40 {
            let price = (low + high) / 2.0;
            let point = self.at_price(price);
            if point.skip_rate < skip_rate {
                low = price;
            } else {
                high = price;
            }
            if (point.skip_rate - skip_rate).abs() < (best.skip_rate - skip_rate).abs() {
                best = point;
            }
        }
        best
    }

    fn at_price(&self, price: f64) -> OperatingPoint {
        let worth = |figures: &ClipFigures| figures.ap50 + price * figures.skip_rate;
        let chosen = self.clips.iter().filter_map(|intervals| {
            intervals
                .iter()
                .max_by(|a, b| worth(a).total_cmp(&worth(b)))
                .cloned()
        });
        OperatingPoint::of(self.name.clone(), None, chosen.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(skip_rate: f64, ap50: f64) -> ClipFigures {
        ClipFigures {
            clip: "a clip".to_owned(),
            skip_rate,
            ap50,
            ..ClipFigures::default()
        }
    }

    #[test]
    fn calls_go_to_the_clip_that_loses_most_without_them() {
        let still = vec![figures(0.0, 0.9), figures(0.5, 0.9), figures(0.8, 0.88)];
        let lively = vec![figures(0.0, 0.9), figures(0.5, 0.6), figures(0.8, 0.2)];
        let oracle = Hindsight {
            name: "oracle".to_owned(),
            clips: vec![still, lively],
        };
        let point = oracle.at_skip_rate(0.4);
        let skips: Vec<_> = point.clips.iter().map(|clip| clip.skip_rate).collect();
        assert_eq!(skips, [0.8, 0.0]);
        assert!((point.ap50 - 0.89).abs() < 1e-12);
        // Nothing is paid for a skip: what costs no accuracy is skipped all the same.
        assert!((oracle.at_skip_rate(0.0).skip_rate - 0.25).abs() < 1e-12);
        assert!((oracle.at_skip_rate(0.8).skip_rate - 0.8).abs() < 1e-12);
    }
}
