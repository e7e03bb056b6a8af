//! Help that fits a terminal of 80 columns, written once: paragraphs are filled, examples keep their lines, and one that is
//! too long has its explanation below it.

use clap::Command;
use std::fmt::Write;

/// Columns of a terminal.
pub(crate) const WIDTH: usize = 80;

/// The command and all below it, their closing texts made to fit.
pub(super) fn fitted(command: Command) -> Command {
    let after = command.get_after_help().map(ToString::to_string);
    let command = command.mut_subcommands(fitted).max_term_width(WIDTH);
    match after {
        Some(text) => command.after_help(fit(&text)),
        None => command,
    }
}

/// The subcommands in groups, in the order in which a newcomer uses them.
const GROUPS: [(&str, &[&str]); 6] = [
    ("Start", &["demo", "check", "detect", "power", "compare"]),
    ("Cameras", &["publish", "replay"]),
    ("Node", &["node", "diag"]),
    (
        "Fleet",
        &["router", "cert", "acl", "hub", "fleet", "simulate"],
    ),
    ("Evaluation", &["eval"]),
    ("Setup", &["man", "completions", "help"]),
];

/// The list of subcommands under headings. One that is in no group comes last, under none.
pub(super) fn grouped(command: Command) -> Command {
    // Clap makes `help` when it parses; here it is only spoken of.
    let help =
        Command::new("help").about("Print this message or the help of the given subcommand(s)");
    let (heading, literal) = {
        let styles = command.get_styles();
        (*styles.get_header(), *styles.get_literal())
    };
    let width = (command.get_subcommands())
        .map(|sub| sub.get_name().len())
        .max()
        .unwrap_or(0);
    let mut text = "{before-help}{about-with-newline}\n{usage-heading} {usage}\n".to_owned();
    let entry = |text: &mut String, sub: &Command| {
        let about = sub.get_about().map(ToString::to_string).unwrap_or_default();
        let name = sub.get_name();
        let indent = " ".repeat(width + 4);
        let lines = filled(about.split_whitespace(), &indent, &indent).join("\n");
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  {literal}{name}{literal:#}{}{}",
            " ".repeat(width + 2 - name.len()),
            lines.trim_start()
        );
    };
    let visible = |sub: &&Command| !sub.is_hide_set();
    for (name, members) in GROUPS {
        let subs = (command.get_subcommands()).chain([&help]).filter(visible);
        let subs: Vec<_> = subs
            .filter(|sub| members.contains(&sub.get_name()))
            .collect();
        if !subs.is_empty() {
            let _ = writeln!(text, "\n{heading}{name}:{heading:#}");
            for name in members {
                for sub in subs.iter().filter(|sub| sub.get_name() == *name) {
                    entry(&mut text, sub);
                }
            }
        }
    }
    let rest = (command.get_subcommands())
        .filter(visible)
        .filter(|sub| !(GROUPS.iter()).any(|(_, members)| members.contains(&sub.get_name())));
    for (index, sub) in rest.enumerate() {
        if index == 0 {
            text.push('\n');
        }
        entry(&mut text, sub);
    }
    let _ = write!(
        text,
        "\n{heading}Options:{heading:#}\n{{options}}{{after-help}}"
    );
    command.help_template(text)
}

/// Fills paragraphs and folds examples. A line that begins with a blank, or ends with a colon, stands for itself.
fn fit(text: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut paragraph: Vec<&str> = Vec::new();
    for line in text.lines() {
        let own = line.is_empty() || line.starts_with(' ') || line.ends_with(':');
        if !own {
            paragraph.push(line);
            continue;
        }
        fill(&mut paragraph, &mut lines);
        fold(line, &mut lines);
    }
    fill(&mut paragraph, &mut lines);
    lines.join("\n")
}

/// The words of a paragraph in lines that fit.
fn fill(paragraph: &mut Vec<&str>, lines: &mut Vec<String>) {
    let words = paragraph.iter().flat_map(|line| line.split_whitespace());
    lines.extend(filled(words, "", ""));
    paragraph.clear();
}

/// Words in lines that fit: the first line begins with `first`, the others with `rest`.
fn filled<'a>(words: impl Iterator<Item = &'a str>, first: &str, rest: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    let mut line = first.to_owned();
    let mut bare = true;
    for word in words {
        if !bare && line.chars().count() + 1 + word.chars().count() > WIDTH {
            lines.push(std::mem::replace(&mut line, rest.to_owned()));
            bare = true;
        }
        if !bare {
            line.push(' ');
        }
        line.push_str(word);
        bare = false;
    }
    if !bare {
        lines.push(line);
    }
    lines
}

