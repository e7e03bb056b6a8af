//! Compares tracked points with OpenCV's `calcOpticalFlowPyrLK` on the same pictures; `tests/parity/flow.py` makes the fixture.

use super::*;
use serde::Deserialize;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct PicturePair {
    before: String,
    after: String,
    /// x, y, found x, found y, and the distance after tracking back, or -1.
    points: Vec<[f32; 5]>,
}

/// The pyramid of a PGM of 255 grey values.
fn pyramid(file: &Path) -> Pyramid {
    let bytes = std::fs::read(file).unwrap();
    let mut words = bytes.splitn(4, u8::is_ascii_whitespace);
    assert_eq!(words.next(), Some(&b"P5"[..]));
    let mut number = || {
        let word = std::str::from_utf8(words.next().unwrap()).unwrap();
        word.parse().unwrap()
    };
    let width = number();
    let height = number();
    let rest = words.next().unwrap();
    filled(width, height, rest.strip_prefix(b"255\n").unwrap())
}

#[test]
fn points_move_as_in_opencv() {
    let given = std::env::var_os("ALBIREO_FLOW_FIXTURE").map(PathBuf::from);
    let by_hand = given.is_some();
    let folder = given
        .unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/flow"));
    let text = std::fs::read_to_string(folder.join("points.json")).unwrap();
    let mut fixture: serde_json::Value = serde_json::from_str(&text).unwrap();
    let pairs: Vec<PicturePair> = serde_json::from_value(fixture["pairs"].take()).unwrap();
    let mut tracker = PointTracker::default();
    let mut points = 0;
    let mut theirs = 0;
    let mut ours = 0;
    let mut differences = Vec::new();
    for pair in &pairs {
        let before = pyramid(&folder.join(&pair.before));
        let after = pyramid(&folder.join(&pair.after));
        for &[x, y, their_x, their_y, their_return] in &pair.points {
            let shift = tracker.track(&before, &after, [x, y], [0.0; 2]);
            // Only points from which tracking back returns are trusted.
            let found = shift.map(|[u, v]| [x + u, y + v]).filter(|&found| {
                let back = tracker.track(&after, &before, found, [0.0; 2]);
                let off = |[u, v]: [f32; 2]| (found[0] + u - x).hypot(found[1] + v - y);
                back.is_some_and(|back| off(back) <= 1.0)
            });
            points += 1;
            match (found, (0.0..=1.0).contains(&their_return)) {
                (Some([x, y]), true) => differences.push((their_x - x).hypot(their_y - y)),
                (Some(_), false) => ours += 1,
                (None, true) => theirs += 1,
                (None, false) => {}
            }
        }
    }
    differences.sort_by(f32::total_cmp);
    let both = differences.len();
    let quantile = |share: f64| differences[((both - 1) as f64 * share) as usize];
    let above = differences.iter().filter(|difference| **difference > 0.1).count();
    let above = above as f64 / both as f64;
    println!(
        "{points} points, {both} trusted by both, {theirs} by OpenCV alone, {ours} by us alone; difference median \
         {:.4}, 99 % {:.4}, 99.9 % {:.4}, largest {:.4} px; above 0.1 px: {:.3} %",
        quantile(0.5),
        quantile(0.99),
        quantile(0.999),
        quantile(1.0),
        100.0 * above,
    );
    if by_hand {
        return;
    }
    assert!(both > 600, "{both}");
    assert!(theirs + ours <= points / 50);
    assert!(above < 0.005);
}
