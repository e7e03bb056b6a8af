//! Reads and formats times and numbers for people.

use crate::cli::values::counted;
use albireo_core::policy::short;
use albireo_hub::tuning::effect::Interval;
use albireo_hub::tuning::outcome::Outcome;
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{DesiredSetting, Threshold};
use serde::Serialize;
use std::collections::BTreeMap;

/// Reads `90`, `90s`, `30m`, `2h`, `7d` as seconds.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let mut number = text;
    let mut unit = 1.0;
    for (letter, seconds) in [('s', 1.0), ('m', 60.0), ('h', 3_600.0), ('d', 86_400.0)] {
        if let Some(before) = text.strip_suffix(letter) {
            number = before;
            unit = seconds;
        }
    }
    match number.trim().parse::<f64>() {
        Ok(count) if count >= 0.0 && (count * unit).is_finite() => Ok(count * unit),
        _ => Err(format!("`{text}` is not a time such as 90s, 30m, 2h or 7d")),
    }
}

/// Reads a number that JSON can hold.
pub(super) fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("`{text}` is not a number")),
    }
}

/// Formats the age of a time, which is in milliseconds since the Unix epoch: `12 s`, `5 min`, `3 h`, `8 d`.
pub(super) fn ago(at_ms: i64) -> String {
    span((unix_milliseconds() - at_ms).max(0) / 1000)
}

/// Formats a time in milliseconds since the Unix epoch: `12 s ago`.
pub(super) fn when(at_ms: i64) -> String {
    format!("{} ago", ago(at_ms))
}

/// Formats the name of a value in messages as words: `cannot be met`.
pub(super) fn name_of(value: &impl Serialize) -> String {
    let name = serde_json::to_value(value).unwrap_or_default();
    name.as_str().unwrap_or("-").replace('_', " ")
}

/// Formats the number of nodes by outcome: `3 applied, 1 timed out`.
pub(super) fn counts(counts: &BTreeMap<Outcome, usize>) -> String {
    joined(counts.iter().map(|(outcome, n)| format!("{n} {}", name_of(outcome))))
}

/// Joins the texts of a list with commas.
pub(super) fn joined(texts: impl Iterator<Item = String>) -> String {
    texts.collect::<Vec<_>>().join(", ")
}

/// Formats a change with its interval: `+1.2% [-0.3%, +2.7%]`, or as numbers if it is not `relative`.
pub(super) fn interval(change: &Interval, relative: bool) -> String {
    let shown = |value: f64| {
        if relative {
            format!("{:+.1}%", value * 100.0)
        } else {
            format!("{value:+.4}")
        }
    };
    let lower = shown(change.lower);
    let upper = shown(change.upper);
    format!("{} [{lower}, {upper}]", shown(change.estimate))
}

/// Formats a number of nodes: `1 node`, `20 nodes`.
pub(super) fn nodes(count: u64) -> String {
    counted(count, "node", "nodes")
}

/// Formats a number of seconds in its largest unit.
pub(super) fn span(seconds: i64) -> String {
    match seconds {
        0..120 => format!("{seconds} s"),
        120..7_200 => format!("{} min", seconds / 60),
        7_200..172_800 => format!("{} h", seconds / 3_600),
        _ => format!("{} d", seconds / 86_400),
    }
}

/// Formats a figure with four significant digits, or all that stand before the point: `0.5512`, `123.4`, `98765`. Very
/// small and very large ones have three and an exponent: `4.12e-5`.
pub(super) fn figure(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".to_owned()
    } else if !(1e-3..1e7).contains(&size) {
        format!("{value:.2e}")
    } else {
        let digits = (3 - size.log10().floor() as i32).clamp(0, 6) as usize;
        format!("{value:.digits$}")
    }
}

/// Formats a threshold: `5e-4`, with its name unless it is `u`. Rounds it to six digits, because the values of a
/// controller have more than anybody reads.
pub(super) fn threshold(threshold: &Threshold) -> String {
    let rounded = format!("{:.5e}", threshold.value).parse();
    let number = short(rounded.unwrap_or(threshold.value));
    match threshold.name.as_str() {
        "u" => number,
        name => format!("{name} {number}"),
    }
}

