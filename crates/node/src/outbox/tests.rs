use super::*;
use albireo_wire::{ClipEnd, ClipEnergy, EnergyQuality};

fn report(clip: u64) -> ClipReport {
    ClipReport {
        v: VERSION,
        node: "n".into(),
        camera: "front".into(),
        clip: format!("window-{clip}"),
        report: 0,
        ended_by: ClipEnd::Window,
        started_ns: 0,
        duration_s: 1.0,
        frames: 30,
        states: albireo_wire::FrameStates::default(),
        skip_rate: 0.0,
        degraded_frames: 0,
        dropped: albireo_wire::DroppedFrames::default(),
        policy: "vanilla".into(),
        knob: None,
        knob_changes: Vec::new(),
        model: "m.onnx".into(),
        provider: "cpu".into(),
        total_latency_ms: albireo_wire::Percentiles::default(),
        detector_latency_ms: albireo_wire::Percentiles::default(),
        energy: ClipEnergy {
            joules: None,
            node_joules: None,
            edp: None,
            quality: EnergyQuality::Unavailable,
            source: "none".into(),
            total_from: String::new(),
            samples: 0,
            coverage: 0.0,
            domains: Vec::new(),
        },
        board: None,
    }
}

struct Bench {
    folder: tempfile::TempDir,
    config: OutboxConfig,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let machine_id = folder.path().join("machine-id");
        std::fs::write(&machine_id, "one").unwrap();
        Self {
            config: OutboxConfig {
                machine_id,
                ..OutboxConfig::default()
            },
            folder,
        }
    }

    fn state(&self) -> PathBuf {
        self.folder.path().join("state")
    }

    fn file(&self) -> PathBuf {
        self.state().join(FILE)
    }

    fn open(&self) -> Outbox {
        Outbox::open(&self.config, Some(&self.state())).unwrap()
    }

    fn become_machine(&self, id: &str) {
        std::fs::write(&self.config.machine_id, id).unwrap();
    }
}

fn keep(outbox: &Outbox, clips: std::ops::Range<u64>) {
    for clip in clips {
        let mut reports = [report(clip)];
        outbox.keep(&mut reports);
        outbox.settle(&reports);
    }
}

fn clips(batch: &Batch) -> Vec<String> {
    batch
        .message
        .reports
        .iter()
        .map(|r| r.clip.clone())
        .collect()
}

fn retry_disk(outbox: &Outbox) {
    outbox.0.state.lock().retry_at = Instant::now();
}

#[test]
fn report_numbers_go_on_after_a_restart_even_when_all_were_acknowledged() {
    let bench = Bench::new();
    let outbox = bench.open();
    let instance = outbox.instance();
    keep(&outbox, 0..3);
    let batch = outbox.batch("n").unwrap();
    assert_eq!((batch.message.first, batch.message.last), (1, 3));
    assert_eq!(outbox.acknowledge(&batch, 3), Acknowledged::Removed(3));
    assert!(outbox.batch("n").is_none());
    drop(outbox);
    let outbox = bench.open();
    keep(&outbox, 3..4);
    let batch = outbox.batch("n").unwrap();
    assert_eq!(batch.message.instance, instance);
    assert_eq!((batch.message.first, batch.message.last), (4, 4));
}

#[test]
fn a_report_is_removed_only_when_it_is_acknowledged() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..5);
    let batch = outbox.batch("n").unwrap();
    assert_eq!(outbox.acknowledge(&batch, 0), Acknowledged::Nothing);
    assert_eq!(outbox.acknowledge(&batch, 2), Acknowledged::Removed(2));
    drop(outbox);
    let outbox = bench.open();
    assert_eq!(
        clips(&outbox.batch("n").unwrap()),
        ["window-2", "window-3", "window-4"]
    );
    assert_eq!(outbox.counts().waiting, 3);
}

