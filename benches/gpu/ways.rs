//! Compares the ways into a session and out of it: plain, bound, on the device, as a CUDA graph. Also measures copies
//! alone, with and without pinned memory. All runs in a separate process: a process can have only one ONNX Runtime,
//! which the node's code keeps, and a crash ends only that process.

mod process;

use super::arguments::{Arguments, name_of, without_folder};
use super::page::{NONE, Page, median, ms, percentile};
use anyhow::{Context, bail};
pub(crate) use process::run;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;
use tokio::process::Command;

/// Uncounted first runs of each way, which allocate memory and record a graph.
const WARM_UP: usize = 5;

/// The time limit of the process. TensorRT takes minutes to build the engines of all ways.
const PATIENCE: Duration = Duration::from_secs(1800);

/// The way that the node uses.
const PLAIN: &str = "plain";

/// The largest ratio of a way's time to the plain one's at which the way is worth its effort.
const WORTH_IT: f64 = 0.95;

/// The number of inputs, which take turns.
const INPUTS: usize = 3;

/// The measurements of one model.
#[derive(Default, Serialize, Deserialize)]
struct Measured {
    /// A text that states whether the provider runs every node of the graph.
    all_nodes: String,
    ways: Vec<Way>,
    copies: Vec<Copy>,
}

impl Measured {
    /// The median ratio of the time of `way` to the plain one's, turn by turn.
    fn beside_plain(&self, way: &Way) -> Option<f64> {
        let plain = self.ways.iter().find(|way| way.name == PLAIN)?;
        let ratios = way.times.iter().zip(&plain.times);
        median(&ratios.map(|(way, plain)| way / plain).collect::<Vec<_>>())
    }
}

#[derive(Serialize, Deserialize)]
struct Way {
    name: String,
    /// The milliseconds of each run.
    times: Vec<f64>,
    /// The largest difference between its outputs and those of the plain way.
    difference: f64,
    /// The reason for which there are no times.
    why_not: Option<String>,
}

#[derive(Serialize, Deserialize)]
struct Copy {
    /// The copied data; empty for the same data in pinned memory.
    name: String,
    bytes: usize,
    times: Vec<f64>,
}

/// Writes both tables for all models.
pub(crate) async fn write(page: &mut Page, arguments: &Arguments) -> anyhow::Result<()> {
    let (mut ways, mut copies) = (Vec::new(), Vec::new());
    for model in arguments.models()? {
        let name = name_of(&model);
        eprintln!("ways into {name}");
        let measured = match in_a_process(arguments, &model).await {
            Ok(measured) => measured,
            Err(error) => {
                let said = without_folder(format_args!("{error:#}"), &model);
                ways.push(vec![name, said]);
                continue;
            }
        };
        let mut row = vec![name.clone(), measured.all_nodes.clone()];
        let mut best: Option<(String, f64)> = None;
        for way in &measured.ways {
            let (middle, late) = (median(&way.times), percentile(&way.times, 0.95));
            if let Some(why_not) = &way.why_not {
                row.push(why_not.clone());
                continue;
            }
            let mut cell = format!("{} ({})", ms(middle), ms(late));
            // Half precision gives slightly different sums in another order.
            if way.difference > 1e-2 {
                cell += &format!(", **differs by {:.3}**", way.difference);
            } else if way.name != PLAIN
                && let Some(ratio) = measured.beside_plain(way)
                && best.as_ref().is_none_or(|(_, least)| ratio < *least)
            {
                best = Some((way.name.clone(), ratio));
            }
            row.push(cell);
        }
        row.push(match &best {
            Some((name, ratio)) => format!("{name}: {ratio:.2}"),
            None => NONE.to_owned(),
        });
        row.push(match best {
            _ if !arguments.is_gpu() => "no choice on a CPU".to_owned(),
            Some((name, ratio)) if ratio < WORTH_IT => name,
            _ => PLAIN.to_owned(),
        });
        ways.push(row);
        let mut row = vec![name];
        for copy in &measured.copies {
            if !copy.name.is_empty() && copy.bytes > 1 {
                row.push(copy.bytes.to_string());
            }
            row.push(ms(median(&copy.times)));
        }
        copies.push(row);
    }
    page.heading("Ways into a session and out of it");
    page.text(
        "Milliseconds from an input that lies in the processor's memory to outputs that lie there, median (95 %), taking turns \
         in one run. *Plain* is what the node does. *Bound* binds input and outputs in the processor's memory (`IoBinding`). *On \
         the device* keeps both there at fixed addresses and copies explicitly; *graph* is the same, recorded once as a CUDA graph \
         and replayed. Ratios are medians of the ratios of single turns. To be kept is another way than plain only where it takes \
         95 % of its time or less with the same outputs. A way through pinned memory is not among them: the crate `ort` reads and \
         writes such memory only with its feature `api-23`, which the node goes without, so as to run with ONNX Runtime 1.22; \
         what it could save is in the next table.",
    );
    let names = [
        "model",
        "every node on the provider?",
        "plain",
        "bound",
        "on the device",
        "graph",
        "best other, times plain",
        "to be kept",
    ];
    for row in &mut ways {
        row.resize(names.len(), NONE.to_owned());
    }
    page.table(&names, &ways);
    page.heading("Copies alone");
    page.text(
        "Milliseconds of one copy by ONNX Runtime between the processor's memory and the device's, waited for, of the model's \
         input and of its outputs. The copy of one byte is what is spent on the way in any case; what pinned memory could save a \
         frame is the difference between the columns with and without it.",
    );
    page.table(
        &[
            "model",
            "one byte",
            "pinned",
            "input, bytes",
            "to the device",
            "pinned",
            "outputs, bytes",
            "from the device",
            "pinned",
        ],
        &copies,
    );
    Ok(())
}

async fn in_a_process(arguments: &Arguments, model: &Path) -> anyhow::Result<Measured> {
    let measuring = Command::new(std::env::current_exe()?)
        .arg("--ways-of")
        .arg(model)
        .args(["--provider", arguments.provider.as_str()])
        .args(["--device", &arguments.device.to_string()])
        .args(["--runs", &arguments.runs.to_string()])
        .stdin(Stdio::null())
        .kill_on_drop(true)
        .output();
    let output = tokio::time::timeout(PATIENCE, measuring)
        .await
        .with_context(|| format!("not measured within {} s", PATIENCE.as_secs()))??;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.lines().last().unwrap_or_default();
        bail!("not measured ({}): {last}", output.status);
    }
    serde_json::from_slice(&output.stdout).context("what was measured")
}
