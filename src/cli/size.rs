//! The size of a picture as an argument.

use albireo_core::geometry::PictureSize;

/// Reads `1280x720`.
pub(super) fn parse_size(text: &str) -> Result<PictureSize, String> {
    let wrong = || format!("`{text}`: a size is columns x rows, such as 1280x720");
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    let side = |text: &str| text.parse().map_err(|_| wrong());
    let size = PictureSize::new(side(width)?, side(height)?);
    if size.pixels() == 0 {
        return Err(wrong());
    }
    Ok(size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_columns_by_rows() {
        assert_eq!(parse_size("640x360").unwrap(), PictureSize::new(640, 360));
        for wrong in ["640", "x", "640x", "ax3", "-1x5", "0x5"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
    }
}
