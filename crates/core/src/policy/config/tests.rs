//! The configuration selects, validates and builds policies.

use super::*;
use crate::policy::SkippedBoxes;

fn config(text: &str) -> PolicyConfig {
    toml::from_str(text).unwrap()
}

fn error(text: &str) -> String {
    config(text).build().err().unwrap().to_string()
}

#[test]
fn the_default_is_albireo_with_the_papers_threshold() {
    let policy = config("").build().unwrap();
    assert_eq!(policy.name(), "albireo");
    assert_eq!(policy.threshold(), Some(3e-4));
}

#[test]
fn an_unknown_policy_is_rejected_with_the_known_names() {
    let message = error("name = 'mine'");
    assert!(message.contains("no policy `mine`"), "{message}");
    assert!(message.contains("`albireo`, `vanilla`"), "{message}");
    let message = error("name = 'albiro'");
    assert!(message.contains("did you mean `albireo`?"), "{message}");
}

#[test]
fn a_name_and_an_argument_select_a_policy_and_the_value_of_its_threshold() {
    let selected = |asked: &str| {
        let mut config = PolicyConfig::default();
        config.select(asked).unwrap();
        let policy = config.build().unwrap();
        (policy.name(), policy.threshold())
    };
    for name in known_policies() {
        let policy = config(&format!("name = '{name}'")).build().unwrap();
        let spec = policy.threshold_spec();
        assert_eq!(selected(name), (name, spec.map(|spec| spec.default)));
        if let Some(spec) = spec {
            // It fits into a message.
            assert!(spec.name.len() <= 24, "{name}: {}", spec.name);
            for value in [spec.minimum, spec.maximum] {
                let found = selected(&format!("{name}:{value:e}"));
                assert_eq!(found, (name, Some(value)));
            }
        }
    }
}

#[test]
fn an_invalid_selection_is_rejected_with_a_reason_and_changes_nothing() {
    for (asked, part) in [
        ("fixedskip:2", "`fixed-skip`"),
        ("", "there is no policy ``"),
        ("vanilla:2", "`vanilla:2`: this policy takes no argument"),
        ("erd-only:", "takes no argument"),
        ("ctd:", "`ctd:`: the argument must be a number"),
        (
            "fixed-skip:two",
            "`fixed-skip:two`: the argument must be a number",
        ),
    ] {
        let mut config = PolicyConfig::default();
        let message = config.select(asked).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
        assert_eq!(config, PolicyConfig::default(), "{asked}");
    }
    for (asked, message) in [
        ("fixed-skip:0", "policy.fixed_skip: `n` must be a number"),
        ("ctd:1", "policy.ctd: `threshold` must be a number"),
        ("ctd:nan", "policy.ctd: `threshold` must be a number"),
        (
            "statues:-1",
            "policy.statues: `component_size` must be a number",
        ),
        ("kill-only:7", "policy.u: `u` must be a number"),
    ] {
        let mut config = PolicyConfig::default();
        config.select(asked).unwrap();
        let found = config.build().err().unwrap().to_string();
        assert!(found.starts_with(message), "{found}");
    }
}

#[test]
fn unknown_keys_and_the_numbers_of_the_methods_are_rejected() {
    for table in [
        "[albireo]\nt_max = 7",
        "[expected_loss]\npixels = 'flow'",
        "[ctd]\nconfidence = 1",
        "[fixed_skip]\nskip = 1",
        "[statues]\nsize = 1",
    ] {
        let error = toml::from_str::<PolicyConfig>(table).unwrap_err();
        assert!(error.to_string().contains("unknown field"), "{error}");
    }
}

#[test]
fn the_baselines_have_their_own_tables() {
    let read = config(
        "name = 'ctd'\n[fixed_skip]\nn = 3\nskipped_boxes = 'predict'\n[ctd]\nthreshold = 0.7\n\
         longest_skip = 4\nlost_frames = 3\n[statues]\npixel_difference = 20",
    );
    assert_eq!(read.fixed_skip.n, 3.0);
    assert_eq!(read.fixed_skip.skipped_boxes, Some(SkippedBoxes::Predict));
    assert_eq!(read.ctd.longest_skip, 4);
    assert_eq!(read.statues.component_size, 75.0);
    assert_eq!(read.build().unwrap().threshold(), Some(0.7));
    let written = toml::to_string(&read).unwrap();
    assert_eq!(config(&written), read);
    let message = error("name = 'statues'\n[statues]\npixel_difference = 0");
    let expected = "policy.statues: `pixel_difference`";
    assert!(message.starts_with(expected), "{message}");
}
