//! Parses values of arguments: frame rates, times and picture sizes. Writes counts.

use albireo_core::geometry::PictureSize;

/// The fewest frames per second: one in 17 minutes. A lower rate is a typing error, and its period might overflow.
pub(super) const MIN_RATE: f64 = 0.001;

/// The most frames per second.
pub(super) const MAX_RATE: f64 = 1000.0;

/// The longest time, seconds: 11 days.
#[cfg(feature = "eval")]
const LONGEST_S: f64 = 1e6;

/// Reads a number of frames per second, or the factor of a speed, at which frames are still a reasonable time apart.
pub(super) fn parse_rate(text: &str) -> Result<f64, String> {
    let fits = |rate| (MIN_RATE..=MAX_RATE).contains(&rate);
    number(text, fits, &format!("from {MIN_RATE} to {MAX_RATE}"))
}

/// Reads a time of at most 11 days, seconds.
#[cfg(feature = "eval")]
pub(super) fn above_zero(text: &str) -> Result<f64, String> {
    let fits = |value| value > 0.0 && value <= LONGEST_S;
    number(text, fits, &format!("above 0, up to {LONGEST_S}"))
}

/// Reads a time of at most 11 days, seconds, that may be 0.
#[cfg(feature = "eval")]
pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    let fits = |value| (0.0..=LONGEST_S).contains(&value);
    number(text, fits, &format!("from 0 to {LONGEST_S}"))
}

/// A count with its noun: `1 clip`, `2 clips`.
pub(super) fn counted(count: u64, one: &str, several: &str) -> String {
    let noun = if count == 1 { one } else { several };
    format!("{count} {noun}")
}

fn number(text: &str, fits: fn(f64) -> bool, which: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if fits(value) => Ok(value),
        _ => Err(format!("must be a number {which}")),
    }
}

/// Reads `1280x720`.
pub(super) fn parse_size(text: &str) -> Result<PictureSize, String> {
    let wrong = || format!("`{text}`: a size is columns x rows, such as 1280x720");
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    let side = |text: &str| text.parse().map_err(|_| wrong());
    let size = PictureSize::new(side(width)?, side(height)?);
    if size.pixels() == 0 {
        return Err(wrong());
    }
    Ok(size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_that_no_clock_can_keep_is_refused_in_words() {
        assert_eq!(parse_rate("12.5"), Ok(12.5));
        for text in ["0", "-1", "1e-30", "1e-4", "1001", "nan", "inf", "fast"] {
            let refused = parse_rate(text).unwrap_err();
            assert_eq!(refused, "must be a number from 0.001 to 1000", "{text}");
        }
    }

    #[cfg(feature = "eval")]
    #[test]
    fn a_time_that_is_too_long_or_not_above_zero_is_refused_with_the_limits() {
        assert_eq!(above_zero("1e6"), Ok(1e6));
        for text in ["2000000", "0", "nan"] {
            let refused = above_zero(text).unwrap_err();
            assert_eq!(refused, "must be a number above 0, up to 1000000", "{text}");
        }
    }

    #[cfg(feature = "eval")]
    #[test]
    fn a_time_that_may_be_zero_has_the_same_longest() {
        assert_eq!(not_negative("0"), Ok(0.0));
        let refused = not_negative("2000000").unwrap_err();
        assert_eq!(refused, "must be a number from 0 to 1000000");
    }

    #[test]
    fn sizes_are_columns_by_rows() {
        assert_eq!(parse_size("640x360").unwrap(), PictureSize::new(640, 360));
        for wrong in ["640", "x", "640x", "ax3", "-1x5", "0x5"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
    }
}
