//! Sizes, fonts, colours and markers that all figures share.

use albireo_core::policy::FrameState;
use plotters::coord::Shift;
use plotters::prelude::{
    Circle, DrawingArea, DrawingBackend, FontDesc, FontFamily, Polygon, Rectangle, TextStyle,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontStyle, RGBColor, ShapeStyle, register_font};
use std::error::Error;
use std::sync::OnceLock;

static REGULAR: &[u8] = include_bytes!("../font/Roboto-Regular-subset.ttf");

/// Ink of text.
pub(crate) const INK: RGBColor = RGBColor(34, 40, 49);
/// Ink of axes and their labels.
pub(crate) const SOFT_INK: RGBColor = RGBColor(92, 101, 112);
/// Grid lines.
pub(crate) const GRID: RGBColor = RGBColor(232, 235, 239);
/// The frontier.
pub(crate) const FRONTIER: RGBColor = RGBColor(205, 210, 217);

/// Colours that the colour-blind can tell apart (Okabe and Ito, 2008), without yellow, which is faint on
/// white.
const PALETTE: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(120, 94, 240),
];

/// Colour of the `index`th family of policies.
pub(crate) fn family_color(index: usize) -> RGBColor {
    PALETTE[index % PALETTE.len()]
}

/// Colour of a frame state: cool where the detector rests, warm where it runs.
pub(crate) const fn state_color(state: FrameState) -> RGBColor {
    match state {
        FrameState::E => RGBColor(143, 188, 219),
        FrameState::P => RGBColor(38, 112, 176),
        FrameState::EI => RGBColor(253, 208, 139),
        FrameState::I => RGBColor(241, 140, 70),
        FrameState::AI => RGBColor(190, 62, 44),
    }
}

/// From points to the backend's steps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale(f64);

impl Scale {
    /// `steps` a point. Registers the embedded font the first time.
    pub(crate) fn new(steps: u32) -> Result<Self, Box<dyn Error>> {
        static FONT: OnceLock<bool> = OnceLock::new();
        let registered =
            FONT.get_or_init(|| register_font("sans-serif", FontStyle::Normal, REGULAR).is_ok());
        if *registered {
            Ok(Self(f64::from(steps)))
        } else {
            Err("the embedded font cannot be read".into())
        }
    }

    /// A length.
    pub(crate) fn length(self, points: f64) -> i32 {
        (points * self.0).round() as i32
    }

    /// A length that cannot be negative.
    pub(crate) fn size(self, points: f64) -> u32 {
        (points * self.0).round() as u32
    }

    /// Text of `points` height.
    pub(crate) fn text(self, points: f64, color: RGBColor) -> TextStyle<'static> {
        // The library's font sizes are line heights: 1.24 of what other programs call the size.
        let font = FontDesc::new(
            FontFamily::SansSerif,
            points * 1.24 * self.0,
            FontStyle::Normal,
        );
        let mut style = TextStyle::from(font);
        style.color = color.to_backend_color();
        style
    }

    /// A line of `points` width.
    pub(crate) fn line(self, points: f64, color: RGBColor) -> ShapeStyle {
        color.stroke_width(self.size(points).max(1))
    }
}

/// Places text by its left or right edge, its middle on the given height.
pub(crate) fn anchored(style: TextStyle<'static>, horizontal: HPos) -> TextStyle<'static> {
    style.pos(Pos::new(horizontal, VPos::Center))
}

/// Draws the marker of the `index`th family at `at`: filled, or white with a coloured edge.
pub(crate) fn marker<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    scale: Scale,
    at: (i32, i32),
    index: usize,
    color: RGBColor,
    filled: bool,
) -> Result<(), Box<dyn Error>>
where
    B::ErrorType: 'static,
{
    let shape = |radius: f64, color: RGBColor| -> Result<(), Box<dyn Error>> {
        let reach = |share: f64| scale.length(radius * share);
        let (x, y) = at;
        match index % 4 {
            0 => area.draw(&Circle::new(at, scale.length(radius), color.filled()))?,
            1 => {
                let r = reach(0.9);
                area.draw(&Rectangle::new(
                    [(x - r, y - r), (x + r, y + r)],
                    color.filled(),
                ))?;
            }
            2 => {
                let corners = [
                    (x, y - reach(1.2)),
                    (x + reach(1.1), y + reach(0.8)),
                    (x - reach(1.1), y + reach(0.8)),
                ];
                area.draw(&Polygon::new(corners.to_vec(), color.filled()))?;
            }
            _ => {
                let r = reach(1.25);
                let corners = [(x, y - r), (x + r, y), (x, y + r), (x - r, y)];
                area.draw(&Polygon::new(corners.to_vec(), color.filled()))?;
            }
        }
        Ok(())
    };
    shape(4.6, color)?;
    if !filled {
        shape(2.9, RGBColor(255, 255, 255))?;
    }
    Ok(())
}

/// An axis range around `values` with some air, and never empty.
pub(crate) fn range(values: impl Iterator<Item = f64>, air: f64) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if !(low.is_finite() && high.is_finite()) {
        return (0.0, 1.0);
    }
    let span = (high - low).max(high.abs() * 1e-3).max(1e-6);
    (low - air * span, high + air * span)
}
/// Draws a ring around a marker.
pub(crate) fn ring<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    scale: Scale,
    at: (i32, i32),
    color: RGBColor,
) -> Result<(), Box<dyn Error>>
where
    B::ErrorType: 'static,
{
    for (radius, color) in [(7.6, color), (6.4, RGBColor(255, 255, 255))] {
        area.draw(&Circle::new(at, scale.length(radius), color.filled()))?;
    }
    Ok(())
}
