//! Changes that look at one pixel at a time.

use image::RgbImage;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// PIL's contrast: away from the mean grey value by a factor in 0.2..50.
pub fn contrast(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let pixels = image.pixels().len().max(1) as f32;
    let mean = (image.pixels().map(|p| luma(&p.0)).sum::<f32>() / pixels).round();
    let factor = rng.random_range(0.2..50.0f32);
    map_channels(image, [factor; 3], |v, f| mean + f * (v - mean));
}

/// PIL's brightness: a factor in 0.1..6.
pub fn brightness(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    map_channels(image, [rng.random_range(0.1..6.0); 3], |v, f| v * f);
}

/// PIL's colour: away from the pixel's grey value by a factor in 0..20.
pub fn color(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    blend_with_grey(image, rng.random_range(0.0..20.0));
}

/// Adds up to 25, with probability 0.3 a value per channel.
pub fn add(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let values = per_channel(rng, 0.3, |rng| rng.random_range(-25.0..=25.0));
    map_channels(image, values, |v, a| v + a);
}

/// Inverts each channel with probability 0.2.
pub fn invert(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let flags = per_channel(rng, 1.0, |rng| f32::from(rng.random_bool(0.2)));
    map_channels(image, flags, |v, flag| if flag > 0.0 { 255.0 - v } else { v });
}

/// A factor in 0.6..1.4, with probability 0.5 per channel.
pub fn multiply_channels(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let factors = per_channel(rng, 0.5, |rng| rng.random_range(0.6..1.4));
    map_channels(image, factors, |v, f| v * f);
}

/// A factor in 0.6..1.4.
pub fn multiply(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    map_channels(image, [rng.random_range(0.6..1.4); 3], |v, f| v * f);
}

/// Gaussian noise of deviation 10 per value.
pub fn gaussian_noise(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    if let Ok(noise) = Normal::new(0.0f32, 10.0) {
        image.iter_mut().for_each(|v| *v = to_u8(*v as f32 + noise.sample(rng)));
    }
}

/// Away from 127 by a factor in 0.5..2.2, with probability 0.3 per channel.
pub fn linear_contrast(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let factors = per_channel(rng, 0.3, |rng| rng.random_range(0.5..2.2));
    map_channels(image, factors, |v, f| 127.0 + f * (v - 127.0));
}

/// Towards the pixel's grey value by a share in 0..1.
pub fn greyscale(image: &mut RgbImage, rng: &mut ChaCha8Rng) {
    let share: f32 = rng.random_range(0.0..1.0);
    blend_with_grey(image, 1.0 - share);
}

/// `grey + factor (v - grey)` with each pixel's grey value.
fn blend_with_grey(image: &mut RgbImage, factor: f32) {
    for pixel in image.pixels_mut() {
        let grey = luma(&pixel.0);
        pixel.0 = pixel.0.map(|v| to_u8(grey + factor * (v as f32 - grey)));
    }
}

fn luma(p: &[u8; 3]) -> f32 {
    0.299 * p[0] as f32 + 0.587 * p[1] as f32 + 0.114 * p[2] as f32
}

/// One value for all channels or, with the given probability, one each.
fn per_channel(rng: &mut ChaCha8Rng, probability: f64, draw: impl Fn(&mut ChaCha8Rng) -> f32) -> [f32; 3] {
    if rng.random_bool(probability) { std::array::from_fn(|_| draw(rng)) } else { [draw(rng); 3] }
}

/// Maps every value of channel c by `map(value, parameters[c])`, by way of a table.
fn map_channels(image: &mut RgbImage, parameters: [f32; 3], map: impl Fn(f32, f32) -> f32) {
    let tables: [[u8; 256]; 3] =
        parameters.map(|parameter| std::array::from_fn(|v| to_u8(map(v as f32, parameter))));
    for pixel in image.pixels_mut() {
        pixel.0 = std::array::from_fn(|c| tables[c][pixel.0[c] as usize]);
    }
}

/// Rounds and clips to 0..255.
pub(super) fn to_u8(value: f32) -> u8 {
    value.round() as u8
}
