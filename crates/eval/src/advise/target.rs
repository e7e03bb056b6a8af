//! What is to be met.

pub use albireo_core::target::Target;

/// A target that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{asked}`: {reason}")]
pub struct TargetError {
    asked: String,
    reason: String,
}

/// Reads `recall=0.95`. The names are those that a node takes; the values here are a camera's, and may be any that a
/// recording could meet.
///
/// # Errors
/// What is wrong, with what to write.
pub fn parse_target(text: &str) -> Result<Target, TargetError> {
    let wrong = |reason: &str| TargetError {
        asked: text.to_owned(),
        reason: reason.to_owned(),
    };
    let names = "write NAME=VALUE with recall, skip_rate, detector_ms_per_s, watts or joules_per_day, for instance \
                 recall=0.95";
    let (name, value) = text.split_once('=').ok_or_else(|| wrong(names))?;
    let value: f64 = (value.trim().parse())
        .map_err(|_| wrong(&format!("`{}` is not a number", value.trim())))?;
    let target = Target::named(name.trim(), value).ok_or_else(|| wrong(names))?;
    let is_share = matches!(target, Target::Recall(_) | Target::SkipRate(_));
    let most = if is_share { 1.0 } else { f64::MAX };
    // Written so that NaN, which compares false to everything, is refused.
    if value > 0.0 && value < most {
        Ok(target)
    } else if is_share {
        Err(wrong("the value must be above 0 and below 1"))
    } else {
        Err(wrong("the value must be above 0"))
    }
}

/// The target in words, as what a camera's policy has to meet.
pub fn target_in_words(target: Target) -> String {
    match target {
        Target::Recall(value) => format!("recall against the detector of at least {value}"),
        Target::SkipRate(value) => format!("a skip rate of {value}"),
        Target::DetectorMsPerS(value) => format!("at most {value} ms of detector a second"),
        Target::Watts(value) => format!("at most {value} W a camera"),
        Target::JoulesPerDay(value) => format!("at most {value} J a day and camera"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_is_read_by_its_name_and_what_cannot_be_is_refused_in_words() {
        assert_eq!(parse_target("recall=0.95"), Ok(Target::Recall(0.95)));
        assert_eq!(parse_target("watts = 3"), Ok(Target::Watts(3.0)));
        for (text, part) in [
            ("recall", "NAME=VALUE"),
            ("accuracy=0.9", "recall, skip_rate"),
            ("recall=much", "`much` is not a number"),
            ("recall=1.5", "below 1"),
            ("skip_rate=NaN", "below 1"),
            ("watts=-1", "above 0"),
        ] {
            let message = parse_target(text).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
