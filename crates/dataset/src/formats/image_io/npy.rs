//! NumPy's `.npy`: an array of integers, floats or booleans, `(height, width)`.

use std::path::Path;

use half::f16;

use super::{
    FormatError,
    decode::check_size,
    samples::{Samples, Values},
};

/// Magic number and version, which the length of the header follows.
const VERSION_END: usize = 8;

pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Samples, FormatError> {
    let truncated = || FormatError::missing(path.display(), "the array", "truncated npy file");
    let length_bytes = if bytes.get(6) == Some(&1) { 2 } else { 4 };
    let start = VERSION_END + length_bytes;
    let mut length = [0; 4];
    length[..length_bytes].copy_from_slice(bytes.get(VERSION_END..start).ok_or_else(truncated)?);
    let end = start.saturating_add(u32::from_le_bytes(length) as usize);
    let header = String::from_utf8_lossy(bytes.get(start..end).ok_or_else(truncated)?);
    let data = bytes.get(end..).unwrap_or_default();

    let text =
        |key| entry(&header, key).ok_or_else(|| FormatError::missing(path.display(), key, "npy header"));
    let [height, width] = shape(text("shape")?, path)?;
    check_size(path, [width, height], bytes.len() as u64)?;
    let element = Element::parse(text("descr")?, path)?;
    let (rows, columns) = (height as usize, width as usize);
    let expected = rows * columns * element.size;
    if data.len() != expected {
        let value = format!("{} bytes", data.len());
        return Err(FormatError::field(path.display(), "array", value, format!("{expected} bytes")));
    }
    let column_major = text("fortran_order")?.starts_with("True");
    let raw = (0..rows * columns).map(|i| {
        let (row, column) = (i / columns, i % columns);
        let at = if column_major { column * rows + row } else { i } * element.size;
        element.bits(&data[at..at + element.size])
    });
    let values = match (element.kind, element.size) {
        ('f', 2) => Values::Floats(raw.map(|bits| f16::from_bits(bits as u16).to_f32()).collect()),
        ('f', 4) => Values::Floats(raw.map(|bits| f32::from_bits(bits as u32)).collect()),
        ('f', _) => Values::Floats(raw.map(|bits| f64::from_bits(bits) as f32).collect()),
        ('i', size) => {
            let unused = 64 - 8 * size as u32;
            let signed = raw.map(|bits| ((bits << unused) as i64 >> unused).clamp(0, u32::MAX.into()) as u32);
            Values::Integers(signed.collect(), 8 * size as u32)
        }
        (_, size) => {
            let unsigned = raw.map(|bits| bits.min(u32::MAX.into()) as u32);
            Values::Integers(unsigned.collect(), 8 * size as u32)
        }
    };
    Ok(Samples { width: width as u32, height: height as u32, values })
}

/// The text of the header's dictionary after a key.
fn entry<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = header.split_once(&format!("'{key}'"))?;
    Some(rest.trim_start().strip_prefix(':')?.trim_start())
}

/// Height and width; a dimension of length 1 before or after them is no dimension.
fn shape(text: &str, path: &Path) -> Result<[u64; 2], FormatError> {
    let inside =
        text.strip_prefix('(').and_then(|rest| rest.split_once(')')).map_or("", |(inside, _)| inside);
    let sides = inside.split(',').map(str::trim).filter(|side| !side.is_empty());
    let sides: Vec<u64> = sides.map(|side| side.parse().unwrap_or_default()).collect();
    match *sides.as_slice() {
        [height, width] | [height, width, 1] | [1, height, width] => Ok([height, width]),
        _ => {
            let value = format!("({inside})");
            Err(FormatError::field(path.display(), "shape", value, "(height, width) or (height, width, 1)"))
        }
    }
}

/// Type of the numbers.
struct Element {
    /// `f`, `i`, `u` or `b` (boolean).
    kind: char,
    /// Bytes.
    size: usize,
    big_endian: bool,
}

impl Element {
    fn parse(text: &str, path: &Path) -> Result<Self, FormatError> {
        let name =
            text.strip_prefix('\'').and_then(|rest| rest.split_once('\'')).map_or(text, |(name, _)| name);
        let mut letters = name.chars();
        let (order, kind) = (letters.next(), letters.next());
        let size = letters.as_str().parse::<usize>().ok();
        match (order, kind, size) {
            (Some('<' | '>' | '|' | '='), Some(kind @ ('i' | 'u')), Some(size @ (1 | 2 | 4 | 8)))
            | (Some('<' | '>' | '|' | '='), Some(kind @ 'f'), Some(size @ (2 | 4 | 8)))
            | (Some('<' | '>' | '|' | '='), Some(kind @ 'b'), Some(size @ 1)) => {
                Ok(Self { kind, size, big_endian: order == Some('>') })
            }
            _ => {
                let value: String = name.chars().take(40).collect();
                let expected = "integers, floats or booleans, such as <u2 or <f4";
                Err(FormatError::field(path.display(), "descr", value, expected))
            }
        }
    }

    /// The bits of one number.
    fn bits(&self, bytes: &[u8]) -> u64 {
        let join = |value: u64, &byte: &u8| value << 8 | u64::from(byte);
        if self.big_endian { bytes.iter().fold(0, join) } else { bytes.iter().rev().fold(0, join) }
    }
}
