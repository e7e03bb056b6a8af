//! Describes everything that can change a run, so that a file of runs is gone on with only under the same settings.

use super::BoardArguments;
use crate::cli::play::played_of;
use albireo_core::policy::{PolicyConfig, known_policies};
use albireo_eval::board::{FRAMES, JUDGED_BY, Setup};
use albireo_eval::data::Rules;
use albireo_node::config::NodeConfig;
use albireo_service::config::without_secrets;
use albireo_vision::detector::{ClassNames, ExecutionProvider};
use albireo_vision::onnx::{external_files, find_library};
use anyhow::Context;
use clap::ValueEnum;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Keys of the node that change no run: what is written where, and the policy, which each run names.
const WITHOUT_EFFECT: [&str; 4] = [
    "log.",
    "policy.name",
    "detector.gpu.engine_cache",
    "detector.onnxruntime",
];

/// Describes what all runs have in common: everything that the node's configuration and the arguments say, except for
/// what is known to have no effect. So a setting that is added later is part of it, too.
///
/// # Errors
/// When a file that the configuration names cannot be read.
pub(super) fn describe(arguments: &BoardArguments, config: &NodeConfig) -> anyhow::Result<Setup> {
    // Every argument is named here, so that a new one must be decided on.
    let BoardArguments {
        clips: _,
        policy: _,
        sweep: _,
        ground_truth: _,
        truth_format,
        rules,
        paced,
        rate,
        warm_up,
        cool_down,
        config: _,
        detector: _,
        precision,
        power_mode,
        machine,
        out: _,
        restart: _,
    } = arguments;
    let mut settings = settings_of(config)?;
    let given_format = truth_format.and_then(|format| format.to_possible_value());
    let format_name = match given_format {
        Some(format) => format.get_name().to_owned(),
        None => "demo".to_owned(),
    };
    let judged_by = match rules {
        Rules::Benchmark => format_name,
        Rules::Paper => format!("{format_name}, --rules paper"),
    };
    let frames = if *paced { "paced" } else { "unpaced" };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut add = |key: &str, value: String| settings.insert(key.to_owned(), value);
    add("albireo", env!("CARGO_PKG_VERSION").to_owned());
    add("cores", cores.to_string());
    add(FRAMES, frames.to_owned());
    add(JUDGED_BY, judged_by);
    add("--warm-up", warm_up.to_string());
    add("--cool-down", cool_down.to_string());
    // Also of frames that are not paced: the warm-up counts the clip's seconds.
    if let Some(rate) = rate {
        add("--rate", rate.to_string());
    }
    let stem = config.detector.model.file_stem().unwrap_or_default();
    let host = || std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let mode = || albireo_power::board_state(&config.power).power_mode;
    // Half precision is a setting of TensorRT alone; elsewhere the model runs as it was exported.
    let first = config.detector.providers.first();
    let is_half = config.detector.gpu.fp16 && first == Some(&ExecutionProvider::TensorRt);
    let as_run = if is_half { "fp16" } else { "as exported" };
    Ok(Setup {
        detector: stem.to_string_lossy().into_owned(),
        precision: precision.clone().unwrap_or_else(|| as_run.to_owned()),
        power_mode: power_mode.clone().or_else(mode).unwrap_or_default(),
        machine: machine.clone().unwrap_or_else(|| host().trim().to_owned()),
        settings,
    })
}

/// The settings of a run's node, by key; files by their digests, wherever they lie.
fn settings_of(config: &NodeConfig) -> anyhow::Result<BTreeMap<String, String>> {
    let mut played = played_of(config);
    played.policy = without_thresholds(played.policy);
    // A pause is part of a policy's label. As NaN it is left out, like the thresholds.
    played.screen.pause_s = f64::NAN;
    played.screen.after_s = f64::NAN;
    let mut settings = BTreeMap::new();
    flatten(String::new(), &without_secrets(&played), &mut settings);
    settings.retain(|key, _| !WITHOUT_EFFECT.iter().any(|start| key.starts_with(start)));
    let names = played.detector.class_names.as_ref().and_then(ClassNames::file);
    let names = names.map(Path::to_path_buf);
    let library = find_library(played.detector.onnxruntime.as_deref()).ok();
    let models = [
        ("detector.model", Some(played.detector.model)),
        ("screen.model", played.screen.model),
    ];
    for (key, file) in models {
        if let Some(file) = file {
            settings.insert(key.to_owned(), digest_of_model(&file)?);
        }
    }
    let others = [
        ("detector.class_names", names),
        ("detector.onnxruntime", library),
    ];
    for (key, file) in others {
        if let Some(file) = file {
            settings.insert(key.to_owned(), digest(&read(&file)?));
        }
    }
    Ok(settings)
}

/// The policies' settings without the thresholds, which are part of a policy's label. They become NaN, which JSON
/// writes as null, and [`flatten`] leaves null out.
fn without_thresholds(mut policy: PolicyConfig) -> PolicyConfig {
    for name in known_policies() {
        name.clone_into(&mut policy.name);
        // A policy without a threshold refuses the value, and has nothing to leave out.
        let _ = policy.set_argument("NaN");
    }
    policy
}

