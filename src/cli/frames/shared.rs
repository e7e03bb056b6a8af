//! Frames in memory that a node on the same machine reads in place: nothing of them goes through the network's stack.
//!
//! Zenoh tells the receiver where a frame lies, where both sides can see the same memory, and sends the bytes where not:
//! what is here is a way and never a condition. A frame's memory is used again only when nobody holds it any more, so
//! that a slow receiver sees whole frames; when all is held, frames go as bytes.

use parking_lot::Mutex;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::shm::{GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder};

/// Frames below this size go as bytes: finding their memory costs more than copying them.
const SMALLEST: usize = 16 << 10;

/// Frames of the largest size seen that there is room for: those that wait in the node's ring, those that its screen and
/// detector look at, and some on their way.
const FRAMES: usize = 12;

/// Least and most memory, bytes.
const LEAST: usize = 4 << 20;
const MOST: usize = 512 << 20;

/// The memory of one sender's frames.
#[derive(Debug, Default)]
pub(super) struct SharedFrames(Mutex<Memory>);

#[derive(Debug, Default)]
enum Memory {
    /// No frame came yet.
    #[default]
    None,
    /// A pool, and the frame size it was made for.
    Pool(ShmProvider<PosixShmProviderBackend>, usize),
    /// There is none to be had here.
    Unusable,
}

impl SharedFrames {
    /// The picture's bytes in shared memory; nothing where they go as well or better as bytes.
    pub(super) fn place(&self, picture: &[u8]) -> Option<ZBytes> {
        if picture.len() < SMALLEST {
            return None;
        }
        let mut memory = self.0.lock();
        let large_enough = match &*memory {
            Memory::Pool(_, size) => picture.len() <= *size,
            Memory::None => false,
            Memory::Unusable => return None,
        };
        if !large_enough {
            // With room for pictures that compress less well than this one.
            let size = picture.len() + picture.len() / 4;
            *memory = match pool(size) {
                Ok(provider) => Memory::Pool(provider, size),
                Err(error) => {
                    tracing::warn!(
                        "there is no shared memory to be had, so frames go as bytes: {}",
                        albireo_service::session::plain(&error)
                    );
                    Memory::Unusable
                }
            };
        }
        let Memory::Pool(provider, _) = &*memory else {
            return None;
        };
        let mut room = provider
            .alloc(picture.len())
            .with_policy::<GarbageCollect>()
            .wait()
            .ok()?;
        room.copy_from_slice(picture);
        Some(room.into())
    }
}

fn pool(frame: usize) -> zenoh::Result<ShmProvider<PosixShmProviderBackend>> {
    let bytes = frame.saturating_mul(FRAMES).clamp(LEAST, MOST);
    ShmProviderBuilder::default_backend(bytes).wait()
}

/// Whether an endpoint is on this machine.
pub(super) fn is_here(endpoint: &str) -> bool {
    let (protocol, address) = endpoint.split_once('/').unwrap_or(("", endpoint));
    let address = address.split(['?', '#']).next().unwrap_or(address);
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    protocol == "unixsock-stream" || matches!(host, "127.0.0.1" | "localhost" | "[::1]")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_shared_with_this_machine_alone() {
        for here in [
            "tcp/127.0.0.1:7447",
            "tcp/localhost:7447",
            "tcp/[::1]:7447#iface=lo",
            "unixsock-stream//run/albireo.sock",
        ] {
            assert!(is_here(here), "{here}");
        }
        for elsewhere in [
            "tcp/192.168.0.5:7447",
            "tls/router.example:7447",
            "tcp/0.0.0.0:7447",
        ] {
            assert!(!is_here(elsewhere), "{elsewhere}");
        }
    }

    #[test]
    fn frames_are_placed_as_long_as_there_is_room_and_room_comes_back() {
        let shared = SharedFrames::default();
        assert!(
            shared.place(&[1; 100]).is_none(),
            "too small to be worth it"
        );
        let picture = vec![7; 3 << 20];
        let mut held = Vec::new();
        while let Some(placed) = shared.place(&picture) {
            assert_eq!(placed.to_bytes().as_ref(), picture);
            held.push(placed);
            assert!(held.len() <= 2 * FRAMES, "more than there is room for");
        }
        assert!(held.len() >= FRAMES, "only {}", held.len());
        held.pop();
        assert!(
            shared.place(&picture).is_some(),
            "what was given back is used again"
        );
        // A larger picture gets memory of its size.
        assert!(shared.place(&vec![9; 7 << 20]).is_some());
    }
}
