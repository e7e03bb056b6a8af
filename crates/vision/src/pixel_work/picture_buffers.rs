//! Buffers for decoded pictures, shared by all cameras: one per picture in progress, not one per camera.

use crate::picture::Picture;
use parking_lot::Mutex;
use std::ops::Deref;
use std::sync::Arc;

/// A buffer of at most this many bytes is always kept.
const ALWAYS_KEPT: usize = 2 << 20;

/// A larger buffer is kept if it is at most this many times as large as the largest recent one.
const KEPT_TIMES: usize = 4;

/// The number of recent buffers that are considered.
const LOOKED_BACK: usize = 8;

/// A pool of reusable buffers. Clones share it.
#[derive(Clone)]
pub(super) struct PictureBuffers(Arc<Mutex<Buffers>>);

struct Buffers {
    idle: Vec<Picture>,
    /// The maximum number of idle buffers.
    most: usize,
    /// The sizes of the most recent buffers in bytes.
    recent: [usize; LOOKED_BACK],
    /// The index of the oldest of them.
    oldest: usize,
}

/// A picture whose buffer goes back to its pool when the picture is dropped.
pub struct PooledPicture {
    picture: Arc<Picture>,
    buffers: PictureBuffers,
}

impl PictureBuffers {
    /// Creates a pool that keeps at most `most` idle buffers.
    pub(super) fn new(most: usize) -> Self {
        Self(Arc::new(Mutex::new(Buffers {
            idle: Vec::new(),
            most,
            recent: [0; LOOKED_BACK],
            oldest: 0,
        })))
    }

    /// Returns a picture to decode into, with meaningless content: the smallest idle buffer that holds `bytes`, else
    /// the largest.
    pub(super) fn take(&self, bytes: usize) -> Picture {
        let idle = &mut self.0.lock().idle;
        let capacity = |index: &usize| idle[*index].pixels.capacity();
        let fitting = (0..idle.len()).filter(|index| capacity(index) >= bytes).min_by_key(capacity);
        let chosen = fitting.or_else(|| (0..idle.len()).max_by_key(capacity));
        match chosen {
            Some(index) => idle.swap_remove(index),
            None => Picture::default(),
        }
    }

    /// Wraps `picture`, so that its buffer comes back to this pool.
    pub(super) fn pooled(&self, picture: Picture) -> PooledPicture {
        PooledPicture {
            picture: Arc::new(picture),
            buffers: self.clone(),
        }
    }

    /// The number of idle buffers.
    pub(super) fn idle(&self) -> usize {
        self.0.lock().idle.len()
    }

    /// Takes a buffer back. A giant buffer among small ones is freed at once: the next giant picture may be minutes
    /// away.
    pub(super) fn give_back(&self, picture: Picture) {
        let mut buffers = self.0.lock();
        let bytes = picture.pixels.capacity();
        let usual = buffers.recent.into_iter().max().unwrap_or(0);
        let oldest = buffers.oldest;
        buffers.recent[oldest] = bytes;
        buffers.oldest = (oldest + 1) % LOOKED_BACK;
        let kept = bytes <= ALWAYS_KEPT || bytes / KEPT_TIMES <= usual;
        if kept && buffers.idle.len() < buffers.most {
            buffers.idle.push(picture);
        }
    }
}

impl PooledPicture {
    /// The picture, for sharing: its buffer goes back to the pool only if `self` is dropped last.
    pub const fn shared(&self) -> &Arc<Picture> {
        &self.picture
    }
}

impl Deref for PooledPicture {
    type Target = Picture;

    fn deref(&self) -> &Picture {
        &self.picture
    }
}

impl Drop for PooledPicture {
    fn drop(&mut self) {
        if let Some(picture) = Arc::get_mut(&mut self.picture) {
            self.buffers.give_back(std::mem::take(picture));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(bytes: usize) -> Picture {
        Picture {
            pixels: Vec::with_capacity(bytes),
            ..Picture::default()
        }
    }

    #[test]
    fn the_buffer_of_a_single_giant_picture_is_released_and_of_many_is_kept() {
        const HD: usize = 1920 * 1080 * 3;
        const GIANT: usize = 16 * HD;
        let buffers = PictureBuffers::new(4);
        let kept = |bytes| {
            drop(buffers.pooled(picture(bytes)));
            buffers.take(0).pixels.capacity()
        };
        assert_eq!(kept(HD), 0, "nothing is known yet of what is usual");
        assert_eq!(kept(HD), HD);
        assert_eq!(kept(GIANT), 0);
        assert_eq!(kept(GIANT), GIANT);
        assert_eq!(kept(640 * 360 * 3), 640 * 360 * 3);
        for _ in 0..LOOKED_BACK {
            assert_eq!(kept(HD), HD);
        }
        assert_eq!(kept(GIANT), 0, "the last giant is forgotten");
        assert_eq!(kept(ALWAYS_KEPT), ALWAYS_KEPT);
    }

    #[test]
    fn a_picture_gets_the_smallest_idle_buffer_that_fits_else_the_largest() {
        let buffers = PictureBuffers::new(3);
        drop([100, 300, 200].map(|bytes| buffers.pooled(picture(bytes))));
        assert_eq!(buffers.take(50).pixels.capacity(), 100);
        // It has to grow least.
        assert_eq!(buffers.take(400).pixels.capacity(), 300);
        assert_eq!(buffers.take(1).pixels.capacity(), 200);
        assert_eq!(buffers.take(1).pixels.capacity(), 0, "none is left");
    }

    #[test]
    fn no_more_than_the_most_idle_buffers_are_kept() {
        let buffers = PictureBuffers::new(2);
        drop([100, 300, 200].map(|bytes| buffers.pooled(picture(bytes))));
        assert_eq!(buffers.idle(), 2);
    }

    #[test]
    fn a_buffer_that_is_still_in_use_does_not_come_back() {
        let buffers = PictureBuffers::new(2);
        let pooled = buffers.pooled(picture(100));
        let held = Arc::clone(pooled.shared());
        drop(pooled);
        assert_eq!(held.pixels.capacity(), 100);
        assert_eq!(buffers.idle(), 0);
    }
}