/// Formats a node's ordered or current setting: a threshold as [`threshold`] does, `hold skip_rate 0.5` for a target.
pub(super) fn setting(setting: &DesiredSetting) -> String {
    match setting {
        DesiredSetting::Threshold(value) => threshold(value),
        DesiredSetting::Target(None) => "hold nothing".to_owned(),
        DesiredSetting::Target(Some(target)) => format!("hold {target}"),
    }
}

/// Reads a target as JSON for a hub: `skip_rate=0.5`, `{"skip_rate": 0.5}`, `{"target": {"skip_rate": 0.5}}`, or `off`,
/// which is null.
pub(super) fn target(text: &str) -> Result<serde_json::Value, String> {
    const FORMS: &str =
        "write NAME=VALUE with recall, skip_rate or watts, for instance skip_rate=0.5; or off";
    if text == "off" {
        return Ok(serde_json::Value::Null);
    }
    if text.starts_with('{') {
        let value: serde_json::Value =
            serde_json::from_str(text).map_err(|error| format!("{error}; {FORMS}"))?;
        return Ok(value.get("target").cloned().unwrap_or(value));
    }
    let (name, value) = text.split_once('=').ok_or(FORMS)?;
    let number = finite(value.trim()).map_err(|error| format!("{error}; {FORMS}"))?;
    Ok(serde_json::json!({ name.trim(): number }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_wire::Target;

    #[test]
    fn a_time_is_read_as_people_write_it() {
        for (text, expected) in [
            ("90", 90.0),
            ("90s", 90.0),
            ("30m", 1_800.0),
            ("1.5h", 5_400.0),
            ("7d", 604_800.0),
        ] {
            assert_eq!(seconds(text), Ok(expected), "{text}");
        }
    }

    #[test]
    fn what_is_no_time_is_refused() {
        for wrong in ["", "m", "-1s", "5 weeks", "nan", "1e305d"] {
            assert!(seconds(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_figure_has_four_digits_or_all_before_the_point() {
        for (value, expected) in [
            (0.0, "0"),
            (0.55123, "0.5512"),
            (123.456, "123.5"),
            (98765.4, "98765"),
        ] {
            assert_eq!(figure(value), expected);
        }
    }

    #[test]
    fn a_very_small_figure_has_three_digits_and_an_exponent() {
        assert_eq!(figure(4.12e-5), "4.12e-5");
    }

    #[test]
    fn a_threshold_is_named_unless_it_is_u() {
        for (name, value, expected) in [("u", 5e-4, "5e-4"), ("lambda", 0.3, "lambda 0.3")] {
            let given = DesiredSetting::Threshold(Threshold::new(name, value));
            assert_eq!(setting(&given), expected);
        }
    }

    #[test]
    fn a_threshold_is_rounded_to_six_digits() {
        let given = Threshold::new("lambda", 0.2901719359159484);
        assert_eq!(threshold(&given), "lambda 0.290172");
    }

    #[test]
    fn a_target_is_held() {
        let target = DesiredSetting::Target(Target::named("skip_rate", 0.5));
        assert_eq!(setting(&target), "hold skip_rate 0.5");
        assert_eq!(setting(&DesiredSetting::Target(None)), "hold nothing");
    }

    #[test]
    fn a_target_is_read_as_name_and_value_as_json_or_as_off() {
        use serde_json::json;
        for (text, expected) in [
            ("skip_rate=0.5", json!({"skip_rate": 0.5})),
            ("recall = 0.9", json!({"recall": 0.9})),
            (r#"{"watts": 3}"#, json!({"watts": 3})),
            (r#"{"target": {"watts": 3}}"#, json!({"watts": 3})),
            (r#"{"target": null}"#, json!(null)),
            ("off", json!(null)),
        ] {
            assert_eq!(target(text), Ok(expected), "{text}");
        }
    }

    #[test]
    fn what_is_no_target_is_refused_with_the_form_of_one() {
        for wrong in [
            "",
            "0.5",
            "recall=much",
            "recall=nan",
            "watts=inf",
            "{recall}",
        ] {
            let error = target(wrong).unwrap_err();
            assert!(error.contains("NAME=VALUE"), "{wrong}: {error}");
        }
    }
}
