//! Colour camera model: exposure, white balance, vignetting, blur, shift against the depth image, tone curve, noise,
//! contrast, sharpening.

use image::RgbImage;
use rand_chacha::ChaCha8Rng;
use unopose_core::config::SensorConfig;
use unopose_dataset::render::{Rendering, linear_to_srgb};

use super::random::Draw;

/// Weights of the luminance of coded values (Rec. 601).
const LUMINANCE: [f32; 3] = [0.299, 0.587, 0.114];

/// An 8-bit picture of the rendering and the luminance (sRGB-coded, 0..1) that the depth sensor reacts to.
pub(super) fn capture(view: &Rendering, config: &SensorConfig, rng: &mut ChaCha8Rng) -> (RgbImage, Vec<f32>) {
    let (w, h) = (view.depth.width as usize, view.depth.height as usize);
    let enabled = if config.enabled { 1.0 } else { 0.0 };
    let scale = w as f32 / 640.0;
    let target = rng.between(config.brightness[0], config.brightness[1]);
    let exposure = exposure_for(&view.radiance, target);
    let balance = enabled * config.white_balance;
    let gains = [1.0 + rng.between(-balance, balance), 1.0, 1.0 + rng.between(-balance, balance)];
    let vignette = enabled * rng.between(0.0, 0.25);
    let blur = enabled * scale * rng.between(0.0, config.blur);
    let limit = enabled * scale * config.misalignment;
    let shift = [rng.between(-limit, limit), rng.between(-limit, limit)];
    let processing = ColorProcessing::draw(config, enabled, rng);
    let mut linear: Vec<[f32; 3]> = view.radiance.clone();
    for (i, pixel) in linear.iter_mut().enumerate() {
        let (x, y) = ((i % w) as f32 / w as f32 - 0.5, (i / w) as f32 / h as f32 - 0.5);
        let fall = exposure * (1.0 - vignette * 2.0 * (x * x + y * y));
        *pixel = std::array::from_fn(|k| (pixel[k] * fall * gains[k]).min(1.0));
    }
    if enabled > 0.0 {
        linear = resample(&linear, w, h, blur, shift);
    }
    let mut luminance = Vec::with_capacity(w * h);
    for pixel in &mut linear {
        let toned = pixel.map(|c| processing.tone.at(c));
        let grey = luma(&toned);
        let coded = toned.map(|c| {
            let value = (grey + (c - grey) * processing.saturation).max(0.0);
            // Shot noise in the lights, read noise in the shadows.
            value + processing.noise * (0.5 + value.sqrt()) * rng.normal()
        });
        luminance.push(luma(&coded));
        *pixel = coded.map(|c| processing.pivot + (c - processing.pivot) * processing.contrast);
    }
    if processing.sharpening > 0.0 {
        sharpen(&mut linear, w, processing.sharpening);
    }
    let bytes = linear.iter().flat_map(|p| p.map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)).collect();
    let picture = RgbImage::from_raw(w as u32, h as u32, bytes);
    (picture.unwrap_or_else(|| RgbImage::new(w as u32, h as u32)), luminance)
}

/// What the camera's electronics make of the light.
struct ColorProcessing {
    /// sRGB coding and gamma.
    tone: ToneCurve,
    saturation: f32,
    /// Standard deviation at mid grey.
    noise: f32,
    /// Gain around `pivot`; a good part of cheap cameras clips shadows and lights.
    contrast: f32,
    pivot: f32,
    /// Share of the difference from the neighbourhood that is added.
    sharpening: f32,
}

impl ColorProcessing {
    fn draw(config: &SensorConfig, enabled: f32, rng: &mut ChaCha8Rng) -> Self {
        let mut around_one = || 1.0 + enabled * rng.between(-config.tone, config.tone);
        let (gamma, saturation) = (around_one(), around_one());
        let harsh = rng.chance(0.3);
        let strength = if harsh { rng.between(1.0, 6.0) } else { rng.between(-0.5, 1.0) };
        let vivid = if harsh { 1.0 + 2.0 * enabled * config.tone * rng.between(0.0, 1.0) } else { 1.0 };
        let noise = enabled * config.color_noise * rng.log_between(0.3, 3.0) / 255.0;
        let sharpening = if rng.chance(0.4) { enabled * rng.between(0.0, 1.2) } else { 0.0 };
        Self {
            tone: ToneCurve::new(|c| linear_to_srgb(c).powf(gamma)),
            saturation: saturation * vivid,
            noise,
            contrast: 1.0 + enabled * config.tone * strength,
            pivot: rng.between(0.35, 0.6),
            sharpening,
        }
    }
}

/// A function of 0..1 from a table that is fine near 0.
struct ToneCurve(Vec<f32>);

impl ToneCurve {
    const STEPS: usize = 1024;

    fn new(of: impl Fn(f32) -> f32) -> Self {
        let root = |i: usize| i as f32 / Self::STEPS as f32;
        Self((0..=Self::STEPS + 1).map(|i| of(root(i) * root(i))).collect())
    }

