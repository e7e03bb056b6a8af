mod flips;

use super::disk::{FILE, LOCK, WITNESS, Witness};
use super::table::MEMORY_BYTES;
use super::waiting::BATCH_BYTES;
use super::*;
use albireo_wire::{
    ClipReport, LARGEST_REPORT_BYTES, RefusedReport, ReportAge, ReportAnswer, ReportBatch, VERSION,
};
use futures_util::FutureExt;
use rusqlite::Connection;
use std::io::{Error, ErrorKind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use uuid::Uuid;

impl Outbox {
    /// Stalls the disk until the result is dropped.
    pub(crate) fn stall(&self) -> impl Sized {
        self.waiting.lock()
    }
}

pub(crate) fn report(clip: u64) -> ClipReport {
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
struct FaultyDisk {
    file: StateFile,
    faults: Arc<Faults>,
}

#[derive(Debug, Default)]
pub(crate) struct Faults {
    is_full: AtomicBool,
}

impl Faults {
    /// Opens an outbox on a disk with these faults.
    pub(crate) fn open(
        self: &Arc<Self>,
        directory: &Path,
        max_bytes: u64,
        now: Now,
    ) -> Result<Outbox, TableError> {
        let file = StateFile::new(directory);
        let faults = Arc::clone(self);
        Outbox::open_on(Box::new(FaultyDisk { file, faults }), max_bytes, now)
    }

    pub(crate) fn fill_disk(&self) {
        self.is_full.store(true, Ordering::Relaxed);
    }

    pub(crate) fn free_disk(&self) {
        self.is_full.store(false, Ordering::Relaxed);
    }
}

impl Disk for FaultyDisk {
    fn open(&mut self) -> Result<Connection, TableError> {
        if self.faults.is_full.load(Ordering::Relaxed) {
            return Err(Error::from(ErrorKind::StorageFull).into());
        }
        let db = self.file.open()?;
        db.busy_timeout(Duration::ZERO)?;
        // FULL, or more: a power cut loses no commit.
        let level: i64 = db.pragma_query_value(None, "synchronous", |row| row.get(0))?;
        assert!(level >= 2, "commits are not synced");
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

    fn witness(&self) -> Option<Witness> {
        self.file.witness()
    }

    fn testify(&self, witness: Witness) {
        self.file.testify(witness);
    }
}

struct Bench {
    folder: tempfile::TempDir,
    max_bytes: u64,
    faults: Arc<Faults>,
}

impl Bench {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
            max_bytes: MAX_BYTES,
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
        let state = self.state();
        let now = Now::system();
        self.faults.open(&state, self.max_bytes, now).unwrap()
    }
}

fn in_memory() -> Outbox {
    Outbox::open(None).unwrap()
}

fn insert(outbox: &Outbox, report: ClipReport, now: Now) {
    outbox.change(|waiting| waiting.insert(&mut [report], now));
}

fn keep(outbox: &Outbox, clips: std::ops::Range<u64>) {
    for clip in clips {
        insert(outbox, report(clip), Now::system());
    }
}

fn keep_large(outbox: &Outbox, clip: u64, bytes: usize) {
    let policy = "x".repeat(bytes);
    let report = ClipReport {
        policy,
        ..report(clip)
    };
    insert(outbox, report, Now::system());
}

fn batch(outbox: &Outbox) -> Option<ReportBatch> {
    batch_of(outbox, BatchScope::NewAndForgotten, Now::system())
}

fn batch_of(outbox: &Outbox, scope: BatchScope, now: Now) -> Option<ReportBatch> {
    outbox.change(|waiting| waiting.batch("n", scope, now))
}

fn retry_disk(outbox: &Outbox) {
    outbox.change(|waiting| waiting.retry_disk(Now::system()));
}

fn clips(batch: &ReportBatch) -> Vec<&str> {
    batch.reports.iter().map(|report| report.clip.as_str()).collect()
}

fn counts_of(batch: &ReportBatch) -> Vec<Option<u64>> {
    batch.reports.iter().map(|report| report.count).collect()
}

fn conclude(outbox: &Outbox, batch: &ReportBatch, answer: &ReportAnswer, now: Now) -> u64 {
    outbox.change(|waiting| waiting.answered(batch, answer, now))
}

fn acknowledge(outbox: &Outbox, batch: &ReportBatch) -> u64 {
    conclude(outbox, batch, &ReportAnswer::default(), Now::system())
}

/// The clips that are sent, in bounded batches, to a hub that accepts everything.
fn drain(outbox: &Outbox) -> Vec<String> {
    let mut sent = Vec::new();
    while let Some(batch) = batch(outbox) {
        assert!(serde_json::to_vec(&batch).unwrap().len() < BATCH_BYTES + 2000);
        acknowledge(outbox, &batch);
        sent.extend(clips(&batch).into_iter().map(str::to_owned));
    }
    sent
}

#[test]
fn reports_are_sent_until_acknowledged_or_refused_and_counted_on_after_a_restart() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..5);
    let mut sent = batch(&outbox).unwrap();
    assert_eq!(counts_of(&sent), [1, 2, 3, 4, 5].map(Some));
    sent.reports.truncate(2);
    let answer = ReportAnswer {
        refused: vec![RefusedReport {
            id: sent.reports[1].id,
            reason: "too old".into(),
        }],
        ..ReportAnswer::default()
    };
    assert_eq!(conclude(&outbox, &sent, &answer, Now::system()), 1);
    drop(outbox);
    let outbox = bench.open();
    let counts = outbox.counts();
    assert_eq!(counts.status.waiting, 3);
    assert_eq!(counts.status.undeliverable, 1);
    assert_eq!(drain(&outbox), ["window-2", "window-3", "window-4"]);
    drop(outbox);
    let outbox = bench.open();
    keep(&outbox, 5..6);
    assert_eq!(counts_of(&batch(&outbox).unwrap()), [Some(6)]);
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
        ..ReportAnswer::default()
    };
    conclude(&outbox, &sent, &answer, Now::system());
    let counts = outbox.counts();
    assert_eq!(counts.status.waiting, 0);
    assert_eq!(counts.again, 3);
    keep(&outbox, 7..8);
    let new = batch_of(&outbox, BatchScope::New, Now::system()).unwrap();
    assert_eq!(clips(&new), ["window-7"]);
    let sent = batch(&outbox).unwrap();
    let expected = ["window-7", "window-1", "window-2", "window-4"];
    assert_eq!(clips(&sent), expected);
    acknowledge(&outbox, &sent);
    assert!(batch(&outbox).is_none());
}

