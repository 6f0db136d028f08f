//! Colour camera model: exposure, white balance, vignetting, tone curve, blur, noise, shift against the depth image.

use image::{Rgb, RgbImage};
use rand_chacha::ChaCha8Rng;

use super::random::Draw;
use crate::{
    config::SensorConfig,
    render::{Rendering, texture::linear_to_srgb},
};

/// An 8-bit picture of the rendering and its luminance 0..1 (sRGB-coded).
pub(super) fn develop(view: &Rendering, config: &SensorConfig, rng: &mut ChaCha8Rng) -> (RgbImage, Vec<f32>) {
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
    let mut around_one = || 1.0 + enabled * rng.between(-config.tone, config.tone);
    let (gamma, saturation) = (around_one(), around_one());
    let noise = enabled * config.color_noise * rng.between(0.4, 1.6) / 255.0;
    let mut linear: Vec<[f32; 3]> = view.radiance.clone();
    for (i, pixel) in linear.iter_mut().enumerate() {
        let (x, y) = ((i % w) as f32 / w as f32 - 0.5, (i / w) as f32 / h as f32 - 0.5);
        let fall = exposure * (1.0 - vignette * 2.0 * (x * x + y * y));
        *pixel = std::array::from_fn(|k| (pixel[k] * fall * gains[k]).min(1.0));
    }
    if enabled > 0.0 {
        linear = resample(&linear, w, h, blur, shift);
    }
    let mut picture = RgbImage::new(w as u32, h as u32);
    let mut luminance = Vec::with_capacity(w * h);
    for (i, pixel) in linear.iter().enumerate() {
        let toned = pixel.map(|c| linear_to_srgb(c).powf(gamma));
        let grey = 0.299 * toned[0] + 0.587 * toned[1] + 0.114 * toned[2];
        let coded = toned.map(|c| {
            let value = (grey + (c - grey) * saturation).max(0.0);
            // Shot noise in the lights, read noise in the shadows.
            value + noise * (0.5 + value.sqrt()) * rng.normal()
        });
        luminance.push(0.299 * coded[0] + 0.587 * coded[1] + 0.114 * coded[2]);
        let bytes = coded.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8);
        picture.put_pixel((i % w) as u32, (i / w) as u32, Rgb(bytes));
    }
    (picture, luminance)
}

/// Gain that brings the mean of the sRGB-coded luminance to `target`.
fn exposure_for(radiance: &[[f32; 3]], target: f32) -> f32 {
    let mean = |gain: f32| {
        let coded =
            radiance.iter().step_by(7).map(|c| linear_to_srgb(gain * (0.3 * c[0] + 0.6 * c[1] + 0.1 * c[2])));
        coded.sum::<f32>() / radiance.len().div_ceil(7).max(1) as f32
    };
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
    for row in 0..h {
        for col in 0..w {
            for &(k, weight) in &across {
                let p = &pixels[row * w + clamp(col as i64 + k, w)];
                (0..3).for_each(|c| rows[row * w + col][c] += weight * p[c]);
            }
        }
    }
    let mut out = vec![[0f32; 3]; w * h];
    for row in 0..h {
        for &(k, weight) in &down {
            let source = clamp(row as i64 + k, h) * w;
            for col in 0..w {
                (0..3).for_each(|c| out[row * w + col][c] += weight * rows[source + col][c]);
            }
        }
    }
    out
}
