//! Whose energy it is when several cameras use one node: the node's energy is measured once and divided.
//!
//! The rule: every second of the node's life is divided between its cameras by the detector time each
//! used in that second; a second without detector time, by the frames each sent; a second without either,
//! as the second before. The shares of a second add up to one, so the clips of all cameras together never
//! count a joule twice.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Length of one piece of the ledger.
const PIECE: Duration = Duration::from_secs(1);

/// A stretch of time in which a camera's share does not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slice {
    /// Its start.
    pub start: Instant,
    /// Its end.
    pub end: Instant,
    /// The camera's share of the node's energy in it, 0 to 1.
    pub share: f64,
}

/// What each camera did, second by second. Cheap to clone: all clones are one ledger.
#[derive(Clone, Debug)]
pub(crate) struct EnergyShares {
    books: Arc<Mutex<Books>>,
}

/// One camera's pen for the ledger.
#[derive(Clone, Debug)]
pub(crate) struct CameraShare {
    camera: usize,
    books: Arc<Mutex<Books>>,
}

#[derive(Debug)]
struct Books {
    epoch: Instant,
    keep: usize,
    cameras: BTreeMap<String, usize>,
    /// Number of the oldest piece kept.
    first: u64,
    pieces: VecDeque<Piece>,
}

/// What happened in one second, by camera.
#[derive(Clone, Debug, Default)]
struct Piece {
    detector_s: Vec<f64>,
    frames: Vec<u64>,
}

impl EnergyShares {
    /// An empty ledger that begins now and remembers the last `keep` (at least ten minutes): give it
    /// twice the longest clip.
    pub(crate) fn new(keep: Duration) -> Self {
        let keep = keep.max(Duration::from_secs(600)).as_secs();
        Self {
            books: Arc::new(Mutex::new(Books {
                epoch: Instant::now(),
                keep: usize::try_from(keep).unwrap_or(usize::MAX),
                cameras: BTreeMap::new(),
                first: 0,
                pieces: VecDeque::new(),
            })),
        }
    }

    /// The pen of `camera`; asked for twice, both write for the same camera.
    pub(crate) fn camera(&self, camera: &str) -> CameraShare {
        let mut books = lock(&self.books);
        let next = books.cameras.len();
        let number = *books.cameras.entry(camera.to_owned()).or_insert(next);
        drop(books);
        CameraShare {
            camera: number,
            books: Arc::clone(&self.books),
        }
    }
}

impl CameraShare {
    /// Notes a frame of this camera.
    pub(crate) fn frame(&self, at: Instant) {
        let mut books = lock(&self.books);
        let number = books.piece_number(at);
        let camera = self.camera;
        if let Some(piece) = books.piece(number) {
            *grown(&mut piece.frames, camera) += 1;
        }
    }

    /// Notes that the detector worked for this camera from `start` to `end`.
    pub(crate) fn detector(&self, start: Instant, end: Instant) {
        let mut books = lock(&self.books);
        let camera = self.camera;
        let (mut from, end) = (start.max(books.epoch), end);
        while from < end {
            let number = books.piece_number(from);
            let to = end.min(books.piece_end(number));
            if let Some(piece) = books.piece(number) {
                *grown(&mut piece.detector_s, camera) += (to - from).as_secs_f64();
            }
            from = to;
        }
    }

    /// This camera's share over `[start, end]`, in slices that tile it.
    pub(crate) fn slices(&self, start: Instant, end: Instant) -> Vec<Slice> {
        let books = lock(&self.books);
        if books.cameras.len() <= 1 {
            return vec![Slice {
                start,
                end,
                share: 1.0,
            }];
        }
        let mut slices: Vec<Slice> = Vec::new();
        let mut from = start;
        while from < end {
            let number = books.piece_number(from);
            let to = end.min(books.piece_end(number));
            let share = books.share(number, self.camera);
            match slices.last_mut() {
                Some(last) if last.share == share => last.end = to,
                _ => slices.push(Slice {
                    start: from,
                    end: to,
                    share,
                }),
            }
            from = to;
        }
        slices
    }
}

impl Books {
    /// The number of the piece `at` is in; what was before the ledger began is in the first.
    fn piece_number(&self, at: Instant) -> u64 {
        at.saturating_duration_since(self.epoch).as_secs()
    }

    fn piece_end(&self, number: u64) -> Instant {
        self.epoch + PIECE * u32::try_from(number + 1).unwrap_or(u32::MAX)
    }

    /// The piece of that number, made if it is newer than the newest; `None` if it is forgotten already.
    fn piece(&mut self, number: u64) -> Option<&mut Piece> {
        if self.pieces.is_empty() {
            self.first = number;
        }
        let newest = self.first + self.pieces.len() as u64;
        if number > newest + self.keep as u64 {
            // After a very long silence: nothing that is kept would be young enough.
            self.pieces.clear();
            self.first = number;
        }
        while self.first + self.pieces.len() as u64 <= number {
            self.pieces.push_back(Piece::default());
            if self.pieces.len() > self.keep {
                self.pieces.pop_front();
                self.first += 1;
            }
        }
        let index = usize::try_from(number.checked_sub(self.first)?).ok()?;
        self.pieces.get_mut(index)
    }

    /// The share of `camera` in a piece; in a piece where nothing happened, that of the last piece before
    /// where something did; before any, an equal part.
    fn share(&self, number: u64, camera: usize) -> f64 {
        let upto = number.saturating_add(1).saturating_sub(self.first);
        let upto = usize::try_from(upto)
            .unwrap_or(usize::MAX)
            .min(self.pieces.len());
        self.pieces
            .range(..upto)
            .rev()
            .find_map(|piece| piece.share(camera))
            .unwrap_or(1.0 / self.cameras.len().max(1) as f64)
    }
}

impl Piece {
    fn share(&self, camera: usize) -> Option<f64> {
        let detector: f64 = self.detector_s.iter().sum();
        if detector > 0.0 {
            return Some(self.detector_s.get(camera).copied().unwrap_or(0.0) / detector);
        }
        let frames: u64 = self.frames.iter().sum();
        (frames > 0).then(|| self.frames.get(camera).copied().unwrap_or(0) as f64 / frames as f64)
    }
}

fn grown<T: Default + Clone>(list: &mut Vec<T>, index: usize) -> &mut T {
    if list.len() <= index {
        list.resize(index + 1, T::default());
    }
    &mut list[index]
}

fn lock(books: &Mutex<Books>) -> MutexGuard<'_, Books> {
    books.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