#[test]
fn a_hub_with_another_database_gets_the_reports_of_the_last_week_once() {
    let bench = Bench::new();
    let outbox = bench.open();
    let start = Now::system();
    let mut sent = Vec::new();
    for clip in 0..24 {
        let mut now = start;
        now.unix_ms += clip.min(19) as i64 * 86_400_000;
        insert(&outbox, report(clip), now);
        let batch = batch_of(&outbox, BatchScope::NewAndForgotten, now).unwrap();
        let mut answer = ReportAnswer::default();
        if clip == 20 {
            // An empty database lacks all reports before the first that it gets.
            answer.missing.push((1, 20));
        }
        conclude(&outbox, &batch, &answer, now);
        let counts = outbox.counts();
        // Sent, waiting, to be sent again.
        sent.push((batch.reports.len(), counts.status.waiting, counts.again));
    }
    assert_eq!(sent[..20], [(1, 0, 0); 20]);
    assert_eq!(sent[20..], [(1, 0, 8), (9, 0, 0), (1, 0, 0), (1, 0, 0)]);
}

#[test]
fn a_foreign_file_and_one_of_the_first_version_are_rejected_with_a_reason() {
    let first_version =
        "CREATE TABLE instance (id); PRAGMA application_id = 0x616c6269; PRAGMA user_version = 1";
    for (statements, wanted) in [
        ("CREATE TABLE other (x)", "another program's"),
        (first_version, "such as 0.1.0"),
    ] {
        let bench = Bench::new();
        std::fs::create_dir(bench.state()).unwrap();
        let db = Connection::open(bench.file()).unwrap();
        db.execute_batch(statements).unwrap();
        drop(db);
        let error = Outbox::open(Some(&bench.state())).unwrap_err();
        assert!(error.to_string().contains(wanted), "{error}");
    }
}

