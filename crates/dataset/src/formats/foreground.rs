//! Foreground of run-length encoded masks without decoding them to pixels: areas and overlaps.

use unopose_core::frame::Mask;

use super::{FormatError, rle::Rle};

/// Set pixels of a mask as disjoint, sorted ranges of column-major positions.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Foreground {
    /// `[height, width]`.
    size: [u32; 2],
    ranges: Vec<[u64; 2]>,
}

impl Foreground {
    /// An error when the runs do not add up to `height * width`.
    pub fn new(rle: &Rle) -> Result<Self, FormatError> {
        let (mut ranges, mut position): (Vec<[u64; 2]>, u64) = (Vec::new(), 0);
        for (run, length) in rle.runs()?.iter().enumerate() {
            let end = position + u64::from(*length);
            if run % 2 == 1 && end > position {
                ranges.push([position, end]);
            }
            position = end;
        }
        Ok(Self { size: rle.size, ranges })
    }

    /// Of a decoded mask.
    pub fn of_mask(mask: &Mask) -> Self {
        let (height, mut ranges) = (u64::from(mask.height), Vec::<[u64; 2]>::new());
        for col in 0..mask.width {
            for row in (0..mask.height).filter(|&row| mask.get(col, row)) {
                let at = u64::from(col) * height + u64::from(row);
                match ranges.last_mut() {
                    Some(last) if last[1] == at => last[1] = at + 1,
                    _ => ranges.push([at, at + 1]),
                }
            }
        }
        Self { size: [mask.height, mask.width], ranges }
    }

    /// Of the image, `[height, width]`.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Number of set pixels.
    pub fn area(&self) -> u64 {
        self.ranges.iter().map(|[start, end]| end - start).sum()
    }

    /// Intersection over union; 0 for empty masks and for masks of images of different sizes.
    pub fn iou(&self, other: &Self) -> f64 {
        if self.size != other.size {
            return 0.0;
        }
        let both = self.common(other);
        let either = self.area() + other.area() - both;
        if either == 0 { 0.0 } else { both as f64 / either as f64 }
    }

    fn common(&self, other: &Self) -> u64 {
        let (mut sum, mut a, mut b) = (0, self.ranges.iter().peekable(), other.ranges.iter().peekable());
        while let (Some(x), Some(y)) = (a.peek(), b.peek()) {
            sum += x[1].min(y[1]).saturating_sub(x[0].max(y[0]));
            let next = if x[1] <= y[1] { &mut a } else { &mut b };
            next.next();
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::rle::Counts;

    fn noise(seed: u32) -> Mask {
        let mut state = seed;
        let mut mask = Mask::empty(31, 23);
        for value in &mut mask.data {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            *value = state >> 30 > 1;
        }
        mask
    }

    #[test]
    fn overlaps_agree_with_those_of_pixels() {
        let (a, b) = (noise(1), noise(2));
        let [x, y] = [&a, &b].map(|m| Foreground::new(&Rle::encode_compressed(m)).unwrap());
        assert_eq!(x, Foreground::of_mask(&a));
        assert_eq!(x.area() as usize, a.count());
        assert!((x.iou(&y) - a.iou(&b)).abs() < 1e-12 && x.iou(&y) > 0.2);
        assert_eq!(x.iou(&x), 1.0);
        let empty = Foreground::of_mask(&Mask::empty(31, 23));
        assert_eq!((empty.iou(&empty), empty.iou(&x)), (0.0, 0.0));
        assert_eq!(Foreground::of_mask(&Mask::empty(23, 31)).iou(&x), 0.0);
    }

    #[test]
    fn wrong_runs_are_refused() {
        let rle = Rle { size: [2, 3], counts: Counts::Runs(vec![4, 1]) };
        let message = Foreground::new(&rle).unwrap_err().to_string();
        assert!(message.contains("sum of counts is 5"), "{message}");
    }
}
