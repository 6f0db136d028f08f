//! Images to files and bytes.

use std::{io::Cursor, path::Path};

use image::{ImageBuffer, ImageFormat, Luma, RgbImage, codecs::jpeg::JpegEncoder};
use unopose_core::{
    files::write_atomic,
    frame::{DepthMap, Mask},
};

use super::{FormatError, MM_PER_METRE, decode::image_error};

/// Writes a colour image in the format of the file's extension (jpeg with quality 92).
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<(), FormatError> {
    let format = ImageFormat::from_path(path).map_err(|e| image_error(path, e))?;
    let bytes = match format {
        ImageFormat::Jpeg => encode_jpeg(image, 92),
        _ => encode(image, format),
    };
    write_bytes(path, bytes)
}

/// Writes a 16-bit png of depth; the counterpart of [`read_depth`](super::read_depth).
pub fn write_depth(path: &Path, depth: &DepthMap, depth_scale_to_mm: f64) -> Result<(), FormatError> {
    write_bytes(path, encode_depth(depth, depth_scale_to_mm))
}

/// Writes an 8-bit png, 255 where the mask is set.
pub fn write_mask(path: &Path, mask: &Mask) -> Result<(), FormatError> {
    let values = mask.data.iter().map(|&m| if m { 255 } else { 0 }).collect();
    write_bytes(path, encode_gray::<u8>(mask.width, mask.height, values))
}

/// The bytes of a jpeg file.
pub(in super::super) fn encode_jpeg(image: &RgbImage, quality: u8) -> image::ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    image.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality))?;
    Ok(bytes)
}

/// The bytes of a 16-bit png. Depth that 65534 steps of this scale do not reach counts as not measured.
pub(in super::super) fn encode_depth(
    depth: &DepthMap,
    depth_scale_to_mm: f64,
) -> image::ImageResult<Vec<u8>> {
    let per_metre = MM_PER_METRE / depth_scale_to_mm;
    let values = depth.data.iter().map(|&z| (f64::from(z) * per_metre).round());
    let values = values.map(|v| if v < f64::from(u16::MAX) { v as u16 } else { 0 }).collect();
    encode_gray::<u16>(depth.width, depth.height, values)
}

fn encode_gray<T>(width: u32, height: u32, values: Vec<T>) -> image::ImageResult<Vec<u8>>
where
    T: image::Primitive,
    Luma<T>: image::PixelWithColorType<Subpixel = T>,
    [T]: image::EncodableLayout,
{
    let wrong_size = || {
        let kind = image::error::ParameterErrorKind::DimensionMismatch;
        image::ImageError::Parameter(image::error::ParameterError::from_kind(kind))
    };
    let image = ImageBuffer::<Luma<T>, _>::from_raw(width, height, values).ok_or_else(wrong_size)?;
    let mut bytes = Vec::new();
    image.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)?;
    Ok(bytes)
}

fn encode(image: &RgbImage, format: ImageFormat) -> image::ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    image.write_to(&mut Cursor::new(&mut bytes), format)?;
    Ok(bytes)
}

fn write_bytes(path: &Path, bytes: image::ImageResult<Vec<u8>>) -> Result<(), FormatError> {
    let bytes = bytes.map_err(|e| image_error(path, e))?;
    Ok(write_atomic(path, |writer| std::io::Write::write_all(writer, &bytes))?)
}
