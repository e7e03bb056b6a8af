//! From OpenMetrics text to Prometheus's older text format (0.0.4).

/// OpenMetrics text in the older format: there a counter is described under the name of its samples, and
/// there is no end mark.
pub(super) fn to_plain(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    let counters: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("# TYPE ")?.strip_suffix(" counter"))
        .collect();
    for line in text.lines().filter(|line| *line != "# EOF") {
        let described = line
            .strip_prefix("# HELP ")
            .or_else(|| line.strip_prefix("# TYPE "))
            .and_then(|rest| rest.split_once(' '))
            .filter(|(name, _)| counters.contains(name));
        match described {
            Some((name, rest)) => {
                let keyword = line.get(..7).unwrap_or_default();
                plain.push_str(&format!("{keyword}{name}_total {rest}"));
            }
            None => plain.push_str(line),
        }
        plain.push('\n');
    }
    plain
}
