//! Masks: which pixels of an image are the object.
//!
//! * The alpha channel, where it varies: a cut-out. Its colours must not be a mask of their own that says otherwise.
//! * One value apart from 0 (or one colour apart from black): its pixels.
//! * Gray that rises from 0 to the largest number without plateaus (smoothed edges, probabilities): cut at half; likewise
//!   every jpeg and lossy webp, whose values are not exact.
//! * Other values are a label map, in which one has to be chosen. A palette's values are its indices.

use std::{fmt, path::Path, str::FromStr};

use unopose_core::frame::Mask;

use super::{
    FormatError,
    decode::read_bytes,
    labels::{Labels, labels},
    soft,
};

/// Share of both masks in which colours and alpha may differ (their edges).
const SAME_MASK: f64 = 0.9;

/// Which pixels of a label map are the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MaskValue {
    /// Those with this number (gray value or palette index), above 0.
    Number(u32),
    /// Those with this colour, red, green and blue.
    Color([u8; 3]),
}

impl FromStr for MaskValue {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<u32>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.unwrap_or_default().as_slice() {
            [number] if *number > 0 => Ok(Self::Number(*number)),
            [r, g, b] if *r.max(g).max(b) <= 255 => Ok(Self::Color([*r as u8, *g as u8, *b as u8])),
            _ => Err(format!("{text:?}, expected a number above 0, or R,G,B from 0 to 255")),
        }
    }
}

impl fmt::Display for MaskValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Color([r, g, b]) => write!(f, "{r},{g},{b}"),
        }
    }
}

/// A mask; a label map is an error.
pub fn read_mask(path: &Path) -> Result<Mask, FormatError> {
    mask_from(labels(&read_bytes(path)?, path, false)?, path, "")
}

/// The pixels of a value in a label map; without a value [`read_mask`], whose error on label maps says how to choose one.
pub fn read_mask_value(path: &Path, value: Option<MaskValue>) -> Result<Mask, FormatError> {
    let is_number = matches!(value, Some(MaskValue::Number(_)));
    let labels = labels(&read_bytes(path)?, path, is_number)?;
    let Some(value) = value else {
        return mask_from(labels, path, "; choose one of the values with --mask-value N");
    };
    let wrong = |value: String, expected: String| {
        Err(FormatError::field(path.display(), "--mask-value", value, expected))
    };
    if labels.lossy {
        return wrong(
            value.to_string(),
            "a lossless format such as png: values of jpeg are not exact".into(),
        );
    }
    let number = match (value, labels.colored) {
        (MaskValue::Number(number), false) => number,
        (MaskValue::Color([r, g, b]), true) => u32::from_be_bytes([0, r, g, b]),
        (_, colored) => {
            let kind =
                if colored { "R,G,B for a mask with colours" } else { "a number for a mask of numbers" };
            return wrong(value.to_string(), format!("{kind}: {}", labels.listed()));
        }
    };
    let mask = labels.select(|v| v == number);
    match mask.count() {
        0 => wrong(value.to_string(), format!("a value of the mask: {}", labels.listed())),
        _ => Ok(mask),
    }
}

fn mask_from(labels: Labels, path: &Path, hint: &str) -> Result<Mask, FormatError> {
    if let Some(alpha) = &labels.alpha {
        let largest = alpha.iter().copied().max().unwrap_or_default();
        let cut_out = |v: u8| u16::from(v) * 2 >= u16::from(largest);
        // Nearly opaque everywhere is no cut-out.
        if !alpha.iter().all(|&v| cut_out(v)) {
            let data = alpha.iter().map(|&v| cut_out(v)).collect();
            let mask = Mask { data, ..labels.select(|_| false) };
            let [background, object] = labels.first_values();
            let colors = labels.select(|v| v != 0);
            if background == Some(0) && object.is_some() && labels.is_plain() && colors.iou(&mask) < SAME_MASK
            {
                let value = format!("{} pixels in the colours and {} in alpha", colors.count(), mask.count());
                let expected = "one mask: remove the alpha channel, or fill the colours";
                return Err(FormatError::field(path.display(), "mask", value, expected));
            }
            return Ok(mask);
        }
    }
    if labels.lossy {
        return match soft::is_bimodal(&labels) {
            true => Ok(labels.select(|v| v >= soft::half(u8::MAX.into()))),
            false => {
                let expected = "black and white areas; this looks like a photograph or a label map";
                Err(FormatError::field(path.display(), "mask", "gray areas in a lossy format", expected))
            }
        };
    }
    if labels.is_plain() {
        return Ok(labels.select(|v| v != 0));
    }
    let listed = labels.listed();
    match labels.into_shades() {
        Some((shades, full)) if soft::has_no_plateaus(&shades, full) => {
            Ok(shades.select(|v| v >= soft::half(full)))
        }
        _ => {
            let expected = format!("0 and one other value: several are a label map{hint}");
            Err(FormatError::field(path.display(), "mask values", listed, expected))
        }
    }
}