    fn at(&self, c: f32) -> f32 {
        let place = c.clamp(0.0, 1.0).sqrt() * Self::STEPS as f32;
        let i = place as usize;
        let t = place - i as f32;
        self.0[i] + (self.0[i + 1] - self.0[i]) * t
    }
}

fn luma(c: &[f32; 3]) -> f32 {
    (0..3).map(|k| LUMINANCE[k] * c[k]).sum()
}

/// Gain that brings the mean of the sRGB-coded luminance to `target`.
fn exposure_for(radiance: &[[f32; 3]], target: f32) -> f32 {
    let coding = ToneCurve::new(linear_to_srgb);
    let sample: Vec<f32> = radiance.iter().step_by(7).map(|c| 0.3 * c[0] + 0.6 * c[1] + 0.1 * c[2]).collect();
    let mean =
        |gain: f32| sample.iter().map(|y| coding.at(gain * y)).sum::<f32>() / sample.len().max(1) as f32;
    let (mut low, mut high) = (1e-3f32, 1e3f32);
    for _ in 0..14 {
        let middle = (low * high).sqrt();
        if mean(middle) < target { low = middle } else { high = middle }
    }
    (low * high).sqrt()
}

/// Gaussian blur and sub-pixel shift in one separable filter.
fn resample(pixels: &[[f32; 3]], w: usize, h: usize, sigma: f32, shift: [f32; 2]) -> Vec<[f32; 3]> {
    let kernel = |offset: f32| -> Vec<(i64, f32)> {
        // Linear interpolation has a width of its own; the Gaussian adds to it.
        let spread = sigma.max(0.3);
        let taps: Vec<(i64, f32)> = (-3i64..=3)
            .map(|k| (k, (-0.5 * ((k as f32 - offset) / spread).powi(2)).exp()))
            .filter(|(_, weight)| *weight > 1e-3)
            .collect();
        let total: f32 = taps.iter().map(|t| t.1).sum();
        taps.into_iter().map(|(k, weight)| (k, weight / total)).collect()
    };
    let (across, down) = (kernel(shift[0]), kernel(shift[1]));
    let clamp = |i: i64, n: usize| i.clamp(0, n as i64 - 1) as usize;
    let mut rows = vec![[0f32; 3]; w * h];
    for (source, line) in pixels.chunks_exact(w).zip(rows.chunks_exact_mut(w)) {
        for &(k, weight) in &across {
            for (col, sum) in line.iter_mut().enumerate() {
                let p = &source[clamp(col as i64 + k, w)];
                (0..3).for_each(|c| sum[c] += weight * p[c]);
            }
        }
    }
    let mut out = vec![[0f32; 3]; w * h];
    for (row, line) in out.chunks_exact_mut(w).enumerate() {
        for &(k, weight) in &down {
            let source = &rows[clamp(row as i64 + k, h) * w..][..w];
            for (sum, p) in line.iter_mut().zip(source) {
                (0..3).for_each(|c| sum[c] += weight * p[c]);
            }
        }
    }
    out
}

/// Adds `amount` times the difference between each pixel's luminance and the mean of its eight neighbours, noise
/// included, as cameras do.
fn sharpen(pixels: &mut [[f32; 3]], w: usize, amount: f32) {
    let bright: Vec<f32> = pixels.iter().map(luma).collect();
    let h = bright.len() / w.max(1);
    for row in 1..h.saturating_sub(1) {
        for col in 1..w.saturating_sub(1) {
            let i = row * w + col;
            let line = |at: usize| bright[at - 1] + bright[at] + bright[at + 1];
            let around = (line(i - w) + line(i) + line(i + w) - bright[i]) / 8.0;
            let change = amount * (bright[i] - around);
            pixels[i].iter_mut().for_each(|c| *c += change);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_follows_the_curve() {
        let curve = ToneCurve::new(|c| linear_to_srgb(c).powf(1.15));
        for i in 0..=10_000 {
            let c = i as f32 / 10_000.0;
            assert!((curve.at(c) - linear_to_srgb(c).powf(1.15)).abs() < 1e-3, "at {c}");
        }
    }

    #[test]
    fn exposure_brings_the_mean_to_the_target_and_sharpening_keeps_flat_pictures() {
        let radiance: Vec<[f32; 3]> = (0..7000).map(|i| [0.02 + 1e-4 * i as f32; 3]).collect();
        let gain = exposure_for(&radiance, 0.4);
        let mean = radiance.iter().map(|c| linear_to_srgb(gain * c[0])).sum::<f32>() / 7000.0;
        assert!((mean - 0.4).abs() < 0.005, "{mean}");
        let mut flat = vec![[0.3, 0.5, 0.7]; 48];
        sharpen(&mut flat, 8, 1.0);
        assert!(flat.iter().all(|p| (p[1] - 0.5).abs() < 1e-6));
    }
}
