//! Projects a clip's energy and time on a board from the numbers of its frames.
//!
//! Where no meter can be read, a model replaces it. It has joules and milliseconds for each frame on which the
//! detector runs, each predicted frame, and each call of the empty-scene screen, as fitted on published per-clip
//! results. All its figures are marked `projected`.

use crate::error::EvalError;
use crate::files::read_text;
use crate::result::{ClipResult, Energy, FrameTime, Provenance, Spread};
use albireo_core::policy::FrameState;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The costs of the kinds of work on a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Costs {
    /// A frame on which the detector runs, without the screen.
    pub detector: f64,
    /// A frame answered by prediction (state P).
    pub predicted: f64,
    /// A call of the empty-scene screen (states E and E+I).
    pub screen: f64,
    /// A look at a small grey picture: decoding it and following the boxes into it (policies `…+flow`).
    #[serde(default, skip_serializing_if = "is_zero")]
    pub look: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Costs {
    /// The total cost of this work.
    fn total(&self, work: Work) -> f64 {
        self.detector * work.detector
            + self.predicted * work.predicted
            + self.screen * work.screen
            + self.look * work.looks
    }
}

/// How often each kind of work was done.
#[derive(Clone, Copy)]
struct Work {
    detector: f64,
    predicted: f64,
    screen: f64,
    looks: f64,
}

impl Work {
    /// The work on one frame.
    fn on_frame(state: FrameState, examined: bool) -> Self {
        let once_if = |is_done: bool| f64::from(u8::from(is_done));
        Self {
            detector: once_if(!state.is_skipped()),
            predicted: once_if(state == FrameState::P),
            screen: once_if(matches!(state, FrameState::E | FrameState::EI)),
            looks: once_if(examined),
        }
    }
}

/// The error of a fitted model on clips that were left out of the fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitError {
    /// The number of parts into which the clips were split; each was left out once.
    pub folds: usize,
    /// Mean absolute error of a clip's energy, percent.
    pub energy_percent: f64,
    /// Mean absolute error of a clip's mean frame time, percent.
    pub frame_time_percent: f64,
    /// Mean over the left-out clips of the energy saved against Vanilla as measured, percent.
    pub saving_measured_percent: f64,
    /// The same as projected, percent.
    pub saving_projected_percent: f64,
}

/// The energy model of a board with a detector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnergyModel {
    /// The board.
    pub board: String,
    /// The detector that it ran.
    pub detector: String,
    /// The source of the figures, and the conditions they are valid for.
    pub source: String,
    /// The costs in joules.
    pub energy_j: Costs,
    /// The costs in milliseconds.
    pub time_ms: Costs,
    /// Power between frames, watts. With it, clips whose frame rate is known are projected at the camera's
    /// rate; without it, frames follow each other back to back, as in the published runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub idle_power_w: Option<f64>,
    /// The error of the fit, if the model was fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out: Option<FitError>,
}

impl EnergyModel {
    /// Reads a model.
    ///
    /// # Errors
    /// [`EvalError`] for a missing file, an unknown key, or a negative cost.
    pub fn load(path: &Path) -> Result<Self, EvalError> {
        let text = read_text(path, "--energy-model names a file of config/energy")?;
        Self::read(&text).map_err(|what| EvalError::content(path, what))
    }

    fn read(text: &str) -> Result<Self, String> {
        let model: Self = toml::from_str(text).map_err(|error| error.to_string())?;
        let named = |table: &str, costs: Costs| {
            [
                (format!("{table}.detector"), costs.detector),
                (format!("{table}.predicted"), costs.predicted),
                (format!("{table}.screen"), costs.screen),
                (format!("{table}.look"), costs.look),
            ]
        };
        let idle = ("idle_power_w".to_owned(), model.idle_power_w.unwrap_or(0.0));
        let numbers = named("energy_j", model.energy_j)
            .into_iter()
            .chain(named("time_ms", model.time_ms))
            .chain([idle]);
        for (name, value) in numbers {
            if !(value.is_finite() && value >= 0.0) {
                return Err(format!(
                    "`{name}` is {value}; it must be a number, 0 or more"
                ));
            }
        }
        Ok(model)
    }

