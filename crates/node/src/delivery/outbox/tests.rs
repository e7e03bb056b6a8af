use super::disk::FILE;
use super::table::MEMORY_BYTES;
use super::waiting::BATCH_BYTES;
use super::*;
use albireo_wire::{LARGEST_REPORT_BYTES, RefusedReport, VERSION};
use futures_util::FutureExt;
use rusqlite::Connection;
use std::io::{Error, ErrorKind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use uuid::Uuid;

/// The database of the hub that answers.
const HUB: Uuid = Uuid::from_u128(1);

pub(in crate::delivery) fn report(clip: u64) -> ClipReport {
    ClipReport {
        v: VERSION,
        id: Uuid::from_u128(u128::from(clip) + 100),
        node: "n".into(),
        camera: "front".into(),
        clip: format!("window-{clip}"),
        duration_s: 1.0,
        frames: 30,
        policy: "vanilla".into(),
        ..ClipReport::default()
    }
}

/// The file of a state directory on a disk that may be full.
#[derive(Debug)]
pub(in crate::delivery) struct FaultyDisk {
    pub(in crate::delivery) file: StateFile,
    pub(in crate::delivery) faults: Arc<Faults>,
}

#[derive(Debug, Default)]
pub(in crate::delivery) struct Faults {
    /// The disk is full.
    pub(in crate::delivery) is_full: AtomicBool,
    /// Commits are synced to the disk.
    pub(in crate::delivery) syncs: AtomicBool,
}

impl Disk for FaultyDisk {
    fn open(&mut self) -> Result<Connection, TableError> {
        if self.faults.is_full.load(Ordering::Relaxed) {
            return Err(Error::from(ErrorKind::StorageFull).into());
        }
        let db = self.file.open()?;
        db.busy_timeout(Duration::ZERO)?;
        // FULL, or more.
        let level: i64 = db.pragma_query_value(None, "synchronous", |row| row.get(0))?;
        self.faults.syncs.store(level >= 2, Ordering::Relaxed);
        let faults = Arc::clone(&self.faults);
        // A commit that is refused is rolled back.
        db.commit_hook(Some(move || faults.is_full.load(Ordering::Relaxed)))?;
        Ok(db)
    }

    fn check(&self) -> Result<(), TableError> {
        self.file.check()
    }

    fn set_aside(&mut self) -> std::io::Result<PathBuf> {
        self.file.set_aside()
    }
}

struct Bench {
    folder: tempfile::TempDir,
    config: OutboxConfig,
    faults: Arc<Faults>,
}

impl Bench {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
            config: OutboxConfig::default(),
            faults: Arc::default(),
        }
    }

    fn state(&self) -> PathBuf {
        self.folder.path().join("state")
    }

    fn file(&self) -> PathBuf {
        self.state().join(FILE)
    }

    fn open(&self) -> Outbox {
        let (file, faults) = (StateFile::new(&self.state()), Arc::clone(&self.faults));
        let disk = Box::new(FaultyDisk { file, faults });
        Outbox::open_on(disk, self.config.max_bytes, Now::system()).unwrap()
    }

    fn fill_disk(&self, is_full: bool) {
        self.faults.is_full.store(is_full, Ordering::Relaxed);
    }

    /// Removes the disk and puts a file in its place, so that no folder can be created there.
    fn take_disk(&self) {
        std::fs::rename(self.state(), self.folder.path().join("away")).unwrap();
        std::fs::write(self.state(), b"").unwrap();
    }

    fn return_disk(&self, outbox: &Outbox) {
        std::fs::remove_file(self.state()).unwrap();
        std::fs::rename(self.folder.path().join("away"), self.state()).unwrap();
        outbox.retry_disk(Now::system());
    }
}

fn in_memory() -> Outbox {
    Outbox::open(&OutboxConfig::default(), None).unwrap()
}

fn keep(outbox: &Outbox, clips: std::ops::Range<u64>) {
    for clip in clips {
        outbox.insert(&mut [report(clip)], Now::system());
    }
}

