//! Parses the power rails in a line of `tegrastats`, of any release from L4T R32 to R39.
//!
//! Power is `RAIL current/average` in milliwatts, without a unit (R32), with `mW` (R34 to R38), or with a
//! third value, the maximum (R39). Only the first is used: the average covers the time since the program started.

use crate::rails::RailWatts;

/// The rails of a line, in the printed order; `None` if the line has no `RAM`, which every `tegrastats` line has.
pub fn tegrastats_rails(line: &str) -> Option<Vec<RailWatts>> {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    if !words.contains(&"RAM") {
        return None;
    }
    let mut rails = Vec::new();
    for pair in words.windows(2) {
        let name = pair[0];
        let value = pair[1];
        if is_name(name)
            && name != "NC"
            && let Some(watts) = watts(value)
        {
            let name = name.into();
            rails.push(RailWatts { name, watts });
        }
    }
    Some(rails)
}

fn is_name(word: &str) -> bool {
    word.starts_with(|c: char| c.is_ascii_alphabetic())
        && word.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

/// The first value of `2399mW/2399mW`, `5139mW/5139mW/5139mW`, `18401/18525`, `2171mW`, in watts.
fn watts(word: &str) -> Option<f64> {
    let milliwatts = |text: &str| text.strip_suffix("mW").unwrap_or(text).parse::<i64>().ok();
    let values: Option<Vec<i64>> = word.split('/').map(milliwatts).collect();
    // A single number without a unit is a clock (`APE 150`), and `RAM 1282/62795MB` is not a power.
    let present = match values?[..] {
        [present] if word.ends_with("mW") => present,
        [present, _] | [present, _, _] => present,
        _ => return None,
    };
    Some(present as f64 / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rails_have_their_present_power_and_other_tokens_are_ignored() {
        for (text, watts) in [
            ("VDD_IN 1mW/1mW ", Some(0.001)),
            ("VDD_IN", None),
            ("VDD_IN mW/mW", None),
            ("VDD_IN 1mW/2mW/3mW/4mW", None),
            ("FUTURE_TOKEN value", None),
        ] {
            let rails = tegrastats_rails(&format!("RAM 1/2MB {text}")).unwrap();
            assert_eq!(rails.first().map(|rail| rail.watts), watts, "{text}");
        }
    }

    #[test]
    fn a_line_of_another_program_is_rejected() {
        let sudo = "sudo: a password is required";
        for text in ["", sudo, "VDD_IN 4915mW/4915mW", "\u{fffd}\u{0}"] {
            assert_eq!(tegrastats_rails(text), None, "{text:?}");
        }
    }

    proptest::proptest! {
        #[test]
        fn any_ram_line_gives_finite_watts(text in "RAM (\\PC{0,40} ){0,8}[A-Z@/%,\\[\\]mWC0-9.-]{0,60}") {
            let rails = tegrastats_rails(&text).unwrap();
            proptest::prop_assert!(rails.iter().all(|rail| rail.watts.is_finite()));
        }
    }
}
