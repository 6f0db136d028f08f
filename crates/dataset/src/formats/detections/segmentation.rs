//! The forms of a mask in a list.

use std::fmt;

use serde::{
    Deserialize, Deserializer,
    de::{self, SeqAccess, Visitor, value::MapAccessDeserializer},
};

use super::{
    super::{FormatError, rle::Rle},
    polygon,
};

/// A mask as a list has it.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Segmentation {
    Rle(Rle),
    /// Corners `x, y, x, y, ...` in pixels; several are united.
    Polygons(Vec<Vec<f64>>),
}

/// Corners this many image sizes outside are errors.
const OUTSIDE: f64 = 2.0;
const EXPECTED: &str = "RLE {size: [height, width], counts} or polygons [[x, y, x, y, ...], ...]";

impl Segmentation {
    /// Detectors of boxes write lists without polygons.
    pub fn is_absent(&self) -> bool {
        matches!(self, Self::Polygons(polygons) if polygons.is_empty())
    }

    /// The mask in an image of `size` (width, height), or of its own size where it has one; `None` where neither is known.
    pub fn rle(&self, size: Option<(u32, u32)>) -> Result<Option<Rle>, FormatError> {
        match (self, size) {
            (Self::Rle(rle), _) => Ok(Some(rle.clone())),
            (Self::Polygons(_), None) => Ok(None),
            (Self::Polygons(polygons), Some(size)) => filled(polygons, size).map(Some),
        }
    }
}

/// The polygons, united.
fn filled(polygons: &[Vec<f64>], (width, height): (u32, u32)) -> Result<Rle, FormatError> {
    let size = [height, width];
    Rle::check_size(size)?;
    let limits = [width, height].map(|side| [-OUTSIDE, 1.0 + OUTSIDE].map(|n| n * f64::from(side)));
    let mut ranges = Vec::new();
    for (index, corners) in polygons.iter().enumerate() {
        let wrong = |value: String, expected: &str| {
            FormatError::field("segmentation", format!("polygon {index}"), value, expected)
        };
        if corners.len() % 2 != 0 {
            return Err(wrong(format!("a list of {} numbers", corners.len()), "pairs x, y"));
        }
        let outside = |(at, value): &(usize, &f64)| {
            let [minimum, maximum] = limits[at % 2];
            !(minimum..=maximum).contains(*value)
        };
        if let Some((_, value)) = corners.iter().enumerate().find(outside) {
            return Err(wrong(format!("one with a corner at {value:?}"), "corners near the image, pixels"));
        }
        ranges.extend(polygon::ranges(corners, size));
    }
    Ok(Rle::of_ranges(size, ranges))
}

impl<'de> Deserialize<'de> for Segmentation {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Forms;
        impl<'de> Visitor<'de> for Forms {
            type Value = Segmentation;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("segmentation as ")?;
                f.write_str(EXPECTED)
            }

            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Segmentation, A::Error> {
                Rle::deserialize(MapAccessDeserializer::new(map)).map(Segmentation::Rle)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Segmentation, A::Error> {
                let mut polygons = Vec::new();
                while let Some(Polygon(corners)) = list.next_element()? {
                    polygons.push(corners);
                }
                Ok(Segmentation::Polygons(polygons))
            }
        }
        deserializer.deserialize_any(Forms)
    }
}

struct Polygon(Vec<f64>);

impl<'de> Deserialize<'de> for Polygon {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Corners;
        impl<'de> Visitor<'de> for Corners {
            type Value = Polygon;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a polygon [x, y, x, y, ...] of segmentation as {EXPECTED}")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Polygon, A::Error> {
                let mut corners = Vec::new();
                while let Some(Number(number)) = list.next_element()? {
                    corners.push(number);
                }
                Ok(Polygon(corners))
            }
        }
        deserializer.deserialize_seq(Corners)
    }
}

struct Number(f64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Coordinate;
        impl Visitor<'_> for Coordinate {
            type Value = Number;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                // Segment Anything's `binary_mask` is a matrix of booleans.
                write!(
                    f,
                    "a polygon's coordinate; segmentation may be {EXPECTED}, as of output_mode coco_rle"
                )
            }

            fn visit_f64<E: de::Error>(self, value: f64) -> Result<Number, E> {
                Ok(Number(value))
            }

            fn visit_u64<E: de::Error>(self, value: u64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }

            fn visit_i64<E: de::Error>(self, value: i64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }
        }
        deserializer.deserialize_f64(Coordinate)
    }
}