    /// Fills in the energy and frame time of `result`.
    pub(crate) fn apply(&self, result: &mut ClipResult) {
        if result.frames == 0 {
            return;
        }
        let work = Work {
            detector: result.detector_frames as f64,
            predicted: result.states.p as f64,
            screen: result.screen_frames as f64,
            looks: result.looked_frames as f64,
        };
        let busy_s = self.time_ms.total(work) / 1e3;
        // A frame without an entry was not examined.
        let examined = result.examined.iter().copied().chain(std::iter::repeat(false));
        let times = result
            .states_by_frame
            .iter()
            .zip(examined)
            .map(|(&state, examined)| self.time_ms.total(Work::on_frame(state, examined)))
            .collect();
        result.frame_time = Spread::of(times).map(|milliseconds| FrameTime {
            milliseconds,
            provenance: Provenance::Projected,
        });
        let mut joules = self.energy_j.total(work);
        let mut duration_s = busy_s;
        if let (Some(idle), Some(rate)) = (self.idle_power_w, result.frame_rate) {
            duration_s = busy_s.max(result.frames as f64 / rate);
            joules += idle * (duration_s - busy_s);
        }
        result.energy = Some(Energy::new(joules, duration_s, result.frames));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::tests::of_states;

    const MODEL: &str = "
        board = 'board'
        detector = 'detector'
        source = 'made up'
        energy_j = { detector = 4.0, predicted = 0.5, screen = 1.0, look = 0.1 }
        time_ms = { detector = 50.0, predicted = 5.0, screen = 10.0, look = 2.0 }";

    fn model() -> EnergyModel {
        EnergyModel::read(MODEL).unwrap()
    }

    fn result(states: &[FrameState]) -> ClipResult {
        let mut result = of_states("clip", "policy", states);
        result.states_by_frame = states.to_vec();
        for &state in states {
            result.detector_frames += usize::from(!state.is_skipped());
            result.screen_frames += usize::from(matches!(state, FrameState::E | FrameState::EI));
        }
        result
    }

    fn projected(model: &EnergyModel, mut result: ClipResult) -> (Energy, FrameTime) {
        model.apply(&mut result);
        (result.energy.unwrap(), result.frame_time.unwrap())
    }

    #[test]
    fn a_projection_sums_the_frames_and_is_marked_as_such() {
        // One frame in each of the five states: the detector runs on three, the screen on two.
        let (energy, time) = projected(&model(), result(&FrameState::ALL));
        assert!((energy.joules - (3.0 * 4.0 + 0.5 + 2.0 * 1.0)).abs() < 1e-12);
        assert!((energy.duration_s - 0.175).abs() < 1e-12);
        assert!((energy.edp - 14.5 * 175.0 / 5.0).abs() < 1e-9);
        assert!((time.milliseconds.mean - 35.0).abs() < 1e-12);
        assert_eq!(time.provenance, Provenance::Projected);
    }

    #[test]
    fn a_look_at_a_picture_costs_as_in_the_model() {
        let blind = result(&[FrameState::I, FrameState::P]);
        let looking = ClipResult {
            looked_frames: 2,
            examined: vec![true, true],
            ..blind.clone()
        };
        let (energy, time) = projected(&model(), blind);
        let (energy_looking, time_looking) = projected(&model(), looking);
        assert!((energy_looking.joules - energy.joules - 2.0 * 0.1).abs() < 1e-12);
        let more_ms = time_looking.milliseconds.mean - time.milliseconds.mean;
        assert!((more_ms - 2.0).abs() < 1e-12);
    }

    #[test]
    fn at_the_cameras_pace_the_time_between_frames_costs_idle_power() {
        let mut model = model();
        model.idle_power_w = Some(20.0);
        let mut result = result(&[FrameState::I, FrameState::P]);
        result.frame_rate = Some(10.0);
        let (energy, _) = projected(&model, result);
        assert!((energy.duration_s - 0.2).abs() < 1e-12);
        assert!((energy.joules - (4.5 + 20.0 * 0.145)).abs() < 1e-12);
    }

    #[test]
    fn a_cost_below_zero_is_rejected_by_name() {
        let error = EnergyModel::read(&MODEL.replace("screen = 1.0", "screen = -1.0")).unwrap_err();
        assert!(error.contains("`energy_j.screen` is -1"), "{error}");
    }
}
