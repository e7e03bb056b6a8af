//! Optical flow inside boxes at 320 pixels' width: one box, ten boxes, and the pyramid of the picture. Run with
//! `cargo bench -p albireo-core`.

use albireo_core::flow::{BoxFlow, GreyPicture, Pyramid};
use albireo_core::geometry::{Corners, PictureSize};
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;

const WIDTH: usize = 320;
const HEIGHT: usize = 180;

/// Waves of many lengths, moved by a few pixels and a little larger.
fn picture(shift: f64, scale: f64) -> Vec<u8> {
    let value = |x: f64, y: f64| {
        let mut sum = 0.0;
        for wave in 0..24u32 {
            let direction = f64::from(wave) * 2.4;
            let k = std::f64::consts::TAU / (6.0 * 1.1f64.powi(wave as i32));
            sum += (k * (x * direction.cos() + y * direction.sin()) + f64::from(wave)).cos();
        }
        (128.0 + 20.0 * sum).clamp(0.0, 255.0) as u8
    };
    let place = |at: usize, shift: f64| (at as f64 - shift) / scale;
    let mut pixels = Vec::new();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            pixels.push(value(place(x, shift), place(y, shift / 2.0)));
        }
    }
    pixels
}

fn boxes() -> Vec<Corners> {
    let mut boxes = Vec::new();
    for index in 0..10u32 {
        let side = 14.0 + 6.0 * f64::from(index);
        let x = 8.0 + 24.0 * f64::from(index);
        let y = 20.0 + 9.0 * f64::from(index % 4);
        boxes.push(Corners {
            x1: x,
            y1: y,
            x2: x + 1.3 * side,
            y2: y + side,
        });
    }
    boxes
}

fn flow(c: &mut Criterion) {
    let bytes = [picture(0.0, 1.0), picture(4.3, 1.02)];
    let size = PictureSize::new(WIDTH as u32, HEIGHT as u32);
    let [first, second] = [&bytes[0], &bytes[1]].map(|pixels| GreyPicture { size, pixels });
    let [mut before, mut after] = [Pyramid::default(), Pyramid::default()];
    before.fill(first);
    after.fill(second);
    let boxes = boxes();

    let mut group = c.benchmark_group("flow");
    group.bench_function("pyramid of 320x180", |b| {
        b.iter(|| after.fill(black_box(second)));
    });
    let mut bench = |name: &str, grid: usize, guess: [f64; 2]| {
        let mut flow = BoxFlow::new(grid);
        let still = flow.follow(&before, &after, boxes[5], guess);
        eprintln!("{name}: {still:?}");
        group.bench_function(format!("{name}: one box"), |b| {
            b.iter(|| flow.follow(&before, &after, black_box(boxes[5]), guess));
        });
        group.bench_function(format!("{name}: ten boxes"), |b| {
            b.iter(|| {
                let mut kept = 0;
                for area in &boxes {
                    kept += flow.follow(&before, &after, *area, guess).kept;
                }
                kept
            });
        });
    };
    bench("6 x 6 points", 6, [0.0; 2]);
    bench("6 x 6 points, predicted", 6, [4.0, 2.0]);
    bench("5 x 5 points", 5, [0.0; 2]);
    bench("4 x 4 points", 4, [0.0; 2]);
    group.finish();
}

criterion_group!(benches, flow);
criterion_main!(benches);