fn keep_large(outbox: &Outbox, clip: u64, bytes: usize) {
    let policy = "x".repeat(bytes);
    let report = ClipReport {
        policy,
        ..report(clip)
    };
    outbox.insert(&mut [report], Now::system());
}

fn batch(outbox: &Outbox) -> Option<ReportBatch> {
    outbox.batch("n", true, Now::system())
}

fn clips(batch: &ReportBatch) -> Vec<&str> {
    batch.reports.iter().map(|r| r.clip.as_str()).collect()
}

fn counts_of(batch: &ReportBatch) -> Vec<Option<u64>> {
    batch.reports.iter().map(|r| r.count).collect()
}

fn acknowledge(outbox: &Outbox, batch: &ReportBatch) -> u64 {
    outbox.answered(batch, &ReportAnswer::new(HUB), Now::system())
}

/// The clips that are sent to a hub that accepts everything.
fn drain(outbox: &Outbox) -> Vec<String> {
    let mut sent = Vec::new();
    while let Some(batch) = batch(outbox) {
        acknowledge(outbox, &batch);
        sent.extend(clips(&batch).into_iter().map(str::to_owned));
    }
    sent
}

#[test]
fn the_count_of_reports_continues_after_a_restart_even_if_all_were_acknowledged() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..3);
    let sent = batch(&outbox).unwrap();
    assert_eq!(counts_of(&sent), [Some(1), Some(2), Some(3)]);
    assert_eq!(acknowledge(&outbox, &sent), 3);
    assert!(batch(&outbox).is_none());
    drop(outbox);
    let outbox = bench.open();
    keep(&outbox, 3..4);
    assert_eq!(counts_of(&batch(&outbox).unwrap()), [Some(4)]);
}

#[test]
fn a_report_is_sent_until_acknowledged_and_a_refused_one_never_again() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..5);
    let mut sent = batch(&outbox).unwrap();
    sent.reports.truncate(2);
    let answer = ReportAnswer {
        refused: vec![RefusedReport {
            id: sent.reports[1].id,
            reason: "too old".into(),
        }],
        ..ReportAnswer::new(HUB)
    };
    assert_eq!(outbox.answered(&sent, &answer, Now::system()), 1);
    drop(outbox);
    let outbox = bench.open();
    let counts = outbox.counts();
    assert_eq!((counts.status.waiting, counts.status.undeliverable), (3, 1));
    assert_eq!(drain(&outbox), ["window-2", "window-3", "window-4"]);
}

#[test]
fn a_state_directory_of_a_renamed_node_delivers_under_the_new_name() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..1);
    let before = batch(&outbox).unwrap();
    let now = outbox.batch("renamed", false, Now::system()).unwrap();
    assert_eq!([&*now.node, &*now.reports[0].node], ["renamed"; 2]);
    assert_eq!(now.reports[0].id, before.reports[0].id);
}

#[test]
fn reports_that_a_hub_lost_are_resent_once_after_new_ones() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..5);
    drain(&outbox);
    keep(&outbox, 5..7);
    let sent = batch(&outbox).unwrap();
    let answer = ReportAnswer {
        missing: vec![(2, 3), (5, 5), (90, 99)],
        ..ReportAnswer::new(HUB)
    };
    outbox.answered(&sent, &answer, Now::system());
    let counts = outbox.counts();
    assert_eq!((counts.status.waiting, counts.again), (0, 3));
    keep(&outbox, 7..8);
    let new = outbox.batch("n", false, Now::system()).unwrap();
    assert_eq!(clips(&new), ["window-7"]);
    let sent = batch(&outbox).unwrap();
    let expected = ["window-7", "window-1", "window-2", "window-4"];
    assert_eq!(clips(&sent), expected);
    acknowledge(&outbox, &sent);
    assert!(batch(&outbox).is_none());
}

