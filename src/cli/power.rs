//! `albireo power`: lists all power sources, those that work here with their rails and watts, the others with the reason.

use super::terminal::{broken, line_width};
use albireo_power::{SourceSurvey, survey};
use albireo_wire::EnergyQuality;
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `albireo power`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Opens every source in turn and reads it for a second. The source marked * is
the one that `source = \"auto\"` selects. Each says what its watts include: the
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

/// The column in which the rails begin. A row that is too long for its line goes on in it.
const RAILS: usize = 33;

/// Formats the sources as a table, in lines of at most `width` characters. Below each source that works are its rails.
fn table(found: &[SourceSurvey], width: usize) -> String {
    let mut text = String::new();
    let mut line = |cells: [&str; 4]| {
        let [source, usable, watts, what] = cells;
        let row = format!("{source:<13} {usable:<7} {watts:>9}  {what}");
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{}", broken(row.trim_end(), width, RAILS));
    };
    line(["source", "usable", "watts", "rails, or why not"]);
    for source in found {
        let mark = if source.automatic { " *" } else { "" };
        let name = format!("{}{mark}", source.source);
        if let Some(why_not) = &source.why_not {
            let prefix = format!("{}: ", source.source);
            let reason = why_not.strip_prefix(&prefix).unwrap_or(why_not);
            line([&name, "no", "", reason]);
            continue;
        }
        let total = source
            .watts
            .iter()
            .find(|(domain, _)| *domain == "total")
            .map(|(_, watts)| *watts);
        let mut summary = scope(source);
        if let Some(share) = source.share_of_core {
            let share = share * 100.0;
            summary.push_str(&format!("; reading it takes {share:.2} % of one core"));
        }
        line([&name, "yes", &in_watts(total), &summary]);
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
            line(["", "", &in_watts(rail.watts), &what]);
        }
    }
    text
}

/// What the total includes, in words.
fn scope(source: &SourceSurvey) -> String {
    let parts = &source.total_from;
    if parts.is_empty() {
        return "no reading in this second".to_owned();
    }
    if parts == "input_rail" {
        return "whole machine".to_owned();
    }
    match source.quality {
        EnergyQuality::Partial => format!("partial: {parts}"),
        _ => parts.clone(),
    }
}

fn in_watts(watts: Option<f64>) -> String {
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
        let rail = |name: &str| RailNow {
            name: name.to_owned(),
            watts: None,
            domain: None,
            in_total: false,
        };
        let input = RailNow {
            watts: Some(19.78),
            in_total: true,
            ..rail("VIN")
        };
        let gpu = RailNow {
            watts: Some(1.962),
            domain: Some("gpu"),
            ..rail("VDD_GPU")
        };
        let cpu = RailNow {
            domain: Some("cpu"),
            ..rail("VDD_CPU_SOC_MSS")
        };
        let ina = SourceSurvey {
            automatic: true,
            rails: vec![input, gpu, cpu],
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
    fn on_a_narrow_terminal_a_row_goes_on_in_the_column_of_the_rails() {
        let [mut ina, ..] = sources();
        // "VDD_CPU_SOC_MSS (in total, cpu)" is too long for 60 columns.
        let cpu = &mut ina.rails[2];
        cpu.in_total = true;
        let of_rails = table(&[ina], 60);
        let of_reasons = table(&sources(), 60);
        for (narrow, goes_on) in [(of_rails, "cpu)"), (of_reasons, "counter")] {
            let below = format!("\n{}{goes_on}\n", " ".repeat(RAILS));
            assert!(narrow.contains(&below), "{narrow}");
            let widest = narrow.lines().map(|line| line.chars().count()).max();
            assert!(widest <= Some(60), "{narrow}");
        }
    }
}
