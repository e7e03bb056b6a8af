//! Compares tracked points with OpenCV's `calcOpticalFlowPyrLK` on the same pictures; `tests/parity/flow.py` makes the fixture.

use super::*;
use serde::Deserialize;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct Fixture {
    pairs: Vec<PicturePair>,
}

#[derive(Deserialize)]
struct PicturePair {
    before: String,
    after: String,
    /// x, y, found x, found y, and the distance after tracking back, or -1.
    points: Vec<[f32; 5]>,
}

/// Width, height and pixels of a PGM of 255 grey values.
fn read(file: &Path) -> (usize, usize, Vec<u8>) {
    let bytes = std::fs::read(file).unwrap();
    let mut words = bytes.splitn(4, u8::is_ascii_whitespace);
    assert_eq!(words.next(), Some(&b"P5"[..]));
    let mut number = || {
        let word = std::str::from_utf8(words.next().unwrap()).unwrap();
        word.parse::<usize>().unwrap()
    };
    let (width, height) = (number(), number());
    let rest = words.next().unwrap();
    let pixels = rest.strip_prefix(b"255\n").unwrap();
    assert_eq!(pixels.len(), width * height);
    (width, height, pixels.to_vec())
}

fn pyramid(file: &Path) -> Pyramid {
    let (width, height, pixels) = read(file);
    let mut pyramid = Pyramid::default();
    pyramid.fill(GreyView::new(width, height, width, &pixels).unwrap(), 3);
    pyramid
}

#[derive(Debug, Default)]
struct Tally {
    points: usize,
    /// Points that only OpenCV trusts.
    theirs: usize,
    /// Points that only we trust.
    ours: usize,
    /// The differences at points that both trust, px.
    differences: Vec<f32>,
}

/// Compares all points of a folder.
fn compare(folder: &Path, settings: TrackerSettings) -> Tally {
    let text = std::fs::read_to_string(folder.join("points.json")).unwrap();
    let fixture: Fixture = serde_json::from_str(&text).unwrap();
    let mut tracker = Tracker::new(settings);
    let mut tally = Tally::default();
    for pair in &fixture.pairs {
        let before = pyramid(&folder.join(&pair.before));
        let after = pyramid(&folder.join(&pair.after));
        for &[x, y, found_x, found_y, their_return] in &pair.points {
            let shift = tracker.track(&before, &after, [x, y], [0.0; 2]);
            let found = shift.map(|[u, v]| [x + u, y + v]);
            let back = found.and_then(|found| tracker.track(&after, &before, found, [0.0; 2]));
            let our_return = (shift.zip(back)).map(|(a, b)| (a[0] + b[0]).hypot(a[1] + b[1]));
            let ours = our_return.is_some_and(|distance| distance <= 1.0);
            let theirs = (0.0..=1.0).contains(&their_return);
            tally.points += 1;
            match (theirs, found.filter(|_| ours)) {
                (true, Some([x, y])) => {
                    let difference = (x - found_x).hypot(y - found_y);
                    tally.differences.push(difference);
                }
                (true, None) => tally.theirs += 1,
                (false, Some(_)) => tally.ours += 1,
                (false, None) => {}
            }
        }
    }
    tally.differences.sort_by(f32::total_cmp);
    tally
}

fn share_above(tally: &Tally, limit: f32) -> f64 {
    let above = tally.differences.iter().filter(|d| **d > limit).count();
    above as f64 / tally.differences.len() as f64
}

#[test]
fn points_move_as_in_opencv() {
    let given = std::env::var_os("ALBIREO_FLOW_FIXTURE").map(PathBuf::from);
    let by_hand = given.is_some();
    let folder = given
        .unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/flow"));
    let tally = compare(&folder, TrackerSettings::default());
    let both = tally.differences.len();
    let at = |share: f64| tally.differences[((both - 1) as f64 * share) as usize];
    println!(
        "{} points, {both} trusted by both, {} by OpenCV alone, {} by us alone; difference median {:.4}, 99 % \
         {:.4}, 99.9 % {:.4}, largest {:.4} px; above 0.1 px: {:.3} %",
        tally.points,
        tally.theirs,
        tally.ours,
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0),
        100.0 * share_above(&tally, 0.1),
    );
    if by_hand {
        return;
    }
    assert!(both > 600, "{both}");
    assert!(tally.theirs + tally.ours <= tally.points / 50);
    assert!(share_above(&tally, 0.1) < 0.005);
}
