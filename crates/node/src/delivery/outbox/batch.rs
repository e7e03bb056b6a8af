//! What is sent next: the oldest reports whose energy is known, and nothing that would overtake another.

use super::state::{Shared, State};
use super::store::{Instance, Wanted};
use albireo_wire::{ClipReport, LARGEST_BATCH_BYTES, ReportBatch, VERSION};
use std::time::{Duration, Instant};

/// A report whose energy is not known after this time is sent without.
const LONGEST_SETTLING: Duration = Duration::from_secs(30);

/// Uncompressed bytes of a batch at most: well below [`LARGEST_BATCH_BYTES`], and compressed far below what an uplink
/// lets through.
pub(super) const BATCH_BYTES: usize = 1 << 20;

/// Bytes of a report beyond which no hub would ever take it, room for the batch around it left.
pub(super) const LARGEST_REPORT: usize = LARGEST_BATCH_BYTES as usize - (64 << 10);

/// A batch to be sent.
#[derive(Debug)]
pub(crate) struct Batch {
    /// What goes over the wire.
    pub message: ReportBatch,
}

/// What the disk has to send.
enum OnDisk {
    Reports(Batch),
    /// Something that must go before anything else, and cannot go now.
    Later,
    Nothing,
}

impl Shared {
    /// The oldest reports that can be sent.
    pub(super) fn next_batch(&self, state: &mut State, node: &str) -> Option<Batch> {
        let most = self.config.batch_reports.max(1);
        match from_disk(state, node, most) {
            OnDisk::Reports(batch) => Some(batch),
            OnDisk::Later => None,
            OnDisk::Nothing => from_memory(state, node, most),
        }
    }
}

fn from_disk(state: &mut State, node: &str, most: usize) -> OnDisk {
    loop {
        let seen: &State = state;
        let Some(store) = &seen.store else {
            // What is on disk and cannot be read has lower numbers: later ones must not overtake them.
            return if seen.unsent_on_disk() > 0 {
                OnDisk::Later
            } else {
                OnDisk::Nothing
            };
        };
        let above = |instance: &str| seen.acknowledged_upto(instance);
        let below = |instance: &str| first_unsettled(seen, instance);
        let wanted = Wanted {
            reports: most,
            bytes: BATCH_BYTES,
            above: &above,
            below: &below,
        };
        let any = Wanted {
            reports: 1,
            below: &|_| None,
            ..wanted
        };
        let found = match store.rows(&wanted) {
            Ok(None) => store.rows(&any).map(|waits| (None, waits.is_some())),
            Ok(Some(rows)) => Ok((Some(rows), true)),
            Err(error) => Err(error),
        };
        let rows = match found {
            Ok((Some(rows), _)) => rows,
            Ok((None, true)) => return OnDisk::Later,
            Ok((None, false)) => return OnDisk::Nothing,
            // It cannot be told what is there: nothing may overtake it.
            Err(error) => {
                state.fail_store(&error);
                return OnDisk::Later;
            }
        };
        let instance = &rows.instance.name;
        let (mut reports, mut unreadable) = (Vec::new(), Vec::new());
        for (number, json) in &rows.reports {
            let place = (instance.clone(), *number);
            if state.unreadable.contains(&place) {
                continue;
            }
            match read(*number, state.settled.get(&place).unwrap_or(json)) {
                Ok(report) => reports.push(report),
                Err(reason) => {
                    tracing::error!(number, reason, "a kept clip report cannot be sent: lost");
                    unreadable.push(*number);
                }
            }
        }
        let found_unreadable = !unreadable.is_empty();
        if found_unreadable {
            give_up(state, instance, &unreadable);
        }
        if let Some(batch) = batch_of(node, &rows.instance, reports) {
            return OnDisk::Reports(batch);
        }
        if !found_unreadable || state.failing.is_some() {
            return OnDisk::Later;
        }
    }
}

/// Counts reports on disk as lost, and removes them as soon as the disk can be written.
fn give_up(state: &mut State, instance: &str, numbers: &[u64]) {
    let lost = numbers.len() as u64;
    if instance == state.current.name {
        state.lose(lost);
    }
    state.counts.last_loss = Some(Instant::now());
    if state.failing.is_none()
        && let Some(store) = &mut state.store
    {
        match store.give_up(instance, numbers) {
            Ok(()) => return,
            Err(error) => state.fail_store(&error),
        }
    }
    let places = numbers.iter().map(|number| (instance.to_owned(), *number));
    state.unreadable.extend(places);
}

/// The lowest number of an instance that must wait for its energy.
fn first_unsettled(state: &State, instance: &str) -> Option<u64> {
    (state.unsettled.values())
        .filter(|report| report.instance == instance && report.since.elapsed() < LONGEST_SETTLING)
        .map(|report| report.number)
        .min()
}

fn from_memory(state: &mut State, node: &str, most: usize) -> Option<Batch> {
    let before = first_unsettled(state, &state.current.name).unwrap_or(u64::MAX);
    let (mut reports, mut bytes) = (Vec::new(), 0);
    let mut unreadable = Vec::new();
    for (number, json) in &state.memory {
        bytes += json.len();
        let full = reports.len() == most || (bytes > BATCH_BYTES && !reports.is_empty());
        if *number >= before || full {
            break;
        }
        match read(*number, json) {
            Ok(report) => reports.push(report),
            Err(reason) => {
                tracing::error!(number, reason, "a clip report cannot be sent: lost");
                bytes -= json.len();
                unreadable.push(*number);
            }
        }
    }
    state
        .memory
        .retain(|(number, _)| !unreadable.contains(number));
    state.lose(unreadable.len() as u64);
    batch_of(node, &state.current, reports)
}

fn read(number: u64, json: &[u8]) -> Result<ClipReport, String> {
    if json.len() > LARGEST_REPORT {
        return Err(format!("{} bytes are more than a hub takes", json.len()));
    }
    match serde_json::from_slice::<ClipReport>(json) {
        Ok(report) => Ok(ClipReport {
            report: number,
            ..report
        }),
        Err(error) => Err(error.to_string()),
    }
}

fn batch_of(node: &str, instance: &Instance, reports: Vec<ClipReport>) -> Option<Batch> {
    let (first, last) = (reports.first()?.report, reports.last()?.report);
    Some(Batch {
        message: ReportBatch {
            v: VERSION,
            node: node.to_owned(),
            instance: instance.name.clone(),
            machine: instance.machine.clone(),
            first,
            last,
            lost: instance.lost,
            reports,
        },
    })
}
