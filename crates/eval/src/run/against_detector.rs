//! Compares a policy's boxes with the detector's on every frame that skipped the detector; a node's audit estimates the
//! same from a sample.

use crate::data::Clip;
use crate::error::EvalError;
use crate::replay::StoredEvidence;
use crate::replay::drive;
use crate::settings::Settings;
use albireo_core::audit::AuditSums;
use albireo_core::policy::Policy;

/// Replays `clip` through `policy` from its initial state, and compares its boxes with the detector's on the frames
/// that skipped the detector. Returns one entry per frame; `None` if the detector ran or the frame was degraded.
///
/// # Errors
/// [`EvalError`] when the clip does not have what the policy needs.
pub fn against_detector(
    policy: &mut dyn Policy,
    clip: &Clip,
    settings: &Settings,
) -> Result<Vec<Option<Box<AuditSums>>>, EvalError> {
    let mut source = StoredEvidence::new(clip, settings)?;
    let mut detected = source.all_detections().to_vec().into_iter();
    let mut compared = Vec::with_capacity(source.frames());
    drive(policy, &mut source, &mut |_, decided| {
        let outcome = decided.outcome;
        let skipped = outcome.state.is_skipped() && !outcome.degraded;
        let found = detected.next().unwrap_or_default();
        if skipped {
            let mut sums = Box::<AuditSums>::default();
            sums.add(&outcome.boxes, &found);
            compared.push(Some(sums));
        } else {
            compared.push(None);
        }
    })?;
    Ok(compared)
}