/// An example: as it is where it fits, else its explanation on a line of its own, and a long command in several.
fn fold(line: &str, lines: &mut Vec<String>) {
    if line.chars().count() <= WIDTH {
        return lines.push(line.to_owned());
    }
    let start = line.len() - line.trim_start().len();
    let (indent, content) = line.split_at(start);
    // Deeper than a command stands what is said of the one above.
    if start > 4 {
        return lines.extend(filled(content.split_whitespace(), indent, indent));
    }
    let explained = content
        .find("   ")
        .map(|at| (content[..at].trim_end(), content[at..].trim()));
    let (command, explanation) = explained.unwrap_or((content, ""));
    // A line of a command that goes on ends with a backslash, so that it can be copied.
    let deeper = format!("{indent}    ");
    let mut folded: Vec<String> = Vec::new();
    let mut rest = command;
    let mut prefix = indent.to_owned();
    while prefix.len() + rest.chars().count() > WIDTH {
        let room = WIDTH - 2 - prefix.len();
        let cut = rest
            .char_indices()
            .take_while(|(at, _)| *at <= room)
            .filter(|(at, letter)| *letter == ' ' && rest[at + 1..].starts_with("--"))
            .last()
            .or_else(|| {
                let blanks = rest.char_indices().take_while(|(at, _)| *at <= room);
                blanks.filter(|(_, letter)| *letter == ' ').last()
            });
        let Some((cut, _)) = cut else { break };
        folded.push(format!("{prefix}{} \\", &rest[..cut]));
        rest = rest[cut..].trim_start();
        prefix.clone_from(&deeper);
    }
    folded.push(format!("{prefix}{rest}"));
    lines.extend(folded);
    lines.extend(filled(explanation.split_whitespace(), &deeper, &deeper));
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn no_help_is_wider_than_a_terminal_and_no_line_is_broken_twice() {
        fn look(mut command: Command, path: &str, seen: &mut usize) {
            *seen += 1;
            let help = command.render_long_help().to_string();
            // The line of the usage is never broken.
            for line in help.lines().filter(|line| !line.starts_with("Usage:")) {
                assert!(line.chars().count() <= WIDTH, "{path}: {line}");
            }
            let closing = command.get_after_help().map(ToString::to_string);
            // A closing text that fits is not broken again.
            for line in closing.iter().flat_map(|closing| closing.lines()) {
                assert!(help.lines().any(|shown| shown == line), "{path}: {line}");
            }
            for sub in command.get_subcommands() {
                look(sub.clone(), &format!("{path} {}", sub.get_name()), seen);
            }
        }
        let mut command = fitted(super::super::Arguments::command()).term_width(WIDTH);
        command.build();
        let mut seen = 0;
        look(command, "albireo", &mut seen);
        assert!(seen > 20, "{seen}");
    }

    #[test]
    fn every_subcommand_is_in_a_group_and_shown_once_under_its_heading() {
        let mut command = grouped(fitted(super::super::Arguments::command()));
        let help = command.render_help().to_string();
        let mut heading = String::new();
        let mut shown: Vec<(String, String)> = Vec::new();
        for line in help.lines() {
            assert!(line.chars().count() <= WIDTH, "{line}");
            if let Some(name) = line.strip_suffix(':') {
                heading = name.to_owned();
            } else if let Some(name) = line
                .strip_prefix("  ")
                .and_then(|line| line.split(' ').next())
                && !name.is_empty()
            {
                shown.push((heading.clone(), name.to_owned()));
            }
        }
        for sub in command.get_subcommands() {
            let name = sub.get_name();
            let group = GROUPS.iter().find(|(_, members)| members.contains(&name));
            let (group, _) = group.unwrap_or_else(|| panic!("{name} is in no group"));
            let places: Vec<_> = (shown.iter())
                .filter(|(heading, shown)| shown == name && heading != "Examples")
                .map(|(heading, _)| heading.as_str())
                .collect();
            assert_eq!(places, [*group], "{name}:\n{help}");
        }
        assert!(help.contains("--version"), "{help}");
    }

    #[test]
    fn a_paragraph_is_filled_and_an_example_too_long_is_explained_below() {
        let text = "A first line\nof a paragraph.\n\nExamples:\n  albireo short        says little\n  albireo rollout start \
                    5e-4 --select all --stages 1,10%,50%,100% --soak 30m --gate 'joules<=+5%'    as far as it is good";
        assert_eq!(
            fit(text),
            "A first line of a paragraph.\n\nExamples:\n  albireo short        says little\n  albireo rollout start 5e-4 \
             --select all --stages 1,10%,50%,100% --soak 30m \\\n      --gate 'joules<=+5%'\n      as far as it is good"
        );
    }
}
