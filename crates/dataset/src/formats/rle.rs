//! COCO run-length encoding of masks: column-major runs that start with background.
//!
//! Both written forms are read: the integer list and the compressed string (five bits per character from
//! `'0'` on, runs after the third stored as the difference to the run two before).

use std::{borrow::Cow, fmt};

use serde::{
    Deserialize, Deserializer, Serialize,
    de::{SeqAccess, Visitor},
};
use unopose_core::frame::Mask;

use super::FormatError;

/// Larger masks are refused instead of allocated.
const MAX_PIXELS: u64 = 1 << 28;
/// Most columns or rows of a mask.
const MAX_SIDE: u32 = 1 << 16;

/// A run-length encoded mask as COCO JSON writes it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rle {
    /// `[height, width]`.
    pub size: [u32; 2],
    /// Run lengths, which add up to `height * width`.
    pub counts: Counts,
}

/// The two forms of run lengths.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Counts {
    /// Alternating lengths of background and foreground runs.
    Runs(Vec<u32>),
    /// The same, compressed.
    Compressed(String),
}

impl<'de> Deserialize<'de> for Counts {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Forms;
        impl<'de> Visitor<'de> for Forms {
            type Value = Counts;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("counts as a list of run lengths or as a compressed string")
            }

            fn visit_str<E>(self, text: &str) -> Result<Counts, E> {
                Ok(Counts::Compressed(text.to_owned()))
            }

            fn visit_string<E>(self, text: String) -> Result<Counts, E> {
                Ok(Counts::Compressed(text))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Counts, A::Error> {
                let mut runs = Vec::new();
                while let Some(run) = list.next_element()? {
                    runs.push(run);
                }
                Ok(Counts::Runs(runs))
            }
        }
        deserializer.deserialize_any(Forms)
    }
}

impl Rle {
    /// Uncompressed encoding.
    pub fn encode(mask: &Mask) -> Self {
        Self { size: [mask.height, mask.width], counts: Counts::Runs(runs_of(mask)) }
    }

    /// Compressed encoding.
    pub fn encode_compressed(mask: &Mask) -> Self {
        Self { size: [mask.height, mask.width], counts: Counts::Compressed(compress(&runs_of(mask))) }
    }

    /// Compressed encoding of the union of ranges of column-major positions, which lie inside the mask.
    pub(crate) fn of_ranges(size: [u32; 2], mut ranges: Vec<[u64; 2]>) -> Self {
        ranges.sort_unstable();
        let (mut runs, mut position) = (Vec::new(), 0);
        let mut current: Option<[u64; 2]> = None;
        let mut push = |[start, end]: [u64; 2]| {
            runs.extend([start - position, end - start].map(|length| length as u32));
            position = end;
        };
        for [start, end] in ranges.into_iter().filter(|[start, end]| start < end) {
            match &mut current {
                Some(last) if start <= last[1] => last[1] = last[1].max(end),
                _ => {
                    current.replace([start, end]).into_iter().for_each(&mut push);
                }
            }
        }
        current.into_iter().for_each(&mut push);
        let rest = u64::from(size[0]) * u64::from(size[1]) - position;
        if rest > 0 || runs.is_empty() {
            runs.push(rest as u32);
        }
        Self { size, counts: Counts::Compressed(compress(&runs)) }
    }

    /// An error where a mask of this size (height, width) is too large.
    pub(crate) fn check_size([height, width]: [u32; 2]) -> Result<(), FormatError> {
        let pixels = u64::from(height) * u64::from(width);
        if pixels > MAX_PIXELS || height.max(width) > MAX_SIDE {
            let expected = format!("at most {MAX_PIXELS} pixels, {MAX_SIDE} a side");
            return Err(FormatError::field("RLE mask", "size", format!("[{height}, {width}]"), expected));
        }
        Ok(())
    }

