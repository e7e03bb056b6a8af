//! Formats tables for a terminal.

use crate::cli::terminal::width;

/// Most characters of a cell that is not the last of its row: a long name leaves room for the other columns.
const LONGEST_CELL: usize = 40;

/// Formats a table with headings such as `"node|>waiting"`, where `>` aligns a column to the right. Each column is as
/// wide as its widest cell, up to [`LONGEST_CELL`]. A line that is too long is cut, because rows that wrap cannot be read.
pub(super) fn table<const N: usize>(
    headings: &str,
    rows: impl IntoIterator<Item = [String; N]>,
) -> String {
    let headings: Vec<&str> = headings.split('|').collect();
    let plain = |heading: &&str| heading.trim_start_matches('>').to_owned();
    let mut lines: Vec<Vec<String>> = vec![headings.iter().map(plain).collect()];
    for row in rows {
        let mut cells = row.map(|cell| printable(&cell));
        // The end of the line cuts the last one.
        for cell in cells.iter_mut().rev().skip(1) {
            *cell = cut(cell, LONGEST_CELL);
        }
        lines.push(Vec::from(cells));
    }
    let mut widths = vec![0; headings.len()];
    for line in &lines {
        for (width, cell) in widths.iter_mut().zip(line) {
            *width = cell.chars().count().max(*width);
        }
    }
    let longest = width();
    let mut text = String::new();
    for line in &lines {
        let mut cells = Vec::new();
        for (column, cell) in line.iter().enumerate() {
            let width = widths[column];
            let aligned = if headings[column].starts_with('>') {
                format!("{cell:>width$}")
            } else {
                format!("{cell:<width$}")
            };
            cells.push(aligned);
        }
        text += &cut(cells.join("  ").trim_end(), longest);
        text.push('\n');
    }
    text
}

/// A text from the network as it can be printed: it must not move the cursor.
pub(super) fn printable(text: &str) -> String {
    text.replace(char::is_control, " ")
}

/// Cuts the text to at most `width` characters.
pub(super) fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mut text: String = text.chars().take(width.saturating_sub(1)).collect();
    text.push('…');
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::terminal::WIDTH;

    fn row(node: &str, u: &str, why: &str) -> [String; 3] {
        [node, u, why].map(str::to_owned)
    }

    #[test]
    fn the_columns_of_a_table_are_aligned() {
        let rows = [row("cam-1", "5e-4", "x"), row("bus-100", "0.01", "y")];
        let expected = "node        u  why\ncam-1    5e-4  x\nbus-100  0.01  y\n";
        assert_eq!(table("node|>u|why", rows), expected);
    }

    #[test]
    fn a_long_name_leaves_room_for_the_other_columns_of_every_row() {
        let rows = [
            row(&"n".repeat(300), "5e-4", "x"),
            row("cam-1", "0.01", "y"),
        ];
        let text = table("node|>u|why", rows);
        for expected in ["n…  5e-4  x\n", "  0.01  y\n"] {
            assert!(text.contains(expected), "{text}");
        }
    }

    #[test]
    fn a_row_is_one_line_of_at_most_a_hundred_columns() {
        let long = row("bus-100", "0.01", &"long\n".repeat(40));
        let text = table("node|>u|why", [long]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2);
        assert!(lines.iter().all(|line| line.chars().count() <= WIDTH));
    }
}
