//! Formats tables for a terminal.

use crate::cli::terminal::width;

/// Formats a table with headings such as `"node|>waiting"`, where `>` aligns a column to the right. Each column is as wide
/// as its widest cell; the last one is cut if the line is too long: cut, a row is read; wrapped, the rows are not.
pub(super) fn table<const N: usize>(
    headings: &str,
    rows: impl IntoIterator<Item = [String; N]>,
) -> String {
    // A name from the network must not move the cursor.
    let clean = |cell: String| cell.replace(char::is_control, " ");
    let headings: Vec<&str> = headings.split('|').collect();
    let plain = |heading: &&str| heading.trim_start_matches('>').to_owned();
    let mut lines: Vec<Vec<String>> = vec![headings.iter().map(plain).collect()];
    lines.extend(rows.into_iter().map(|row| row.map(clean).into()));
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
            cells.push(if headings[column].starts_with('>') {
                format!("{cell:>width$}")
            } else {
                format!("{cell:<width$}")
            });
        }
        text += &cut(cells.join("  ").trim_end(), longest);
        text.push('\n');
    }
    text
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

    #[test]
    fn a_table_is_aligned_and_never_wider_than_a_hundred_columns() {
        let row = |node: &str, u: &str, why: &str| [node, u, why].map(str::to_owned);
        let rows = [
            row("cam-1", "5e-4", "x"),
            row("bus-100", "0.01", &"long\n".repeat(40)),
        ];
        let text = table("node|>u|why", rows);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "node        u  why");
        assert_eq!(lines[1], "cam-1    5e-4  x");
        assert_eq!(lines.len(), 3);
        assert!(lines.iter().all(|line| line.chars().count() <= WIDTH));
    }
}
