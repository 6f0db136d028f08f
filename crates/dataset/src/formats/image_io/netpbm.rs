//! Gray netpbm files with numbers as they stand: PGM (`P2`, `P5`), which image libraries stretch to the full range, and its
//! sibling for floats, PFM (`Pf`).

use std::path::Path;

use super::{
    FormatError,
    decode::check_size,
    samples::{Samples, Values},
};

pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Samples, FormatError> {
    let mut words = Words(&bytes[2..]);
    let mut next = |field: &str| {
        let word = words.next().unwrap_or_default();
        let word = std::str::from_utf8(word).unwrap_or_default();
        word.parse::<f64>().map_err(|_| FormatError::field(path.display(), field, word, "a number"))
    };
    let (width, height, last) = (next("width")?, next("height")?, next("maximum or scale")?);
    check_size(path, [width as u64, height as u64], bytes.len() as u64)?;
    let (columns, count) = (width as usize, width as usize * height as usize);
    let wrong = |field, value: f64, expected| Err(FormatError::field(path.display(), field, value, expected));
    let values = match bytes[1] {
        b'F' => return wrong("channels", 3.0, "1 (Pf)"),
        b'f' if last.abs() != 1.0 => return wrong("scale", last, "-1 or 1: numbers as they stand"),
        b'f' => {
            let number = match last < 0.0 {
                true => f32::from_le_bytes,
                false => f32::from_be_bytes,
            };
            let rows = words.binary(count * 4, path)?.chunks_exact(columns * 4).rev();
            let numbers = rows.flat_map(|row| row.chunks_exact(4)).map(|b| number([b[0], b[1], b[2], b[3]]));
            Values::Floats(numbers.collect())
        }
        _ if !(1.0..=65535.0).contains(&last) => return wrong("maximum", last, "1 to 65535"),
        b'2' => {
            let numbers = words.by_ref().take(count).map(|word| std::str::from_utf8(word).ok()?.parse().ok());
            let numbers: Vec<u32> = numbers.collect::<Option<_>>().unwrap_or_default();
            if numbers.len() != count {
                return Err(FormatError::missing(
                    path.display(),
                    format!("{count} numbers"),
                    "truncated pgm",
                ));
            }
            Values::Integers(numbers, if last > 255.0 { 16 } else { 8 })
        }
        _ if last > 255.0 => {
            let numbers = words.binary(count * 2, path)?.chunks_exact(2);
            Values::Integers(numbers.map(|b| u16::from_be_bytes([b[0], b[1]]).into()).collect(), 16)
        }
        _ => Values::Integers(words.binary(count, path)?.iter().map(|&b| b.into()).collect(), 8),
    };
    Ok(Samples { width: width as u32, height: height as u32, values })
}

/// Words between white space and comments, which run from `#` to the end of the line.
struct Words<'a>(&'a [u8]);

impl<'a> Words<'a> {
    /// Bytes after the single white space that ends the header.
    fn binary(&self, length: usize, path: &Path) -> Result<&'a [u8], FormatError> {
        let data = self.0.get(1..).unwrap_or_default();
        data.get(..length).ok_or_else(|| {
            let expected = format!("{length} bytes");
            FormatError::field(path.display(), "pixels", format!("{} bytes", data.len()), expected)
        })
    }
}

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        loop {
            self.0 = self.0.trim_ascii_start();
            if self.0.first()? != &b'#' {
                break;
            }
            let line = self.0.iter().position(|&b| b == b'\n').unwrap_or(self.0.len());
            self.0 = &self.0[line..];
        }
        let end = self.0.iter().position(u8::is_ascii_whitespace).unwrap_or(self.0.len());
        let (word, rest) = self.0.split_at(end);
        self.0 = rest;
        Some(word)
    }
}
