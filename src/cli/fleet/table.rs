//! Tables that fit a terminal of 100 columns.

/// Widest line.
pub(super) const WIDTH: usize = 100;

/// A table: each column as wide as its widest cell, the last one cut where the line would be too wide.
#[derive(Debug)]
pub(super) struct Table {
    /// Whether a column is aligned to the right.
    right: Vec<bool>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with those headings; one after `>` is aligned to the right.
    pub(super) fn new(headings: &[&str]) -> Self {
        let plain = |heading: &&str| heading.trim_start_matches('>').to_owned();
        Self {
            right: headings
                .iter()
                .map(|heading| heading.starts_with('>'))
                .collect(),
            rows: vec![headings.iter().map(plain).collect()],
        }
    }

    pub(super) fn row(&mut self, cells: impl IntoIterator<Item = impl Into<String>>) {
        // A name from the network shall not move the cursor.
        let clean = |cell: String| {
            cell.chars()
                .map(|c| if c.is_control() { ' ' } else { c })
                .collect()
        };
        self.rows
            .push(cells.into_iter().map(|cell| clean(cell.into())).collect());
    }
}

impl std::fmt::Display for Table {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let count = |cell: &String| cell.chars().count();
        let width = |column: usize| {
            self.rows
                .iter()
                .filter_map(|row| row.get(column).map(count))
                .max()
                .unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.right.len()).map(width).collect();
        for row in &self.rows {
            let mut line = String::new();
            for (column, cell) in row.iter().enumerate() {
                let wide = widths.get(column).copied().unwrap_or(0);
                if column > 0 {
                    line.push_str("  ");
                }
                if self.right.get(column) == Some(&true) {
                    line.push_str(&format!("{cell:>wide$}"));
                } else {
                    line.push_str(&format!("{cell:<wide$}"));
                }
            }
            writeln!(f, "{}", cut(line.trim_end(), WIDTH))?;
        }
        Ok(())
    }
}

/// The text in at most `width` characters.
pub(super) fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mut text: String = text.chars().take(width.saturating_sub(1)).collect();
    text.push('…');
    text
}

/// The text in lines of at most [`WIDTH`] characters, broken between words; all but the first begin behind `indent`.
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
        assert!(
            broken.starts_with("   3 s ago seven")
                && broken.lines().skip(1).all(
                    |line| line.starts_with("           s") || line.starts_with("           l")
                )
        );
        assert_eq!(
            broken.split_whitespace().collect::<Vec<_>>(),
            text.split_whitespace().collect::<Vec<_>>()
        );
    }

    #[test]
    fn a_table_is_aligned_and_never_wider_than_a_hundred_columns() {
        let mut table = Table::new(&["node", ">u", "why"]);
        table.row(["cam-1", "5e-4", "x"]);
        table.row(["bus-100".to_owned(), "0.01".to_owned(), "long\n".repeat(40)]);
        let text = table.to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "node        u  why");
        assert_eq!(lines[1], "cam-1    5e-4  x");
        assert_eq!(lines.len(), 3);
        assert!(lines.iter().all(|line| line.chars().count() <= WIDTH));
    }
}
