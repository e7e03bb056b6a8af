//! Collects the times of the stages and summarises them.

use std::time::Duration;

/// A stage in the path of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    Decode,
    Letterbox,
    Model,
    Head,
    Policy,
    Message,
    Publish,
}

impl Stage {
    pub(crate) const ALL: [Self; 7] = [
        Self::Decode,
        Self::Letterbox,
        Self::Model,
        Self::Head,
        Self::Policy,
        Self::Message,
        Self::Publish,
    ];

    pub(crate) const fn title(self) -> &'static str {
        match self {
            Self::Decode => "JPEG decoding",
            Self::Letterbox => "letterbox",
            Self::Model => "model",
            Self::Head => "head and suppression",
            Self::Policy => "policy (matching)",
            Self::Message => "message (JSON)",
            Self::Publish => "publication (Zenoh put)",
        }
    }

    /// Returns `true` for all stages except the model and decoding, which is shown separately.
    const fn is_ours(self) -> bool {
        !matches!(self, Self::Decode | Self::Model)
    }
}

/// The milliseconds of every frame, one list per stage.
#[derive(Default)]
pub(crate) struct Samples {
    stages: [Vec<f64>; Stage::ALL.len()],
    ours: Vec<f64>,
    detections: usize,
}

impl Samples {
    /// Adds a frame with the times of its stages and its number of detected objects.
    pub(crate) fn add(&mut self, times: &[(Stage, Duration)], detections: usize) {
        let mut ours = 0.0;
        for &(stage, time) in times {
            let time = time.as_secs_f64() * 1e3;
            self.add_one(stage, time);
            if stage.is_ours() {
                ours += time;
            }
        }
        self.ours.push(ours);
        self.detections += detections;
    }

    /// Adds one time of a stage, in milliseconds.
    pub(crate) fn add_one(&mut self, stage: Stage, milliseconds: f64) {
        self.stages[stage as usize].push(milliseconds);
    }

    /// The median and 95th percentile of a stage; `None` if it was never measured.
    pub(crate) fn stage(&self, stage: Stage) -> Option<[f64; 2]> {
        summary(&self.stages[stage as usize])
    }

    /// The median and 95th percentile of the sum per frame of albireo's own stages.
    pub(crate) fn ours(&self) -> Option<[f64; 2]> {
        summary(&self.ours)
    }

    /// The mean number of detected objects per frame.
    pub(crate) fn detections(&self) -> f64 {
        self.detections as f64 / self.ours.len().max(1) as f64
    }
}

/// The median and 95th percentile by nearest rank.
fn summary(values: &[f64]) -> Option<[f64; 2]> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = |share: f64| {
        let rank = (share * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.saturating_sub(1)).copied()
    };
    Some([rank(0.5)?, rank(0.95)?])
}

/// The median; NaN if there are no values.
pub(crate) fn median(values: &[f64]) -> f64 {
    summary(values).map_or(f64::NAN, |[median, _]| median)
}
