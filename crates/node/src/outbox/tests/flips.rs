//! Flips single bits of a node's files: the result is the same, or the node says what it lost.

use super::*;
use crate::settings::SettingsFile;
use rand_core::{RngCore, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::BTreeMap;
use std::thread;

const FLIPS: u64 = 2000;
const REPORTS: u64 = 150;
const SETTING: &str = "threshold/front";

/// The files of a node that was killed, and its reports.
struct Killed {
    files: [(&'static str, Vec<u8>); 4],
    reports: BTreeMap<Uuid, ClipReport>,
}

/// A temporary folder, in memory where the machine has such a folder.
fn folder() -> tempfile::TempDir {
    let in_memory = tempfile::tempdir_in("/dev/shm");
    in_memory.or_else(|_| tempfile::tempdir()).unwrap()
}

impl Killed {
    fn new() -> Self {
        let bench = Bench::new();
        let outbox = bench.open();
        keep(&outbox, 0..REPORTS);
        let settings = SettingsFile::open(Some(&bench.state()));
        settings.edit(|kept| kept.set(SETTING, &9e-4));
        let names = [FILE, "node.db-wal", WITNESS, "settings.json"];
        let files = names.map(|name| (name, std::fs::read(bench.state().join(name)).unwrap()));
        assert!(files.iter().all(|(_, bytes)| bytes.len() > 20));
        let mut reports = BTreeMap::new();
        while let Some(sent) = batch(&outbox) {
            acknowledge(&outbox, &sent);
            reports.extend(sent.reports.into_iter().map(|report| (report.id, report)));
        }
        Self { files, reports }
    }

    /// Starts a node on these files with one bit flipped. Returns true if it says that something is wrong.
    fn flip(&self, seed: u64, folder: &Path) -> bool {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let flipped = (seed % 4) as usize;
        let state = folder.join(seed.to_string());
        std::fs::create_dir(&state).unwrap();
        let mut place = 0;
        for (number, (name, bytes)) in self.files.iter().enumerate() {
            let mut bytes = bytes.clone();
            if number == flipped {
                place = random.next_u64() as usize % bytes.len();
                bytes[place] ^= 1 << (random.next_u64() % 8);
            }
            std::fs::write(state.join(name), bytes).unwrap();
        }
        let case = format!("seed {seed}: byte {place} of {}", self.files[flipped].0);
        let settings = SettingsFile::open(Some(&state));
        let is_kept = settings.get(SETTING) == Some(9e-4);
        assert!(is_kept || settings.fault().is_some(), "{case}");
        // Another program's file, as far as the node can tell: it does not start, and says why.
        let Ok(outbox) = Arc::<Faults>::default().open(&state, MAX_BYTES, Now::system()) else {
            return true;
        };
        let mut delivered = 0;
        while let Some(sent) = batch(&outbox) {
            for report in &sent.reports {
                assert_eq!(Some(report), self.reports.get(&report.id), "{case}");
            }
            delivered += sent.reports.len() as u64;
            assert!(delivered <= REPORTS, "{case}");
            acknowledge(&outbox, &sent);
        }
        let status = outbox.counts().status;
        let told = status.lost + status.undeliverable;
        assert!(
            delivered + told >= REPORTS,
            "{case}: {delivered}, {status:?}"
        );
        insert(&outbox, report(REPORTS), Now::system());
        let next = batch(&outbox).unwrap();
        assert!(counts_of(&next) >= vec![Some(REPORTS + 1)], "{case}");
        std::fs::remove_dir_all(state).unwrap();
        told > 0 || settings.fault().is_some() || outbox.counts().disk_failures > 0
    }
}

#[test]
fn one_flipped_bit_changes_nothing_or_is_told() {
    let killed = Killed::new();
    let folder = folder();
    let threads = thread::available_parallelism().map_or(1, |many| many.get().min(8)) as u64;
    let run = &|first| {
        let mut told: usize = 0;
        for seed in (first..FLIPS).step_by(threads as usize) {
            if killed.flip(seed, folder.path()) {
                told += 1;
            }
        }
        told
    };
    let told: usize = thread::scope(|scope| {
        let spawn = |first| scope.spawn(move || run(first));
        let threads: Vec<_> = (0..threads).map(spawn).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).sum()
    });
    println!("{told} of {FLIPS} flips were told; the others changed nothing");
    assert!(told > 0);
}
