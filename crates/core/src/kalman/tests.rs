mod dense;

use super::{Filter, FilterModel, FilterParameters, MeasurementUnit, MotionModel};
use crate::geometry::{BoundingBox, PictureSize};
use dense::DenseFilter;
use proptest::prelude::*;

fn boxes() -> impl Strategy<Value = BoundingBox> {
    (0.0..1.0, 0.0..1.0, 0.001..0.9, 0.001..0.9)
        .prop_map(|(x, y, width, height)| BoundingBox::new(x, y, width, height))
}

fn sizes() -> impl Strategy<Value = PictureSize> {
    (1u32..8192, 1u32..8192).prop_map(|(width, height)| PictureSize::new(width, height))
}

/// Parameters from a third to three times the default.
fn parameters() -> impl Strategy<Value = FilterParameters> {
    prop::array::uniform11(0.33f64..3.0).prop_map(|all_factors| {
        let mut parameters = FilterParameters::default();
        for (part, factors) in [
            (&mut parameters.process, &all_factors[..5]),
            (&mut parameters.initial, &all_factors[5..10]),
        ] {
            part.center *= factors[0];
            part.size *= factors[1];
            part.center_velocity *= factors[2];
            part.size_velocity *= factors[3];
            part.acceleration *= factors[4];
        }
        parameters.measurement.deviation *= all_factors[10];
        parameters
    })
}

fn close(found: &[f64], expected: &[f64]) -> bool {
    found
        .iter()
        .zip(expected)
        .all(|(a, b)| (a - b).abs() <= 1e-12 * a.abs().max(1.0))
}

proptest! {
    /// In a life every frame is predicted, and those with a box are updated.
    #[test]
    fn filters_of_ten_and_eight_dimensions_equal_the_textbook(
        parameters in parameters(),
        size in sizes(), first in boxes(),
        life in prop::collection::vec(prop::option::weighted(0.6, boxes()), 1..60),
    ) {
        for motion in [MotionModel::ConstantAcceleration, MotionModel::ConstantSize] {
            let model = FilterModel::new(&FilterParameters { motion, ..parameters }, size);
            let mut filter = Filter::new(&model, first);
            let mut dense = DenseFilter::new(&model, first);
            for measured in &life {
                filter.predict(&model);
                dense.predict();
                if let Some(measured) = *measured {
                    let expected = dense.squared_distance(measured);
                    let found = filter.gauge(&model).squared_distance(measured);
                    let off = (found - expected).abs();
                    prop_assert!(off <= 1e-9 * expected.max(1.0), "{found} {expected}");
                    filter.update(&model, measured);
                    dense.update(measured);
                }
                let mean = filter.mean();
                let covariance = filter.covariance();
                prop_assert!(close(mean.as_slice(), dense.mean.as_slice()), "{mean} {}", dense.mean);
                prop_assert!(close(covariance.as_slice(), dense.covariance.as_slice()));
                prop_assert!((filter.tau() - dense.tau()).abs() <= 1e-12);
                // Eight dimensions have no velocity of the size: it is and remains zero, and correlates with nothing.
                let velocity = mean.rows(6, 2);
                let correlated = covariance.rows(6, 2);
                let is_absent = velocity.iter().chain(correlated.iter()).all(|&value| value == 0.0);
                prop_assert_eq!(is_absent, motion == MotionModel::ConstantSize);
            }
        }
    }

    #[test]
    fn the_reach_of_the_gate_is_a_tight_bound(
        parameters in parameters(),
        size in sizes(), first in boxes(), exponent in -12.0f64..2.0,
    ) {
        let model = FilterModel::new(&parameters, size);
        let gauge = Filter::new(&model, first).gauge(&model);
        let gate = 10f64.powf(exponent);
        let expected = gauge.expected;
        let reach = gauge.reach(gate);
        let x = expected.center_x;
        let y = expected.center_y;
        prop_assert!(reach.x1 < x && x < reach.x2 && reach.y1 < y && y < reach.y2);
        for (x, y) in [(reach.x1, y), (reach.x2, y), (x, reach.y1), (x, reach.y2)] {
            let at_edge = gauge.squared_distance(BoundingBox::new(x, y, expected.width, expected.height));
            prop_assert!(at_edge >= gate, "{at_edge:e} is below {gate:e}");
            prop_assert!(gate < 0.01 || at_edge < gate * (1.0 + 1e-6), "{at_edge:e} {gate:e}");
        }
    }

    #[test]
    fn sides_are_clamped_to_their_minimum_and_nothing_else_changes(
        size in sizes(), first in boxes(), least_width in 0.0..1.0, least_height in 0.0..1.0,
    ) {
        let model = FilterModel::new(&FilterParameters::default(), size);
        let mut filter = Filter::new(&model, first);
        let before = filter.mean();
        filter.clamp_size(least_width, least_height);
        let mut expected = before;
        expected[2] = before[2].max(least_width);
        expected[3] = before[3].max(least_height);
        prop_assert_eq!(filter.mean(), expected);
    }

    /// 256 cases of 400 cycles: 10^5 cycles in all.
    #[test]
    fn the_covariance_stays_symmetric_and_positive_definite(
        parameters in parameters(),
        size in sizes(), first in boxes(),
        life in prop::collection::vec(prop::option::weighted(0.6, boxes()), 400),
    ) {
        let model = FilterModel::new(&parameters, size);
        let mut filter = Filter::new(&model, first);
        for measured in life {
            filter.predict(&model);
            if let Some(measured) = measured {
                filter.update(&model, measured);
            }
            let covariance = filter.covariance();
            // Rounding makes the triangles of (I − K H) P differ by a few bits, which do not accumulate.
            let asymmetry = (covariance - covariance.transpose()).amax();
            prop_assert!(asymmetry <= 1e-12 * covariance.amax(), "{asymmetry:e}");
            prop_assert!(covariance.cholesky().is_some(), "{covariance}");
        }
    }
}

#[test]
fn measurement_noise_is_pixels_over_the_padded_longer_side() {
    let mut noise = FilterParameters::default().measurement;
    for (width, height, padded) in [(1242, 375, 1248.0), (480, 640, 640.0)] {
        let variance = noise.variance(PictureSize::new(width, height));
        assert_eq!(variance, (5.0f64 / padded).powi(2));
    }
    assert!(noise.variance(PictureSize::new(0, 0)).is_finite());
    assert!(noise.variance(PictureSize::new(u32::MAX, u32::MAX)) > 0.0);
    noise.unit = MeasurementUnit::Normalised;
    noise.deviation = 0.01;
    assert_eq!(noise.variance(PictureSize::new(1, 1)), 0.01 * 0.01);
}
