//! Pictures and the models that look at them: decoding, letterbox, the detector, the empty-scene screen.

pub mod detector;
pub mod onnx;
pub mod picture;
pub mod pixel_work;
pub mod recordings;
pub mod screen;
pub mod worker;
