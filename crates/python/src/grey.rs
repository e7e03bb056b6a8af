//! The grey picture that a policy may look at.

use albireo_core::geometry::PictureSize;
use albireo_core::policy::{Evidence, GreyPicture};
use numpy::ndarray::{ArrayViewMut2, Axis, Zip};
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A grey picture in a buffer that is reused.
#[derive(Default)]
pub(crate) struct Grey {
    size: Option<PictureSize>,
    pixels: Vec<u8>,
}

impl Grey {
    /// Copies a picture of shape (rows, columns), so that no one changes it while it is read without the interpreter's
    /// lock.
    pub(crate) fn take(&mut self, picture: &PyReadonlyArray2<'_, u8>) -> PyResult<()> {
        let picture = picture.as_array();
        let (rows, columns) = picture.dim();
        self.size = Some(size(rows, columns)?);
        self.pixels.clear();
        self.pixels.extend(picture.iter());
        Ok(())
    }

    /// Takes the brightness of a picture of shape (rows, columns, 3 or 4), whose colours begin with red or with blue.
    pub(crate) fn take_colored(
        &mut self,
        picture: &PyReadonlyArray3<'_, u8>,
        red_first: bool,
    ) -> PyResult<()> {
        let picture = picture.as_array();
        let (rows, columns, colors) = picture.dim();
        if !(3..=4).contains(&colors) {
            return Err(PyValueError::new_err(format!(
                "a picture in colour has 3 values for each pixel, or 4 with transparency, not {colors}"
            )));
        }
        self.size = Some(size(rows, columns)?);
        let (red, blue) = if red_first { (0, 2) } else { (2, 0) };
        let plane = |color| picture.index_axis(Axis(2), color);
        self.pixels.resize(rows * columns, 0);
        // `Zip` pairs pixels by row and column, however the picture lies in memory.
        let grey = ArrayViewMut2::from_shape((rows, columns), &mut self.pixels)
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        Zip::from(grey)
            .and(plane(red))
            .and(plane(1))
            .and(plane(blue))
            .for_each(|grey, &red, &green, &blue| *grey = luma(red, green, blue));
        Ok(())
    }

    /// True if there is a picture for the next frame.
    pub(crate) const fn has_picture(&self) -> bool {
        self.size.is_some()
    }

    /// Forgets the picture.
    pub(crate) const fn forget(&mut self) {
        self.size = None;
    }

    /// Returns the picture, halved once if it can be.
    pub(crate) fn halved(&mut self) -> Evidence<'_> {
        let Some(mut size) = self.size.take() else {
            return Evidence::Unavailable;
        };
        if can_be_halved(size) {
            size = halve(&mut self.pixels, size);
        }
        self.evidence(size)
    }

    /// Returns the picture, halved while at least `width` columns remain.
    pub(crate) fn with_columns(&mut self, width: u32) -> Evidence<'_> {
        let Some(mut size) = self.size.take() else {
            return Evidence::Unavailable;
        };
        while can_be_halved(size) && size.width / 2 >= width.max(1) {
            size = halve(&mut self.pixels, size);
        }
        self.evidence(size)
    }

    /// The picture, which now has this size. It was taken, because a buffer that was made smaller cannot be used a second
    /// time.
    fn evidence(&self, size: PictureSize) -> Evidence<'_> {
        Evidence::GreyPicture(GreyPicture {
            size,
            pixels: &self.pixels,
        })
    }
}

/// Brightness as JPEG has it (ITU-R BT.601: 0.299, 0.587 and 0.114), in 256ths, rounded.
fn luma(red: u8, green: u8, blue: u8) -> u8 {
    let red = u32::from(red);
    let green = u32::from(green);
    let blue = u32::from(blue);
    ((77 * red + 150 * green + 29 * blue + 128) >> 8) as u8
}

/// The longest side of a picture that the core takes, pixels.
const LARGEST_SIDE: usize = 65_535;

/// The size of a picture.
fn size(rows: usize, columns: usize) -> PyResult<PictureSize> {
    let sides = 1..=LARGEST_SIDE;
    if !(sides.contains(&rows) && sides.contains(&columns)) {
        return Err(PyValueError::new_err(format!(
            "a picture of {columns}x{rows} pixels: its sides must be 1 to {LARGEST_SIDE}"
        )));
    }
    Ok(PictureSize::new(columns as u32, rows as u32))
}

fn can_be_halved(size: PictureSize) -> bool {
    size.width >= 2 && size.height >= 2
}

/// Halves a grey picture in each direction, in place, and returns its new size.
fn halve(pixels: &mut Vec<u8>, size: PictureSize) -> PictureSize {
    let half = PictureSize::new(size.width / 2, size.height / 2);
    let row = size.width as usize;
    let half_row = half.width as usize;
    // A pixel is written at or before the first of those that it is the mean of, so nothing unread is overwritten.
    for y in 0..half.height as usize {
        for x in 0..half_row {
            let first = 2 * y * row + 2 * x;
            let mut sum = 0_u16;
            for place in [first, first + 1, first + row, first + row + 1] {
                sum += u16::from(pixels[place]);
            }
            pixels[y * half_row + x] = ((sum + 2) / 4) as u8;
        }
    }
    pixels.truncate(half_row * half.height as usize);
    half
}