/// Adds the members of `value` that are not null to `settings`, by their keys as in the configuration.
fn flatten(key: String, value: &Value, settings: &mut BTreeMap<String, String>) {
    match value {
        Value::Object(members) => {
            for (name, value) in members {
                let separator = if key.is_empty() { "" } else { "." };
                flatten(format!("{key}{separator}{name}"), value, settings);
            }
        }
        Value::Null => {}
        Value::String(text) => {
            settings.insert(key, text.clone());
        }
        other => {
            settings.insert(key, other.to_string());
        }
    }
}

/// The digests of a model and of the files beside it that hold its weights.
fn digest_of_model(file: &Path) -> anyhow::Result<String> {
    let model = read(file)?;
    let mut digests = vec![digest(&model)];
    let folder = file.parent().unwrap_or(Path::new(""));
    for name in external_files(&model) {
        digests.push(digest(&read(&folder.join(name))?));
    }
    Ok(digests.join(" + "))
}

fn read(file: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(file).with_context(|| file.display().to_string())
}

/// CRC-32 and length.
fn digest(bytes: &[u8]) -> String {
    format!("{:08x}-{}", crc32fast::hash(bytes), bytes.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        board: BoardArguments,
    }

    fn config(text: &str) -> NodeConfig {
        toml::from_str(text).unwrap()
    }

    /// The keys of the settings that the configuration `text` and the `arguments` change.
    fn differing(text: &str, arguments: &[&str]) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in [("a.onnx", "a"), ("b.onnx", "b")] {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        let setup = |text: &str, arguments: &[&str]| {
            let mut config = config(text);
            // In place of the library, which is large.
            config.detector.onnxruntime = Some(folder.path().join("a.onnx"));
            let models = [
                Some(&mut config.detector.model),
                config.screen.model.as_mut(),
            ];
            for model in models.into_iter().flatten() {
                let is_other = model.ends_with("b.onnx");
                let name = if is_other { "b.onnx" } else { "a.onnx" };
                *model = folder.path().join(name);
            }
            let always = [
                "board",
                "clip",
                "--out",
                "out",
                "--machine",
                "m",
                "--power-mode",
                "",
            ];
            let command = Command::parse_from(always.iter().chain(arguments));
            describe(&command.board, &config).unwrap().settings
        };
        let before = setup("", &[]);
        let now = setup(text, arguments);
        let all = before.keys().chain(now.keys());
        let is_different = |key: &&String| before.get(*key) != now.get(*key);
        let mut keys: Vec<String> = all.filter(is_different).cloned().collect();
        keys.sort();
        keys.dedup();
        keys
    }

    #[test]
    fn a_setting_that_changes_runs_is_part_of_their_setup() {
        for (text, key) in [
            ("[detector]\nmodel = \"b.onnx\"", "detector.model"),
            ("[detector]\nconfidence = 0.6", "detector.confidence"),
            (
                "[detector]\nsuppression_overlap = 0.6",
                "detector.suppression_overlap",
            ),
            ("[detector]\nproviders = [\"cuda\"]", "detector.providers"),
            (
                "[detector]\nreport_classes = [\"car\"]",
                "detector.report_classes",
            ),
            ("[screen]\nmodel = \"b.onnx\"", "screen.model"),
            ("[screen]\nstill_s = 10.0", "screen.still_s"),
            ("[policy]\nprofile = \"reference\"", "policy.profile"),
            ("[report]\nconfidence = 0.3", "report.confidence"),
            ("[audit]\nshare = 0.0", "audit.share"),
            ("[power]\nsource = \"rapl\"", "power.source"),
            ("[power]\ninterval_ms = 500", "power.interval_ms"),
        ] {
            assert_eq!(differing(text, &[]), [key]);
        }
        for (arguments, key) in [
            (["--warm-up", "3"], "--warm-up"),
            (["--cool-down", "3"], "--cool-down"),
            (["--rules", "paper"], JUDGED_BY),
        ] {
            assert_eq!(differing("", &arguments), [key]);
        }
        assert_eq!(
            differing("", &["--paced", "--rate", "5"]),
            ["--rate", FRAMES]
        );
    }

    #[test]
    fn a_setting_that_changes_no_run_is_no_part_of_their_setup() {
        for text in [
            "[log]\nlevel = \"debug\"",
            "[node]\nname = \"car-7\"\nstate_dir = \"state\"",
            "[http]\nlisten = \"0.0.0.0:80\"\ntoken = \"0123456789abcdef\"",
            "[zenoh]\nconnect = [\"tcp/hub.example:7447\"]",
            "[clip]\nwindow_s = 10.0",
            "[record]\nfolder = \"recordings\"",
            "[detector.gpu]\nengine_cache = \"engines\"",
            "[[camera]]\nname = \"rear\"",
        ] {
            assert_eq!(differing(text, &[]), [""; 0], "{text}");
        }
        assert_eq!(differing("", &["--restart"]), [""; 0]);
    }

    #[test]
    fn what_the_label_of_a_run_says_is_no_part_of_their_setup() {
        for text in [
            "[policy]\nname = \"vanilla\"\nu = 5e-4\nlambda = 0.1",
            "[policy.fixed_skip]\nn = 3",
            "[screen]\npause_s = 0.2\nafter_s = 2.0",
        ] {
            assert_eq!(differing(text, &[]), [""; 0], "{text}");
        }
        assert_eq!(differing("", &["--sweep", "u=1e-3"]), [""; 0]);
    }
}