#[test]
fn a_report_without_its_energy_is_not_sent_and_survives_a_kill() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..1);
    outbox.keep(&mut [report(1)]);
    keep(&outbox, 2..3);
    // It stands in the way of later ones, so that numbers go out in order.
    assert_eq!(clips(&outbox.batch("n").unwrap()), ["window-0"]);
    drop(outbox);
    assert_eq!(bench.open().batch("n").unwrap().message.reports.len(), 3);
}

#[test]
fn a_cloned_state_directory_is_a_new_instance_and_the_old_reports_keep_theirs() {
    let bench = Bench::new();
    let outbox = bench.open();
    let first = outbox.instance();
    keep(&outbox, 0..2);
    drop(outbox);
    bench.become_machine("two");
    let outbox = bench.open();
    assert_ne!(outbox.instance(), first);
    keep(&outbox, 2..3);
    let old = outbox.batch("n").unwrap();
    assert_eq!(old.message.instance, first);
    assert_eq!(clips(&old), ["window-0", "window-1"]);
    // The hub may have more of the old instance, from the machine it was cloned from.
    assert_eq!(outbox.acknowledge(&old, 9), Acknowledged::Removed(2));
    let new = outbox.batch("n").unwrap();
    assert_eq!(
        (new.message.first, clips(&new)),
        (1, vec!["window-2".to_owned()])
    );
    assert_eq!(new.message.instance, outbox.instance());
}

#[test]
fn a_state_directory_that_went_back_in_time_begins_a_new_instance_and_loses_nothing() {
    let bench = Bench::new();
    let outbox = bench.open();
    let first = outbox.instance();
    keep(&outbox, 0..3);
    let batch = outbox.batch("n").unwrap();
    assert_eq!(outbox.acknowledge(&batch, 20), Acknowledged::NewInstance);
    let batch = outbox.batch("n").unwrap();
    assert_ne!(batch.message.instance, first);
    assert_eq!((batch.message.first, batch.message.last), (1, 3));
    assert_eq!(clips(&batch).len(), 3);
    let instance = outbox.instance();
    drop(outbox);
    assert_eq!(bench.open().instance(), instance);
}

#[test]
fn a_second_node_with_the_same_state_directory_refuses_to_start() {
    let bench = Bench::new();
    let outbox = bench.open();
    let error = Outbox::open(&bench.config, Some(&bench.state())).unwrap_err();
    assert!(
        error.to_string().contains("in use by another node"),
        "{error}"
    );
    drop(outbox);
    bench.open();
}

#[test]
fn a_foreign_file_is_refused_in_words() {
    let bench = Bench::new();
    std::fs::create_dir(bench.state()).unwrap();
    let db = rusqlite::Connection::open(bench.file()).unwrap();
    db.execute_batch("CREATE TABLE other (x)").unwrap();
    drop(db);
    let error = Outbox::open(&bench.config, Some(&bench.state())).unwrap_err();
    assert!(error.to_string().contains("another program's"), "{error}");
}

#[test]
fn a_damaged_file_is_set_aside_and_what_can_be_read_is_saved() {
    let bench = Bench::new();
    let outbox = bench.open();
    let first = outbox.instance();
    keep(&outbox, 0..400);
    drop(outbox);
    let mut bytes = std::fs::read(bench.file()).unwrap();
    let pages = bytes.len() / 4096;
    let torn = (pages * 2 / 3) * 4096;
    bytes[torn..torn + 4096].fill(0xa5);
    std::fs::write(bench.file(), bytes).unwrap();
    let outbox = bench.open();
    let counts = outbox.counts();
    assert!(counts.disk_failures > 0);
    assert!((100..400).contains(&counts.waiting), "{counts:?}");
    assert_ne!(outbox.instance(), first, "what was lost cannot be known");
    assert!(bench.state().join("node.db.damaged-0").exists());
    let batch = outbox.batch("n").unwrap();
    assert_eq!(batch.message.instance, first);
}

