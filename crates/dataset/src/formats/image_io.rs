//! Image files and bytes: colour (png, jpeg, tiff, bmp), 16-bit depth, masks.

use std::{io::Cursor, path::Path};

use image::{DynamicImage, ImageBuffer, ImageFormat, ImageReader, Luma, RgbImage, codecs::jpeg::JpegEncoder};
use unopose_core::{
    files::write_atomic,
    frame::{DepthMap, Mask},
};

use super::FormatError;

const MM_PER_METRE: f64 = 1000.0;

/// The jpeg decoder fills what a truncated file lacks with gray, so the end marker is looked for.
/// Entropy-coded data cannot contain it.
const JPEG_END: [u8; 2] = [0xff, 0xd9];

/// Colour image as 8-bit RGB; gray becomes three equal channels, an alpha channel is dropped.
pub fn read_rgb(path: &Path) -> Result<RgbImage, FormatError> {
    Ok(read(path)?.into_rgb8())
}

/// Width and height, from the header alone.
pub fn image_size(path: &Path) -> Result<(u32, u32), FormatError> {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let reader = reader.map_err(|e| FormatError::io(path, e))?;
    reader.into_dimensions().map_err(|e| image_error(path, e))
}

/// 16-bit depth image, millimetres = value x `depth_scale_to_mm`; 0 and 65535 are no measurement.
pub fn read_depth(path: &Path, depth_scale_to_mm: f64) -> Result<DepthMap, FormatError> {
    depth_from(read(path)?, path, depth_scale_to_mm)
}

/// Mask: every pixel with a channel other than alpha above 0 is set.
pub fn read_mask(path: &Path) -> Result<Mask, FormatError> {
    let image = read(path)?;
    let (width, height) = (image.width(), image.height());
    let data = match image {
        DynamicImage::ImageLuma8(gray) => gray.into_raw().into_iter().map(|v| v > 0).collect(),
        DynamicImage::ImageLuma16(gray) => gray.into_raw().into_iter().map(|v| v > 0).collect(),
        other => other.into_rgb8().pixels().map(|p| p.0 != [0; 3]).collect(),
    };
    Ok(Mask { width, height, data })
}

/// [`read_rgb`] of bytes in memory; `name` stands for the file in messages.
pub(super) fn decode_rgb(bytes: &[u8], name: &str) -> Result<RgbImage, FormatError> {
    Ok(decode(bytes, Path::new(name))?.into_rgb8())
}

/// [`read_depth`] of bytes in memory; `name` stands for the file in messages.
pub(super) fn decode_depth(
    bytes: &[u8],
    name: &str,
    depth_scale_to_mm: f64,
) -> Result<DepthMap, FormatError> {
    depth_from(decode(bytes, Path::new(name))?, Path::new(name), depth_scale_to_mm)
}

/// Writes a colour image in the format of the file's extension (jpeg with quality 92).
pub fn write_rgb(path: &Path, image: &RgbImage) -> Result<(), FormatError> {
    let format = ImageFormat::from_path(path).map_err(|e| image_error(path, e))?;
    let bytes = match format {
        ImageFormat::Jpeg => encode_jpeg(image, 92),
        _ => encode(image, format),
    };
    write_bytes(path, bytes)
}

/// Writes a 16-bit png of depth; the counterpart of [`read_depth`].
pub fn write_depth(path: &Path, depth: &DepthMap, depth_scale_to_mm: f64) -> Result<(), FormatError> {
    write_bytes(path, encode_depth(depth, depth_scale_to_mm))
}

/// Writes an 8-bit png, 255 where the mask is set.
pub fn write_mask(path: &Path, mask: &Mask) -> Result<(), FormatError> {
    let values = mask.data.iter().map(|&m| if m { 255 } else { 0 }).collect();
    write_bytes(path, encode_gray::<u8>(mask.width, mask.height, values))
}

/// The bytes of a jpeg file.
pub(super) fn encode_jpeg(image: &RgbImage, quality: u8) -> image::ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    image.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality))?;
    Ok(bytes)
}

