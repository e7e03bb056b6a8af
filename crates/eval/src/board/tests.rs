use super::*;
use crate::spec::BASELINE;
use crate::text::WIDTH;
use albireo_wire::{BoardState, ClipReport, FrameStates};
use std::fs;
use std::path::{Path, PathBuf};

fn setup() -> Setup {
    Setup {
        detector: "yolo".to_owned(),
        precision: "fp16".to_owned(),
        power_mode: "15 W".to_owned(),
        machine: "board".to_owned(),
        settings: [
            ("detector.model", "ab"),
            (FRAMES, "unpaced"),
            (JUDGED_BY, "labels"),
        ]
        .map(|(key, value)| (key.to_owned(), value.to_owned()))
        .into(),
    }
}

/// Opens the file of the runs of `setup`, as a second command does that goes on where the first was stopped.
fn opened(folder: &Path, setup: &Setup) -> Result<RunsFile, EvalError> {
    let restart = false;
    RunsFile::open(folder, setup, restart)
}

fn run(clip: &str, policy: &str, joules: f64, ap50: f64) -> ClipRun {
    let skipped = if policy == BASELINE { 0 } else { 20 };
    ClipRun {
        clip: clip.to_owned(),
        policy: policy.to_owned(),
        content: "1280x720".to_owned(),
        frames: 100,
        dropped: 0,
        unlabelled: 0,
        states: FrameStates {
            p: skipped,
            i: 100 - skipped,
            ..FrameStates::default()
        },
        degraded: 0,
        detector_calls: 100 - skipped,
        duration_s: 10.0,
        frame_ms: Some(50.0),
        ap50: Some(ap50),
        map: Some(ap50 / 2.0),
        joules: Some(joules),
        domains: [
            ("gpu".to_owned(), joules / 2.0),
            ("cpu".to_owned(), joules / 4.0),
        ]
        .into(),
        estimated: false,
        energy_of: "input_rail".to_owned(),
        cpu_s: Some(12.0),
        gpu_utilisation: None,
        memory_mb: Some(310.0),
        traces: [("total", 6.0), ("gpu", 4.0), ("cpu", 1.0)]
            .map(|(domain, watts)| (domain.to_owned(), vec![[0.1, 5.0], [0.2, watts]]))
            .into(),
        throttled: false,
    }
}

#[test]
fn a_run_survives_a_stop_and_a_line_cut_off_by_it_is_played_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = opened(folder.path(), &setup()).unwrap();
    for clip in ["a", "b"] {
        file.add(run(clip, BASELINE, 10.0, 0.5)).unwrap();
    }
    let path = file.path().to_owned();
    drop(file);
    let whole = fs::read(&path).unwrap();
    // Every place at which writing the second run can have been cut off.
    let second = whole[..whole.len() - 1].iter().rposition(|byte| *byte == b'\n').unwrap() + 1;
    for cut in second..whole.len() {
        fs::write(&path, &whole[..cut]).unwrap();
        let mut file = opened(folder.path(), &setup()).unwrap();
        assert!(file.has("a", BASELINE), "cut at {cut}");
        assert!(!file.has("b", BASELINE), "cut at {cut}");
        file.add(run("b", BASELINE, 10.0, 0.5)).unwrap();
        drop(file);
        assert_eq!(fs::read(&path).unwrap(), whole, "cut at {cut}");
    }
}

#[test]
fn the_power_of_a_traced_clip_is_drawn_with_a_line_for_each_policy() {
    let runs = vec![
        run("a", "albireo-u3e-4", 8.0, 0.5),
        run("a", BASELINE, 10.0, 0.5),
    ];
    let setups = [SetupRuns {
        setup: setup(),
        runs,
    }];
    let summaries = summary::summarise_all(&setups);
    let plots = figures::figures(&setups, &summaries).unwrap();
    let trace = plots.iter().find(|plot| plot.name == "power-trace-1").unwrap();
    for words in ["vanilla", "albireo", "Seconds of a", "Watts"] {
        assert!(trace.svg.contains(words), "{words}");
    }
    assert!(!plots.iter().any(|plot| plot.name == "power-trace-2"));
    let parts = plots.iter().find(|plot| plot.name == "power-domains-1").unwrap();
    for words in ["vanilla cpu", "vanilla gpu", "albireo-u3e-4 gpu"] {
        assert!(parts.svg.contains(words), "{words}");
    }
    assert!(!parts.svg.contains("total"));
}