#[test]
fn a_file_of_rubbish_is_set_aside() {
    let bench = Bench::new();
    std::fs::create_dir(bench.state()).unwrap();
    std::fs::write(bench.file(), vec![b'x'; 9000]).unwrap();
    let outbox = bench.open();
    keep(&outbox, 0..1);
    assert!(outbox.counts().durable);
    assert!(bench.state().join("node.db.damaged-0").exists());
}

#[test]
fn a_disk_that_vanishes_and_returns_keeps_what_came_meanwhile() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..2);
    let away = bench.folder.path().join("away");
    std::fs::rename(bench.state(), &away).unwrap();
    // Something stands where the folder was, so that it cannot be made anew.
    std::fs::write(bench.state(), b"").unwrap();
    keep(&outbox, 2..4);
    let counts = outbox.counts();
    assert!(!counts.durable && counts.failing.is_some());
    assert_eq!((counts.in_memory, counts.waiting), (2, 4));
    // What is on the disk has lower numbers: nothing may overtake it.
    assert!(outbox.batch("n").is_none());
    std::fs::remove_file(bench.state()).unwrap();
    std::fs::rename(&away, bench.state()).unwrap();
    retry_disk(&outbox);
    let batch = outbox.batch("n").unwrap();
    assert_eq!((batch.message.first, batch.message.last), (1, 4));
    let counts = outbox.counts();
    assert!(counts.durable && counts.in_memory == 0);
    drop(outbox);
    assert_eq!(bench.open().counts().waiting, 4);
}

#[test]
fn a_full_outbox_loses_the_oldest_and_counts_them() {
    let mut bench = Bench::new();
    let size = serde_json::to_vec(&report(1)).unwrap().len() as u64;
    bench.config.max_bytes = 10 * size + size / 2;
    let outbox = bench.open();
    keep(&outbox, 0..30);
    let counts = outbox.counts();
    assert!(
        counts.waiting <= 10 && counts.lost + counts.waiting == 30,
        "{counts:?}"
    );
    let batch = outbox.batch("n").unwrap();
    assert_eq!(batch.message.last, 30);
    assert_eq!(batch.message.lost, counts.lost);
    drop(outbox);
    assert_eq!(bench.open().counts().lost, counts.lost);
}

#[test]
fn without_a_state_directory_reports_wait_in_memory_within_bounds() {
    let config = OutboxConfig {
        memory_reports: 5,
        ..OutboxConfig::default()
    };
    let outbox = Outbox::open(&config, None).unwrap();
    keep(&outbox, 0..8);
    let counts = outbox.counts();
    assert_eq!((counts.waiting, counts.lost, counts.durable), (5, 3, false));
    let batch = outbox.batch("n").unwrap();
    assert_eq!((batch.message.first, batch.message.last), (4, 8));
    assert_eq!(outbox.acknowledge(&batch, 8), Acknowledged::Removed(5));
    assert!(outbox.batch("n").is_none());
}

#[test]
fn thresholds_of_an_earlier_version_are_taken_over_once() {
    let bench = Bench::new();
    std::fs::create_dir(bench.state()).unwrap();
    let old = bench.state().join("thresholds.json");
    std::fs::write(
        &old,
        r#"{"v":1,"cameras":{"front":{"knob":"u","value":5e-4,"configured":3e-4}}}"#,
    )
    .unwrap();
    let outbox = bench.open();
    let kept: serde_json::Value = outbox.setting("threshold/front").unwrap();
    assert_eq!(kept["value"], 5e-4);
    assert!(!old.exists());
    drop(outbox);
    assert!(
        bench
            .open()
            .setting::<serde_json::Value>("threshold/front")
            .is_some()
    );
}

