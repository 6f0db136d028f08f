//! Bilinear resize of 8-bit images bit for bit as Pillow does it, on which Segment Anything was trained: the kernel widens
//! when the image shrinks, weights are integers, columns come first and are rounded to 8 bits before the rows.

use image::RgbImage;
use rayon::prelude::*;

/// Fractional bits of a weight.
const BITS: u32 = 22;

/// Old pixels that make up a new one: the first, and their weights.
struct Taps {
    first: usize,
    weights: Vec<i32>,
}

fn taps(old: usize, new: usize) -> Vec<Taps> {
    let scale = old as f64 / new as f64;
    let support = scale.max(1.0);
    let of_pixel = |pixel: usize| {
        let center = (pixel as f64 + 0.5) * scale;
        let first = (center - support + 0.5).max(0.0) as usize;
        let end = ((center + support + 0.5) as usize).min(old);
        let weight = |k: usize| (1.0 - ((k as f64 - center + 0.5) / support).abs()).max(0.0);
        let total: f64 = (first..end).map(weight).sum();
        let weights = (first..end).map(|k| (weight(k) / total * f64::from(1 << BITS) + 0.5) as i32);
        Taps { first, weights: weights.collect() }
    };
    (0..new).map(of_pixel).collect()
}

/// Sums with half a unit added, as 8-bit values.
fn rounded(sum: i32) -> u8 {
    (sum >> BITS).clamp(0, 255) as u8
}

/// Half a unit of an 8-bit value, for rounding.
const HALF: i32 = 1 << (BITS - 1);

/// `image` with other sides, both at least 1.
pub fn resized(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    let (old_width, old_height) = (image.width() as usize, image.height() as usize);
    let row = 3 * width as usize;
    let mut narrow: Vec<u8> = image.as_raw().clone();
    if image.width() != width {
        let taps = taps(old_width, width as usize);
        narrow = vec![0; row * old_height];
        let rows = image.as_raw().par_chunks_exact(3 * old_width);
        narrow.par_chunks_exact_mut(row).zip(rows).for_each(|(out, old)| {
            for (pixel, taps) in out.as_chunks_mut::<3>().0.iter_mut().zip(&taps) {
                let mut sums = [HALF; 3];
                for (old, weight) in old.as_chunks::<3>().0[taps.first..].iter().zip(&taps.weights) {
                    sums.iter_mut().zip(old).for_each(|(sum, &value)| *sum += i32::from(value) * weight);
                }
                *pixel = sums.map(rounded);
            }
        });
    }
    if image.height() != height {
        let taps = taps(old_height, height as usize);
        let mut out = vec![0; row * height as usize];
        out.par_chunks_exact_mut(row).zip(&taps).for_each(|(out, taps)| {
            let mut sums = vec![HALF; row];
            for (old, weight) in narrow.chunks_exact(row).skip(taps.first).zip(&taps.weights) {
                sums.iter_mut().zip(old).for_each(|(sum, &value)| *sum += i32::from(value) * weight);
            }
            out.iter_mut().zip(sums).for_each(|(value, sum)| *value = rounded(sum));
        });
        narrow = out;
    }
    RgbImage::from_raw(width, height, narrow).unwrap_or_else(|| RgbImage::new(width, height))
}