/// A setup in which one setting has another value, or, with `None`, no value.
fn changed(key: &str, value: Option<&str>) -> Setup {
    let mut changed = setup();
    changed.settings.remove(key);
    if let Some(value) = value {
        changed.settings.insert(key.to_owned(), value.to_owned());
    }
    changed
}

#[test]
fn runs_with_other_settings_are_not_added_to_a_file() {
    let folder = tempfile::tempdir().unwrap();
    drop(opened(folder.path(), &setup()).unwrap());
    for (key, value, expected) in [
        (
            "detector.model",
            Some("cd"),
            "detector.model was ab, and now is cd",
        ),
        (FRAMES, None, "frames was unpaced, and now is not set"),
        (
            "screen.model",
            Some("ef"),
            "screen.model was not set, and now is ef",
        ),
    ] {
        let other = changed(key, value);
        let refused = opened(folder.path(), &other).unwrap_err().to_string();
        for words in [expected, "--out", "--restart"] {
            assert!(refused.contains(words), "{refused}");
        }
    }
}

#[test]
fn another_precision_has_a_file_of_its_own() {
    let other = Setup {
        precision: "fp32".to_owned(),
        ..setup()
    };
    assert_ne!(other.file_name(), setup().file_name());
    let folder = tempfile::tempdir().unwrap();
    drop(opened(folder.path(), &setup()).unwrap());
    drop(opened(folder.path(), &other).unwrap());
}

/// Writes a file of one run, and returns its path.
fn file_with_a_run(folder: &Path) -> PathBuf {
    let mut file = opened(folder, &setup()).unwrap();
    file.add(run("a", BASELINE, 10.0, 0.5)).unwrap();
    file.path().to_owned()
}

#[test]
fn a_restart_keeps_the_runs_before_in_a_file_beside() {
    let folder = tempfile::tempdir().unwrap();
    let path = file_with_a_run(folder.path());
    let before = fs::read(&path).unwrap();
    let other = changed(FRAMES, Some("paced"));
    let restart = true;
    let file = RunsFile::open(folder.path(), &other, restart).unwrap();
    assert!(file.runs().is_empty());
    let kept = path.with_extension("jsonl.before");
    assert_eq!(file.kept(), Some(kept.as_path()));
    drop(file);
    assert_eq!(fs::read(kept).unwrap(), before);
    drop(opened(folder.path(), &other).unwrap());
}

#[test]
fn no_restart_replaces_runs_that_an_earlier_one_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = file_with_a_run(folder.path());
    for ending in ["jsonl.before", "jsonl.before-2", "jsonl.before-3"] {
        let before = fs::read(&path).unwrap();
        let restart = true;
        let mut file = RunsFile::open(folder.path(), &setup(), restart).unwrap();
        file.add(run("b", ending, 20.0, 0.5)).unwrap();
        drop(file);
        assert_eq!(fs::read(path.with_extension(ending)).unwrap(), before);
    }
    let first = fs::read_to_string(path.with_extension("jsonl.before")).unwrap();
    assert!(first.contains(BASELINE), "{first}");
}

#[test]
fn a_restart_that_was_stopped_before_its_first_run_leaves_the_runs_that_were_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = file_with_a_run(folder.path());
    let before = fs::read(&path).unwrap();
    for _ in 0..2 {
        let restart = true;
        drop(RunsFile::open(folder.path(), &setup(), restart).unwrap());
    }
    let kept = fs::read(path.with_extension("jsonl.before")).unwrap();
    assert_eq!(kept, before);
}

