//! Changes that look at a pixel's neighbourhood.

use image::RgbImage;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::values::to_u8;

/// Blackens a fifth of the cells of a coarse grid (a cell is 20 pixels wide, at least 3 x 3 cells).
pub fn coarse_dropout(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let (width, height) = image.dimensions();
    let cells = |pixels: u32| ((pixels as f64 * 0.05).round() as u32).max(3);
    let (columns, rows) = (cells(width), cells(height));
    let dropped: Vec<bool> = (0..columns * rows).map(|_| rng.random_bool(0.2)).collect();
    for (x, y, pixel) in image.enumerate_pixels_mut() {
        let (column, row) = (x * columns / width, y * rows / height);
        if dropped[(row * columns + column) as usize] {
            pixel.0 = [0; 3];
        }
    }
}

/// Gaussian blur of deviation 0..3 pixels, mirrored at the border.
pub fn gaussian_blur(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    blur(image, rng.random_range(0.0..3.0));
}

/// [`gaussian_blur`] with a given deviation.
pub(super) fn blur(image: &mut RgbImage, sigma: f32) {
    let (width, height) = (image.width() as usize, image.height() as usize);
    if sigma < 0.05 || width == 0 || height == 0 {
        return;
    }
    let radius = (3.0 * sigma).ceil() as usize;
    let mut kernel: Vec<f32> =
        (0..=2 * radius).map(|i| (-0.5 * ((i as f32 - radius as f32) / sigma).powi(2)).exp()).collect();
    let total: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= total);

    let stride = 3 * width;
    let source: Vec<f32> = image.iter().map(|&v| v as f32).collect();
    let mut vertical = vec![0.0f32; source.len()];
    for (y, row) in vertical.chunks_exact_mut(stride).enumerate() {
        for (i, &k) in kernel.iter().enumerate() {
            let from = mirrored(y + i, radius, height) * stride;
            row.iter_mut().zip(&source[from..from + stride]).for_each(|(v, &s)| *v += k * s);
        }
    }
    let mut padded = vec![0.0f32; 3 * (width + 2 * radius)];
    let mut out = vec![0.0f32; stride];
    for (row, target) in vertical.chunks_exact(stride).zip(image.chunks_exact_mut(stride)) {
        for (x, pixel) in padded.chunks_exact_mut(3).enumerate() {
            let from = 3 * mirrored(x, radius, width);
            pixel.copy_from_slice(&row[from..from + 3]);
        }
        out.fill(0.0);
        for (i, &k) in kernel.iter().enumerate() {
            out.iter_mut().zip(&padded[3 * i..]).for_each(|(o, &p)| *o += k * p);
        }
        target.iter_mut().zip(&out).for_each(|(t, &o)| *t = to_u8(o));
    }
}

/// Index of a position `shifted - radius` mirrored about the first and last index.
fn mirrored(shifted: usize, radius: usize, len: usize) -> usize {
    let period = 2 * (len.max(2) - 1);
    let position = (shifted as i64 - radius as i64).rem_euclid(period as i64) as usize;
    position.min(period - position).min(len - 1)
}

/// PIL's sharpness: away from the smoothed image by a factor in 0..50. The border stays.
pub fn sharpness(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let factor: f32 = rng.random_range(0.0..50.0);
    let source = image.clone();
    let (width, height) = source.dimensions();
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            for c in 0..3 {
                let at = |dx: u32, dy: u32| source.get_pixel(x + dx - 1, y + dy - 1).0[c] as f32;
                let ring: f32 = (0..9).map(|i| at(i % 3, i / 3)).sum();
                let center = at(1, 1);
                let smooth = ((ring + 4.0 * center) / 13.0).round();
                image.get_pixel_mut(x, y).0[c] = to_u8(smooth + factor * (center - smooth));
            }
        }
    }
}
