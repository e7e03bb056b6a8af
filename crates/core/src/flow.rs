//! Sparse optical flow inside boxes: how far a box has moved and grown between two grey pictures, and how reliable that
//! estimate is.
//!
//! A regular grid of points in a box is followed from one picture to the next and back by pyramidal Lucas-Kanade;
//! points that return close to their start are kept, and the box moves by the median of their shifts and grows by the
//! median ratio of their distances.
//!
//! | part | what | source |
//! | --- | --- | --- |
//! | [`Pyramid`] | a picture, repeatedly halved after a 5 x 5 Gaussian | Burt and Adelson, "The Laplacian Pyramid as a Compact Image Code" (1983) |
//! | [`PointTracker`] | one point, coarse to fine, by Gauss-Newton steps on a window | Lucas and Kanade (1981); Bouguet, "Pyramidal Implementation of the Lucas Kanade Feature PointTracker" (2000), with the stopping rules of OpenCV's `calcOpticalFlowPyrLK`, which it is tested against |
//! | [`BoxFlow`] | a grid of points to a box's motion | Kalal, Mikolajczyk and Matas, "Forward-Backward Error: Automatic Detection of Tracking Failures" (ICPR 2010), the Median Flow tracker |
//!
//! Coordinates are pixels of the finest level; the centre of the first pixel is 0. Nothing allocates once the buffers
//! have grown to the size of the pictures and the grid.

mod box_flow;
mod median;
mod pyramid;
mod tracker;
mod window;

pub use box_flow::{BoxFlow, BoxMotion, Followed};
pub use pyramid::{GreyPicture, Pyramid};
pub use tracker::PointTracker;

#[cfg(test)]
mod tests;
