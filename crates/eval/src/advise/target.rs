//! Parses the target that the advice has to meet.

use serde::Serialize;

/// A target; the values are shares between 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// Recall against the detector, by the lower end of its interval.
    Recall(f64),
    /// Share of frames that skip the detector.
    SkipRate(f64),
}

impl std::str::FromStr for Target {
    type Err = String;

    /// Reads `recall=0.95` or `skip_rate=0.5`.
    fn from_str(text: &str) -> Result<Self, String> {
        let form = "write recall=VALUE or skip_rate=VALUE, for instance recall=0.95";
        let (name, number) = text.split_once('=').ok_or(form)?;
        let number = number.trim();
        let value: f64 = number.parse().map_err(|_| format!("`{number}` is not a number"))?;
        let target = match name.trim() {
            "recall" => Self::Recall(value),
            "skip_rate" => Self::SkipRate(value),
            _ => return Err(form.to_owned()),
        };
        // Written so that NaN, which compares false to everything, is refused.
        if value > 0.0 && value < 1.0 {
            Ok(target)
        } else {
            Err("the value must be above 0 and below 1".to_owned())
        }
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Recall(value) => write!(f, "recall against the detector of at least {value}"),
            Self::SkipRate(value) => write!(f, "a skip rate of {value}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_is_read_by_its_name_and_an_impossible_one_is_rejected_with_a_reason() {
        assert_eq!("recall=0.95".parse(), Ok(Target::Recall(0.95)));
        assert_eq!("skip_rate = 0.5".parse(), Ok(Target::SkipRate(0.5)));
        for (text, part) in [
            ("recall", "recall=VALUE"),
            ("accuracy=0.9", "skip_rate=VALUE"),
            ("recall=much", "`much` is not a number"),
            ("recall=1.5", "below 1"),
            ("skip_rate=NaN", "below 1"),
            ("skip_rate=-1", "above 0"),
        ] {
            let message = text.parse::<Target>().unwrap_err();
            assert!(message.contains(part), "{message}");
        }
    }
}
