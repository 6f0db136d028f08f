//! Gray TIFF with numbers as they stand: integers of 8 to 64 bits and floats.

use std::{io::Cursor, path::Path};

use tiff::{
    ColorType,
    decoder::{Decoder, DecodingResult, Limits},
    tags::Tag,
};

use super::{
    FormatError,
    decode::{check_size, image_error},
    samples::{Samples, Values},
};

/// Value of the tag for pixels as they are.
const UNCOMPRESSED: u16 = 1;

/// `None` where the image has several channels or less than a byte per pixel.
pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Option<Samples>, FormatError> {
    let error = |source: tiff::TiffError| {
        let format = image::error::ImageFormatHint::Exact(image::ImageFormat::Tiff);
        image_error(path, image::ImageError::Decoding(image::error::DecodingError::new(format, source)))
    };
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(error)?;
    let (width, height) = decoder.dimensions().map_err(error)?;
    check_size(path, [width.into(), height.into()], bytes.len() as u64)?;
    let ColorType::Gray(bits @ 8..) = decoder.colortype().map_err(error)? else { return Ok(None) };
    let compression = decoder.find_tag_unsigned::<u16>(Tag::Compression).map_err(error)?;
    let stored = u64::from(width) * u64::from(height) * u64::from(bits) / 8;
    if compression.is_none_or(|c| c == UNCOMPRESSED) && stored > bytes.len() as u64 {
        let expected = format!("at most the file's {} bytes of uncompressed pixels", bytes.len());
        return Err(FormatError::field(
            path.display(),
            "image size",
            format!("{width} x {height}"),
            expected,
        ));
    }
    let orientation = decoder.find_tag_unsigned::<u16>(Tag::Orientation).map_err(error)?;
    if let Some(turned) = orientation.filter(|&o| o > 1) {
        let expected = "1 (as stored): numbers are not turned";
        return Err(FormatError::field(path.display(), "orientation", turned, expected));
    }
    let mut limits = Limits::default();
    limits.decoding_buffer_size = width as usize * height as usize * size_of::<f64>();
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    let mut decoder = decoder.with_limits(limits);
    let values = match decoder.read_image().map_err(error)? {
        DecodingResult::U8(values) => integers(values),
        DecodingResult::U16(values) => integers(values),
        DecodingResult::U32(values) => integers(values),
        DecodingResult::U64(values) => integers(values),
        DecodingResult::I8(values) => integers(values),
        DecodingResult::I16(values) => integers(values),
        DecodingResult::I32(values) => integers(values),
        DecodingResult::I64(values) => integers(values),
        DecodingResult::F16(values) => Values::Floats(values.into_iter().map(|v| v.to_f32()).collect()),
        DecodingResult::F32(values) => Values::Floats(values),
        DecodingResult::F64(values) => Values::Floats(values.into_iter().map(|v| v as f32).collect()),
    };
    Ok(Some(Samples { width, height, values }))
}

fn integers<T: Into<i128>>(values: Vec<T>) -> Values {
    let unsigned = |value: T| value.into().clamp(0, u32::MAX.into()) as u32;
    Values::Integers(values.into_iter().map(unsigned).collect(), 8 * size_of::<T>() as u32)
}
