//! The latest pictures as JPEG files: made at most once a picture, and one at a time.

use crate::state::board::{CameraBoard, LatestFrame};
use albireo_service::metrics::Counter;
use albireo_vision::picture::{FrameLimits, PictureFormat, to_jpeg};
use bytes::Bytes;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A picture that has been made, or could not be, and of what.
#[derive(Clone)]
struct Made {
    of: Bytes,
    seq: u64,
    file: Result<Bytes, String>,
}

/// The newest file of each camera, and the right to make one.
#[derive(Default)]
pub(crate) struct Pictures {
    making: Arc<tokio::sync::Mutex<()>>,
    made: Arc<Mutex<BTreeMap<String, Made>>>,
    decoded: Counter,
}

impl Pictures {
    /// Pictures decoded to be shown, since the start.
    pub(super) fn decoded(&self) -> u64 {
        self.decoded.get()
    }

    /// The newest picture of `camera` and its number; `None` before the first. Requests that come while one is made
    /// wait for it: memory holds one decoded picture, however many ask. One that is not waited for any more is made to
    /// its end all the same, and is there for the next who asks.
    pub(crate) async fn newest(
        &self,
        camera: &CameraBoard,
        limits: FrameLimits,
    ) -> Option<(u64, Result<Bytes, String>)> {
        let frame = camera.latest_frame()?;
        if frame.picture.format == PictureFormat::Jpeg {
            return Some((frame.seq, Ok(frame.picture.bytes)));
        }
        if let Some(found) = self.found(camera.name(), &frame) {
            return Some(found);
        }
        let turn = Arc::clone(&self.making).lock_owned().await;
        // Made while this waited, or another has come.
        let frame = camera.latest_frame()?;
        if let Some(found) = self.found(camera.name(), &frame) {
            return Some(found);
        }
        let (made, decoded) = (Arc::clone(&self.made), self.decoded.clone());
        let (name, seq) = (camera.name().to_owned(), frame.seq);
        let making = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            decoded.inc();
            let file = to_jpeg(&frame.picture, &limits).map_err(|fault| fault.to_string());
            let one = Made {
                of: frame.picture.bytes,
                seq: frame.seq,
                file: file.clone(),
            };
            made.lock().insert(name, one);
            file
        });
        let file = making.await.unwrap_or_else(|error| Err(error.to_string()));
        Some((seq, file))
    }

    /// The file of this very picture, if it is the one made last.
    fn found(&self, camera: &str, frame: &LatestFrame) -> Option<(u64, Result<Bytes, String>)> {
        let made = self.made.lock();
        let made = made.get(camera)?;
        // As long as the bytes are held, nothing else can lie where they are.
        let same = made.seq == frame.seq
            && std::ptr::eq(made.of.as_ptr(), frame.picture.bytes.as_ptr())
            && made.of.len() == frame.picture.bytes.len();
        same.then(|| (made.seq, made.file.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::NodeConfig;
    use crate::state::board::{Board, BoardSetup};
    use albireo_core::geometry::PictureSize;
    use albireo_vision::detector::DetectorStatus;
    use albireo_vision::picture::EncodedPicture;
    use tokio::sync::watch;

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_picture_is_decoded_once_however_many_ask_for_it() {
        let (_, status) = watch::channel(DetectorStatus::Starting);
        let setup = BoardSetup::from_config(&NodeConfig::default(), status).unwrap();
        let board = Board::new(setup);
        let camera = Arc::clone(board.camera("front").unwrap());
        let size = PictureSize::new(640, 480);
        let show = |seq: u64| {
            camera.set_latest_frame(LatestFrame {
                seq,
                picture: EncodedPicture {
                    format: PictureFormat::Rgb8,
                    bytes: vec![seq as u8; 640 * 480 * 3].into(),
                    size,
                },
            });
        };
        let pictures = Arc::new(Pictures::default());
        for (number, seq) in [(1, 7), (2, 8), (3, 8)] {
            show(seq);
            let ask = || {
                let (pictures, camera) = (Arc::clone(&pictures), Arc::clone(&camera));
                tokio::spawn(async move { pictures.newest(&camera, FrameLimits::default()).await })
            };
            let asking: Vec<_> = (0..24).map(|_| ask()).collect();
            for asked in asking {
                let (answered, file) = asked.await.unwrap().unwrap();
                assert_eq!(answered, seq);
                assert!(file.unwrap().starts_with(b"\xff\xd8\xff"));
            }
            assert_eq!(pictures.decoded(), number);
        }
    }
}
