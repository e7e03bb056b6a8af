//! The figures of a report, each as SVG and as PNG.
//!
//! Text in PNG files is drawn with an embedded subset of Roboto (Apache License 2.0, text in `../font`);
//! SVG files name the viewer's own sans-serif font.

mod clips;
mod states;
mod style;
mod tradeoff;

pub use tradeoff::Point;

use crate::spec::{BASELINE, split_label};
use crate::summary::PolicySummary;
use plotters::coord::Shift;
use plotters::prelude::{BitMapBackend, DrawingArea, DrawingBackend, IntoDrawingArea, SVGBackend};
use std::error::Error;
use style::Scale;
use tradeoff::Tradeoff;

/// Steps of an SVG file's coordinates per point, so that rounding to whole numbers does not show.
const SVG_STEPS: u32 = 8;
/// Pixels of a PNG file per point.
const PNG_PIXELS: u32 = 3;

type DrawResult<T = ()> = Result<T, Box<dyn Error>>;

/// A figure.
pub struct Figure {
    /// Name of its files, without ending.
    pub name: &'static str,
    /// What it shows, as a heading.
    pub title: String,
    /// How to read it.
    pub caption: String,
    /// Width and height in points.
    size: (u32, u32),
    content: Content,
}

enum Content {
    Tradeoff(Tradeoff),
    States(Vec<states::Bar>),
    Clips(Vec<clips::Cloud>),
}

impl Figure {
    /// The figure as an SVG document.
    ///
    /// # Errors
    /// A sentence from the drawing library.
    pub fn svg(&self) -> Result<String, String> {
        let (width, height) = self.size;
        let mut text = String::new();
        {
            let size = (width * SVG_STEPS, height * SVG_STEPS);
            let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
            self.draw(&area, SVG_STEPS)
                .map_err(|error| error.to_string())?;
        }
        // The view box stays in steps; the picture itself is as large as planned.
        let (width_steps, height_steps) = (width * SVG_STEPS, height * SVG_STEPS);
        Ok(text.replacen(
            &format!("width=\"{width_steps}\" height=\"{height_steps}\""),
            &format!("width=\"{width}\" height=\"{height}\""),
            1,
        ))
    }

    /// The figure as a PNG file.
    ///
    /// # Errors
    /// A sentence from the drawing or encoding library.
    pub fn png(&self) -> Result<Vec<u8>, String> {
        let (width, height) = (self.size.0 * PNG_PIXELS, self.size.1 * PNG_PIXELS);
        let mut pixels = vec![255; (width * height * 3) as usize];
        {
            let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
            self.draw(&area, PNG_PIXELS)
                .map_err(|error| error.to_string())?;
        }
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
        writer
            .write_image_data(&pixels)
            .map_err(|error| error.to_string())?;
        writer.finish().map_err(|error| error.to_string())?;
        Ok(bytes)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, steps: u32) -> DrawResult
    where
        B::ErrorType: 'static,
    {
        let scale = Scale::new(steps)?;
        area.fill(&plotters::style::WHITE)?;
        match &self.content {
            Content::Tradeoff(tradeoff) => tradeoff.draw(area, scale)?,
            Content::States(bars) => states::draw(bars, area, scale)?,
            Content::Clips(clouds) => clips::draw(clouds, area, scale)?,
        }
        area.present()?;
        Ok(())
    }
}

/// The figures that `report` has the data for.
pub fn figures(report: &super::Report) -> Vec<Figure> {
    let summaries = &report.policies;
    let mut figures = Vec::new();
    let has_accuracy = summaries.iter().any(|summary| summary.ap50.is_some());
    let marks = "Whiskers: 95 % confidence interval of the difference to Vanilla, paired over clips, cut at the figure's edge. \
                 Thin line: Vanilla. Grey band: the Pareto frontier; filled markers are on it.";
    if has_accuracy {
        figures.push(Figure {
            name: "ap50-against-skip-rate",
            title: "Accuracy against skip rate".to_owned(),
            caption: format!("Mean over clips. {marks}"),
            size: (720, 430),
            content: Content::Tradeoff(Tradeoff {
                x_label: "Frames without the detector, %".to_owned(),
                y_label: "AP@50".to_owned(),
                points: points(summaries),
            }),
        });
    }
    figures.push(Figure {
        name: "frame-states",
        title: "Frame states".to_owned(),
        caption: "Mean share of frames over clips. E: screen says empty; P: predicted; E+I: screen, then \
                  detector; I: detector; AI: detector and a rescue."
            .to_owned(),
        size: (720, 70 + 26 * u32::try_from(summaries.len()).unwrap_or(20).min(60)),
        content: Content::States(states::bars(summaries)),
    });
    let clouds = clips::clouds(&report.clips);
    if clouds.iter().any(|cloud| !cloud.points.is_empty()) {
        figures.push(Figure {
            name: "clips-ap50-change-against-skip-rate",
            title: "Change of accuracy clip by clip".to_owned(),
            caption: "Each marker is one clip under one policy: how much AP@50 changed against Vanilla, and \
                      how many frames went without the detector."
                .to_owned(),
            size: (720, 430),
            content: Content::Clips(clouds),
        });
    }
    figures
}

fn points(summaries: &[PolicySummary]) -> Vec<Point> {
    summaries
        .iter()
        .filter_map(|summary| {
            let (family, setting) = split_label(&summary.policy);
            let y = summary.ap50?;
            let interval = summary
                .against_baseline
                .and_then(|against| against.ap50?.t)
                .map(|t| (y - t.mean + t.lower, y - t.mean + t.upper));
            Some(Point {
                family: family.to_owned(),
                setting,
                x: summary.skip_rate * 100.0,
                y,
                interval,
                on_frontier: summary.on_skip_frontier,
                baseline: summary.policy == BASELINE,
            })
        })
        .collect()
}
