use super::*;
use proptest::prelude::*;

/// The largest region by flood fill, pixel by pixel.
fn slow(width: usize, before: &[u8], after: &[u8], difference: u8) -> u64 {
    let mut open: Vec<bool> = before
        .iter()
        .zip(after)
        .map(|(&before, &after)| before.abs_diff(after) >= difference)
        .collect();
    let mut largest = 0;
    for start in 0..open.len() {
        let mut pixels = 0;
        let mut next = vec![start];
        while let Some(place) = next.pop() {
            if !open[place] {
                continue;
            }
            open[place] = false;
            pixels += 1;
            let column = place % width;
            if column > 0 {
                next.push(place - 1);
            }
            if column + 1 < width {
                next.push(place + 1);
            }
            if place >= width {
                next.push(place - width);
            }
            if place + width < open.len() {
                next.push(place + width);
            }
        }
        largest = largest.max(pixels);
    }
    largest
}

/// Two pictures of the same size whose pixels differ with a random probability.
fn pictures() -> impl Strategy<Value = (usize, Vec<u8>, Vec<u8>)> {
    (1..24usize, 0..24usize, 0.0..1.0f64).prop_flat_map(|(width, height, density)| {
        let pixel = (any::<u8>(), prop::bool::weighted(density)).prop_map(|(before, changed)| {
            let distance = if changed { 30 } else { 29 };
            let after = if before < 128 {
                before + distance
            } else {
                before - distance
            };
            (before, after)
        });
        prop::collection::vec(pixel, width * height).prop_map(move |pixels| {
            let (before, after) = pixels.into_iter().unzip();
            (width, before, after)
        })
    })
}

proptest! {
    #[test]
    fn the_largest_region_is_that_of_a_flood_fill((width, before, after) in pictures()) {
        let mut region = ChangedRegion::default();
        // A reused search must answer like a new one.
        region.exceeds(3, &[0; 9], &[0, 99, 0, 99, 99, 99, 0, 99, 0], 30, u64::MAX);
        let expected = slow(width, &before, &after, 30);
        for size in expected.saturating_sub(1)..=expected {
            let exceeds = region.exceeds(width, &before, &after, 30, size);
            prop_assert_eq!(exceeds, expected > size);
        }
    }
}

#[test]
fn a_picture_without_pixels_has_not_changed() {
    assert!(!ChangedRegion::default().exceeds(0, &[], &[], 30, 0));
}
