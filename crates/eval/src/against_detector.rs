//! A policy's boxes beside the detector's own, on every frame that it answered without the detector: what the audit of a
//! node estimates from a sample.

use crate::data::Clip;
use crate::error::EvalError;
use crate::replay::drive;
use crate::run::Settings;
use crate::source::StoredEvidence;
use albireo_core::audit::AuditSums;
use albireo_core::policy::Policy;

/// Takes `policy` from its initial state through all frames of `clip`, and compares what it shows on frames without the
/// detector with what the detector finds in them: one entry per frame, `None` on a frame of the detector, which is the
/// reference, and on a degraded one.
///
/// # Errors
/// [`EvalError`] when the clip does not have what the policy asks for.
pub fn against_detector(
    policy: &mut dyn Policy,
    clip: &Clip,
    settings: &Settings,
) -> Result<Vec<Option<Box<AuditSums>>>, EvalError> {
    let mut source = StoredEvidence::new(clip, settings)?;
    let mut detected = source.all_detections().to_vec().into_iter();
    let mut compared = Vec::with_capacity(source.frames());
    drive(policy, &mut source, &mut |_, played| {
        let outcome = played.outcome;
        let skipped = outcome.state.is_skipped() && !outcome.degraded;
        let found = detected.next().unwrap_or_default();
        compared.push(skipped.then(|| {
            let mut sums = Box::<AuditSums>::default();
            sums.add(&outcome.boxes, &found);
            sums
        }));
    })?;
    Ok(compared)
}