#[test]
fn a_restart_that_was_stopped_within_its_first_run_leaves_the_runs_that_were_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = file_with_a_run(folder.path());
    let before = fs::read(&path).unwrap();
    let restart = true;
    drop(RunsFile::open(folder.path(), &setup(), restart).unwrap());
    let mut cut_off = fs::read(&path).unwrap();
    cut_off.extend(b"{\"run\":{\"clip\":\"caf");
    fs::write(&path, cut_off).unwrap();
    drop(RunsFile::open(folder.path(), &setup(), restart).unwrap());
    let kept = fs::read(path.with_extension("jsonl.before")).unwrap();
    assert_eq!(kept, before);
}

#[test]
fn a_file_whose_last_line_was_cut_within_a_letter_is_read_up_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = file_with_a_run(folder.path());
    let mut bytes = fs::read(&path).unwrap();
    // The first of the two bytes of é.
    bytes.extend(b"{\"run\":{\"clip\":\"caf\xC3");
    fs::write(&path, bytes).unwrap();
    assert_eq!(read(&path).unwrap().runs.len(), 1);
}

#[test]
fn setups_of_one_title_are_told_apart_by_the_settings_that_differ() {
    let of = |setup: Setup| SetupRuns {
        setup,
        runs: vec![run("a", BASELINE, 10.0, 0.5), run("a", "albireo", 8.0, 0.5)],
    };
    let setups = [of(setup()), of(changed(FRAMES, Some("paced")))];
    let titles = setups.each_ref().map(|found| found.setup.title_among(&setups));
    assert_eq!(titles[0], "yolo, fp16, 15 W, board (frames unpaced)");
    assert_eq!(titles[1], "yolo, fp16, 15 W, board (frames paced)");
    let summaries = summary::summarise_all(&setups);
    let plots = figures::figures(&setups, &summaries).unwrap();
    let changes = plots.iter().find(|plot| plot.name == "clips-ap50-change").unwrap();
    for title in &titles {
        assert!(changes.svg.contains(title), "{title}");
    }
    for row in rows::rows_of_clips(&setups) {
        assert!(titles.contains(&row[0].1), "{row:?}");
    }
}

#[test]
fn a_clip_whose_pictures_or_labels_have_changed_is_not_added_to_its_runs() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = opened(folder.path(), &setup()).unwrap();
    file.add(run("a", BASELINE, 10.0, 0.5)).unwrap();
    file.check_clip("a", "1280x720").unwrap();
    file.check_clip("b", "640x360").unwrap();
    let refused = file.check_clip("a", "640x360").unwrap_err().to_string();
    assert!(
        refused.contains("of 1280x720, and now it is of 640x360"),
        "{refused}"
    );
}

#[test]
fn two_commands_do_not_write_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let _first = opened(folder.path(), &setup()).unwrap();
    let refused = opened(folder.path(), &setup()).unwrap_err().to_string();
    assert!(refused.contains("stop that one first"), "{refused}");
}

#[test]
fn what_is_neither_runs_nor_published_rows_is_refused_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rows");
    for text in [
        "",
        "a,b\n1,2\n",
        "{\"v\":1}\n",
        "{\"run\":{}}\n",
        "\u{7f}ELF",
    ] {
        fs::write(&path, text).unwrap();
        let refused = read(&path).unwrap_err().to_string();
        assert!(refused.contains("rows"), "{text}: {refused}");
    }
}

#[test]
fn differences_are_paired_over_the_clips_that_both_played() {
    let runs = vec![
        run("a", BASELINE, 100.0, 0.50),
        run("b", BASELINE, 200.0, 0.60),
        run("c", BASELINE, 300.0, 0.70),
        run("a", "albireo", 80.0, 0.51),
        run("b", "albireo", 220.0, 0.58),
    ];
    let summary = summary::summarise("a setup".to_owned(), &runs);
    let albireo = &summary.policies[1];
    let change = albireo.change.as_ref().unwrap();
    assert_eq!(change.joules.unwrap().mean, 0.0);
    assert_eq!(change.clips_that_save, Some(0.5));
    assert!((change.ap50.unwrap().mean + 0.5).abs() < 1e-9);
    let clips = change.clips.as_ref().unwrap();
    assert_eq!(clips.as_good, 1);
    assert_eq!(clips.all, 2);
    assert!((clips.median_drop.unwrap() - 2.0).abs() < 1e-9);
}

