//! Describes the machine and measures the card at rest.

use super::arguments::{Arguments, library, name_of};
use super::card::Card;
use super::page::NONE;
use super::pieces::{Row, Table, TableName};
use anyhow::bail;
use std::time::Duration;

/// The time for which the card is watched at rest.
const AT_REST: Duration = Duration::from_secs(5);

pub(crate) fn table() -> Table {
    Table {
        heading: "The machine",
        text: "At rest: the whole card's watts over 5 s before anything ran on it, by its energy counter and by its power, looked \
               at every 20 ms and added up (NVML's power may be a mean over a second)."
            .to_owned(),
        columns: &[
            "GPU",
            "processor",
            "load at the start",
            "ONNX Runtime",
            "build",
            "at rest, W by the counter",
            "W by power",
        ],
    }
}

/// # Errors
/// If a GPU is asked for and NVML shows none.
pub(crate) async fn measure(arguments: &Arguments) -> anyhow::Result<Vec<Row>> {
    let card = match Card::open(arguments.device) {
        Ok(card) => Some(card),
        Err(error) if arguments.is_gpu() => return Err(error),
        Err(_) => None,
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let mut cells = vec![
        match &card {
            Some(card) => card.description()?,
            None => "none, or no driver".to_owned(),
        },
        format!("{cores} cores, {}", std::env::consts::ARCH),
        load.split_whitespace().next().unwrap_or(NONE).to_owned(),
        name_of(&library()?.canonicalize()?),
        if cfg!(debug_assertions) {
            "development"
        } else {
            "optimised"
        }
        .to_owned(),
    ];
    match card {
        Some(card) => {
            let measuring = card.measure();
            tokio::time::sleep(AT_REST).await;
            let energy = measuring.end();
            for joules in [energy.counter, energy.integrated] {
                let watts = joules.map(|joules| format!("{:.1}", joules / energy.seconds));
                cells.push(watts.unwrap_or_else(|| NONE.to_owned()));
            }
        }
        None => cells.extend([NONE.to_owned(), NONE.to_owned()]),
    }
    works(arguments)?;
    Ok(vec![Row {
        table: TableName::Machine,
        cells,
    }])
}

/// Opens the first model, so that a missing provider is told before anything is measured.
fn works(arguments: &Arguments) -> anyhow::Result<()> {
    let first = arguments.models()?.swap_remove(0);
    let network = albireo_vision::detector::DetectorNetwork::open(&arguments.detector(&first))?;
    let used = network.provider();
    if used != arguments.provider {
        bail!(
            "`{}` was asked for and the session runs on `{}`",
            arguments.provider.as_str(),
            used.as_str()
        );
    }
    Ok(())
}
