use super::*;
use crate::policy::SkippedBoxes;

fn config(text: &str) -> PolicyConfig {
    toml::from_str(text).unwrap()
}

#[test]
fn an_invalid_selection_is_rejected_with_a_reason_and_changes_nothing() {
    let no_number = "`fixed-skip:two`: the argument must be a number";
    for (asked, part) in [
        ("mine", "there is no policy `mine`"),
        ("mine", "`albireo`, `vanilla`"),
        ("albiro", "did you mean `albireo`?"),
        ("fixedskip:2", "`fixed-skip`"),
        ("", "there is no policy ``"),
        ("vanilla:2", "`vanilla:2`: this policy takes no argument"),
        ("erd-only:", "takes no argument"),
        ("ctd:", "`ctd:`: the argument must be a number"),
        ("fixed-skip:two", no_number),
    ] {
        let mut config = PolicyConfig::default();
        let message = config.select(asked).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
        assert_eq!(config, PolicyConfig::default(), "{asked}");
    }
    let negative = "policy.statues: `component_size` must be a number";
    for (asked, message) in [
        ("fixed-skip:0", "policy.fixed_skip: `n` must be a number"),
        ("ctd:1", "policy.ctd: `threshold` must be a number"),
        ("ctd:nan", "policy.ctd: `threshold` must be a number"),
        ("statues:-1", negative),
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
    assert_eq!(config(&toml::to_string(&read).unwrap()), read);
    let wrong = config("name = 'statues'\n[statues]\npixel_difference = 0");
    let message = wrong.build().err().unwrap().to_string();
    let expected = "policy.statues: `pixel_difference`";
    assert!(message.starts_with(expected), "{message}");
}
