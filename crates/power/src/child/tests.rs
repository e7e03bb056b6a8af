//! Promises of the supervised child.

use super::*;
use std::path::Path;

fn shell(script: &str) -> LineChild {
    let arguments = ["-c".to_owned(), script.to_owned()];
    LineChild::start(Path::new("/bin/sh"), &arguments).unwrap()
}

const LONG: Duration = Duration::from_secs(60);

/// Takes lines until there are `count` of them.
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
    let found = lines(child, count).into_iter();
    found.map(|(_, line)| line).collect()
}

/// Whether a process of that number is there, be it as a zombie.
fn exists(process: u32) -> bool {
    Path::new(&format!("/proc/{process}")).exists()
}

#[test]
fn lines_come_with_rising_times_and_the_child_is_gone_with_its_owner() {
    let mut child = shell("while :; do echo tick; sleep 0.02; done");
    let process = child.process().unwrap();
    let found = lines(&mut child, 5);
    assert!(found.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    assert!(exists(process));
    drop(child);
    assert!(!exists(process), "neither running nor a zombie");
}

#[test]
fn a_child_that_ends_is_started_again_and_leaves_no_zombie() {
    let mut child = shell("echo $$; exit 3");
    let processes = texts(&mut child, 3);
    assert_eq!(child.trouble().unwrap(), "it ended with exit status: 3");
    // The first two have been waited for, or the third could not have been started.
    for process in &processes[..2] {
        assert!(!exists(process.parse().unwrap()));
    }
}

#[test]
fn a_silent_child_is_killed_and_started_again() {
    let mut child = shell("echo here; exec sleep 1000");
    assert_eq!(texts(&mut child, 1), ["here"]);
    let stalled = child.process().unwrap();
    // It has been silent for longer than not at all, and started long enough ago.
    std::thread::sleep(PAUSE);
    child.take(Duration::ZERO);
    assert_eq!(texts(&mut child, 1), ["here"]);
    assert_ne!(child.process(), Some(stalled));
    assert!(!exists(stalled));
    assert!(child.trouble().unwrap().contains("printed nothing"));
}

#[test]
fn a_line_cut_off_by_the_childs_death_is_not_given_out() {
    let mut child = shell("echo whole; printf 'VDD_IN 49'");
    assert_eq!(texts(&mut child, 2), ["whole", "whole"]);
}

#[test]
fn a_program_that_is_not_there_is_an_error_at_once() {
    let error = LineChild::start(Path::new("/nowhere/tegrastats"), &[]).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::NotFound);
}

#[test]
fn lines_nobody_takes_do_not_fill_the_memory() {
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
    // What the pipe still held is read, and dropped, by now or in a moment.
    let found = lines(&mut child, MOST_LINES);
    assert!(found.len() <= MOST_LINES + 1, "{}", found.len());
}
