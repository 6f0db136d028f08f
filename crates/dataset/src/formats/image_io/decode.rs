//! Bytes to pixels, within limits that are checked on the header before anything of the image's size is allocated.

use std::{
    io::{BufRead, BufReader, Cursor, Seek},
    path::Path,
};

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits, metadata::Orientation};
use unopose_core::files::{open_regular, read_regular};

use super::FormatError;

/// Bytes of the largest image file.
const MAX_FILE: u64 = 1 << 30;
/// Columns, and rows, of the largest image.
const MAX_SIDE: u32 = 16_384;
/// Pixels of the largest image.
const MAX_PIXELS: u64 = 100_000_000;
/// Bytes of the largest image in memory.
const MAX_DECODED: u64 = 2 << 30;

/// An even one-bit image packs this many pixels into a byte of a png; beyond, the header is not of this file.
const MAX_PIXELS_PER_BYTE: u64 = 10_000;
/// Smaller images may be as even as they like.
const SMALL: u64 = 4_000_000;

pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>, FormatError> {
    read_regular(path, MAX_FILE).map_err(|e| FormatError::io(path, e))
}

/// Refuses sizes that no image of a camera has, and those that a file of `bytes` bytes cannot fill.
pub(super) fn check_size(path: &Path, [width, height]: [u64; 2], bytes: u64) -> Result<(), FormatError> {
    let side = 1..=u64::from(MAX_SIDE);
    let pixels = width.saturating_mul(height);
    let expected = if !side.contains(&width) || !side.contains(&height) || pixels > MAX_PIXELS {
        format!("1 to {MAX_SIDE} columns and rows, at most {} million pixels", MAX_PIXELS / 1_000_000)
    } else if pixels > SMALL.max(bytes.saturating_mul(MAX_PIXELS_PER_BYTE)) {
        format!("a size that {bytes} bytes of file can hold")
    } else {
        return Ok(());
    };
    Err(FormatError::field(path.display(), "image size", format!("{width} x {height}"), expected))
}

/// The image as its EXIF orientation says it is to be seen. The format is told by the content, not by the name.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<DynamicImage, FormatError> {
    if image::guess_format(bytes).ok() == Some(ImageFormat::Jpeg) && !jpeg_has_end(bytes) {
        return Err(FormatError::missing(path.display(), "end-of-image marker", "truncated jpeg"));
    }
    let mut decoder = decoder(Cursor::new(bytes), bytes.len() as u64, path)?;
    let orientation = orientation_of(&mut decoder);
    let mut image = DynamicImage::from_decoder(decoder).map_err(|e| image_error(path, e))?;
    image.apply_orientation(orientation);
    Ok(image)
}

/// Columns and rows as stored and the orientation that is applied to them, from the header alone.
pub(super) fn stored_size(path: &Path) -> Result<((u32, u32), Orientation), FormatError> {
    let file = open_regular(path).map_err(|e| FormatError::io(path, e))?;
    let length = file.metadata().map_err(|e| FormatError::io(path, e))?.len();
    let mut decoder = decoder(BufReader::new(file), length, path)?;
    Ok((decoder.dimensions(), orientation_of(&mut decoder)))
}

/// Whether columns become rows.
pub(super) fn is_turned(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
}

fn decoder<'a, R: BufRead + Seek + 'a>(
    content: R,
    length: u64,
    path: &Path,
) -> Result<impl ImageDecoder + use<'a, R>, FormatError> {
    let mut reader = ImageReader::new(content).with_guessed_format().map_err(|e| FormatError::io(path, e))?;
    // Sides are checked below, with a message that names the limit.
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MAX_DECODED);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|e| image_error(path, e))?;
    let (width, height) = decoder.dimensions();
    check_size(path, [width.into(), height.into()], length)?;
    if decoder.total_bytes() > MAX_DECODED {
        let value = format!("{} bytes", decoder.total_bytes());
        return Err(FormatError::field(
            path.display(),
            "decoded image",
            value,
            format!("at most {MAX_DECODED}"),
        ));
    }
    Ok(decoder)
}

/// Damaged metadata is none.
fn orientation_of(decoder: &mut impl ImageDecoder) -> Orientation {
    decoder.orientation().unwrap_or(Orientation::NoTransforms)
}

/// Whether the end marker follows the pixels: the decoder fills what a truncated file lacks with gray. Entropy-coded data
/// cannot contain the marker; the segments before it can (a thumbnail is a jpeg, too), so they are skipped.
fn jpeg_has_end(bytes: &[u8]) -> bool {
    const SCAN: u8 = 0xda;
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = bytes.get(at..at + 4) {
        match marker {
            SCAN => break,
            // Padding before a marker.
            0xff => at += 1,
            _ => at += 2 + usize::from(u16::from_be_bytes([high, low])),
        }
    }
    bytes.get(at..).is_some_and(|scans| scans.windows(2).any(|pair| pair == [0xff, 0xd9]))
}

pub(super) fn image_error(path: &Path, source: image::ImageError) -> FormatError {
    FormatError::Image { path: path.to_path_buf(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_with_absurd_sizes_are_refused_before_decoding() {
        // A png whose header says 60000 x 60000, and one of 16000 x 6000 in a file of under 100 bytes.
        for (width, height, part) in
            [(60_000, 60_000, "1 to 16384 columns"), (16_000, 6_000, "bytes of file can hold")]
        {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, width, height);
            encoder.set_color(png::ColorType::Rgb);
            let mut writer = encoder.write_header().unwrap();
            writer.write_chunk(png::chunk::IDAT, &[]).unwrap();
            drop(writer);
            let message = decode(&bytes, Path::new("a.png")).unwrap_err().to_string();
            assert!(message.contains(&format!("image size is {width} x {height}")), "{message}");
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn the_end_of_a_thumbnail_is_not_the_end_of_the_image() {
        // Start, APP1 of 6 bytes with an end marker in it, start of scan, data.
        let mut bytes = vec![0xff, 0xd8, 0xff, 0xe1, 0, 6, 0xff, 0xd9, 0, 0, 0xff, 0xda, 0, 2, 1, 2, 3];
        assert!(!jpeg_has_end(&bytes));
        bytes.extend([0xff, 0xd9]);
        assert!(jpeg_has_end(&bytes));
    }
}
