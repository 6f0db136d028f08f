//! One number per pixel: what depth images and masks have in common, before anything is said about units.

use std::path::Path;

use image::DynamicImage;

use super::{FormatError, decode::decode, exr, netpbm, npy, tiff};

/// Row-major `[height, width]` numbers of a file.
pub(super) struct Samples {
    pub width: u32,
    pub height: u32,
    pub values: Values,
}

/// Numbers as the file has them.
pub(super) enum Values {
    /// Unsigned, negative ones are 0; the bits of one number in the file.
    Integers(Vec<u32>, u32),
    /// 16 to 64 bits in the file.
    Floats(Vec<f32>),
}

/// The samples of a file with one channel in one of the formats for numbers, told by the content: npy, pgm, pfm, OpenEXR and
/// gray tiff. `None` for other images.
pub(super) fn numbers(bytes: &[u8], path: &Path) -> Result<Option<Samples>, FormatError> {
    match bytes {
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => npy::read(bytes, path).map(Some),
        [b'P', b'2' | b'5' | b'f' | b'F', space, ..] if space.is_ascii_whitespace() => {
            netpbm::read(bytes, path).map(Some)
        }
        [0x76, 0x2f, 0x31, 0x01, ..] => exr::read(bytes, path).map(Some),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff::read(bytes, path),
        [b'P', b'K', 3, 4, ..] => {
            let expected = "an image or a .npy file of one array";
            Err(FormatError::field(path.display(), "format", "an archive (zip, npz)", expected))
        }
        _ => Ok(None),
    }
}

/// [`numbers`], or a 16-bit gray image. Other images come back whole.
pub(super) fn samples(bytes: &[u8], path: &Path) -> Result<Result<Samples, DynamicImage>, FormatError> {
    if let Some(samples) = numbers(bytes, path)? {
        return Ok(Ok(samples));
    }
    Ok(match decode(bytes, path)? {
        DynamicImage::ImageLuma16(gray) => {
            let (width, height) = gray.dimensions();
            let values = gray.into_raw().into_iter().map(u32::from).collect();
            Ok(Samples { width, height, values: Values::Integers(values, 16) })
        }
        other => Err(other),
    })
}