#[test]
fn a_hub_with_another_database_gets_the_kept_reports_once() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..4);
    drain(&outbox);
    keep(&outbox, 4..5);
    let other = ReportAnswer::new(Uuid::from_u128(2));
    let sent = batch(&outbox).unwrap();
    outbox.answered(&sent, &other, Now::system());
    let counts = outbox.counts();
    assert_eq!((counts.status.waiting, counts.again), (0, 4));
    let sent = batch(&outbox).unwrap();
    assert_eq!(sent.reports.len(), 4);
    outbox.answered(&sent, &other, Now::system());
    // Both databases are known now, whichever hub answers.
    for answer in [ReportAnswer::new(HUB), other] {
        keep(&outbox, 5..6);
        if let Some(sent) = batch(&outbox) {
            outbox.answered(&sent, &answer, Now::system());
        }
        assert_eq!(outbox.counts().again, 0);
    }
}

/// A time that many days after a day in November 2026.
fn at(days: i64) -> Now {
    Now {
        at: Instant::now(),
        unix_ms: 1_795_000_000_000 + days * 86_400_000,
    }
}

#[test]
fn no_clock_step_loses_a_report() {
    for steps in [[-3 * 365, 0], [0, 200], [200, -3 * 365], [-20_000, 20_000]] {
        let bench = Bench::new();
        let outbox = bench.open();
        let days = [0, steps[0], steps[1], 0];
        for (clip, day) in (0..20).zip(days.iter().cycle()) {
            outbox.insert(&mut [report(clip)], at(*day));
        }
        // An acknowledgement at one time removes nothing else at another time.
        let mut sent = outbox.batch("n", true, at(steps[0])).unwrap();
        sent.reports.truncate(4);
        for day in steps {
            outbox.answered(&sent, &ReportAnswer::new(HUB), at(day));
        }
        let status = outbox.counts().status;
        assert_eq!((status.waiting, status.lost), (16, 0));
        let left = outbox.batch("n", true, at(steps[1])).unwrap();
        assert_eq!(left.reports.len(), 16);
    }
}

#[test]
fn acknowledged_reports_are_kept_for_a_week() {
    let bench = Bench::new();
    let outbox = bench.open();
    for day in 0..20_i64 {
        outbox.insert(&mut [report(day.unsigned_abs())], at(day));
        let sent = outbox.batch("n", true, at(day)).unwrap();
        outbox.answered(&sent, &ReportAnswer::new(HUB), at(day));
    }
    // A hub with another database asks for all stored reports.
    outbox.insert(&mut [report(20)], at(19));
    let sent = outbox.batch("n", true, at(19)).unwrap();
    outbox.answered(&sent, &ReportAnswer::new(Uuid::from_u128(2)), at(19));
    assert_eq!(outbox.counts().again, 8);
}

#[test]
fn a_foreign_file_and_one_of_the_first_version_are_rejected_with_a_reason() {
    for (statements, wanted) in [
        ("CREATE TABLE other (x)", "another program's"),
        (
            "CREATE TABLE instance (id); PRAGMA application_id = 0x616c6269; PRAGMA user_version = 1",
            "such as 0.1.0",
        ),
    ] {
        let bench = Bench::new();
        std::fs::create_dir(bench.state()).unwrap();
        let db = Connection::open(bench.file()).unwrap();
        db.execute_batch(statements).unwrap();
        drop(db);
        let error = Outbox::open(&bench.config, Some(&bench.state())).unwrap_err();
        assert!(error.to_string().contains(wanted), "{error}");
    }
}

#[test]
fn a_damaged_file_and_a_garbage_file_are_set_aside() {
    for (intact, length) in [(4096, usize::MAX), (0, 9000)] {
        let bench = Bench::new();
        keep(&bench.open(), 0..400);
        let mut bytes = std::fs::read(bench.file()).unwrap();
        bytes.truncate(length);
        bytes[intact..].fill(0xa5);
        std::fs::write(bench.file(), bytes).unwrap();
        let outbox = bench.open();
        keep(&outbox, 400..401);
        let counts = outbox.counts();
        assert!(counts.disk_failures > 0, "{counts:?}");
        assert!(counts.status.durable, "{counts:?}");
        assert!(bench.state().join("node.db.damaged-0").exists());
        assert_eq!(drain(&outbox), ["window-400"]);
    }
}

