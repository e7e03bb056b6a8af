use super::batch::{BATCH_BYTES, LARGEST_REPORT};
use super::*;
use albireo_wire::{ClipEnd, ClipEnergy, EnergyQuality, VERSION};
use std::sync::mpsc::channel;
use std::time::Duration;

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
        threshold: None,
        threshold_changes: Vec::new(),
        model: "m.onnx".into(),
        provider: "cpu".into(),
        total_latency_ms: albireo_wire::Percentiles::default(),
        detector_latency_ms: albireo_wire::Percentiles::default(),
        detector_used_ms: 0.0,
        energy: ClipEnergy {
            joules: None,
            node_joules: None,
            saved_joules_estimated: None,
            edp: None,
            quality: EnergyQuality::Unavailable,
            source: "none".into(),
            total_from: String::new(),
            samples: 0,
            coverage: 0.0,
            domains: Vec::new(),
        },
        board: None,
        audit: None,
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
        let tickets = outbox.keep(&mut reports);
        outbox.settle(&tickets, &mut reports);
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

/// The batches that go out when a hub takes everything.
fn drain(outbox: &Outbox) -> Vec<Batch> {
    let mut sent = Vec::new();
    while let Some(batch) = outbox.batch("n") {
        outbox.acknowledge(&batch, batch.message.last);
        sent.push(batch);
    }
    sent
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
    outbox.disk_is_due();
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
    // What is on disk can still be read and goes first, also after a look that found the disk as full as before.
    for _ in 0..2 {
        let batch = outbox.batch("n").unwrap();
        assert_eq!(batch.message.first, 1);
        assert!(batch.message.last < 60);
        outbox.disk_is_due();
    }
    assert!(!outbox.counts().durable);
    limit(1000);
    outbox.disk_is_due();
    let batch = outbox.batch("n").unwrap();
    assert_eq!((batch.message.first, batch.message.last), (1, 60));
    assert!(outbox.counts().durable);
}

#[test]
fn a_disk_that_cannot_be_written_delivers_what_is_on_it_and_then_what_is_in_memory() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..2);
    let mut unsettled = [report(2)];
    let tickets = outbox.keep(&mut unsettled);
    // Somebody else writes and does not end: opening the file anew is of no use.
    let other = rusqlite::Connection::open(bench.file()).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    unsettled[0].policy = "settled".into();
    outbox.settle(&tickets, &mut unsettled);
    keep(&outbox, 3..5);
    outbox.disk_is_due();
    let batch = outbox.batch("n").unwrap();
    assert_eq!(clips(&batch), ["window-0", "window-1", "window-2"]);
    assert_eq!(batch.message.reports[2].policy, "settled");
    assert_eq!(outbox.acknowledge(&batch, 3), Acknowledged::Removed(3));
    let batch = outbox.batch("n").unwrap();
    assert_eq!((batch.message.first, batch.message.last), (4, 5));
    assert_eq!(outbox.acknowledge(&batch, 4), Acknowledged::Removed(1));
    assert_eq!(outbox.counts().waiting, 1);
    other.execute_batch("ROLLBACK").unwrap();
    outbox.disk_is_due();
    assert_eq!(clips(&outbox.batch("n").unwrap()), ["window-4"]);
    let counts = outbox.counts();
    assert!(counts.durable && counts.waiting == 1 && counts.in_memory == 0);
    drop(outbox);
    let outbox = bench.open();
    assert_eq!(clips(&outbox.batch("n").unwrap()), ["window-4"]);
}

#[test]
fn a_file_that_has_become_read_only_is_read_and_opened_anew() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..2);
    {
        let state = outbox.0.state.lock();
        state.store.as_ref().unwrap().refuse_writes();
    }
    keep(&outbox, 2..3);
    assert!(outbox.counts().failing.unwrap().contains("readonly"));
    assert_eq!(outbox.batch("n").unwrap().message.last, 2);
    outbox.disk_is_due();
    assert_eq!(outbox.batch("n").unwrap().message.last, 3);
    assert!(outbox.counts().durable);
}

#[test]
fn energy_that_is_known_while_the_disk_is_away_is_there_when_it_returns() {
    let bench = Bench::new();
    let outbox = bench.open();
    let mut reports = [report(0), report(1)];
    let tickets = outbox.keep(&mut reports);
    let away = bench.folder.path().join("away");
    std::fs::rename(bench.state(), &away).unwrap();
    reports[0].policy = "settled".into();
    outbox.settle(&tickets, &mut reports);
    assert!(outbox.counts().failing.is_some());
    std::fs::remove_dir_all(bench.state()).ok();
    std::fs::rename(&away, bench.state()).unwrap();
    outbox.disk_is_due();
    outbox.look_after_disk();
    drop(outbox);
    let batch = bench.open().batch("n").unwrap();
    assert_eq!(batch.message.reports[0].policy, "settled");
}

