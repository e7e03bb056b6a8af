//! All sessions of this process, kept so that none runs when the process ends.
//!
//! ONNX Runtime's library is destroyed as the process exits. A thread that still loads or runs a model then uses
//! destroyed objects: it logs strange errors and may crash.

use parking_lot::{Condvar, Mutex};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Asks a model that is being loaded or run to end early.
type Interrupter = Arc<dyn Fn() + Send + Sync>;

/// The sessions of this process.
pub(super) static SESSIONS: Sessions = Sessions::new();

/// Interrupts every model that is being loaded or run in this process, and waits until all sessions are gone, at most
/// `patience`. Sessions loaded afterwards are interrupted at once: call this at the end of the process. Returns `false`
/// if some are left.
pub fn end_all_sessions(patience: Duration) -> bool {
    SESSIONS.end_all(patience)
}

/// The sessions, each from before it is loaded until it is gone.
pub(super) struct Sessions {
    kept: Mutex<Kept>,
    one_is_gone: Condvar,
}

struct Kept {
    ending: bool,
    next: u64,
    interrupters: BTreeMap<u64, Interrupter>,
}

impl Sessions {
    const fn new() -> Self {
        Self {
            kept: Mutex::new(Kept {
                ending: false,
                next: 0,
                interrupters: BTreeMap::new(),
            }),
            one_is_gone: Condvar::new(),
        }
    }

    /// Keeps `interrupter` for as long as the returned entry exists; calls it at once if all sessions must end.
    pub(super) fn enter(&self, interrupter: Interrupter) -> Entry<'_> {
        let mut kept = self.kept.lock();
        let number = kept.next;
        kept.next += 1;
        kept.interrupters.insert(number, interrupter.clone());
        if kept.ending {
            drop(kept);
            interrupter();
        }
        Entry {
            sessions: self,
            number,
        }
    }

    fn end_all(&self, patience: Duration) -> bool {
        let interrupters: Vec<_> = {
            let mut kept = self.kept.lock();
            kept.ending = true;
            kept.interrupters.values().cloned().collect()
        };
        for interrupt in interrupters {
            interrupt();
        }
        let mut kept = self.kept.lock();
        self.one_is_gone
            .wait_while_for(&mut kept, |kept| !kept.interrupters.is_empty(), patience);
        kept.interrupters.is_empty()
    }
}

/// The entry of one session; removed when dropped.
pub(super) struct Entry<'a> {
    sessions: &'a Sessions,
    number: u64,
}

impl Drop for Entry<'_> {
    fn drop(&mut self) {
        self.sessions.kept.lock().interrupters.remove(&self.number);
        self.sessions.one_is_gone.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::mpsc::channel;

    #[test]
    fn all_are_interrupted_and_waited_for_up_to_a_limit_and_late_ones_interrupted_at_once() {
        // Long enough that no test waits for it.
        const PATIENCE: Duration = Duration::from_secs(60);
        let sessions = Sessions::new();
        drop(sessions.enter(Arc::new(|| panic!("it is gone"))));
        let (interrupt, interrupted) = channel();
        let enter = || {
            let interrupt = interrupt.clone();
            sessions.enter(Arc::new(move || interrupt.send(()).unwrap()))
        };
        let entries = [enter(), enter(), enter()];
        assert!(interrupted.try_recv().is_err());
        assert!(!sessions.end_all(Duration::from_millis(1)));
        assert_eq!(interrupted.try_iter().count(), 3);
        let late = enter();
        interrupted.try_recv().unwrap();
        std::thread::scope(|scope| {
            let ended = scope.spawn(|| sessions.end_all(PATIENCE));
            (0..4).for_each(|_| interrupted.recv().unwrap());
            drop((entries, late));
            assert!(ended.join().unwrap());
        });
        assert!(sessions.end_all(PATIENCE));
    }
}
