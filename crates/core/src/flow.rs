//! Sparse optical flow inside boxes: how far a box has moved and grown from one grey picture to the next,
//! and how far that can be trusted.
//!
//! A regular grid of points in a box is followed from the picture before to the one after and back again
//! by pyramidal Lucas-Kanade; what comes back to where it started is kept, and the box moves by the median
//! of the points' shifts and grows by the median ratio of their distances.
//!
//! | part | what | source |
//! | --- | --- | --- |
//! | [`Pyramid`] | a picture, halved again and again behind a 5 x 5 Gaussian | Burt and Adelson, "The Laplacian Pyramid as a Compact Image Code" (1983) |
//! | [`Tracker`] | one point, coarse to fine, by Gauss-Newton steps on a window | Lucas and Kanade (1981); Bouguet, "Pyramidal Implementation of the Lucas Kanade Feature Tracker" (2000), with the stopping rules of OpenCV's `calcOpticalFlowPyrLK`, which it is tested against |
//! | [`BoxFlow`] | a grid of points to a box's motion | Kalal, Mikolajczyk and Matas, "Forward-Backward Error: Automatic Detection of Tracking Failures" (ICPR 2010), the Median Flow tracker |
//!
//! Coordinates are pixels of the finest level; the centre of the first pixel is 0. Nothing allocates once
//! the buffers have grown to the size of the pictures and of the grid.

mod box_flow;
mod median;
mod pyramid;
mod tracker;
mod window;

pub use box_flow::{BoxFlow, BoxFlowSettings, BoxMotion, Followed};
pub use pyramid::{GreyView, Pyramid};
pub use tracker::{Tracker, TrackerSettings};

#[cfg(test)]
mod tests;