#[test]
fn energy_finds_its_clip_when_a_new_instance_has_begun_meanwhile() {
    let bench = Bench::new();
    for outbox in [bench.open(), Outbox::in_memory()] {
        let first = outbox.instance();
        keep(&outbox, 0..3);
        let mut waiting = [report(3)];
        let tickets = outbox.keep(&mut waiting);
        let batch = outbox.batch("n").unwrap();
        assert_eq!(outbox.acknowledge(&batch, 2), Acknowledged::Removed(2));
        let batch = outbox.batch("n").unwrap();
        assert!(outbox.conflict(&batch));
        assert_ne!(outbox.instance(), first);
        // Two more, so that the number of before is another clip's now.
        keep(&outbox, 4..6);
        waiting[0].policy = "settled".into();
        outbox.settle(&tickets, &mut waiting);
        assert_eq!(waiting[0].report, 2);
        let batch = outbox.batch("n").unwrap();
        assert_eq!(
            clips(&batch),
            ["window-2", "window-3", "window-4", "window-5"]
        );
        let settled: Vec<_> = (batch.message.reports.iter())
            .filter(|report| report.policy == "settled")
            .map(|report| report.clip.as_str())
            .collect();
        assert_eq!(settled, ["window-3"]);
    }
}

#[test]
fn what_a_hub_has_of_one_file_is_not_removed_from_another() {
    let bench = Bench::new();
    let other = Bench::new();
    let outbox = other.open();
    keep(&outbox, 0..5);
    drop(outbox);
    let outbox = bench.open();
    keep(&outbox, 0..4);
    let batch = outbox.batch("n").unwrap();
    std::fs::rename(bench.state(), bench.folder.path().join("away")).unwrap();
    std::fs::write(bench.state(), b"").unwrap();
    keep(&outbox, 4..5);
    assert_eq!(outbox.acknowledge(&batch, 4), Acknowledged::Removed(4));
    // Another disk is put in: its instance has the same row there.
    std::fs::remove_file(bench.state()).unwrap();
    std::fs::rename(other.state(), bench.state()).unwrap();
    outbox.disk_is_due();
    let sent = drain(&outbox);
    let numbers: Vec<_> = sent
        .iter()
        .map(|b| (b.message.first, b.message.last))
        .collect();
    assert_eq!(numbers, [(1, 5), (5, 5)]);
    assert_ne!(sent[0].message.instance, sent[1].message.instance);
}

#[test]
fn a_batch_from_memory_is_bounded_as_one_from_the_disk() {
    let outbox = Outbox::in_memory();
    for clip in 0..20 {
        let mut reports = [report(clip)];
        reports[0].policy = "x".repeat(300 << 10);
        let tickets = outbox.keep(&mut reports);
        outbox.settle(&tickets, &mut reports);
    }
    let sent = drain(&outbox);
    let size = |batch: &Batch| serde_json::to_vec(&batch.message).unwrap().len();
    assert!(sent.iter().all(|batch| size(batch) < BATCH_BYTES + 2000));
    assert_eq!(sent.iter().flat_map(clips).count(), 20);
}

#[test]
fn a_report_that_no_hub_would_take_is_counted_as_lost_and_the_rest_goes() {
    let bench = Bench::new();
    for outbox in [bench.open(), Outbox::in_memory()] {
        for clip in 0..3 {
            let mut reports = [report(clip)];
            if clip == 1 {
                reports[0].policy = "x".repeat(LARGEST_REPORT);
            }
            let tickets = outbox.keep(&mut reports);
            outbox.settle(&tickets, &mut reports);
        }
        let sent: Vec<_> = drain(&outbox).iter().flat_map(clips).collect();
        assert_eq!(sent, ["window-0", "window-2"]);
        let counts = outbox.counts();
        assert_eq!((counts.lost, counts.waiting), (1, 0));
        assert!(counts.last_loss.is_some());
    }
}

#[test]
fn waking_the_sender_never_waits_for_a_disk() {
    let outbox = Outbox::in_memory();
    // As while a disk is written.
    let writing = outbox.0.state.lock();
    let (woken, seen) = channel();
    let sender = outbox.clone();
    let thread = std::thread::spawn(move || {
        sender.wake();
        let revision = sender.wait_for_change(0, Instant::now() + Duration::from_secs(60));
        woken.send(revision).unwrap();
    });
    let woken = seen.recv_timeout(Duration::from_secs(20));
    drop(writing);
    assert_eq!(woken.unwrap(), 1);
    thread.join().unwrap();
}

#[test]
fn the_pauses_between_looks_at_a_failed_disk_grow_up_to_a_bound() {
    let bench = Bench::new();
    std::fs::write(bench.folder.path().join("not a folder"), b"").unwrap();
    let state = bench.folder.path().join("not a folder/state");
    let outbox = Outbox::open(&bench.config, Some(&state)).unwrap();
    let mut pauses = Vec::new();
    for _ in 0..6 {
        outbox.disk_is_due();
        outbox.look_after_disk();
        pauses.push(outbox.0.state.lock().retry_pause.as_secs());
    }
    assert_eq!(pauses, [4, 8, 16, 30, 30, 30]);
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
        let tickets = outbox.keep(&mut reports);
        reports[0].policy = "a longer name than the one it was kept with".into();
        outbox.settle(&tickets, &mut reports);
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
