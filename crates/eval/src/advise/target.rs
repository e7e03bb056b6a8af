//! What is to be met.

use serde::Serialize;

/// One thing to be held, with its value. The names are those that a node takes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// Recall against the detector on the frames without it; the lower end of the interval is what must reach it.
    Recall(f64),
    /// Share of frames without the detector.
    SkipRate(f64),
    /// Milliseconds of detector a second and camera.
    DetectorMsPerS(f64),
    /// Watts a camera.
    Watts(f64),
    /// Joules a day and camera.
    JoulesPerDay(f64),
}

/// A target that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{asked}`: {reason}")]
pub struct TargetError {
    asked: String,
    reason: String,
}

impl std::str::FromStr for Target {
    type Err = TargetError;

    fn from_str(text: &str) -> Result<Self, TargetError> {
        let wrong = |reason: &str| TargetError {
            asked: text.to_owned(),
            reason: reason.to_owned(),
        };
        let names = "write NAME=VALUE with recall, skip_rate, detector_ms_per_s, watts or joules_per_day, for instance \
                     recall=0.95";
        let (name, value) = text.split_once('=').ok_or_else(|| wrong(names))?;
        let value: f64 = (value.trim().parse())
            .map_err(|_| wrong(&format!("`{}` is not a number", value.trim())))?;
        let (target, least, most) = match name.trim() {
            "recall" => (Self::Recall(value), 0.0, 1.0),
            "skip_rate" => (Self::SkipRate(value), 0.0, 1.0),
            "detector_ms_per_s" => (Self::DetectorMsPerS(value), 0.0, f64::MAX),
            "watts" => (Self::Watts(value), 0.0, f64::MAX),
            "joules_per_day" => (Self::JoulesPerDay(value), 0.0, f64::MAX),
            _ => return Err(wrong(names)),
        };
        // Written so that NaN, which compares false to everything, is refused.
        if value > least && value < most {
            Ok(target)
        } else if most > 1.0 {
            Err(wrong("the value must be above 0"))
        } else {
            Err(wrong("the value must be above 0 and below 1"))
        }
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Recall(value) => write!(f, "recall against the detector of at least {value}"),
            Self::SkipRate(value) => write!(f, "a skip rate of {value}"),
            Self::DetectorMsPerS(value) => {
                write!(f, "at most {value} ms of detector a second")
            }
            Self::Watts(value) => write!(f, "at most {value} W a camera"),
            Self::JoulesPerDay(value) => write!(f, "at most {value} J a day and camera"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_is_read_by_its_name_and_what_cannot_be_is_refused_in_words() {
        assert_eq!("recall=0.95".parse(), Ok(Target::Recall(0.95)));
        assert_eq!("watts = 3".parse(), Ok(Target::Watts(3.0)));
        for (text, part) in [
            ("recall", "NAME=VALUE"),
            ("accuracy=0.9", "recall, skip_rate"),
            ("recall=much", "`much` is not a number"),
            ("recall=1.5", "below 1"),
            ("skip_rate=NaN", "below 1"),
            ("watts=-1", "above 0"),
        ] {
            let message = text.parse::<Target>().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
