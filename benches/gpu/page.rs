//! Builds text in Markdown.

use std::fmt::Display;

/// The mark for a figure that was not measured.
pub(crate) const NONE: &str = "–";

/// The width of a paragraph, in columns.
const WIDTH: usize = 130;

#[derive(Default)]
pub(crate) struct Page(String);

impl Page {
    /// Adds a paragraph and an empty line.
    pub(crate) fn text(&mut self, text: impl Display) {
        let mut length = 0;
        for word in text.to_string().split_whitespace() {
            if length > 0 && length + 1 + word.len() > WIDTH {
                self.0.push('\n');
                length = 0;
            }
            if length > 0 {
                self.0.push(' ');
                length += 1;
            }
            self.0 += word;
            length += word.len();
        }
        self.0 += "\n\n";
    }

    /// Adds unwrapped lines and an empty line.
    pub(crate) fn lines(&mut self, lines: impl Display) {
        self.0 += &format!("{lines}\n\n");
    }

    pub(crate) fn heading(&mut self, text: &str) {
        self.lines(format_args!("## {text}"));
    }

    pub(crate) fn table(&mut self, header: &[&str], rows: &[Vec<String>]) {
        let mut line = |cells: &[String]| {
            let cells: Vec<_> = cells.iter().map(|cell| in_a_cell(cell)).collect();
            self.0 += &format!("| {} |\n", cells.join(" | "));
        };
        line(&header.iter().map(|cell| (*cell).to_owned()).collect::<Vec<_>>());
        line(&vec!["---".to_owned(); header.len()]);
        rows.iter().for_each(|row| line(row));
        self.0.push('\n');
    }

    pub(crate) fn into_text(self) -> String {
        let mut text = self.0;
        text.truncate(text.trim_end().len());
        text.push('\n');
        text
    }
}

/// Makes a text fit a table cell: an error may contain line breaks and `|`.
fn in_a_cell(text: &str) -> String {
    let words: Vec<_> = text.split_whitespace().collect();
    words.join(" ").replace('|', "\\|")
}

/// Formats milliseconds for a table, or [`NONE`].
pub(crate) fn ms(value: Option<f64>) -> String {
    value.map_or_else(|| NONE.to_owned(), |value| format!("{value:.3}"))
}

/// The percentile at `share`, by nearest rank.
pub(crate) fn percentile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

pub(crate) fn median(values: &[f64]) -> Option<f64> {
    percentile(values, 0.5)
}
