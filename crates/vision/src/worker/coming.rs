//! The pictures that are coming: their askers have said so, and no run has begun with them yet.

use super::Asker;
use albireo_core::geometry::PictureSize;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The sizes of the coming pictures, by who asks. Clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Coming(Arc<Mutex<BTreeMap<Asker, PictureSize>>>);

/// The word that an asker's picture is coming. It no longer counts once this is dropped or its run begins.
#[derive(Debug)]
pub struct Announcement {
    coming: Coming,
    asker: Asker,
}

impl Coming {
    /// Says that a picture of `asker` is coming, whose input has this size. An asker has one at a time.
    pub(crate) fn announce(&self, asker: Asker, size: PictureSize) -> Announcement {
        self.0.lock().insert(asker, size);
        Announcement {
            coming: self.clone(),
            asker,
        }
    }

    /// Those whose pictures of `size` are coming.
    pub(super) fn askers_of(&self, size: PictureSize) -> Vec<Asker> {
        let coming = self.0.lock();
        let of_size = coming.iter().filter(|(_, its_size)| **its_size == size);
        of_size.map(|(asker, _)| *asker).collect()
    }

    /// True if a run with a picture of `size` is about to begin and has fewer than `most` so far.
    pub(crate) fn has_room(&self, size: PictureSize, most: usize) -> bool {
        let pictures = self.0.lock().values().filter(|its_size| **its_size == size).count();
        (1..most).contains(&pictures)
    }

    /// The run with the picture of `asker` begins.
    pub(super) fn begins(&self, asker: Asker) {
        self.0.lock().remove(&asker);
    }
}

impl Drop for Announcement {
    fn drop(&mut self) {
        self.coming.begins(self.asker);
    }
}
