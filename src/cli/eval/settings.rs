//! The arguments of `albireo eval` that become the settings of a run.

use super::{JUDGED, WRITTEN};
use albireo_core::policy::Profile;
use albireo_eval::data::Rules;
use albireo_eval::judge::{Classes, Interpolation};
use albireo_eval::settings::{ScreenRule, Settings};
use anyhow::bail;
use clap::Args;
use clap::builder::{PossibleValuesParser, RangedU64ValueParser, TypedValueParser};
use std::path::PathBuf;

/// The most threads, as of a detector: with thousands they spend their time on each other.
const MOST_THREADS: u64 = 1024;

/// The settings of every comparison of policies.
#[derive(Clone, Debug, Args)]
pub(super) struct SettingsArguments {
    /// The definitions that apply where the published code and the paper's text differ.
    #[arg(long, default_value = "paper", value_parser = profile_parser())]
    pub profile: Profile,
    /// The source of the empty-scene screen's verdicts.
    #[arg(long, help_heading = JUDGED, value_enum, default_value_t = ScreenRule::Nonempty)]
    pub screen: ScreenRule,
    /// Frames in a row that the screen may call empty before the detector runs anyway; 0 for any number.
    #[arg(long, help_heading = JUDGED, value_name = "COUNT", default_value_t = 100)]
    pub longest_empty_run: u32,
    /// Detections below this confidence are not used.
    #[arg(long, help_heading = JUDGED, default_value_t = 0.5, allow_negative_numbers = true)]
    pub confidence: f64,
    /// Boxes below this confidence are not judged, as a node with this `report.confidence` does not publish them
    /// [default: --confidence for detected boxes, half of it for predicted ones].
    #[arg(long, help_heading = JUDGED)]
    pub report_confidence: Option<f64>,
    /// How boxes are judged where the ground truth marks crowds, distractors or ignored regions [default: benchmark;
    /// paper with --profile reference].
    #[arg(long, help_heading = JUDGED, value_enum)]
    pub rules: Option<Rules>,
    /// Judge every class by itself instead of all as one.
    #[arg(long, help_heading = JUDGED)]
    pub per_class: bool,
    /// Area under the precision-recall curve at COCO's 101 recall levels instead of all points.
    #[arg(long, help_heading = JUDGED)]
    pub coco_interpolation: bool,
    /// Write what each policy did, frame by frame, to DIR/POLICY/SEQUENCE.jsonl.gz.
    #[arg(long, help_heading = WRITTEN, value_name = "DIR")]
    pub traces: Option<PathBuf>,
    /// The number of threads, at most 1024; 0 for as many as the machine has.
    #[arg(long, default_value_t = 0, value_parser = RangedU64ValueParser::<usize>::new().range(0..=MOST_THREADS))]
    pub threads: usize,
}

/// Parses the name of a profile.
fn profile_parser() -> impl TypedValueParser<Value = Profile> {
    PossibleValuesParser::new(["reference", "paper"]).map(|name| match name.as_str() {
        "reference" => Profile::Reference,
        _ => Profile::Paper,
    })
}

impl SettingsArguments {
    /// The rules by which boxes on marked places are judged.
    ///
    /// # Errors
    /// When those of the benchmark are asked for with the published code's definitions, which have none.
    pub(super) fn rules(&self) -> anyhow::Result<Rules> {
        match (self.profile, self.rules) {
            (Profile::Reference, Some(Rules::Benchmark)) => {
                bail!(
                    "--profile reference judges as the paper's evaluator does: --rules benchmark needs --profile paper"
                )
            }
            (Profile::Reference, _) => Ok(Rules::Paper),
            (Profile::Paper, rules) => Ok(rules.unwrap_or_default()),
        }
    }

    /// The settings, without an energy model.
    pub(super) fn settings(&self) -> Settings {
        Settings {
            profile: self.profile,
            screen: self.screen,
            longest_empty_run: self.longest_empty_run,
            confidence: self.confidence,
            report_confidence: self.report_confidence,
            classes: if self.per_class {
                Classes::Separate
            } else {
                Classes::Pooled
            },
            interpolation: if self.coco_interpolation {
                Interpolation::Coco101
            } else {
                Interpolation::AllPoints
            },
            traces: self.traces.clone(),
            threads: self.threads,
            keep_worst: false,
            energy_model: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        settings: SettingsArguments,
    }

    fn parsed(arguments: &[&str]) -> Settings {
        Command::parse_from(arguments).settings.settings()
    }

    #[test]
    fn without_arguments_the_settings_are_the_defaults() {
        let none = parsed(&["eval"]);
        assert_eq!(format!("{none:?}"), format!("{:?}", Settings::default()));
    }

    #[test]
    fn per_class_judges_every_class_by_itself() {
        let set = parsed(&["eval", "--per-class"]);
        assert_eq!(set.classes, Classes::Separate);
    }

    #[test]
    fn more_threads_than_a_machine_can_use_are_refused_with_the_limit() {
        assert_eq!(parsed(&["eval", "--threads", "1024"]).threads, 1024);
        let refused = Command::try_parse_from(["eval", "--threads", "2000"]);
        let said = refused.err().unwrap().to_string();
        assert!(said.contains("0..=1024"), "{said}");
    }

    #[test]
    fn coco_interpolation_takes_cocos_recall_levels() {
        let set = parsed(&["eval", "--coco-interpolation"]);
        assert_eq!(set.interpolation, Interpolation::Coco101);
    }
}
