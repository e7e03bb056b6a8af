//! Compares JPEG decoders, which take turns within one run: albireo's `zune-jpeg`, libjpeg-turbo (the feature
//! `turbojpeg` uses it to decode at reduced size), and `jpeg-decoder`, which can also scale.
//!
//! ```text
//! cargo run --release --locked --manifest-path benches/decoders/Cargo.toml [-- FILE.jpg …]
//! ```
//!
//! Without files, decodes pictures of a scene of boxes at three sizes. Prints the median and the 95th percentile of the
//! milliseconds per picture, and the ratio of the median to that of `zune-jpeg` in colour.

#![allow(clippy::expect_used, clippy::panic, clippy::print_stdout)]

use albireo_core::geometry::PictureSize;
use albireo_scene::BoxScene;
use std::hint::black_box;
use std::time::Instant;
use turbojpeg::{Decompressor, Image, PixelFormat, ScalingFactor};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;

const ROUNDS: usize = 40;

/// A decoder from a file to pixels.
struct Way {
    name: &'static str,
    decode: Box<dyn FnMut(&[u8], &mut Vec<u8>)>,
    /// The buffer, which is reused.
    pixels: Vec<u8>,
    /// The milliseconds of each file.
    times: Vec<f64>,
}

impl Way {
    /// The median of the times, which are sorted.
    fn median(&self) -> f64 {
        self.times[self.times.len() / 2]
    }
}

fn way(name: &'static str, decode: impl FnMut(&[u8], &mut Vec<u8>) + 'static) -> Way {
    Way {
        name,
        decode: Box::new(decode),
        pixels: Vec::new(),
        times: Vec::new(),
    }
}

/// Decodes like the node: strict, into an existing buffer.
fn zune(colors: ColorSpace) -> impl FnMut(&[u8], &mut Vec<u8>) {
    move |file, pixels| {
        let options =
            DecoderOptions::default().set_strict_mode(true).jpeg_set_out_colorspace(colors);
        let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(file), options);
        decoder.decode_headers().expect("a header");
        pixels.resize(decoder.output_buffer_size().expect("a size"), 0);
        decoder.decode_into(pixels).expect("a JPEG file");
    }
}

fn turbo(format: PixelFormat, factor: ScalingFactor) -> impl FnMut(&[u8], &mut Vec<u8>) {
    let mut decompressor = Decompressor::new().expect("libjpeg-turbo");
    move |file, pixels| {
        let header = decompressor.read_header(file).expect("a header");
        decompressor.set_scaling_factor(factor).expect("a scale");
        let width = factor.scale(header.width);
        let height = factor.scale(header.height);
        let pitch = width * format.size();
        pixels.resize(pitch * height, 0);
        let image = Image {
            pixels: pixels.as_mut_slice(),
            width,
            pitch,
            height,
            format,
        };
        decompressor.decompress(file, image).expect("a JPEG file");
    }
}

fn jpeg_decoder(divisor: u16) -> impl FnMut(&[u8], &mut Vec<u8>) {
    move |file, pixels| {
        let mut decoder = jpeg_decoder::Decoder::new(file);
        if divisor > 1 {
            decoder.read_info().expect("a header");
            let info = decoder.info().expect("a header");
            decoder.scale(info.width / divisor, info.height / divisor).expect("a scale");
        }
        *pixels = decoder.decode().expect("a JPEG file");
    }
}

fn ways() -> Vec<Way> {
    let rgb = PixelFormat::RGB;
    let grey = PixelFormat::GRAY;
    vec![
        way("zune-jpeg, colour", zune(ColorSpace::RGB)),
        way("zune-jpeg, luma", zune(ColorSpace::Luma)),
        way("libjpeg-turbo, colour", turbo(rgb, ScalingFactor::ONE)),
        way("libjpeg-turbo, luma", turbo(grey, ScalingFactor::ONE)),
        way(
            "libjpeg-turbo, colour, half",
            turbo(rgb, ScalingFactor::ONE_HALF),
        ),
        way(
            "libjpeg-turbo, colour, quarter",
            turbo(rgb, ScalingFactor::ONE_QUARTER),
        ),
        way(
            "libjpeg-turbo, luma, quarter",
            turbo(grey, ScalingFactor::ONE_QUARTER),
        ),
        way("jpeg-decoder, colour", jpeg_decoder(1)),
        way("jpeg-decoder, colour, half", jpeg_decoder(2)),
    ]
}

/// The files to decode, in groups with a name.
fn files() -> Vec<(String, Vec<Vec<u8>>)> {
    let named: Vec<_> = std::env::args().skip(1).collect();
    if !named.is_empty() {
        let mut groups = Vec::new();
        for name in named {
            let file = std::fs::read(&name).unwrap_or_else(|error| panic!("{name}: {error}"));
            groups.push((name, vec![file]));
        }
        return groups;
    }
    let mut groups = Vec::new();
    for (width, height) in [(640, 360), (1280, 720), (1920, 1080)] {
        let scene = BoxScene::new(7, PictureSize::new(width, height));
        let files: Vec<_> = (0..4)
            .map(|index| scene.frame(index * 20).jpeg(85).expect("a JPEG file"))
            .collect();
        groups.push((format!("{width}x{height}, a scene of boxes"), files));
    }
    groups
}

fn main() {
    let mut ways = ways();
    for (name, files) in files() {
        for way in &mut ways {
            way.times.clear();
        }
        for round in 0..=ROUNDS {
            for file in &files {
                for way in &mut ways {
                    let start = Instant::now();
                    (way.decode)(black_box(file), &mut way.pixels);
                    black_box(&way.pixels);
                    // The first round warms up.
                    if round > 0 {
                        way.times.push(start.elapsed().as_secs_f64() * 1e3);
                    }
                }
            }
        }
        let kilobytes = files.iter().map(Vec::len).sum::<usize>() / files.len() / 1000;
        println!("{name}, {kilobytes} kB");
        println!(
            "{:<32} {:>8} {:>8} {:>8}",
            "milliseconds", "median", "95 %", "ratio"
        );
        for way in &mut ways {
            way.times.sort_by(f64::total_cmp);
        }
        // The first way is ours.
        let our_median = ways[0].median();
        for way in &ways {
            let median = way.median();
            let high = way.times[way.times.len() * 95 / 100];
            let ratio = median / our_median;
            println!("{:<32} {median:>8.3} {high:>8.3} {ratio:>8.2}", way.name);
        }
        println!();
    }
}
