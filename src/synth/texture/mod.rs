//! Procedural textures: noise, solid patterns, prints, and their baking into an object's texture map.

mod bake;
mod look;
pub(super) mod noise;
pub(super) mod pattern;
mod print;
mod scenery;

pub(super) use bake::textured;
pub(super) use look::Look;
pub(super) use scenery::{plain, scenery};

use image::{Rgb, RgbImage};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::random::Draw;
use pattern::Pattern;

/// A repeating picture for tables, floors and walls: `resolution` pixels stand for `extent` metres.
pub(super) fn tile(resolution: u32, extent: f32, rng: &mut ChaCha8Rng) -> RgbImage {
    let mut pattern = Pattern::any(extent, rng);
    let mut soft = Pattern::any(extent * 0.5, rng);
    if rng.chance(0.4) {
        soft = Pattern::plain(rng);
    }
    if rng.chance(0.15) {
        pattern = Pattern::plain(rng);
    }
    let mix = if rng.chance(0.5) { 0.0 } else { rng.between(0.1, 0.5) };
    let contrast = rng.between(0.25, 1.0);
    // Most tables, floors and walls are wooden, grey, beige, black or white.
    let mute = if rng.chance(0.7) { rng.between(0.4, 0.9) } else { 0.0 };
    let mean = pattern.color(&Vector3::zeros());
    // The torus in four dimensions would tile exactly; mirrored halves are enough under objects.
    let fold = |i: u32| {
        let t = i as f32 / resolution as f32;
        (1.0 - (2.0 * t - 1.0).abs()) * extent * 0.5
    };
    RgbImage::from_fn(resolution, resolution, |x, y| {
        let p = Vector3::new(fold(x), fold(y), 0.013);
        let color = mean.lerp(&pattern.color(&p), contrast).lerp(&soft.color(&p), mix);
        let color = color.lerp(&pattern::Color::repeat(color.mean()), mute);
        Rgb(color.map(|v| (v.clamp(0.0, 1.0) * 255.0) as u8).into())
    })
}