/// The bytes of a 16-bit png. Depth that 65534 steps of this scale do not reach counts as not measured.
pub(super) fn encode_depth(depth: &DepthMap, depth_scale_to_mm: f64) -> image::ImageResult<Vec<u8>> {
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

fn read(path: &Path) -> Result<DynamicImage, FormatError> {
    let bytes = std::fs::read(path).map_err(|e| FormatError::io(path, e))?;
    decode(&bytes, path)
}

/// The format is told by the content, not by the name.
fn decode(bytes: &[u8], path: &Path) -> Result<DynamicImage, FormatError> {
    let reader =
        ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| FormatError::io(path, e))?;
    if reader.format() == Some(ImageFormat::Jpeg) && !bytes.windows(2).any(|pair| pair == JPEG_END) {
        return Err(FormatError::missing(path.display(), "end-of-image marker", "truncated jpeg"));
    }
    reader.decode().map_err(|e| image_error(path, e))
}

fn depth_from(image: DynamicImage, path: &Path, scale: f64) -> Result<DepthMap, FormatError> {
    if !(scale.is_finite() && scale > 0.0) {
        return Err(FormatError::field(path.display(), "depth_scale", scale, "a finite number above 0"));
    }
    let (width, height) = (image.width(), image.height());
    // Cameras write the largest number where nothing was measured.
    let metres = |value: u16| match value {
        u16::MAX => 0.0,
        value => (f64::from(value) * scale / MM_PER_METRE) as f32,
    };
    let data = match image {
        DynamicImage::ImageLuma16(gray) => gray.into_raw().into_iter().map(metres).collect(),
        other => {
            let color = format!("{:?}", other.color());
            let expected = "16-bit gray; an image of 8 bits is a preview, whose distances are lost";
            return Err(FormatError::field(path.display(), "depth pixel type", color, expected));
        }
    };
    Ok(DepthMap { width, height, data })
}

fn image_error(path: &Path, source: image::ImageError) -> FormatError {
    FormatError::Image { path: path.to_path_buf(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> RgbImage {
        RgbImage::from_fn(64, 48, |x, y| image::Rgb([(x * 4) as u8, (y * 5) as u8, ((x * y) % 251) as u8]))
    }

    #[test]
    fn depth_survives_the_file_at_its_resolution() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        let depth = DepthMap { width: 4, height: 1, data: vec![0.0, 0.71501, 6.5534, 6.5535] };
        write_depth(&path, &depth, 0.1).unwrap();
        // 0.1 mm steps; 65535 is no measurement.
        assert_eq!(read_depth(&path, 0.1).unwrap().data, [0.0, 0.7150, 6.5534, 0.0]);
        assert!((read_depth(&path, 1.0).unwrap().data[1] - 7.150).abs() < 1e-6);
        for scale in [0.0, f64::NAN] {
            assert!(read_depth(&path, scale).unwrap_err().to_string().contains("depth_scale"));
        }
    }

    #[test]
    fn gray_becomes_three_channels_and_colour_is_no_depth() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gray.tif");
        image::GrayImage::from_fn(3, 2, |x, _| Luma([x as u8 * 100])).save(&path).unwrap();
        assert_eq!(read_rgb(&path).unwrap().get_pixel(2, 1).0, [200; 3]);
        let rgb = folder.path().join("rgb.png");
        write_rgb(&rgb, &gradient()).unwrap();
        assert_eq!(read_rgb(&rgb).unwrap(), gradient());
        for no_depth in [&rgb, &path] {
            assert!(read_depth(no_depth, 1.0).unwrap_err().to_string().contains("16-bit gray"));
        }
        let unmeasured = folder.path().join("unmeasured.png");
        ImageBuffer::from_fn(2, 1, |x, _| Luma([[700, u16::MAX][x as usize]])).save(&unmeasured).unwrap();
        assert_eq!(read_depth(&unmeasured, 1.0).unwrap().data, [0.7, 0.0]);
    }

    #[test]
    fn masks_survive_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mask.png");
        let mut mask = Mask::empty(5, 4);
        mask.data[7] = true;
        write_mask(&path, &mask).unwrap();
        assert_eq!(read_mask(&path).unwrap(), mask);
    }

    #[test]
    fn truncated_files_are_errors_that_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "a.jpg", "a.tif", "a.bmp"] {
            let path = folder.path().join(name);
            write_rgb(&path, &gradient()).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            assert!(decode_rgb(&bytes, name).is_ok());
            for keep in [0, 1, 10, bytes.len() / 2, bytes.len() * 9 / 10] {
                let message = decode_rgb(&bytes[..keep], name).unwrap_err().to_string();
                assert!(message.contains(name), "{message}");
            }
        }
    }
}
