//! The pictures that are coming: their askers have said so, and no run has begun with them yet.

use super::Asker;
use albireo_core::geometry::PictureSize;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;
use tokio::sync::Notify;

/// The coming pictures. Clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Coming(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    /// The sizes of the pictures, by who asks.
    sizes: Mutex<BTreeMap<Asker, PictureSize>>,
    /// Tells that a picture does not come after all.
    called_off: Notify,
}

/// The word that an asker's picture is coming. It no longer counts once this is dropped or its run begins.
#[derive(Debug)]
pub struct Announcement {
    coming: Coming,
    asker: Asker,
}

impl Coming {
    /// Says that a picture of `asker` is coming, whose input has this size. An asker has one at a time.
    pub(crate) fn announce(&self, asker: Asker, size: PictureSize) -> Announcement {
        self.0.sizes.lock().insert(asker, size);
        Announcement {
            coming: self.clone(),
            asker,
        }
    }

    /// Those whose pictures of `size` are coming.
    pub(super) fn askers_of(&self, size: PictureSize) -> Vec<Asker> {
        let coming = self.0.sizes.lock();
        let of_size = coming.iter().filter(|(_, its_size)| **its_size == size);
        of_size.map(|(asker, _)| *asker).collect()
    }

    /// True if a run with a picture of `size` is about to begin and has fewer than `most` so far.
    pub(crate) fn has_room(&self, size: PictureSize, most: usize) -> bool {
        (1..most).contains(&self.askers_of(size).len())
    }

    /// The run with the picture of `asker` begins.
    pub(super) fn begins(&self, asker: Asker) {
        self.0.sizes.lock().remove(&asker);
    }

    /// Waits until a picture is called off for which a run may wait.
    pub(super) async fn called_off(&self) {
        self.0.called_off.notified().await;
    }
}

impl Drop for Announcement {
    fn drop(&mut self) {
        let shared = &self.coming.0;
        let was_coming = shared.sizes.lock().remove(&self.asker).is_some();
        if was_coming {
            shared.called_off.notify_one();
        }
    }
}
