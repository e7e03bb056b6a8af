use super::*;
use crate::tests::assert_contains;
use std::path::Path;

fn shell(script: &str) -> LineChild {
    let arguments = ["-c".to_owned(), script.to_owned()];
    LineChild::start(Path::new("/bin/sh"), &arguments, PAUSE).unwrap()
}

const LONG: Duration = Duration::from_secs(60);

fn lines(child: &mut LineChild, count: usize) -> Vec<(Instant, String)> {
    let mut found = Vec::new();
    let given_up = std::time::Instant::now() + Duration::from_secs(20);
    while found.len() < count {
        assert!(std::time::Instant::now() < given_up, "only {found:?}");
        found.extend(child.take(LONG));
        std::thread::sleep(Duration::from_millis(1));
    }
    found
}

fn texts(child: &mut LineChild, count: usize) -> Vec<String> {
    lines(child, count).into_iter().map(|(_, line)| line).collect()
}

fn exists(process: u32) -> bool {
    Path::new(&format!("/proc/{process}")).exists()
}

#[test]
fn timestamps_never_decrease_and_drop_ends_and_reaps_the_child() {
    let mut child = shell("while :; do echo tick; sleep 0.02; done");
    let process = child.process().unwrap();
    let found = lines(&mut child, 5);
    assert!(found.is_sorted_by_key(|(at, _)| *at));
    assert!(exists(process));
    drop(child);
    assert!(!exists(process), "neither running nor a zombie");
}

#[test]
fn an_exited_child_is_restarted_and_leaves_no_zombie_and_no_unfinished_line() {
    let mut child = shell("echo $$; printf 'VDD_IN 49'; exit 3");
    let processes = texts(&mut child, 3);
    let trouble = child.trouble.as_deref();
    assert_eq!(trouble, Some("it ended with exit status: 3"));
    // The third child starts only after the first two were reaped.
    for process in &processes[..2] {
        assert!(!exists(process.parse().unwrap()));
    }
}

#[test]
fn the_last_line_of_the_error_output_is_part_of_the_fault() {
    let mut child = shell("echo here; printf 'first\\n  broken\\n\\n' >&2; exit 3");
    assert_eq!(texts(&mut child, 2), ["here", "here"]);
    let trouble = child.trouble.as_deref();
    assert_eq!(trouble, Some("it ended with exit status: 3: broken"));
}

#[test]
fn a_child_with_much_error_output_goes_on() {
    let mut child = shell("head -c 300000 /dev/zero >&2; echo here; exec sleep 1000");
    assert_eq!(texts(&mut child, 1), ["here"]);
}

/// What remains of an over-long line must not be taken for a line of its own: a meter would read numbers from its middle.
#[test]
fn a_line_that_is_too_long_is_passed_over_whole() {
    let mut child = shell(
        "head -c 70000 /dev/zero | tr '\\0' 7; echo ' VDD_IN 49'; echo here; exec sleep 1000",
    );
    assert_eq!(texts(&mut child, 1), ["here"]);
}

#[test]
fn a_silent_child_is_killed_and_restarted() {
    let mut child = shell("echo here; exec sleep 1000");
    assert_eq!(texts(&mut child, 1), ["here"]);
    let stalled = child.process().unwrap();
    // Any silence exceeds a limit of zero, and the pause since the start has passed.
    std::thread::sleep(PAUSE);
    child.take(Duration::ZERO);
    assert_eq!(texts(&mut child, 1), ["here"]);
    assert_ne!(child.process(), Some(stalled));
    assert!(!exists(stalled));
    assert_contains(child.trouble.as_deref().unwrap(), &["printed nothing"]);
}

#[test]
fn the_backlog_of_unread_lines_is_bounded() {
    let folder = tempfile::tempdir().unwrap();
    let done = folder.path().join("done");
    let mut child = shell(&format!(
        "i=0; while [ $i -lt 2000 ]; do echo $i; i=$((i+1)); done; touch '{}'; exec sleep 1000",
        done.display()
    ));
    let given_up = std::time::Instant::now() + LONG;
    while !done.exists() {
        assert!(std::time::Instant::now() < given_up);
        std::thread::sleep(Duration::from_millis(5));
    }
    // The rest of the pipe is read and dropped now or shortly after.
    let found = lines(&mut child, MOST_LINES);
    assert!(found.len() <= MOST_LINES + 1, "{}", found.len());
}
