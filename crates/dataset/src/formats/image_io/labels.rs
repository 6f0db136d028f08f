//! The values of a mask image as its file has them.

use std::{collections::BTreeSet, path::Path};

use image::{DynamicImage, ImageFormat};
use unopose_core::frame::Mask;

use super::{
    FormatError,
    decode::{decode, image_error},
    samples::{Samples, Values, numbers},
};

/// One value per pixel.
pub(super) struct Labels {
    pub width: u32,
    pub height: u32,
    /// Numbers, or colours as `0xrrggbb`. 0 is background.
    pub values: Vec<u32>,
    /// Whether the values are colours.
    pub colored: bool,
    /// The largest number that the file's type can hold, where such a number means "wholly inside".
    pub full: Option<u32>,
    /// Whether values are changed by compression.
    pub lossy: bool,
    /// 0 to 255, where the file has an alpha channel.
    pub alpha: Option<Vec<u8>>,
}

/// More values are not listed in messages.
const LISTED: usize = 12;

impl Labels {
    /// The pixels with certain values.
    pub fn select(&self, is_object: impl Fn(u32) -> bool) -> Mask {
        let data = self.values.iter().map(|&v| is_object(v)).collect();
        Mask { width: self.width, height: self.height, data }
    }

    /// Whether there is at most one value apart from 0.
    pub fn is_plain(&self) -> bool {
        let mut objects = self.values.iter().filter(|&&v| v != 0);
        objects.next().is_none_or(|first| objects.all(|v| v == first))
    }

    /// The smallest value, and a larger one.
    pub fn first_values(&self) -> [Option<u32>; 2] {
        let smallest = self.values.iter().min();
        [smallest.copied(), self.values.iter().find(|v| Some(*v) > smallest).copied()]
    }

    /// The values apart from 0, for messages.
    pub fn listed(&self) -> String {
        let values: BTreeSet<u32> = self.values.iter().copied().filter(|&v| v != 0).collect();
        let text = |&value: &u32| match value.to_be_bytes() {
            [_, r, g, b] if self.colored => format!("({r},{g},{b})"),
            _ => value.to_string(),
        };
        let first: Vec<String> = values.iter().take(LISTED).map(text).collect();
        let rest = values.len().saturating_sub(LISTED);
        let rest = if rest > 0 { format!(" and {rest} more") } else { String::new() };
        format!("{}{rest}", first.join(", "))
    }

    /// The same as shades of gray and the largest of them, where there are shades: numbers of which one is the largest of the
    /// file's type, or colours that are shades of one.
    pub fn into_shades(self) -> Option<(Self, u32)> {
        if !self.colored {
            let full = self.full?;
            return Some((self, full));
        }
        let channels = |value: u32| value.to_be_bytes().map(u32::from);
        let brightness = |value: &u32| channels(*value).into_iter().max().unwrap_or_default();
        let brightest = self.values.iter().copied().max_by_key(brightness)?;
        let full = brightness(&brightest);
        let is_shade = |value: &u32| {
            let own = brightness(value);
            let pairs = channels(*value).into_iter().zip(channels(brightest));
            // Two steps for the rounding of both.
            pairs.into_iter().all(|(a, b)| (a * full).abs_diff(b * own) <= 2 * full)
        };
        if !self.values.iter().all(is_shade) {
            return None;
        }
        let values = self.values.iter().map(brightness).collect();
        Some((Self { values, colored: false, ..self }, full))
    }
}

