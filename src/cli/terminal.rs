//! Fits text to the terminal.

use rustix::termios::tcgetwinsize;
use std::os::fd::AsFd;
use textwrap::{Options, WordSplitter};

/// The longest line, where the terminal is not narrower.
pub(super) const WIDTH: usize = 100;

/// The narrowest terminal that lines are made for.
const LEAST_WIDTH: usize = 60;

/// The columns of a terminal that lines are made for; `None` if `stream` is no terminal, or one that does not tell.
fn columns(stream: impl AsFd) -> Option<usize> {
    let size = tcgetwinsize(stream).ok()?;
    let columns = usize::from(size.ws_col);
    (columns > 0).then(|| columns.clamp(LEAST_WIDTH, WIDTH))
}

/// The longest line of a table on standard output.
#[cfg(any(feature = "eval", feature = "hub"))]
pub(super) fn width() -> usize {
    columns(std::io::stdout()).unwrap_or(WIDTH)
}

/// The longest line of other text on standard output. Without a terminal there is no limit: a program reads one line
/// for each fact, however long.
pub(super) fn line_width() -> usize {
    columns(std::io::stdout()).unwrap_or(usize::MAX)
}

/// Breaks each line of `text` that is longer than `width` at spaces; what follows is indented by `indent` spaces more
/// than the line itself.
fn hanging(text: &str, width: usize, indent: usize) -> String {
    let fit = |line: &str| {
        let own = line.len() - line.trim_start_matches(' ').len();
        broken(line, width, own + indent)
    };
    text.lines().map(fit).collect::<Vec<_>>().join("\n")
}

/// Breaks a line that is longer than `width` at spaces; what follows begins in this column. A longer word, such as a
/// path, stays whole.
pub(super) fn broken(line: &str, width: usize, column: usize) -> String {
    let below = " ".repeat(column);
    let options = Options::new(width)
        .subsequent_indent(&below)
        .break_words(false)
        .word_splitter(WordSplitter::NoHyphenation);
    textwrap::fill(line, options)
}

/// The program's name as it was called, so that a printed command works where the program is not on the PATH.
#[cfg(any(feature = "eval", feature = "hub"))]
pub(super) fn program() -> String {
    std::env::args().next().unwrap_or_else(|| "albireo".to_owned())
}

/// Prints a line, and what does not fit the terminal below it, indented.
pub(super) fn print(line: &str) {
    println!("{}", hanging(line, line_width(), 2));
}

/// Breaks the lines of an error for the terminal of standard error, if it is one.
pub(super) fn error(text: &str) -> String {
    hanging(text, columns(std::io::stderr()).unwrap_or(usize::MAX), 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_goes_on_indented_and_a_path_stays_whole() {
        let text = "note: /a/path/of-twenty-four-chars/is-whole-here cannot be read\n  key: is far too long";
        let expected = "note:\n  /a/path/of-twenty-four-chars/is-whole-here\n  cannot be read\n  key: is far too\n    long";
        assert_eq!(hanging(text, 20, 2), expected);
        assert_eq!(hanging(text, usize::MAX, 2), text);
    }
}