#[test]
fn a_damaged_page_costs_its_own_rows_and_they_are_counted_as_lost() {
    let bench = Bench::new();
    keep(&bench.open(), 0..400);
    let mut bytes = std::fs::read(bench.file()).unwrap();
    let page = bytes.len() / 2 / 4096 * 4096;
    bytes[page] ^= 0xff;
    std::fs::write(bench.file(), bytes).unwrap();
    let outbox = bench.open();
    let status = outbox.counts().status;
    assert!(status.waiting > 380, "{status:?}");
    assert!(status.durable, "{status:?}");
    assert_eq!(status.waiting + status.lost, 400);
    keep(&outbox, 400..401);
    let last = batch(&outbox).unwrap().reports.pop();
    assert!(last.unwrap().count >= Some(351));
}

#[test]
fn a_cut_log_costs_at_most_a_hundred_reports_and_they_are_counted_as_lost() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..149);
    let log = bench.state().join("node.db-wal");
    let mut bytes = std::fs::read(&log).unwrap();
    let place = bytes.len() / 10;
    bytes[place] ^= 4;
    let file = bench.file();
    let counts = bench.state().join(WITNESS);
    let kept = [&file, &counts].map(|file| std::fs::read(file).unwrap());
    drop(outbox);
    std::fs::write(&log, bytes).unwrap();
    for (file, bytes) in [&file, &counts].into_iter().zip(kept) {
        std::fs::write(file, bytes).unwrap();
    }
    let outbox = bench.open();
    let counts = outbox.counts();
    assert!(counts.status.lost > 0, "{counts:?}");
    assert!(counts.last_loss.is_some(), "{counts:?}");
    assert_eq!(counts.status.waiting + counts.status.lost, 149);
    assert!(counts.status.waiting >= 100, "{counts:?}");
    // The hub sees the gap.
    keep(&outbox, 149..150);
    let sent = batch(&outbox).unwrap();
    assert_eq!(counts_of(&sent).last(), Some(&Some(150)));
}

#[test]
fn what_the_node_knows_of_a_reports_age_survives_a_restart_of_the_program() {
    let bench = Bench::new();
    let outbox = bench.open();
    let mut now = Now::system();
    let age_of_first = |outbox: &Outbox, node: &str, now| {
        let sent = outbox.change(|waiting| waiting.batch(node, BatchScope::New, now));
        sent.unwrap().ages[0]
    };
    insert(&outbox, report(0), now);
    drop(outbox);
    let outbox = bench.open();
    now.uptime.s += 7;
    now.unix_ms -= 400 * 86_400_000;
    let sent_first = |made_s| ReportAge {
        made_s,
        first: true,
    };
    let sent_before = |made_s| ReportAge {
        made_s,
        first: false,
    };
    assert_eq!(age_of_first(&outbox, "n", now), sent_first(Some(7)));
    drop(outbox);
    let outbox = bench.open();
    assert_eq!(age_of_first(&outbox, "n", now), sent_before(Some(7)));
    now.uptime.boot += 1;
    assert_eq!(age_of_first(&outbox, "n", now), sent_before(None));
    // A copied state directory: the first owner may have sent it.
    let other = in_memory();
    insert(&other, report(1), now);
    assert_eq!(age_of_first(&other, "other", now), sent_before(Some(0)));
}

