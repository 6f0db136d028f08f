//! From the decoder's small masks to masks of the image: bilinear to the network's input, the padding cut off, bilinear to
//! the image. The two steps are one here: each is linear, and along rows and columns alone.

use rayon::prelude::*;
use unopose_core::{frame::Mask, simd::vectorised};

use super::resize::ResizeLongestSide;

/// Old positions that make up each new one, with their weights.
#[derive(Clone, Debug, PartialEq)]
struct Resampling(Vec<Vec<(usize, f32)>>);

impl Resampling {
    /// Bilinear between half-pixel centres, clamped at the ends.
    fn bilinear(old: usize, new: usize) -> Self {
        let scale = old as f64 / new.max(1) as f64;
        let taps = |position: usize| {
            let x = ((position as f64 + 0.5) * scale - 0.5).max(0.0);
            let low = (x as usize).min(old - 1);
            let share = (x - low as f64) as f32;
            vec![(low, 1.0 - share), ((low + 1).min(old - 1), share)]
        };
        Self((0..new).map(taps).collect())
    }

    /// The first `count` positions.
    fn cut(mut self, count: usize) -> Self {
        self.0.truncate(count);
        self
    }

    /// `self`, then `next` of its result.
    fn then(&self, next: &Self) -> Self {
        let taps = |taps: &Vec<(usize, f32)>| {
            let mut merged: Vec<(usize, f32)> = Vec::with_capacity(4);
            let parts = taps.iter().flat_map(|&(i, weight)| {
                self.0[i].iter().map(move |&(source, share)| (source, weight * share))
            });
            for (source, weight) in parts.filter(|&(_, weight)| weight != 0.0) {
                match merged.iter_mut().find(|(known, _)| *known == source) {
                    Some((_, sum)) => *sum += weight,
                    None => merged.push((source, weight)),
                }
            }
            merged
        };
        Self(next.0.iter().map(taps).collect())
    }
}

/// Resampling of images along both axes.
#[derive(Clone, Debug)]
pub struct Upscaling {
    columns: Resampling,
    rows: Resampling,
    /// Columns of the small image.
    width: usize,
}

impl Upscaling {
    /// From masks of `low x low` values to the image that `resize` describes.
    pub fn new(low: usize, resize: &ResizeLongestSide) -> Self {
        let input = Resampling::bilinear(low, resize.side as usize);
        let axis = |axis: usize| {
            let kept = resize.resized[axis] as usize;
            let rest = Resampling::bilinear(kept, resize.image[axis] as usize);
            input.clone().cut(kept).then(&rest)
        };
        Self { columns: axis(0), rows: axis(1), width: low }
    }

    /// From images of one size (width, height) to another.
    pub fn between(old: [u32; 2], new: [u32; 2]) -> Self {
        let [columns, rows] = [0, 1].map(|axis| Resampling::bilinear(old[axis] as usize, new[axis] as usize));
        Self { columns, rows, width: old[0] as usize }
    }

    /// Row-major values of the small image to those of the large one.
    pub fn apply(&self, values: &[f32]) -> Vec<f32> {
        let (width, height) = (self.columns.0.len(), self.rows.0.len());
        let used = self.rows.0.iter().flatten().map(|&(row, _)| row + 1).max().unwrap_or(0);
        let mut wide = vec![0.0f32; used * width];
        for (out, row) in wide.chunks_exact_mut(width).zip(values.chunks_exact(self.width)) {
            for (value, taps) in out.iter_mut().zip(&self.columns.0) {
                *value = taps.iter().map(|&(column, weight)| row[column] * weight).sum();
            }
        }
        let mut out = vec![0.0f32; width * height];
        vectorised!({
            for (out, taps) in out.chunks_exact_mut(width).zip(&self.rows.0) {
                for &(row, weight) in taps {
                    let row = &wide[row * width..][..width];
                    out.iter_mut().zip(row).for_each(|(o, v)| *o += weight * v);
                }
            }
        });
        out
    }
}

/// Logits above this are inside.
pub const THRESHOLD: f32 = 0.0;
/// How far the threshold is moved for the stability score.
const OFFSET: f32 = 1.0;

/// Share of the pixels above the lowered threshold that are above the raised one, too; `None` without any.
pub fn stability(logits: &[f32]) -> Option<f64> {
    let above = |threshold: f32| logits.iter().filter(|&&logit| logit > threshold).count();
    let wide = above(THRESHOLD - OFFSET);
    (wide > 0).then(|| above(THRESHOLD + OFFSET) as f64 / wide as f64)
}

/// The mask of logits.
pub fn thresholded(logits: &[f32], [width, height]: [u32; 2]) -> Mask {
    Mask { width, height, data: logits.iter().map(|&logit| logit > THRESHOLD).collect() }
}

/// A mask at another size: more than half of what is interpolated.
pub fn resized_mask(mask: &Mask, size: [u32; 2]) -> Mask {
    let values: Vec<f32> = mask.data.par_iter().map(|&inside| f32::from(u8::from(inside))).collect();
    let shares = Upscaling::between([mask.width, mask.height], size).apply(&values);
    Mask { width: size[0], height: size[1], data: shares.into_iter().map(|share| share > 0.5).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_steps_in_one_are_the_two_steps() {
        // 3 values to 6, the first 5 of them, to 2: by hand.
        let first = Resampling::bilinear(3, 6).cut(5);
        // 0, 0.25 between 0 and 1, 0.75, 1.25, 1.75.
        let middle: Vec<f32> =
            first.0.iter().map(|taps| taps.iter().map(|&(i, w)| i as f32 * w).sum()).collect();
        assert_eq!(middle, [0.0, 0.25, 0.75, 1.25, 1.75]);
        // 5 to 2: positions 0.75 and 3.25.
        let both = first.then(&Resampling::bilinear(5, 2));
        let got: Vec<f32> = both.0.iter().map(|taps| taps.iter().map(|&(i, w)| i as f32 * w).sum()).collect();
        assert_eq!(got, [0.1875, 1.375]);
        let resize = ResizeLongestSide { image: [2, 2], resized: [5, 5], side: 6 };
        let values: Vec<f32> = (0..9).map(|i| (i % 3) as f32 + 10.0 * (i / 3) as f32).collect();
        let out = Upscaling::new(3, &resize).apply(&values);
        let expected = [0.1875 + 1.875, 1.375 + 1.875, 0.1875 + 13.75, 1.375 + 13.75];
        assert!(out.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{out:?}");
    }

    #[test]
    fn stability_compares_two_thresholds() {
        // Above -1: 6 of 8; above 1: 3.
        let logits = [3.0, 2.0, 1.5, 1.0, 0.0, -0.5, -1.0, -7.0];
        assert_eq!(stability(&logits), Some(0.5));
        assert_eq!(stability(&[-1.0, -2.0]), None);
        assert_eq!(thresholded(&logits, [4, 2]).count(), 4);
    }

    #[test]
    fn a_mask_shrinks_and_grows_by_its_halves() {
        let mask = Mask { width: 4, height: 1, data: vec![true, true, true, false] };
        assert_eq!(resized_mask(&mask, [2, 1]).data, [true, false]);
        // Positions 0, 0.25, 0.75, ..., of which 2.25 is the last with more than a half.
        let grown = resized_mask(&mask, [8, 1]).data;
        assert_eq!(grown, [true, true, true, true, true, true, false, false]);
    }
}
