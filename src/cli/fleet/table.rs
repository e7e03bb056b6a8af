//! Formats tables for a terminal of 100 columns.

/// The longest line.
pub(super) const WIDTH: usize = 100;

/// Formats a table with headings such as `"node|>waiting"`, where `>` aligns a column to the right. Each column is as wide
/// as its widest cell; the last one is cut if the line is too long.
pub(super) fn table<const N: usize>(
    headings: &str,
    rows: impl IntoIterator<Item = [String; N]>,
) -> String {
    // A name from the network must not move the cursor.
    let clean = |cell: String| cell.replace(char::is_control, " ");
    let headings: Vec<&str> = headings.split('|').collect();
    let plain = |heading: &&str| heading.trim_start_matches('>').to_owned();
    let mut lines: Vec<Vec<String>> = vec![headings.iter().map(plain).collect()];
    lines.extend((rows.into_iter()).map(|row| row.map(clean).into()));
    let width = |column: usize| {
        let widths = lines.iter().map(|line| line[column].chars().count());
        widths.max().unwrap_or(0)
    };
    let shown = |line: &Vec<String>| {
        let cells = line.iter().zip(&headings).enumerate();
        let cells = cells.map(|(column, (cell, heading))| {
            let wide = width(column);
            match heading.starts_with('>') {
                true => format!("{cell:>wide$}"),
                false => format!("{cell:<wide$}"),
            }
        });
        let cells: Vec<String> = cells.collect();
        cut(cells.join("  ").trim_end(), WIDTH) + "\n"
    };
    lines.iter().map(shown).collect()
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

/// Breaks the text between words into lines of at most [`WIDTH`] characters; all but the first begin with `indent`.
pub(super) fn wrapped(text: &str, indent: usize) -> String {
    let first = text.len() - text.trim_start().len();
    let mut lines = vec![text[..first].to_owned()];
    let mut empty = true;
    for word in text.split_whitespace() {
        let line = lines.last().map_or(0, |line| line.chars().count());
        if !empty && line + 1 + word.chars().count() > WIDTH {
            lines.push(" ".repeat(indent));
            empty = true;
        }
        if let Some(line) = lines.last_mut() {
            if !empty {
                line.push(' ');
            }
            line.push_str(word);
        }
        empty = false;
    }
    lines.iter().map(|line| cut(line, WIDTH) + "\n").collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_is_broken_between_words_and_loses_none() {
        let text = format!("   3 s ago {}", "seven letters ".repeat(20));
        let broken = wrapped(&text, 11);
        assert!(broken.lines().count() > 2);
        assert!(broken.lines().all(|line| line.chars().count() <= WIDTH));
        assert!(broken.starts_with("   3 s ago seven"));
        let indented = ["           s", "           l"];
        let is_indented = |line: &str| indented.iter().any(|begin| line.starts_with(begin));
        assert!(broken.lines().skip(1).all(is_indented));
        assert!(broken.split_whitespace().eq(text.split_whitespace()));
    }

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