#[test]
fn a_damaged_file_and_a_garbage_file_are_set_aside() {
    // All but the first page is damaged, and nothing is left of the file.
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
        assert_eq!(counts.status.lost, 400);
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
        let away = bench.folder.path().join("away");
        match fault {
            "full" => bench.faults.fill_disk(),
            "gone" => {
                // With a file in its place, no folder can be created there.
                std::fs::rename(bench.state(), &away).unwrap();
                std::fs::write(bench.state(), b"").unwrap();
            }
            "locked" => other.execute_batch("BEGIN IMMEDIATE").unwrap(),
            _ => {
                let waiting = outbox.waiting.lock();
                let db = &waiting.table.db;
                db.pragma_update(None, "query_only", true).unwrap();
            }
        }
        keep(&outbox, 3..60);
        // A file that is only read-only works again at the first retry.
        let retries = if fault == "read-only" { 0 } else { 20 };
        for _ in 0..retries {
            retry_disk(&outbox);
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
            "full" => bench.faults.free_disk(),
            "gone" => {
                std::fs::remove_file(bench.state()).unwrap();
                std::fs::rename(&away, bench.state()).unwrap();
            }
            "locked" => other.execute_batch("ROLLBACK").unwrap(),
            _ => {}
        }
        retry_disk(&outbox);
        let counts = outbox.counts();
        assert!(counts.status.durable, "{fault}: {counts:?}");
        drop(outbox);
        let kept = counts_of(&batch(&bench.open()).unwrap());
        assert!(kept.into_iter().eq((4..=60_u64).map(Some)), "{fault}");
    }
}

#[test]
fn reports_in_memory_move_to_another_disk_that_takes_the_place_of_the_first() {
    let bench = Bench::new();
    let other = Bench::new();
    let outbox = bench.open();
    keep(&other.open(), 10..12);
    std::fs::rename(bench.state(), bench.folder.path().join("first")).unwrap();
    keep(&outbox, 3..4);
    std::fs::rename(other.state(), bench.state()).unwrap();
    retry_disk(&outbox);
    let mut sent = drain(&outbox);
    sent.sort();
    assert_eq!(sent, ["window-10", "window-11", "window-3"]);
}

#[test]
fn no_second_node_gets_a_state_directory_whose_lock_was_removed() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..1);
    let remove_folder = || std::fs::remove_dir_all(bench.state()).unwrap();
    let remove_lock = || std::fs::remove_file(bench.state().join(LOCK)).unwrap();
    let removals: [&dyn Fn(); 2] = [&remove_folder, &remove_lock];
    for (clip, remove) in (1..).zip(removals) {
        remove();
        keep(&outbox, clip..clip + 1);
        retry_disk(&outbox);
        assert!(outbox.counts().status.durable);
        let refused = Outbox::open(Some(&bench.state())).unwrap_err();
        let reason = refused.to_string();
        assert!(reason.contains("in use by another node"), "{reason}");
    }
    let mut sent = drain(&outbox);
    sent.sort();
    let made_since = ["window-1", "window-2"].map(str::to_owned);
    assert!(sent.ends_with(&made_since), "{sent:?}");
}

#[test]
fn a_link_to_nowhere_as_state_directory_is_named() {
    let bench = Bench::new();
    std::os::unix::fs::symlink("nowhere", bench.state()).unwrap();
    let outbox = bench.open();
    let failing = outbox.counts().failing.unwrap();
    let expected = format!(
        "{} cannot be created: it is a link",
        bench.state().display()
    );
    assert!(failing.contains(&expected), "{failing}");
}

#[test]
fn reports_made_before_the_disk_is_ready_have_no_count_and_are_delivered() {
    let bench = Bench::new();
    keep(&bench.open(), 0..3);
    bench.faults.fill_disk();
    let outbox = bench.open();
    keep(&outbox, 3..4);
    bench.faults.free_disk();
    retry_disk(&outbox);
    keep(&outbox, 4..5);
    let mut sent = batch(&outbox).unwrap();
    sent.reports.sort_by_key(|report| report.id);
    assert_eq!(counts_of(&sent), [Some(1), Some(2), Some(3), None, Some(4)]);
}

