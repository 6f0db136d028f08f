//! Image files and bytes: colour (png, jpeg, webp, tiff, bmp), depth (16-bit png, tiff and pgm, npy, floats of tiff, OpenEXR
//! and pfm), masks (any of them). An EXIF orientation is applied.

mod decode;
mod depth;
#[cfg(test)]
mod depth_tests;
mod exr;
mod labels;
mod mask;
#[cfg(test)]
mod mask_tests;
mod netpbm;
mod npy;
mod samples;
mod soft;
#[cfg(test)]
mod tests;
mod tiff;
mod write;

pub use depth::{read_depth, read_depth_by};
pub use mask::{MaskValue, read_mask, read_mask_value};
pub use write::{write_depth, write_mask, write_rgb};

use std::path::Path;

use image::RgbImage;

use super::FormatError;
pub(super) use depth::decode_depth;
pub(super) use write::{encode_depth, encode_jpeg};

const MM_PER_METRE: f64 = 1000.0;

/// Colour image as 8-bit RGB; gray becomes three equal channels, an alpha channel is dropped, 16 bits are rounded to 8.
pub fn read_rgb(path: &Path) -> Result<RgbImage, FormatError> {
    Ok(decode::decode(&decode::read_bytes(path)?, path)?.into_rgb8())
}

/// [`read_rgb`] of bytes in memory; `name` stands for the file in messages.
pub(super) fn decode_rgb(bytes: &[u8], name: &str) -> Result<RgbImage, FormatError> {
    Ok(decode::decode(bytes, Path::new(name))?.into_rgb8())
}

/// Width and height of the image that [`read_rgb`] gives, from the header alone.
pub fn image_size(path: &Path) -> Result<(u32, u32), FormatError> {
    let ((width, height), orientation) = decode::stored_size(path)?;
    Ok(if decode::is_turned(orientation) { (height, width) } else { (width, height) })
}

/// Width and height as the file stores them, where its EXIF orientation swaps them.
pub fn size_before_orientation(path: &Path) -> Option<(u32, u32)> {
    let (size, orientation) = decode::stored_size(path).ok()?;
    decode::is_turned(orientation).then_some(size)
}
