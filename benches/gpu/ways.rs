//! Compares the ways into a session and out of it: plain, bound, on the device, as a CUDA graph. Also measures copies
//! alone, with and without pinned memory.

mod sessions;

use super::arguments::{Arguments, name_of, without_folder};
use super::page::{NONE, median, ms, percentile};
use super::pieces::{Row, Table, TableName};
use std::path::Path;

/// Uncounted first runs of each way, which allocate memory and record a graph.
const WARM_UP: usize = 5;

/// The way that the node uses.
const PLAIN: &str = "plain";

/// The largest ratio of a way's time to the plain one's at which the way is worth its effort.
const WORTH_IT: f64 = 0.95;

/// The number of inputs, which take turns.
const INPUTS: usize = 3;

/// The measurements of one model.
#[derive(Default)]
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
        let ratios: Vec<_> =
            way.times.iter().zip(&plain.times).map(|(way, plain)| way / plain).collect();
        median(&ratios)
    }
}

struct Way {
    name: String,
    /// The milliseconds of each run.
    times: Vec<f64>,
    /// The largest difference between its outputs and those of the plain way.
    difference: f64,
    /// The reason for which there are no times.
    why_not: Option<String>,
}

struct Copy {
    /// The copied data; empty for the same data in pinned memory.
    name: String,
    bytes: usize,
    times: Vec<f64>,
}

pub(crate) fn ways_table() -> Table {
    Table {
        heading: "Ways into a session and out of it",
        text: "Milliseconds from an input that lies in the processor's memory to outputs that lie there, median (95 %), taking turns \
               in one run. *Plain* is what the node does. *Bound* binds input and outputs in the processor's memory (`IoBinding`). *On \
               the device* keeps both there at fixed addresses and copies explicitly; *graph* is the same, recorded once as a CUDA \
               graph and replayed. Ratios are medians of the ratios of single turns. To be kept is another way than plain only where \
               it takes 95 % of its time or less with the same outputs. A way through pinned memory is not among them: the crate `ort` \
               reads and writes such memory only with its feature `api-23`, which the node goes without, so as to run with ONNX Runtime \
               1.22; what it could save is in the next table."
            .to_owned(),
        columns: &[
            "model",
            "every node on the provider?",
            "plain",
            "bound",
            "on the device",
            "graph",
            "best other, times plain",
            "to be kept",
        ],
    }
}

pub(crate) fn copies_table() -> Table {
    Table {
        heading: "Copies alone",
        text: "Milliseconds of one copy by ONNX Runtime between the processor's memory and the device's, waited for, of the model's \
               input and of its outputs. The copy of one byte is what is spent on the way in any case; what pinned memory could save \
               a frame is the difference between the columns with and without it."
            .to_owned(),
        columns: &[
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
    }
}

/// A row of both tables.
pub(crate) fn measure(arguments: &Arguments, model: &Path) -> anyhow::Result<Vec<Row>> {
    let measured = sessions::run(arguments, model)?;
    Ok(vec![
        Row {
            table: TableName::Ways,
            cells: ways(arguments, model, &measured),
        },
        Row {
            table: TableName::Copies,
            cells: copies(model, &measured),
        },
    ])
}

fn ways(arguments: &Arguments, model: &Path, measured: &Measured) -> Vec<String> {
    let mut row = vec![name_of(model), measured.all_nodes.clone()];
    let mut best: Option<(String, f64)> = None;
    for way in &measured.ways {
        if let Some(why_not) = &way.why_not {
            row.push(without_folder(why_not, model));
            continue;
        }
        let late = percentile(&way.times, 0.95);
        let mut cell = format!("{} ({})", ms(median(&way.times)), ms(late));
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
    row
}

fn copies(model: &Path, measured: &Measured) -> Vec<String> {
    let mut row = vec![name_of(model)];
    for copy in &measured.copies {
        if !copy.name.is_empty() && copy.bytes > 1 {
            row.push(copy.bytes.to_string());
        }
        row.push(ms(median(&copy.times)));
    }
    row
}
