//! Formats text and tables for a terminal.

use std::fmt::Write;

/// Breaks `text` at white space into lines of at most `width` columns; a longer word gets a line of its own.
pub fn wrapped(text: &str, width: usize) -> String {
    let mut lines = String::new();
    let mut used = 0;
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if used > 0 && used + 1 + length > width {
            lines.push('\n');
            used = 0;
        } else if used > 0 {
            lines.push(' ');
            used += 1;
        }
        lines.push_str(word);
        used += length;
    }
    lines
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
        let texts = self.heads.iter().chain(&self.cells);
        texts.map(|text| text.chars().count()).max().unwrap_or(0)
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
    let is_zero = !text.contains(|digit: char| digit.is_ascii_digit() && digit != '0');
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
    fn a_difference_that_rounds_to_zero_is_not_negative() {
        let texts = [-0.04, 0.0, -0.0, -0.06, 1.24].map(|value| signed(value, 1));
        assert_eq!(texts, ["+0.0", "+0.0", "+0.0", "-0.1", "+1.2"]);
    }
}
