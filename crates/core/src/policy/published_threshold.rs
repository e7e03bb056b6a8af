//! Conversion of a threshold to the units of the published code.
//!
//! The state is in shares of the picture, as are the process noise Q and the covariance P of a new object; but the
//! published code gives the noise R of a measured box in pixels of the picture. If P, Q and R are all multiplied by one
//! number, so is τ: the gains stay, and with `u` multiplied alike every decision stays. If R alone changes, the gains
//! change. So no factor on `u` makes the published filter decide at one picture size as at another, and the profile
//! `paper` gives R as a share of the picture, too: then nothing in the filter depends on the size. For the published
//! code only an equivalent remains: the threshold that lets it predict a steadily seen object for as many frames.

use super::AlbireoSettings;
use crate::geometry::{BoundingBox, PictureSize};
use crate::kalman::{Filter, FilterModel, FilterParameters, MeasurementNoise, MeasurementUnit};

/// Frames of prediction covered by the curve of τ: T_max of both profiles.
const FRAMES: usize = 15;

/// Updates after which P has settled to the last significant digit.
const SETTLED: usize = 200;

/// Returns the threshold with which the published code, in pictures of size `picture`, predicts a steadily seen object
/// for as many frames as the profile `paper` at `u` in pictures of any size. At 1280x720 it is `u`.
pub fn published_threshold(u: f64, picture: PictureSize) -> f64 {
    let published = FilterModel::new(&AlbireoSettings::reference().objects.filter, picture);
    let paper = FilterModel::new(&AlbireoSettings::paper().objects.filter, picture);
    if published == paper {
        return u;
    }
    // Both curves rise: `u` lies between two frames of the first, and the answer between the same two of the second.
    let mut paper_before = 0.0;
    let mut published_before = 0.0;
    for (&paper_tau, &published_tau) in curve(&paper).iter().zip(&curve(&published)) {
        if u <= paper_tau {
            let share = (u - paper_before) / (paper_tau - paper_before);
            return published_before + share * (published_tau - published_before);
        }
        paper_before = paper_tau;
        published_before = published_tau;
    }
    // Above the last of the curve no frame tells: the two thresholds keep the proportion they have there.
    u / paper_before * published_before
}

/// Returns τ of a steadily seen object after its update and after each frame of prediction.
fn curve(model: &FilterModel) -> [f64; FRAMES + 1] {
    let anywhere = BoundingBox::new(0.5, 0.5, 0.1, 0.1);
    let mut filter = Filter::new(model, anywhere);
    for _ in 0..SETTLED {
        filter.predict(model);
        filter.update(model, anywhere);
    }
    let mut taus = [filter.tau(); FRAMES + 1];
    for tau in &mut taus[1..] {
        filter.predict(model);
        *tau = filter.tau();
    }
    taus
}

/// Returns the filter of the profile `paper`: the published one, with the measurement's deviation as a share of the
/// picture, which at 1280x720 equals 5 of 1280 pixels to the last bit.
pub(super) fn sizeless(published: FilterParameters) -> FilterParameters {
    FilterParameters {
        measurement: MeasurementNoise {
            deviation: 5.0 / 1280.0,
            unit: MeasurementUnit::Normalised,
        },
        ..published
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::Albireo;
    use crate::policy::tests::PICTURE;

    const SIZES: [PictureSize; 5] = [
        PictureSize::new(640, 480),
        PictureSize::new(720, 576),
        PictureSize::new(1242, 375),
        PictureSize::new(1280, 720),
        PictureSize::new(1920, 1080),
    ];

    #[test]
    fn at_the_papers_size_both_filters_are_identical_to_the_last_bit() {
        let published = FilterModel::new(&AlbireoSettings::reference().objects.filter, PICTURE);
        let paper = FilterModel::new(&AlbireoSettings::paper().objects.filter, PICTURE);
        assert_eq!(published, paper);
        for u in [1e-9, 3e-4, 1e-3, 1.0] {
            assert_eq!(published_threshold(u, PICTURE).to_bits(), u.to_bits());
        }
    }

    #[test]
    fn the_equivalent_lets_the_published_filter_predict_for_as_many_frames() {
        let frames = |model: &FilterModel, u: f64| {
            curve(model)[1..].iter().take_while(|tau| **tau < u).count()
        };
        for size in SIZES {
            let published = FilterModel::new(&AlbireoSettings::reference().objects.filter, size);
            let paper = FilterModel::new(&AlbireoSettings::paper().objects.filter, size);
            for u in [1e-5, 1e-4, 3e-4, 5e-4, 7e-4, 1e-3, 3e-3, 1e-2] {
                let equivalent = frames(&published, published_threshold(u, size));
                assert_eq!(equivalent, frames(&paper, u), "u = {u} at {size}");
            }
        }
        // What the published code needs at 720x576 for what 3e-4 does at 1280x720.
        let equivalent = published_threshold(3e-4, PictureSize::new(720, 576));
        assert!((4e-4..6e-4).contains(&equivalent), "{equivalent}");
    }

    #[test]
    fn the_range_of_u_covers_every_useful_value() {
        let model = FilterModel::new(&AlbireoSettings::paper().objects.filter, PICTURE);
        let taus = curve(&model);
        let spec = Albireo::THRESHOLD;
        // Below the first a seen object calls the detector on every frame.
        assert!(spec.useful_minimum <= taus[1] && taus[1] <= 1.5 * spec.useful_minimum);
        let most = spec.useful_maximum;
        assert_eq!(taus[1..].iter().take_while(|tau| **tau < most).count(), 6);
    }
}
