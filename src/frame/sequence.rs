//! Sequence numbers of one camera: what is new, lost, late or there twice.

/// What a sequence number means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// A new frame.
    New {
        /// Its place in the stream, lost frames counted: grows with every new frame, also across a
        /// restart of the camera. `step` of a policy is the difference to the frame processed before.
        index: u64,
        /// Numbers missing between the frame before and this one.
        lost: u64,
        /// The camera began to number anew (or it is the first frame).
        restarted: bool,
    },
    /// The number came before.
    Duplicate,
    /// A later number came before. It had been counted as lost when `counted_lost`.
    Late {
        /// Whether the number was part of an earlier `lost`.
        counted_lost: bool,
    },
}

/// Follows the sequence numbers of one camera.
#[derive(Clone, Debug, Default)]
pub struct SequenceTracker {}

impl SequenceTracker {
    /// A tracker that has seen nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes the next number in the order of arrival, usable frame or not.
    pub fn arrive(&mut self, sequence: u64, clip: Option<&str>) -> Arrival {
        let _ = clip;
        Arrival::New {
            index: sequence,
            lost: 0,
            restarted: false,
        }
    }
}