#[test]
fn a_failing_disk_delays_no_report_and_its_return_loses_or_repeats_none() {
    for (fault, reason) in [
        ("full", "no storage space"),
        ("gone", "cannot be used"),
        // Reopening the file does not help.
        ("locked", "locked"),
        ("read-only", "readonly"),
    ] {
        let bench = Bench::new();
        let outbox = bench.open();
        keep(&outbox, 0..3);
        let sent = batch(&outbox).unwrap();
        let other = Connection::open(bench.file()).unwrap();
        match fault {
            "full" => bench.fill_disk(true),
            "gone" => bench.take_disk(),
            "locked" => other.execute_batch("BEGIN IMMEDIATE").unwrap(),
            _ => {
                let waiting = outbox.0.waiting.lock();
                let db = waiting.file().connection();
                db.pragma_update(None, "query_only", true).unwrap();
            }
        }
        keep(&outbox, 3..60);
        // A file that is only read-only works again at the first retry.
        let retries = if fault == "read-only" { 0 } else { 20 };
        for _ in 0..retries {
            outbox.retry_disk(Now::system());
        }
        let counts = outbox.counts();
        assert!(!counts.status.durable, "{fault}");
        assert_eq!(counts.status.waiting, 60, "{fault}");
        let failing = counts.failing.unwrap();
        assert!(failing.contains(reason), "{fault}: {failing}");
        // Reports on the disk are sent too.
        assert_eq!(batch(&outbox).unwrap().reports.len(), 60, "{fault}");
        assert_eq!(acknowledge(&outbox, &sent), 3, "{fault}");
        assert_eq!(outbox.counts().status.waiting, 57, "{fault}");
        assert_eq!(clips(&batch(&outbox).unwrap())[0], "window-3", "{fault}");
        match fault {
            "full" => bench.fill_disk(false),
            "gone" => bench.return_disk(&outbox),
            "locked" => other.execute_batch("ROLLBACK").unwrap(),
            _ => {}
        }
        outbox.retry_disk(Now::system());
        let counts = outbox.counts();
        assert!(counts.status.durable, "{fault}: {counts:?}");
        drop(outbox);
        let kept = counts_of(&batch(&bench.open()).unwrap());
        assert!(kept.into_iter().eq((4..=60_u64).map(Some)), "{fault}");
    }
}

#[test]
fn reports_in_memory_move_to_another_disk_that_takes_the_place_of_the_first() {
    let (bench, other) = (Bench::new(), Bench::new());
    let outbox = bench.open();
    keep(&other.open(), 10..12);
    std::fs::rename(bench.state(), bench.folder.path().join("first")).unwrap();
    keep(&outbox, 3..4);
    std::fs::rename(other.state(), bench.state()).unwrap();
    outbox.retry_disk(Now::system());
    let mut sent = drain(&outbox);
    sent.sort();
    assert_eq!(sent, ["window-10", "window-11", "window-3"]);
}

#[test]
fn reports_made_before_the_disk_is_ready_have_no_count_and_are_delivered() {
    let bench = Bench::new();
    keep(&bench.open(), 0..3);
    bench.take_disk();
    let state = bench.state().join("below");
    let outbox = Outbox::open(&bench.config, Some(&state)).unwrap();
    keep(&outbox, 3..4);
    std::fs::remove_file(bench.state()).unwrap();
    std::fs::create_dir(bench.state()).unwrap();
    std::fs::rename(bench.folder.path().join("away"), &state).unwrap();
    outbox.retry_disk(Now::system());
    keep(&outbox, 4..5);
    let sent = batch(&outbox).unwrap();
    assert_eq!(sent.reports.len(), 5);
    let of = |clip: &str| sent.reports.iter().find(|report| report.clip == clip);
    assert_eq!(of("window-3").unwrap().count, None);
    assert_eq!(of("window-4").unwrap().count, Some(4));
}

