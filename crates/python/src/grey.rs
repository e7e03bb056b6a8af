//! The grey picture that a policy may look at.

use albireo_core::geometry::PictureSize;
use albireo_core::policy::{Evidence, GreyPicture};
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
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
        let [rows, columns] = *picture.shape() else {
            return Err(PyValueError::new_err("a grey picture has two dimensions"));
        };
        let side = |pixels: usize| {
            u32::try_from(pixels)
                .ok()
                .filter(|side| (1..=65_535).contains(side))
                .ok_or_else(|| {
                    PyValueError::new_err(format!(
                        "a grey picture of {columns}x{rows} pixels: its sides must be 1 to 65535"
                    ))
                })
        };
        let size = PictureSize::new(side(columns)?, side(rows)?);
        self.pixels.clear();
        self.pixels.extend(picture.as_array().iter());
        self.size = Some(size);
        Ok(())
    }

    /// True if there is a picture for the next frame.
    pub(crate) const fn is_there(&self) -> bool {
        self.size.is_some()
    }

    /// Forgets the picture.
    pub(crate) const fn forget(&mut self) {
        self.size = None;
    }

    /// Returns the picture, halved until it is as small as `width` asks for, or once without a width.
    pub(crate) fn evidence(&mut self, width: Option<u32>) -> Evidence<'_> {
        let Some(mut size) = self.size else {
            return Evidence::Unavailable;
        };
        let least = width.map(|width| width.max(1));
        while size.width >= 2
            && size.height >= 2
            && least.is_none_or(|least| size.width / 2 >= least)
        {
            size = halve(&mut self.pixels, size);
            if least.is_none() {
                break;
            }
        }
        // The buffer has been made smaller, so it cannot be used a second time.
        self.size = None;
        Evidence::GreyPicture(GreyPicture {
            size,
            pixels: &self.pixels,
        })
    }
}

/// Halves a grey picture in each direction, in place, and returns its new size.
fn halve(pixels: &mut Vec<u8>, size: PictureSize) -> PictureSize {
    let half = PictureSize::new(size.width / 2, size.height / 2);
    let (row, half_row) = (size.width as usize, half.width as usize);
    for y in 0..half.height as usize {
        for x in 0..half_row {
            let at = 2 * y * row + 2 * x;
            let sum: u16 = [at, at + 1, at + row, at + row + 1]
                .iter()
                .map(|&pixel| u16::from(pixels[pixel]))
                .sum();
            pixels[y * half_row + x] = ((sum + 2) / 4) as u8;
        }
    }
    pixels.truncate(half_row * half.height as usize);
    half
}
