//! Promises of the supervised child.

use super::*;
use std::path::Path;

fn shell(script: &str) -> LineChild {
    let arguments = ["-c".to_owned(), script.to_owned()];
    LineChild::start(Path::new("/bin/sh"), &arguments).unwrap()
}

/// Takes lines until there are `count` of them.
fn lines(child: &LineChild, count: usize) -> Vec<String> {
    let mut found = Vec::new();
    while found.len() < count {
        assert!(
            child.wait_for_line(Duration::from_secs(20)),
            "only {found:?}"
        );
        found.extend(child.take().into_iter().map(|(_, line)| line));
    }
    found
}

/// Whether a process of that number is there, be it as a zombie.
fn exists(process: u32) -> bool {
    Path::new(&format!("/proc/{process}")).exists()
}

#[test]
fn lines_come_with_rising_times_and_the_child_is_gone_with_its_owner() {
    let child = shell("while :; do echo tick; sleep 0.02; done");
    let process = child.process().unwrap();
    let mut times = Vec::new();
    while times.len() < 5 {
        assert!(child.wait_for_line(Duration::from_secs(20)));
        times.extend(child.take().into_iter().map(|(at, _)| at));
    }
    assert!(times.windows(2).all(|pair| pair[0] <= pair[1]));
    assert!(exists(process));
    drop(child);
    assert!(!exists(process), "neither running nor a zombie");
}

#[test]
fn a_child_that_ends_is_started_again_and_leaves_no_zombie() {
    let child = shell("echo $$; exit 3");
    let processes = lines(&child, 3);
    assert!(child.starts() >= 3);
    assert_eq!(child.trouble().unwrap(), "it ended with exit status: 3");
    // The first two have been waited for, or the third could not have been started.
    for process in &processes[..2] {
        assert!(!exists(process.parse().unwrap()));
    }
}

#[test]
fn a_silent_child_is_killed_and_started_again() {
    let child = shell("echo here; exec sleep 1000");
    assert_eq!(lines(&child, 1), ["here"]);
    let stalled = child.process().unwrap();
    let later = Instant::now() + Duration::from_secs(60);
    child.kill_if_silent(later, Duration::from_secs(5));
    assert_eq!(lines(&child, 1), ["here"]);
    assert_ne!(child.process(), Some(stalled));
    assert!(!exists(stalled));
}

#[test]
fn a_line_cut_off_by_the_childs_death_is_not_given_out() {
    let child = shell("echo whole; printf 'VDD_IN 49'");
    assert_eq!(lines(&child, 2), ["whole", "whole"]);
}

#[test]
fn a_program_that_is_not_there_is_an_error_at_once() {
    let error = LineChild::start(Path::new("/nowhere/tegrastats"), &[]).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::NotFound);
}

#[test]
fn lines_nobody_takes_do_not_fill_the_memory() {
    let child = shell(
        "i=0; while [ $i -lt 2000 ]; do echo $i; i=$((i+1)); done; echo end; exec sleep 1000",
    );
    let given_up = std::time::Instant::now() + Duration::from_secs(60);
    loop {
        let last = child
            .shared
            .state
            .lock()
            .lines
            .back()
            .map(|(_, l)| l.clone());
        if last.as_deref() == Some("end") {
            break;
        }
        assert!(std::time::Instant::now() < given_up);
        std::thread::yield_now();
    }
    assert_eq!(child.take().len(), MOST_LINES);
}