#[test]
fn savings_that_multiply_have_the_factor_one() {
    // In each mode the policy saves a fifth.
    let in_mode = |mode: &str, factor: f64| {
        let mut runs = Vec::new();
        for (clip, joules) in [("a", 100.0), ("b", 200.0), ("c", 300.0)] {
            runs.push(run(clip, BASELINE, joules * factor, 0.5));
            runs.push(run(clip, "albireo", joules * factor * 0.8, 0.5));
        }
        let setup = Setup {
            power_mode: mode.to_owned(),
            ..setup()
        };
        SetupRuns { setup, runs }
    };
    let found = summary::compositions(&[in_mode("MAXN", 1.0), in_mode("15W", 0.5)]);
    assert_eq!(found.len(), 1);
    let only = &found[0];
    assert!((only.factor - 1.0).abs() < 1e-12);
    assert!((only.together - 0.6).abs() < 1e-12);
    assert!((only.expected - 0.6).abs() < 1e-12);
}

#[test]
fn a_run_has_the_gpus_utilisation_of_its_report_and_none_where_nothing_read_it() {
    let utilisation = |board: Option<BoardState>| {
        let report = ClipReport {
            board,
            ..ClipReport::default()
        };
        ClipRun::of(&report, "a", BASELINE).gpu_utilisation
    };
    let busy = BoardState {
        gpu_utilisation: Some(0.437),
        ..BoardState::default()
    };
    assert_eq!(utilisation(Some(busy)), Some(0.437));
    assert_eq!(utilisation(Some(BoardState::default())), None);
    assert_eq!(utilisation(None), None);
}

#[test]
fn a_mean_or_a_share_of_no_frame_is_an_empty_cell() {
    assert_eq!(
        ClipRun::of(&ClipReport::default(), "a", BASELINE).frame_ms,
        None
    );
    let unanswered = ClipRun {
        frames: 0,
        dropped: 100,
        states: FrameStates::default(),
        detector_calls: 0,
        frame_ms: None,
        ..run("a", BASELINE, 10.0, 0.5)
    };
    let setups = [SetupRuns {
        setup: setup(),
        runs: vec![unanswered, run("b", BASELINE, 10.0, 0.5)],
    }];
    let summaries = summary::summarise_all(&setups);
    let of_clip = rows::rows_of_clips(&setups).swap_remove(0);
    let of_policy = rows::rows_of_policies(&summaries).swap_remove(0);
    for (column, cell) in of_clip.into_iter().chain(of_policy) {
        let is_mean = column.starts_with("edp") || ["frame_ms", "skip_rate"].contains(&column);
        if is_mean {
            assert_eq!(cell, "", "{column}");
        }
    }
    assert_eq!(summaries[0].policies[0].states, [None; 5]);
    figures::figures(&setups, &summaries).unwrap();
}

/// The text for one run, under vanilla.
fn text_of_one_run() -> String {
    let alone = SetupRuns {
        setup: setup(),
        runs: vec![run("a", BASELINE, 10.0, 0.5)],
    };
    render(&[alone], WIDTH)
}

#[test]
fn tables_without_rows_say_what_they_need() {
    let text = text_of_one_run();
    let missing = text.split_once("No rows").unwrap().1;
    for what in [
        "sweep:",
        "change of AP@50 clip by clip:",
        "against frames in E:",
        "paired tests:",
        "detectors, machines",
        "power modes side by side:",
        "whether savings multiply:",
    ] {
        assert!(missing.contains(what), "{what}: {text}");
    }
}

#[test]
fn a_utilisation_that_nothing_read_is_named() {
    let text = text_of_one_run();
    let unread = "Not read: utilisation or use of GPU.";
    assert!(text.contains(unread), "{text}");
}

