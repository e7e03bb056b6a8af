//! Per-clip results as the paper's authors publish them: a CSV file with a row a clip and system.
//!
//! The columns used are found by name, so both the authors' full files and selections of their columns can
//! be read. Source: the repository that accompanies the paper, `results/*/summary.csv`.

use crate::data::DataError;
use crate::result::StateCounts;
use std::path::Path;

/// The system all others are compared with, as the files name it.
pub(crate) const VANILLA: &str = "Vanilla";

/// One clip under one system.
#[derive(Clone, Debug, PartialEq)]
pub struct PublishedRow {
    /// Name of the clip.
    pub sequence: String,
    /// Name of the system: `Vanilla`, `Adaptive`, …
    pub system: String,
    /// AP@50.
    pub ap50: f64,
    /// mAP@50:95.
    pub map: f64,
    /// Frames by state.
    pub states: StateCounts,
    /// Frames on which the detector ran.
    pub detector_frames: usize,
    /// Duration of the run over the clip, seconds.
    pub wall_s: f64,
    /// Mean time per frame, milliseconds.
    pub frame_time_ms: f64,
    /// Energy of the clip, joules.
    pub energy_j: f64,
}

impl PublishedRow {
    /// All frames.
    pub fn frames(&self) -> usize {
        self.states.total()
    }
}

/// Reads a file.
///
/// # Errors
/// [`DataError`] for a missing file or column, a row whose counts do not fit together, a figure that is
/// not a finite number, or a clip that comes twice under one system.
pub fn read(path: &Path) -> Result<Vec<PublishedRow>, DataError> {
    let text = std::fs::read(path).map_err(|error| {
        DataError::read(
            path,
            error,
            "give a summary.csv with a row per sequence and system",
        )
    })?;
    let mut reader = csv::Reader::from_reader(&text[..]);
    let headers = reader
        .headers()
        .map_err(|error| DataError::line(path, 1, error.to_string()))?
        .clone();
    let mut seen = std::collections::HashSet::new();
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| {
            let line = error.position().map_or(0, csv::Position::line);
            DataError::line(path, line, error.to_string())
        })?;
        let line = record.position().map_or(0, csv::Position::line);
        let row = parse(&headers, &record).map_err(|what| DataError::line(path, line, what))?;
        if !seen.insert((row.sequence.clone(), row.system.clone())) {
            return Err(DataError::line(
                path,
                line,
                format!("`{}` comes twice under `{}`", row.sequence, row.system),
            ));
        }
        rows.push(row);
    }
    if rows.is_empty() {
        return Err(DataError::file(path, "there is not one row of results"));
    }
    Ok(rows)
}

fn parse(headers: &csv::StringRecord, record: &csv::StringRecord) -> Result<PublishedRow, String> {
    let text = |name: &str| {
        let index = headers.iter().position(|header| header == name);
        index
            .and_then(|index| record.get(index))
            .ok_or_else(|| format!("the column `{name}` is missing"))
    };
    let number = |name: &str| {
        let value = text(name)?;
        match value.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(format!("`{name}` is `{value}`, not a finite number")),
        }
    };
    let count = |name: &str| {
        let value = number(name)?;
        if value >= 0.0 && value.fract() == 0.0 && value < 1e9 {
            Ok(value as usize)
        } else {
            Err(format!("`{name}` is {value}, not a count"))
        }
    };
    let positive = |name: &str| {
        let value = number(name)?;
        if value > 0.0 {
            Ok(value)
        } else {
            Err(format!("`{name}` is {value}; it must be above 0"))
        }
    };
    let states = StateCounts {
        e: count("erd_empty_count")?,
        p: count("predict_count")?,
        ei: count("erd_infer_count")?,
        i: count("pure_infer_count")?,
        ai: count("augmented_infer_count")?,
    };
    let detector_frames = count("infer_count")?;
    if states.ei + states.i + states.ai != detector_frames {
        return Err(format!(
            "the states E+I, I and AI make {} detector frames, `infer_count` says {detector_frames}",
            states.ei + states.i + states.ai
        ));
    }
    let skipped = count("skip_count")?;
    if states.e + states.p != skipped {
        return Err(format!(
            "the states E and P make {} skipped frames, `skip_count` says {skipped}",
            states.e + states.p
        ));
    }
    if states.total() == 0 {
        return Err("the clip has no frames".to_owned());
    }
    Ok(PublishedRow {
        sequence: text("sequence")?.to_owned(),
        system: text("system")?.to_owned(),
        ap50: number("ap_50")?,
        map: number("ap_50_95")?,
        states,
        detector_frames,
        wall_s: positive("wall_duration_s")?,
        frame_time_ms: positive("avg_frame_time_ms")?,
        energy_j: positive("energy_j")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "sequence,system,ap_50,ap_50_95,infer_count,skip_count,erd_empty_count,\
        predict_count,erd_infer_count,augmented_infer_count,pure_infer_count,wall_duration_s,\
        avg_frame_time_ms,energy_j";

    fn read_rows(rows: &str) -> Result<Vec<PublishedRow>, DataError> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("summary.csv");
        std::fs::write(&path, format!("{HEADER}\n{rows}")).expect("written");
        read(&path)
    }

    #[test]
    fn a_row_whose_counts_do_not_fit_together_is_refused_with_its_line() {
        let good = "a,Vanilla,0.7,0.5,10,0,0,0,0,0,10,1.5,60,90\n";
        assert_eq!(read_rows(good).expect("it is readable").len(), 1);
        for (row, part) in [
            (
                "b,Adaptive,0.7,0.5,9,1,0,1,0,0,8,1.5,60,90\n",
                "make 8 detector frames",
            ),
            (
                "b,Adaptive,0.7,0.5,9,2,0,1,0,0,9,1.5,60,90\n",
                "make 1 skipped frames",
            ),
            (
                "b,Adaptive,nan,0.5,9,1,0,1,0,0,9,1.5,60,90\n",
                "`ap_50` is `nan`",
            ),
            (
                "b,Adaptive,0.7,0.5,9,1,0,1,0,0,9,1.5,60,0\n",
                "`energy_j` is 0",
            ),
            ("b,Adaptive,0.7,0.5,0,0,0,0,0,0,0,1.5,60,9\n", "no frames"),
            (good, "comes twice"),
        ] {
            let message = read_rows(&format!("{good}{row}"))
                .expect_err("refused")
                .to_string();
            assert!(message.contains("summary.csv:3: "), "{message}");
            assert!(message.contains(part), "{message}");
        }
        assert!(read_rows("").is_err());
    }
}