#[test]
fn a_full_outbox_drops_acknowledged_reports_first_then_the_oldest_and_counts_them() {
    let mut bench = Bench::new();
    bench.config.max_bytes = 128 << 10;
    let outbox = bench.open();
    keep(&outbox, 0..40);
    drain(&outbox);
    keep(&outbox, 40..60);
    let counts = outbox.counts();
    assert_eq!((counts.status.waiting, counts.status.lost), (20, 0));
    keep(&outbox, 60..400);
    let counts = outbox.counts();
    let (lost, waiting) = (counts.status.lost, counts.status.waiting);
    assert!(lost > 0 && waiting > 20, "{counts:?}");
    assert_eq!(lost + waiting, 360);
    assert!(counts.last_loss.is_some());
    assert_eq!(drain(&outbox).last().unwrap(), "window-399");
    let size = std::fs::metadata(bench.file()).unwrap().len();
    assert!(size < 256 << 10, "{size}");
    drop(outbox);
    assert_eq!(bench.open().counts().status.lost, counts.status.lost);
}

#[test]
fn without_a_state_directory_reports_wait_in_bounded_memory() {
    let outbox = in_memory();
    let most = 40 * MEMORY_BYTES / 1_000_000;
    for clip in 0..most {
        keep_large(&outbox, clip, 50_000);
    }
    let counts = outbox.counts();
    assert!(!counts.status.durable && counts.status.lost > 0 && counts.status.waiting > most / 3);
    assert_eq!(counts.status.waiting + counts.status.lost, most);
    let sent = drain(&outbox);
    assert_eq!(sent.len() as u64, counts.status.waiting);
    assert_eq!(sent.last().unwrap(), &format!("window-{}", most - 1));
}

#[test]
fn a_batch_from_memory_is_bounded_like_one_from_disk() {
    let bench = Bench::new();
    for outbox in [bench.open(), in_memory()] {
        for clip in 0..60 {
            keep_large(&outbox, clip, 50 << 10);
        }
        let mut sent = Vec::new();
        while let Some(batch) = batch(&outbox) {
            assert!(serde_json::to_vec(&batch).unwrap().len() < BATCH_BYTES + 2000);
            acknowledge(&outbox, &batch);
            sent.extend(batch.reports);
        }
        assert_eq!(sent.len(), 60);
    }
}

#[test]
fn a_report_that_cannot_be_sent_is_counted_and_the_rest_is_sent() {
    let (bench, unreadable) = (Bench::new(), Bench::new());
    keep(&unreadable.open(), 0..3);
    let db = Connection::open(unreadable.file()).unwrap();
    let spoilt = "UPDATE report SET json = x'00' WHERE count = 2";
    db.execute(spoilt, []).unwrap();
    drop(db);
    let too_large = |outbox: Outbox| {
        for clip in 0..3 {
            let bytes = if clip == 1 { LARGEST_REPORT_BYTES } else { 9 };
            keep_large(&outbox, clip, bytes);
        }
        outbox
    };
    for (case, outbox) in [
        ("unreadable", unreadable.open()),
        ("too large on the disk", too_large(bench.open())),
        ("too large in memory", too_large(in_memory())),
    ] {
        assert_eq!(drain(&outbox), ["window-0", "window-2"], "{case}");
        let status = outbox.counts().status;
        assert_eq!((status.undeliverable, status.waiting), (1, 0), "{case}");
    }
}

#[test]
fn counting_and_waking_the_sender_never_wait_for_a_disk() {
    let outbox = in_memory();
    keep(&outbox, 0..1);
    // The lock is held while the disk is written.
    let writing = outbox.0.waiting.lock();
    assert_eq!(outbox.counts().status.waiting, 1);
    assert!(outbox.changed().now_or_never().is_some());
    drop(writing);
}