    /// Run lengths, background first; an error when they do not add up to `height * width`.
    pub fn runs(&self) -> Result<Cow<'_, [u32]>, FormatError> {
        let [height, width] = self.size;
        Self::check_size(self.size)?;
        let pixels = u64::from(height) * u64::from(width);
        let runs = match &self.counts {
            Counts::Runs(runs) => Cow::Borrowed(runs.as_slice()),
            Counts::Compressed(text) => Cow::Owned(decompress(text)?),
        };
        let total: u64 = runs.iter().map(|&n| u64::from(n)).sum();
        if total != pixels {
            return Err(FormatError::field(
                "RLE mask",
                "sum of counts",
                total,
                format!("height x width = {height} x {width} = {pixels}"),
            ));
        }
        Ok(runs)
    }

    /// The mask; errors are those of [`Self::runs`].
    pub fn decode(&self) -> Result<Mask, FormatError> {
        let ([height, width], runs) = (self.size, self.runs()?);
        let mut mask = Mask::empty(width, height);
        let mut position = 0usize;
        for (run, &length) in runs.iter().enumerate() {
            let end = position + length as usize;
            if run % 2 == 1 {
                for p in position..end {
                    let (col, row) = (p / height as usize, p % height as usize);
                    mask.data[row * width as usize + col] = true;
                }
            }
            position = end;
        }
        Ok(mask)
    }
}

/// Column-major run lengths, first background (may be 0), at least one run.
fn runs_of(mask: &Mask) -> Vec<u32> {
    let (mut runs, mut current, mut length) = (Vec::new(), false, 0u32);
    for col in 0..mask.width {
        for row in 0..mask.height {
            let value = mask.get(col, row);
            if value != current {
                runs.push(length);
                (current, length) = (value, 0);
            }
            length += 1;
        }
    }
    runs.push(length);
    runs
}

fn compress(runs: &[u32]) -> String {
    let mut text = String::new();
    for (i, &run) in runs.iter().enumerate() {
        let mut x = i64::from(run) - if i > 2 { i64::from(runs[i - 2]) } else { 0 };
        loop {
            let bits = (x & 0x1f) as u8;
            x >>= 5;
            let more = if bits & 0x10 != 0 { x != -1 } else { x != 0 };
            text.push(char::from(48 + bits + if more { 0x20 } else { 0 }));
            if !more {
                break;
            }
        }
    }
    text
}

