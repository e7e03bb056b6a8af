//! `albireo power`: lists the power sources that work on this machine, with their rails and current watts.

use super::terminal::{hanging, line_width};
use albireo_power::{SourceSurvey, survey};
use albireo_wire::EnergyQuality;
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `albireo power`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Opens every source in turn and reads it for a second. The source marked * is
the one that `source = \"auto\"` selects. It says what its watts include: the
whole machine, or the parts that are added up; `partial` means that a part that
consumes much is left out. The watts of `estimate` come from a model; all others
are measured.

Examples:
  albireo power
  albireo power --config /etc/albireo/node.toml
  albireo power --json | jq '.[] | select(.automatic)'")]
pub(super) struct PowerArguments {
    /// The node's configuration file
    #[arg(long, short, env = "ALBIREO_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &PowerArguments) -> anyhow::Result<()> {
    let config = super::node::configuration(arguments.config.as_deref())?;
    let found = survey(&config.power);
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&found)?);
    } else {
        print!("{}", table(&found, line_width()));
    }
    Ok(())
}

/// The column in which the rails begin, and what is broken because it is longer than the line goes on.
const RAILS: usize = 33;

/// Formats the sources as a table, each with the rails of a source that works below it, in lines of `width` characters.
fn table(found: &[SourceSurvey], width: usize) -> String {
    let mut text = String::new();
    let mut line = |cells: [&str; 4]| {
        let [source, usable, watts, what] = cells;
        let row = format!("{source:<13} {usable:<7} {watts:>9}  {what}");
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{}", hanging(row.trim_end(), width, RAILS));
    };
    line(["source", "usable", "watts", "rails, or why not"]);
    for source in found {
        let mark = if source.automatic { " *" } else { "" };
        let name = format!("{}{mark}", source.source);
        if let Some(why_not) = &source.why_not {
            let prefix = format!("{}: ", source.source);
            let why_not = why_not.strip_prefix(&prefix).unwrap_or(why_not);
            line([&name, "no", "", why_not]);
            continue;
        }
        let total = source.watts.iter().find(|(domain, _)| *domain == "total");
        let cost = source.share_of_core.map_or_else(String::new, |share| {
            format!("; reading it takes {:.2} % of one core", share * 100.0)
        });
        let summary = format!("{}{cost}", scope(source));
        line([
            &name,
            "yes",
            &watts(total.map(|(_, watts)| *watts)),
            &summary,
        ]);
        for rail in &source.rails {
            let mut what = rail.name.clone();
            let mut notes = Vec::new();
            if rail.in_total {
                notes.push("in total");
            }
            if let Some(domain) = rail.domain {
                notes.push(domain);
            }
            if !notes.is_empty() {
                what.push_str(&format!(" ({})", notes.join(", ")));
            }
            line(["", "", &watts(rail.watts), &what]);
        }
    }
    text
}

/// What the total includes, in words.
fn scope(source: &SourceSurvey) -> String {
    match (source.quality, source.total_from.as_str()) {
        (_, "input_rail") => "whole machine".to_owned(),
        (EnergyQuality::Partial, parts) => format!("partial: {parts}"),
        (_, parts) => parts.to_owned(),
    }
}

fn watts(watts: Option<f64>) -> String {
    watts.map_or_else(|| "-".to_owned(), |watts| format!("{watts:.2} W"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_power::RailNow;

    fn source(name: &'static str) -> SourceSurvey {
        SourceSurvey {
            source: name,
            automatic: false,
            why_not: None,
            quality: EnergyQuality::Measured,
            total_from: "input_rail".to_owned(),
            watts: vec![("total", 19.78)],
            rails: Vec::new(),
            share_of_core: Some(0.0012),
        }
    }

    /// A source with rails, one of parts, and one that does not work here.
    fn sources() -> [SourceSurvey; 3] {
        let rail = |name: &str, watts, domain, in_total| RailNow {
            name: name.to_owned(),
            watts,
            domain,
            in_total,
        };
        let ina = SourceSurvey {
            automatic: true,
            rails: vec![
                rail("VIN", Some(19.78), None, true),
                rail("VDD_GPU", Some(1.962), Some("gpu"), false),
                rail("VDD_CPU_SOC_MSS", None, Some("cpu"), false),
            ],
            ..source("ina")
        };
        let parts = SourceSurvey {
            quality: EnergyQuality::Partial,
            total_from: "processor + card, without card".to_owned(),
            ..source("rapl+nvml")
        };
        let rapl = SourceSurvey {
            why_not: Some("rapl: not on this machine: no counter".to_owned()),
            ..source("rapl")
        };
        [ina, parts, rapl]
    }

    #[test]
    fn the_table_lists_each_source_its_rails_and_why_not() {
        insta::assert_snapshot!(table(&sources(), usize::MAX));
    }

    #[test]
    fn on_a_narrow_terminal_a_reason_goes_on_below_its_column() {
        let narrow = table(&sources(), 60);
        assert!(
            narrow.lines().all(|line| line.chars().count() <= 60),
            "{narrow}"
        );
        let below = format!("\n{}counter\n", " ".repeat(RAILS));
        assert!(narrow.contains(&below), "{narrow}");
    }
}
