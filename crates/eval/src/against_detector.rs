//! A policy's boxes beside the detector's own, on every frame that it answered without the detector: what the audit of a
//! node estimates from a sample.

use crate::data::Clip;
use crate::replay::drive;
use crate::run::Settings;
use crate::source::{ClipEvidence, SourceError, StoredEvidence};
use albireo_core::audit::AuditSums;
use albireo_core::policy::Policy;

/// One frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparedFrame {
    /// Its index in the stream, which counts lost frames too: what the audit draws by.
    pub index: u64,
    /// The comparison; `None` on a frame of the detector, which is the reference, and on a degraded one.
    pub sums: Option<Box<AuditSums>>,
}

/// Takes `policy` from its initial state through all frames of `clip`, and compares what it shows on frames without the
/// detector with what the detector finds in them.
///
/// # Errors
/// [`SourceError`] when the clip does not have what the policy asks for.
pub fn against_detector(
    policy: &mut dyn Policy,
    clip: &Clip,
    settings: &Settings,
) -> Result<Vec<ComparedFrame>, SourceError> {
    let mut source = StoredEvidence::new(clip, settings)?;
    let detected = source.all_detections().to_vec();
    let mut compared = Vec::with_capacity(source.frames());
    drive(policy, &mut source, &mut |_, played| {
        let outcome = played.outcome;
        let skipped = outcome.state.is_skipped() && !outcome.degraded;
        compared.push(ComparedFrame {
            index: played.head.index,
            sums: skipped.then(|| {
                let mut sums = Box::<AuditSums>::default();
                let found = detected.get(played.frame).map_or(&[][..], Vec::as_slice);
                sums.add(&outcome.boxes, found);
                sums
            }),
        });
    })?;
    Ok(compared)
}