#[test]
fn a_full_outbox_drops_acknowledged_reports_first_then_the_oldest_and_counts_them() {
    let mut bench = Bench::new();
    bench.max_bytes = 128 << 10;
    let outbox = bench.open();
    keep(&outbox, 0..40);
    drain(&outbox);
    keep(&outbox, 40..60);
    let counts = outbox.counts();
    assert_eq!(counts.status.waiting, 20);
    assert_eq!(counts.status.lost, 0);
    keep(&outbox, 60..400);
    let counts = outbox.counts();
    let lost = counts.status.lost;
    let waiting = counts.status.waiting;
    assert!(lost > 0, "{counts:?}");
    assert!(waiting > 20, "{counts:?}");
    assert_eq!(lost + waiting, 360);
    assert!(counts.last_loss.is_some());
    assert_eq!(drain(&outbox).last().unwrap(), "window-399");
    let size = std::fs::metadata(bench.file()).unwrap().len();
    assert!(size < 256 << 10, "{size}");
    drop(outbox);
    assert_eq!(bench.open().counts().status.lost, counts.status.lost);
}

#[test]
fn without_a_state_directory_reports_wait_in_bounded_memory_and_are_sent_in_bounded_batches() {
    let outbox = in_memory();
    let most = 40 * MEMORY_BYTES / 1_000_000;
    for clip in 0..most {
        keep_large(&outbox, clip, 50_000);
    }
    let counts = outbox.counts();
    assert!(!counts.status.durable, "{counts:?}");
    assert!(counts.status.lost > 0, "{counts:?}");
    assert!(counts.status.waiting > most / 3, "{counts:?}");
    assert_eq!(counts.status.waiting + counts.status.lost, most);
    let sent = drain(&outbox);
    assert_eq!(sent.len() as u64, counts.status.waiting);
    assert_eq!(sent.last().unwrap(), &format!("window-{}", most - 1));
}

#[test]
fn a_report_that_cannot_be_sent_is_counted_and_told_and_the_rest_is_sent() {
    let bench = Bench::new();
    let too_large = in_memory();
    keep(&bench.open(), 0..3);
    let db = Connection::open(bench.file()).unwrap();
    let spoilt = "UPDATE report SET json = x'00' WHERE count = 2";
    db.execute(spoilt, []).unwrap();
    drop(db);
    for (clip, bytes) in [(0, 9), (1, LARGEST_REPORT_BYTES), (2, 9)] {
        keep_large(&too_large, clip, bytes);
    }
    for (case, outbox) in [("unreadable", bench.open()), ("too large", too_large)] {
        assert_eq!(drain(&outbox), ["window-0", "window-2"], "{case}");
        let status = outbox.counts().status;
        assert_eq!(status.undeliverable, 1, "{case}");
        let fault = outbox.counts().fault().unwrap();
        assert!(fault.reason.contains("no hub will get"), "{fault:?}");
        assert_eq!(status.waiting, 0, "{case}");
    }
}

#[test]
fn counting_and_waking_the_sender_never_wait_for_a_disk() {
    let outbox = in_memory();
    keep(&outbox, 0..1);
    // The lock is held while the disk is written.
    let writing = outbox.waiting.lock();
    assert_eq!(outbox.counts().status.waiting, 1);
    assert!(outbox.changed().now_or_never().is_some());
    drop(writing);
}

#[test]
fn lost_reports_are_a_fault_of_the_node() {
    let lost = OutboxCounts {
        last_loss: Some(Instant::now()),
        ..OutboxCounts::default()
    };
    let fault = lost.fault().unwrap();
    assert!(fault.reason.contains("were lost"), "{}", fault.reason);
}

#[test]
fn refused_reports_are_a_fault_of_the_node_for_some_minutes_and_counted_for_ever() {
    let bench = Bench::new();
    let outbox = bench.open();
    keep(&outbox, 0..1);
    let sent = batch(&outbox).unwrap();
    let answer = ReportAnswer {
        refused: vec![RefusedReport {
            id: sent.reports[0].id,
            reason: "too old".into(),
        }],
        ..ReportAnswer::default()
    };
    conclude(&outbox, &sent, &answer, Now::system());
    let mut counts = outbox.counts();
    let fault = counts.fault().unwrap();
    assert!(fault.reason.contains("no hub will get"), "{fault:?}");
    counts.last_refusal = Instant::now().checked_sub(LOSS_SHOWN_FOR);
    assert_eq!(counts.fault(), None);
    assert_eq!(counts.refused, 1);
}
