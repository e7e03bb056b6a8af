//! Formats text and tables for a terminal.

use std::fmt::Write;
use textwrap::{Options, WordSplitter};

/// The width of text in a file, in characters.
pub const WIDTH: usize = 100;

/// Breaks `text` at spaces into lines of at most `width` columns; a longer word gets a line of its own.
pub fn wrapped(text: &str, width: usize) -> String {
    let options = Options::new(width)
        .break_words(false)
        .word_splitter(WordSplitter::NoHyphenation);
    textwrap::fill(text, options)
}

/// A number of things by their noun: `1 clip`, `200 clips`.
pub fn counted(number: usize, noun: &str) -> String {
    let plural = if number == 1 { "" } else { "s" };
    format!("{number} {noun}{plural}")
}

/// A column: its two header lines and its cells.
pub(crate) struct Column {
    pub heads: [String; 2],
    pub cells: Vec<String>,
}

impl Column {
    pub(crate) fn new(heads: [&str; 2], cells: Vec<String>) -> Self {
        Self {
            heads: heads.map(str::to_owned),
            cells,
        }
    }

    /// The width of the widest header line or cell.
    pub(crate) fn width(&self) -> usize {
        self.heads
            .iter()
            .chain(&self.cells)
            .map(|text| text.chars().count())
            .max()
            .unwrap_or(0)
    }
}

/// Formats `columns` with `gap` between them, the first aligned to the left and the others to the right. A blank header
/// line is left out.
pub(crate) fn table<'a>(columns: impl Iterator<Item = &'a Column>, gap: &str) -> String {
    let columns: Vec<(&Column, usize)> = columns.map(|column| (column, column.width())).collect();
    let mut text = String::new();
    for head in 0..2 {
        let cells = columns.iter().map(|(column, width)| (&*column.heads[head], *width));
        push_line(&mut text, cells, gap);
    }
    let rows = columns.first().map_or(0, |(first, _)| first.cells.len());
    for row in 0..rows {
        let cells = columns.iter().map(|(column, width)| (&*column.cells[row], *width));
        push_line(&mut text, cells, gap);
    }
    text
}

/// Formats `columns` as [`table`] does, in lines of at most `width` characters: columns that do not fit are in further
/// tables below, which begin with the first column, too. A column of p-values stays beside the one that it is about.
pub(crate) fn fitted(columns: &[Column], gap: &str, width: usize) -> String {
    let Some((first, others)) = columns.split_first() else {
        return String::new();
    };
    let is_p = |column: &Column| column.heads.concat() == "p";
    let gap_width = gap.chars().count();
    let mut blocks = Vec::new();
    let mut block = vec![first];
    let mut used = first.width();
    for group in others.chunk_by(|_, next| is_p(next)) {
        let needed: usize = group.iter().map(|column| gap_width + column.width()).sum();
        if block.len() > 1 && used + needed > width {
            let full = std::mem::replace(&mut block, vec![first]);
            blocks.push(full);
            used = first.width();
        }
        block.extend(group);
        used += needed;
    }
    blocks.push(block);
    let tables: Vec<String> =
        blocks.into_iter().map(|block| table(block.into_iter(), gap)).collect();
    tables.join("\n")
}

/// Adds a line of cells, each with its width, to `text`, unless all are blank.
fn push_line<'a>(text: &mut String, cells: impl Iterator<Item = (&'a str, usize)>, gap: &str) {
    let mut line = String::new();
    for (index, (cell, width)) in cells.enumerate() {
        // Writing to a string cannot fail.
        let _ = match index {
            0 => write!(line, "{cell:<width$}"),
            _ => write!(line, "{gap}{cell:>width$}"),
        };
    }
    if !line.trim().is_empty() {
        text.push_str(line.trim_end());
        text.push('\n');
    }
}

/// Formats a figure with one decimal, or as `-` if there is none.
pub(crate) fn one_decimal(value: Option<f64>) -> String {
    or_dash(value.map(|value| format!("{value:.1}")))
}

/// Formats a figure with two decimals, or as `-` if there is none.
pub(crate) fn two_decimals(value: Option<f64>) -> String {
    or_dash(value.map(|value| format!("{value:.2}")))
}

/// Formats a difference with its sign. A sign of one that rounds to zero means nothing, and is always `+`.
pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = format!("{value:+.decimals$}");
    let is_zero = !text.contains(|digit: char| matches!(digit, '1'..='9'));
    if is_zero {
        text.replace('-', "+")
    } else {
        text
    }
}

/// Formats a figure with three decimals, or as `-` if there is none.
pub(crate) fn three_decimals(value: Option<f64>) -> String {
    or_dash(value.map(|value| format!("{value:.3}")))
}

pub(crate) fn or_dash(cell: Option<String>) -> String {
    cell.unwrap_or_else(|| "-".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_is_too_wide_goes_on_below_and_p_stays_beside_its_figure() {
        let column = |head: &str, cell: &str| Column::new([head, ""], vec![cell.to_owned()]);
        let columns = [
            column("policy", "albireo"),
            column("AP@50", "+0.5 [0.1, 0.9]"),
            column("p", "0.02"),
            column("mAP", "+0.3 [-0.1, 0.7]"),
            column("p", "0.2"),
        ];
        let whole = fitted(&columns, "  ", 60);
        assert_eq!(whole, table(columns.iter(), "  "));
        let expected = "policy             AP@50     p\n\
                        albireo  +0.5 [0.1, 0.9]  0.02\n\
                        \n\
                        policy                mAP    p\n\
                        albireo  +0.3 [-0.1, 0.7]  0.2\n";
        assert_eq!(fitted(&columns, "  ", 40), expected);
    }

    #[test]
    fn a_difference_that_rounds_to_zero_is_not_negative() {
        let texts = [-0.04, 0.0, -0.0, -0.06, 1.24].map(|value| signed(value, 1));
        assert_eq!(texts, ["+0.0", "+0.0", "+0.0", "-0.1", "+1.2"]);
    }
}