fn decompress(text: &str) -> Result<Vec<u32>, FormatError> {
    let wrong = |value: String, expected: &str| FormatError::field("RLE mask", "counts", value, expected);
    let mut runs: Vec<u32> = Vec::new();
    let (mut x, mut shift) = (0i64, 0u32);
    for (at, byte) in text.bytes().enumerate() {
        let bits = match byte {
            48..112 => i64::from(byte - 48),
            _ => return Err(wrong(format!("byte {byte} at {at}"), "characters '0' to 'o'")),
        };
        if shift > 35 {
            return Err(wrong(
                format!("a run of more than 40 bits at character {at}"),
                "run lengths below 2^32",
            ));
        }
        x |= (bits & 0x1f) << shift;
        shift += 5;
        if bits & 0x20 != 0 {
            continue;
        }
        if bits & 0x10 != 0 {
            x |= -1 << shift;
        }
        if runs.len() > 2 {
            x += i64::from(runs[runs.len() - 2]);
        }
        runs.push(
            u32::try_from(x).map_err(|_| wrong(format!("run {x} at character {at}"), "a run length >= 0"))?,
        );
        (x, shift) = (0, 0);
    }
    if shift != 0 {
        return Err(wrong("a string that ends inside a run".into(), "a complete string"));
    }
    Ok(runs)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(width: u32, height: u32, set: &[(u32, u32)]) -> Mask {
        let mut mask = Mask::empty(width, height);
        for &(col, row) in set {
            mask.data[(row * width + col) as usize] = true;
        }
        mask
    }

    #[test]
    fn runs_are_column_major_and_start_with_background() {
        let m = mask(3, 2, &[(0, 0), (0, 1), (1, 0), (2, 1)]);
        // Columns: 11 | 10 | 01.
        assert_eq!(Rle::encode(&m).counts, Counts::Runs(vec![0, 3, 2, 1]));
        assert_eq!(Rle::encode(&m).decode().unwrap(), m);
        assert_eq!(Rle::encode(&Mask::empty(3, 2)).counts, Counts::Runs(vec![6]));
    }

    #[test]
    fn compressed_form_is_the_one_of_pycocotools() {
        // pycocotools on a 480 x 640 mask with one 5 x 5 square at row 10, column 20:
        // runs 9610, 5, 475, 5, 475, ... ; the differences after the third run are 0.
        let square: Vec<_> = (0..25).map(|i| (20 + i % 5, 10 + i / 5)).collect();
        let rle = Rle::encode_compressed(&mask(640, 480, &square));
        let Counts::Compressed(text) = &rle.counts else { panic!("compressed form expected") };
        assert!(text.starts_with("Z\\95k>0"), "{text}");
        assert_eq!(rle.decode().unwrap(), mask(640, 480, &square));
    }

    #[test]
    fn both_forms_agree_on_random_masks() {
        let mut state = 7u32;
        let mut m = Mask::empty(37, 53);
        for value in &mut m.data {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            *value = state >> 29 > 4;
        }
        assert_eq!(Rle::encode(&m).decode().unwrap(), m);
        assert_eq!(Rle::encode_compressed(&m).decode().unwrap(), m);
    }

    #[test]
    fn wrong_runs_are_refused_with_the_numbers() {
        let rle = Rle { size: [2, 3], counts: Counts::Runs(vec![4, 1]) };
        let message = rle.decode().unwrap_err().to_string();
        assert!(message.contains("sum of counts is 5") && message.contains("2 x 3 = 6"), "{message}");
        for text in ["\u{7f}", "Z", "ooooooooooooooo"] {
            assert!(
                Rle { size: [2, 3], counts: Counts::Compressed(text.into()) }.decode().is_err(),
                "{text}"
            );
        }
        for size in [[u32::MAX, u32::MAX], [1_000_000_000, 1_000_000_000], [1, 1 << 17], [20_000, 20_000]] {
            let huge = Rle { size, counts: Counts::Runs(vec![]) };
            assert!(huge.decode().unwrap_err().to_string().contains("at most 268435456 pixels"));
        }
        for (counts, part) in [
            ("[3, -1]", "invalid value: integer `-1`, expected u32"),
            ("[3.5]", "floating point `3.5`, expected u32"),
            ("{}", "expected counts as a list of run lengths or as a compressed string"),
        ] {
            let text = format!(r#"{{"size": [2, 3], "counts": {counts}}}"#);
            let message = serde_json::from_str::<Rle>(&text).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn ranges_are_united() {
        let rle = Rle::of_ranges([3, 4], vec![[7, 9], [1, 3], [2, 5], [5, 6], [7, 7]]);
        assert_eq!(rle.runs().unwrap().as_ref(), [1, 5, 1, 2, 3]);
        assert_eq!(Rle::of_ranges([3, 4], vec![]).runs().unwrap().as_ref(), [12]);
        assert_eq!(Rle::of_ranges([3, 4], vec![[0, 12]]).runs().unwrap().as_ref(), [0, 12]);
    }

    #[test]
    fn damaged_strings_are_masks_or_errors() {
        let Counts::Compressed(text) =
            Rle::encode_compressed(&mask(40, 30, &[(3, 4), (3, 5), (9, 9)])).counts
        else {
            panic!("compressed form expected")
        };
        let mut state = 5u32;
        let mut random = |below: usize| {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            (state >> 8) as usize % below
        };
        for _ in 0..5000 {
            let mut bytes = text.clone().into_bytes();
            for _ in 0..1 + random(3) {
                let at = random(bytes.len());
                bytes[at] = random(128) as u8;
            }
            bytes.truncate(1 + random(bytes.len() + 3));
            let counts = Counts::Compressed(String::from_utf8(bytes).unwrap());
            if let Ok(mask) = (Rle { size: [30, 40], counts }).decode() {
                assert_eq!(mask.data.len(), 1200);
            }
        }
    }
}