/// Three clips under vanilla and two settings of a policy.
fn measured(detector: &str, mode: &str) -> SetupRuns {
    let share = if mode == "15W" { 0.5 } else { 1.0 };
    let policies = [
        (BASELINE, 1.0),
        ("albireo-u3e-3", 0.7),
        ("albireo-u3e-4", 0.8),
    ];
    let of_clip = |(clip, joules): (&'static str, f64)| {
        policies.map(|(policy, part)| {
            let skipped = if policy == BASELINE { 0 } else { 10 };
            ClipRun {
                gpu_utilisation: Some(0.437),
                unlabelled: 60,
                states: FrameStates {
                    e: skipped,
                    p: skipped,
                    i: 100 - 2 * skipped,
                    ..FrameStates::default()
                },
                ..run(clip, policy, joules * share * part, 0.5 * part)
            }
        })
    };
    let clips = [("a", 10.0), ("b", 20.0), ("c", 31.0)];
    SetupRuns {
        setup: Setup {
            detector: detector.to_owned(),
            power_mode: mode.to_owned(),
            ..setup()
        },
        runs: clips.into_iter().flat_map(of_clip).collect(),
    }
}

fn three_setups() -> [SetupRuns; 3] {
    [
        measured("yolo", "MAXN"),
        measured("yolo", "15W"),
        measured("detr", "MAXN"),
    ]
}

#[test]
fn setups_that_differ_in_a_setting_are_not_compared_in_silence() {
    let mut setups = three_setups();
    for (runs, confidence) in setups.iter_mut().zip(["0.5", "0.5", "0.3"]) {
        let Setup {
            detector, settings, ..
        } = &mut runs.setup;
        settings.insert("detector.confidence".to_owned(), confidence.to_owned());
        settings.insert("detector.model".to_owned(), detector.clone());
    }
    let text = render(&setups, WIDTH);
    assert!(
        text.contains("also differ in detector.confidence (0.3, 0.5)."),
        "{text}"
    );
}

#[test]
fn each_table_of_the_paper_has_rows() {
    let text = render(&three_setups(), WIDTH);
    for what in [
        "Sweep: yolo, fp16, MAXN, board",
        "Detectors and machines side by side",
        "Do savings multiply?",
        "yolo: MAXN → 15W",
        "Accuracy is that of 120 of 300 frames",
        // The GPU's utilisation, percent.
        " 44 ",
    ] {
        assert!(text.contains(what), "{what}: {text}");
    }
    for missing in ["No rows", "Not read"] {
        assert!(!text.contains(missing), "{text}");
    }
    let fits = |line: &str| line.chars().count() <= WIDTH;
    assert!(text.lines().all(fits), "{text}");
}

/// The place of the first line that begins with `start`.
fn place(text: &str, start: &str) -> usize {
    text.lines().position(|line| line.starts_with(start)).unwrap()
}

#[test]
fn a_sweep_has_the_settings_of_a_policy_in_order() {
    let text = render(&three_setups(), WIDTH);
    let low = place(&text, "albireo u = 3e-4");
    let high = place(&text, "albireo u = 3e-3");
    assert_eq!(low + 1, high, "{text}");
}

#[test]
fn the_power_modes_of_a_policy_are_beside_each_other_in_the_order_of_the_files() {
    let text = render(&three_setups(), WIDTH);
    let mut of_vanilla = text
        .lines()
        .skip(place(&text, "Power modes") + 1)
        .filter(|line| line.contains("vanilla"));
    assert!(of_vanilla.next().unwrap().contains("MAXN"), "{text}");
    assert!(of_vanilla.next().unwrap().contains("15W"), "{text}");
}

