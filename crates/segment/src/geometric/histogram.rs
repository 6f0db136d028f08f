//! Colours of a masked view as a histogram over CIE L*a*b*.

use unopose_core::frame::Mask;

use crate::lab::lab;

/// Bins of lightness and of each chroma axis. Lightness is coarse: it changes most between images.
const BINS: [usize; 3] = [5, 12, 12];
/// Pixels looked at.
const SAMPLES: usize = 3000;

/// Shares of the bins, summing to 1, with linear weights between neighbouring bins.
#[derive(Clone, Debug, PartialEq)]
pub struct ColorHistogram(Vec<f32>);

impl ColorHistogram {
    /// Of at most [`SAMPLES`] pixels of the mask, evenly spread.
    pub fn new(rgb: &image::RgbImage, mask: &Mask) -> Self {
        let step = mask.count().div_ceil(SAMPLES).max(1);
        let mut bins = vec![0.0f32; BINS.iter().product()];
        let mut total = 0.0f32;
        let inside = mask.pixels().filter(|&(col, row)| col < rgb.width() && row < rgb.height());
        for (col, row) in inside.step_by(step) {
            let [l, a, b] = lab(rgb.get_pixel(col, row).0);
            let place = |value: f32, low: f32, high: f32, count: usize| {
                let x = ((value - low) / (high - low)).clamp(0.0, 1.0) * (count - 1) as f32;
                let first = (x as usize).min(count - 2);
                (first, x - first as f32)
            };
            let (l, fl) = place(l, 0.0, 100.0, BINS[0]);
            let (a, fa) = place(a, -60.0, 60.0, BINS[1]);
            let (b, fb) = place(b, -60.0, 60.0, BINS[2]);
            for (dl, wl) in [(0, 1.0 - fl), (1, fl)] {
                for (da, wa) in [(0, 1.0 - fa), (1, fa)] {
                    for (db, wb) in [(0, 1.0 - fb), (1, fb)] {
                        bins[((l + dl) * BINS[1] + a + da) * BINS[2] + b + db] += wl * wa * wb;
                    }
                }
            }
            total += 1.0;
        }
        bins.iter_mut().for_each(|bin| *bin /= total.max(1.0));
        Self(bins)
    }

    /// Bhattacharyya coefficient, 1 for equal histograms and 0 for disjoint ones.
    pub fn similarity(&self, other: &Self) -> f64 {
        self.0.iter().zip(&other.0).map(|(a, b)| f64::from((a * b).sqrt())).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    #[test]
    fn like_colours_are_like_and_others_are_not() {
        let full = Mask { width: 8, height: 8, data: vec![true; 64] };
        let of = |rgb: [u8; 3]| ColorHistogram::new(&RgbImage::from_pixel(8, 8, Rgb(rgb)), &full);
        let red = of([200, 30, 30]);
        assert!((red.similarity(&red) - 1.0).abs() < 1e-5);
        assert!(red.similarity(&of([185, 30, 32])) > 0.8);
        assert!(red.similarity(&of([30, 30, 200])) < 1e-6);
    }
}