#[test]
fn reports_of_an_earlier_version_are_taken_over() {
    let bench = Bench::new();
    let folder = bench.state().join("clip-reports/front");
    std::fs::create_dir_all(&folder).unwrap();
    for clip in 0..3 {
        let name = format!("{:020}-{clip:08}.json", 7);
        std::fs::write(
            folder.join(name),
            serde_json::to_vec(&report(clip)).unwrap(),
        )
        .unwrap();
    }
    let outbox = bench.open();
    let batch = outbox.batch("n").unwrap();
    assert_eq!(clips(&batch), ["window-0", "window-1", "window-2"]);
    assert_eq!(batch.message.last, 3);
    assert!(!bench.state().join("clip-reports").exists());
}

#[test]
fn a_full_disk_keeps_reports_in_memory_until_there_is_room() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..2);
    let limit = |pages| {
        let state = outbox.0.state.lock();
        state.store.as_ref().unwrap().limit_pages(pages);
    };
    // SQLite's own error of a full disk.
    limit(0);
    keep(&outbox, 2..60);
    let counts = outbox.counts();
    assert!(counts.in_memory > 0 && counts.waiting == 60, "{counts:?}");
    assert!(counts.failing.unwrap().contains("full"));
    // What is on disk can still be read and goes first.
    let batch = outbox.batch("n").unwrap();
    assert_eq!(batch.message.first, 1);
    assert!(batch.message.last < 60);
    retry_disk(&outbox);
    // Opened anew without the limit.
    let batch = outbox.batch("n").unwrap();
    assert_eq!((batch.message.first, batch.message.last), (1, 60));
    assert!(outbox.counts().durable);
}

#[test]
fn a_report_of_an_old_instance_that_cannot_be_read_is_counted_lost_and_the_rest_goes() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..3);
    drop(outbox);
    let db = rusqlite::Connection::open(bench.file()).unwrap();
    db.execute("UPDATE report SET json = x'00' WHERE number = 2", [])
        .unwrap();
    drop(db);
    let outbox = bench.open();
    let batch = outbox.batch("n").unwrap();
    assert_eq!(clips(&batch), ["window-0", "window-2"]);
    assert_eq!(outbox.counts().lost, 1);
}

#[test]
fn reports_whose_numbers_another_has_taken_get_a_new_instance() {
    let bench = Bench::new();
    let outbox = bench.open();
    let first = outbox.instance();
    keep(&outbox, 0..2);
    drop(outbox);
    bench.become_machine("two");
    let outbox = bench.open();
    keep(&outbox, 2..4);
    // First of the old instance, then of the present one.
    let old = outbox.batch("n").unwrap();
    assert_eq!(old.message.instance, first);
    assert!(outbox.conflict(&old));
    let mut seen = Vec::new();
    while let Some(batch) = outbox.batch("n") {
        assert_ne!(batch.message.instance, first);
        assert_eq!(batch.message.first, 1);
        seen.extend(clips(&batch));
        outbox.acknowledge(&batch, batch.message.last);
    }
    assert_eq!(seen, ["window-2", "window-3", "window-0", "window-1"]);
    keep(&outbox, 4..5);
    let batch = outbox.batch("n").unwrap();
    assert!(outbox.conflict(&batch));
    assert_eq!(clips(&outbox.batch("n").unwrap()), ["window-4"]);
}

#[test]
fn a_report_that_grows_by_its_energy_is_counted_with_its_size() {
    let bench = Bench::new();
    let outbox = bench.open();
    for clip in 0..3 {
        let mut reports = [report(clip)];
        outbox.keep(&mut reports);
        reports[0].policy = "a longer name than the one it was kept with".into();
        outbox.settle(&reports);
        let batch = outbox.batch("n").unwrap();
        let state = outbox.0.state.lock();
        let waiting = state.store.as_ref().unwrap().waiting();
        assert_eq!(
            waiting.bytes,
            serde_json::to_vec(&reports[0]).unwrap().len() as u64
        );
        drop(state);
        assert_eq!(
            outbox.acknowledge(&batch, clip + 1),
            Acknowledged::Removed(1)
        );
        let state = outbox.0.state.lock();
        assert_eq!(
            state.store.as_ref().unwrap().waiting(),
            store::Waiting::default()
        );
    }
}