/// The labels of any image; those of a palette of colours are its indices where a label map has to have them, or
/// `always_indices`.
pub(super) fn labels(bytes: &[u8], path: &Path, always_indices: bool) -> Result<Labels, FormatError> {
    if let Some(Samples { width, height, values }) = numbers(bytes, path)? {
        let (values, full) = match values {
            Values::Integers(values, bits) => (values, (bits <= 16).then(|| (1 << bits) - 1)),
            // Probabilities, unless they are numbers.
            Values::Floats(values) if !values.iter().any(|&v| v > 1.0) => {
                (values.iter().map(|v| (v * 255.0).round() as u32).collect(), Some(255))
            }
            Values::Floats(values) => (values.iter().map(|v| v.round() as u32).collect(), None),
        };
        return Ok(Labels { width, height, values, full, colored: false, lossy: false, alpha: None });
    }
    let format = image::guess_format(bytes).ok();
    let image = decode(bytes, path)?;
    if format == Some(ImageFormat::Png)
        && !image.color().has_alpha()
        && let Some(labels) = indexed(bytes, path, always_indices)?
    {
        return Ok(labels);
    }
    let (width, height) = (image.width(), image.height());
    let alpha = image.color().has_alpha().then(|| image.to_rgba8().pixels().map(|p| p.0[3]).collect());
    let (values, colored, full) = match image {
        DynamicImage::ImageLuma16(gray) => {
            (gray.into_raw().into_iter().map(u32::from).collect(), false, u16::MAX.into())
        }
        other if !other.color().has_color() => {
            (other.into_luma8().into_raw().into_iter().map(u32::from).collect(), false, u8::MAX.into())
        }
        other => {
            let (values, colored) = colors(other.into_rgb8().pixels().map(|p| p.0).collect());
            (values, colored, u8::MAX.into())
        }
    };
    let lossy = match format {
        Some(ImageFormat::Jpeg) => true,
        // Its other kind is lossless.
        Some(ImageFormat::WebP) => !bytes.windows(4).any(|name| name == b"VP8L"),
        _ => false,
    };
    // Compression shifts hues.
    let values = match colored && lossy {
        true => {
            values.into_iter().map(|v: u32| v.to_be_bytes().into_iter().max().unwrap_or(0).into()).collect()
        }
        false => values,
    };
    Ok(Labels { width, height, values, full: Some(full), colored: colored && !lossy, lossy, alpha })
}

/// Gray values where all colours are gray, and whether they are not.
fn colors(pixels: Vec<[u8; 3]>) -> (Vec<u32>, bool) {
    let colored = pixels.iter().any(|[r, g, b]| r != g || g != b);
    let value = |[r, g, b]: [u8; 3]| if colored { u32::from_be_bytes([0, r, g, b]) } else { r.into() };
    (pixels.into_iter().map(value).collect(), colored)
}

/// The numbers of a png with a palette of several colours, or with gray of less than 8 bits, which images in memory no longer
/// have.
fn indexed(bytes: &[u8], path: &Path, always: bool) -> Result<Option<Labels>, FormatError> {
    let error = |source: png::DecodingError| {
        let format = image::error::ImageFormatHint::Exact(ImageFormat::Png);
        image_error(path, image::ImageError::Decoding(image::error::DecodingError::new(format, source)))
    };
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().map_err(error)?;
    let (kind, depth) = reader.output_color_type();
    let bits = depth as u32;
    let palette = match (kind, bits) {
        (png::ColorType::Indexed, _) => reader.info().palette.clone().unwrap_or_default(),
        (png::ColorType::Grayscale, 2 | 4) => Default::default(),
        _ => return Ok(None),
    };
    let (width, height) = (reader.info().width, reader.info().height);
    let (Some(length), Some(line)) = (reader.output_buffer_size(), reader.output_line_size(width)) else {
        return Ok(None);
    };
    let mut packed = vec![0; length];
    reader.next_frame(&mut packed).map_err(error)?;
    let mut values = Vec::with_capacity(width as usize * height as usize);
    for row in packed.chunks_exact(line) {
        // Leftmost pixel in the highest bits.
        let pixel = |x: u32| {
            let bit = x * bits;
            let byte = row.get(bit as usize / 8).copied().unwrap_or_default();
            u32::from(byte >> (8 - bits - bit % 8)) & ((1 << bits) - 1)
        };
        values.extend((0..width).map(pixel));
    }
    let labels = Labels {
        width,
        height,
        values,
        colored: false,
        full: Some((1 << bits) - 1),
        lossy: false,
        alpha: None,
    };
    if kind != png::ColorType::Indexed {
        return Ok(Some(labels));
    }
    Ok(of_palette(labels, &palette, always))
}

/// Indices as values; `None` where the colours say it as well: a palette of grays or, unless `always`, at most one colour apart
/// from black.
fn of_palette(mut labels: Labels, palette: &[u8], always: bool) -> Option<Labels> {
    let used: BTreeSet<u32> = labels.values.iter().copied().collect();
    let color = |index: &u32| palette.get(*index as usize * 3..*index as usize * 3 + 3).unwrap_or(&[0; 3]);
    let gray = used.iter().all(|i| color(i).windows(2).all(|pair| pair[0] == pair[1]));
    let black: Vec<&u32> = used.iter().filter(|i| color(i) == [0; 3]).collect();
    if gray || (!always && used.len() <= 2 && !black.is_empty()) {
        return None;
    }
    // Black is background, and is so in its place where no index 0 is used.
    if !used.contains(&0)
        && let &[&background] = black.as_slice()
    {
        for value in labels.values.iter_mut().filter(|v| **v == background) {
            *value = 0;
        }
    }
    labels.full = None;
    Some(labels)
}
