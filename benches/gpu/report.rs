//! Puts the page together from what was measured so far, and says what is missing.

use super::arguments::{Arguments, without_folder};
use super::page::Page;
use super::pieces::{Piece, TableName, table};
use super::results::{Outcome, Results, replace};
use anyhow::bail;

/// The mark on a trial's page. A trial overwrites no page without it.
const TRIAL: &str = "**CPU provider: a trial of the script, not a GPU's figures.**";

/// # Errors
/// If a trial would overwrite a GPU's figures.
pub(crate) fn may_be_written(arguments: &Arguments) -> anyhow::Result<()> {
    let there = std::fs::read_to_string(&arguments.out).unwrap_or_default();
    if !arguments.is_gpu() && !there.is_empty() && !there.contains(TRIAL) {
        bail!(
            "{} has a GPU's figures: name another page for a trial (OUT=…)",
            arguments.out.display()
        );
    }
    Ok(())
}

pub(crate) fn write(
    arguments: &Arguments,
    pieces: &[Piece],
    results: &Results,
) -> anyhow::Result<()> {
    let mut page = Page::default();
    beginning(&mut page, arguments);
    for name in TableName::ALL {
        let pieces: Vec<_> = pieces.iter().filter(|piece| piece.tables().contains(&name)).collect();
        if !pieces.is_empty() {
            section(&mut page, arguments, name, &pieces, results);
        }
    }
    page.text(failures_not_tried());
    replace(&arguments.out, &page.into_text())
}

/// A table with the rows of its pieces, and a line about when and how long they were measured and what is missing.
fn section(
    page: &mut Page,
    arguments: &Arguments,
    name: TableName,
    pieces: &[&Piece],
    results: &Results,
) {
    let table = table(name, arguments);
    let mut rows = Vec::new();
    let mut measured = Vec::new();
    let mut missing = Vec::new();
    for piece in pieces {
        match results.get(piece) {
            Some(Outcome {
                rows: Ok(found),
                seconds,
                date,
            }) => {
                let found =
                    found.iter().filter(|row| row.table == name).map(|row| row.cells.clone());
                rows.extend(found);
                measured.push(format!("{} in {seconds:.0} s ({date})", piece.name()));
            }
            Some(Outcome {
                rows: Err(reason), ..
            }) => missing.push(format!(
                "{}: {}",
                piece.name(),
                without_paths(arguments, reason)
            )),
            None => missing.push(format!("{}: the run ended before", piece.name())),
        }
    }
    page.heading(table.heading);
    page.text(table.text);
    if !rows.is_empty() {
        page.table(table.columns, &rows);
    }
    if !measured.is_empty() {
        page.text(format!("Measured: {}.", measured.join(", ")));
    }
    if !missing.is_empty() {
        page.text(format!("**Not measured**: {}.", missing.join("; ")));
    }
}

fn without_paths(arguments: &Arguments, reason: &str) -> String {
    let mut models = arguments.models().unwrap_or_default();
    models.extend(arguments.camera_models().unwrap_or_default());
    models.iter().fold(reason.to_owned(), |said, model| without_folder(said, model))
}

/// The subject of the page and the command that makes it.
fn beginning(page: &mut Page, arguments: &Arguments) {
    page.lines("# What a GPU does for the node");
    if arguments.is_gpu() {
        page.text(format!(
            "Figures of one GPU, by `{}`.",
            arguments.provider.as_str()
        ));
    } else {
        page.text(format!(
            "{TRIAL} Each table below is what the same script wrote with ONNX Runtime's CPU provider, so that script and tables are \
             known to work; on a machine with a GPU the same command fills these tables with the GPU's figures."
        ));
    }
    page.lines(format!(
        "<!-- by hand, {} -->\n```sh\nmake gpu                                      # with CUDA; PROVIDER=tensorrt for TensorRT\n\
         make gpu MODELS=\"yolo11n.onnx yolo26m.onnx\"   # your own detectors, of any size; made beside them: half precision, an open batch\n\
         make gpu PROVIDER=cpu                         # a trial of the script without a GPU\n```",
        arguments.date
    ));
    page.text(
        "It needs NVIDIA's driver, and ONNX Runtime's CUDA build with the CUDA and cuDNN libraries that it loads: the wheel \
         `onnxruntime-gpu` has the build, `ORT_DYLIB_PATH` names its `libonnxruntime.so`, `LD_LIBRARY_PATH` the rest. Without them \
         it stops with what ONNX Runtime said and writes nothing. Each piece has a process and at most `LIMIT` seconds (60), and the \
         page is written after each; a run that was cut is continued by the next one under the same conditions, `AGAIN=1` measures all \
         anew. `CAMERA_MODELS`, `POLICIES`, `SECONDS_EACH`, `MOST_CAMERAS`, `RUNS`, `DEVICE` and `OUT` set the rest. For a machine \
         without Rust the bench is built elsewhere (`cargo bench --no-run --bench gpu` says where it lies) and named in `GPU_BENCH`, \
         the program in `ALBIREO_BIN`. Speed is that of the architecture: models with random weights do for everything but the \
         cameras, whose model must detect what it sees: `benches/gpu/load.py` puts a detector's boxes and a large model's \
         computation into one file.",
    );
}

fn failures_not_tried() -> &'static str {
    "A GPU that is lost while it runs (`CUDA failure 700`, `719`, `999` and their like, after which nothing works any more in the \
     process) cannot be brought about here without harm to others. What the node does then is tested with the words that ONNX \
     Runtime's source writes, at the seam where sessions are built (`crates/vision/src/worker/tests/gpu.rs`): the frame is \
     answered from prediction, a new session is tried with growing pauses, and when it fails in the same way the detector is \
     reported as lost and the service manager's watchdog is not fed any more, for only a new process gets a new CUDA context."
}