#[test]
fn the_page_has_every_figure_and_loads_no_other_file() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &three_setups(), "").unwrap();
    let names = [
        "ap50-against-edp",
        "frame-states",
        "energy-by-domain",
        "clips-ap50-change",
        "clips-ap50-change-e",
        "clips-ap50-change-p",
        "power-trace-1",
        "power-trace-2",
        "power-domains-1",
        "power-domains-2",
    ];
    for name in names {
        let file = folder.path().join(format!("{name}.svg"));
        assert!(file.is_file(), "{name}");
    }
    let page = fs::read_to_string(folder.path().join("join.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), names.len());
    for other_file in ["src=\"", "href=\"http"] {
        assert!(!page.contains(other_file), "{other_file}");
    }
}

#[test]
fn the_power_of_each_traced_run_is_written_entry_by_entry() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &three_setups(), "").unwrap();
    let power = fs::read_to_string(folder.path().join("power.csv")).unwrap();
    let mut entries = 0;
    for run in three_setups().iter().flat_map(|setup| &setup.runs) {
        entries += run.traces.values().map(Vec::len).sum::<usize>();
    }
    let heading = 1;
    assert_eq!(power.lines().count(), heading + entries);
}

/// The rows of the paper's repository for the Thor board; the project does not carry them.
fn published() -> Option<PathBuf> {
    let shared = std::env::var_os("ALBIREO_SHARED")?;
    let rows = "data/published-results/thor/albireo/yolo26x/summary-selected-columns.csv";
    Some(PathBuf::from(shared).join(rows)).filter(|path| path.is_file())
}

#[test]
#[ignore = "needs ../shared"]
fn the_published_rows_give_the_papers_main_table() {
    let path = published().expect("ALBIREO_SHARED names the folder with the published rows");
    let text = render(&[read(&path).unwrap()], WIDTH);
    // AP@50, energy, time, EDP (the paper has 31023, the product of its rounded means), skip rate and states.
    let row = |name: &str| -> Vec<String> {
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace().map(str::to_owned).collect()
    };
    let vanilla = row("vanilla");
    assert_eq!(
        vanilla[1..6],
        ["0.609", "0.470", "811.5", "50.9", "41305"],
        "{text}"
    );
    // The rows are rounded to five decimals, and their mean, 0.61648, to 0.616; the paper has 0.617.
    let albireo = row("albireo");
    assert_eq!(
        albireo[1..7],
        ["0.616", "0.433", "668.6", "46.4", "31036", "19.3"],
        "{text}"
    );
    for part in [
        "yolo26x",
        "thor",
        "-17.6",
        "-8.8",
        "-24.9",
        "144 of 200",
        "89 %",
        "<.001",
        "-3.7",
        "Not read: utilisation or use of CPU, GPU, memory.",
        "No rows, and what they need",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(
        text.lines().all(|line| line.chars().count() <= 100),
        "{text}"
    );
}

#[test]
#[ignore = "needs ../shared"]
fn the_published_rows_are_written_as_page_tables_and_figures() {
    let path = published().expect("ALBIREO_SHARED names the folder with the published rows");
    let setups = [read(&path).unwrap()];
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &setups, &render(&setups, WIDTH)).unwrap();
    for file in [
        "join.html",
        "join.txt",
        "clips.csv",
        "policies.csv",
        "ap50-against-edp.svg",
        "clips-ap50-change.svg",
    ] {
        assert!(
            folder.path().join(file).metadata().unwrap().len() > 400,
            "{file}"
        );
    }
    let rows = fs::read_to_string(folder.path().join("clips.csv")).unwrap();
    let heading = 1;
    // 200 clips under two policies.
    assert_eq!(rows.lines().count(), heading + 200 * 2);
}

#[test]
fn a_folder_without_files_of_runs_says_what_is_expected() {
    let folder = tempfile::tempdir().unwrap();
    let error = files_of(&[folder.path().to_owned()]).unwrap_err().to_string();
    let expected = format!(
        "{}: this is a folder, and it has no .jsonl file; give files",
        folder.path().display()
    );
    assert!(error.starts_with(&expected), "{error}");
}

#[test]
fn a_folder_stands_for_its_files_of_runs_in_the_order_of_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let first = folder.path().join("a.jsonl");
    let second = folder.path().join("b.jsonl");
    for file in [&second, &first, &folder.path().join("a.jsonl.before")] {
        fs::write(file, "").unwrap();
    }
    let found = files_of(&[folder.path().to_owned(), second.clone()]).unwrap();
    assert_eq!(found, [first, second.clone(), second]);
}
