//! Tops of tables, floors and boards: wood, inlays, stone, carpet, and anything.

use image::{Rgb, RgbImage};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::pattern::{Color, Pattern, hsv, object_color};
use crate::{noise, random::Draw};

/// A surface material; coordinates are metres.
enum Material {
    Wood(Wood),
    /// Squares of two materials.
    Inlay(Box<[Material; 2]>, f32),
    /// Base and vein colours, strength of veins and speckles.
    Stone([Color; 2], [f32; 2], u32),
    /// Two yarns, threads per metre.
    Carpet([Color; 2], f32, u32),
    Any(Box<Mixed>),
}

/// A repeating picture: `resolution` pixels stand for `extent` metres.
pub(crate) fn tile(resolution: u32, extent: f32, rng: &mut ChaCha8Rng) -> RgbImage {
    let material = Material::draw(extent, rng);
    let step = extent / resolution as f32;
    RgbImage::from_fn(resolution, resolution, |x, y| {
        let color = material.color((x as f32 + 0.5) * step, (y as f32 + 0.5) * step, extent);
        Rgb(color.map(|v| (v.clamp(0.0, 1.0) * 255.0) as u8).into())
    })
}

/// Grey, beige, dark or white, sometimes a colour.
fn muted(rng: &mut ChaCha8Rng) -> Color {
    let color = object_color(rng);
    let share = if rng.chance(0.7) { rng.between(0.5, 1.0) } else { 0.0 };
    color.lerp(&Color::repeat(color.mean()), share)
}

impl Material {
    fn draw(extent: f32, rng: &mut ChaCha8Rng) -> Self {
        match rng.between(0.0, 1.0) {
            d if d < 0.32 => Self::Wood(Wood::draw(extent, rng)),
            d if d < 0.42 => {
                let squares = 2.0 * rng.count(1, 6) as f32;
                let pair = if rng.chance(0.5) {
                    [Self::Wood(Wood::draw(extent, rng)), Self::stone(rng)]
                } else {
                    [Self::stone(rng), Self::stone(rng)]
                };
                Self::Inlay(Box::new(pair), squares)
            }
            d if d < 0.62 => Self::stone(rng),
            d if d < 0.74 => {
                let yarns = [muted(rng), muted(rng)];
                Self::Carpet(yarns, rng.log_between(60.0, 300.0), rng.count(0, 1 << 30) as u32)
            }
            _ => Self::Any(Box::new(Mixed::draw(extent, rng))),
        }
    }

    fn stone(rng: &mut ChaCha8Rng) -> Self {
        let base = muted(rng);
        let vein = base.lerp(&muted(rng), rng.between(0.2, 0.8));
        let veins = if rng.chance(0.5) { 0.0 } else { rng.between(0.1, 0.8) };
        Self::Stone([base, vein], [veins, rng.between(0.0, 0.12)], rng.count(0, 1 << 30) as u32)
    }

    fn color(&self, x: f32, y: f32, extent: f32) -> Color {
        // Mirrored halves meet where the picture repeats.
        let fold = |t: f32| 0.5 * extent * (1.0 - (2.0 * t / extent - 1.0).abs());
        match self {
            Self::Wood(wood) => wood.color(x, fold(y), extent),
            Self::Inlay(pair, squares) => {
                let odd = ((x / extent * squares) as i32 + (y / extent * squares) as i32) % 2;
                pair[odd as usize].color(x, y, extent)
            }
            Self::Stone([base, vein], [veins, speckles], seed) => {
                let p = Vector3::new(fold(x), fold(y), 0.3);
                let ridge = 1.0 - noise::fractal(&(p * 9.0), 4, *seed).abs() * 4.0;
                let grain = noise::value(&(p * 420.0), seed ^ 1) + 0.6 * noise::value(&(p * 110.0), seed ^ 2);
                base.lerp(vein, (veins * ridge).clamp(0.0, 1.0)) * (1.0 + speckles * grain)
            }
            Self::Carpet([a, b], threads, seed) => {
                let p = Vector3::new(fold(x), fold(y), 0.7);
                let wave = 0.5 + 0.25 * ((p.x * threads).sin() + (p.y * threads).sin());
                let loose = 0.5 * noise::value(&(p * *threads), *seed);
                a.lerp(b, (wave + loose).clamp(0.0, 1.0)) * (1.0 + 0.08 * noise::value(&(p * 6.0), seed ^ 7))
            }
            Self::Any(mixed) => mixed.color(&Vector3::new(fold(x), fold(y), 0.013)),
        }
    }
}

/// Boards side by side, or one sheet of veneer.
struct Wood {
    colors: [Color; 2],
    /// Brightness of each board.
    tones: Vec<f32>,
    /// Width of the gap, share of a board.
    gap: f32,
    /// Rings per metre, their contrast, and that of the fibres.
    rings: f32,
    contrast: [f32; 2],
    seed: u32,
}

impl Wood {
    fn draw(extent: f32, rng: &mut ChaCha8Rng) -> Self {
        let hue = rng.between(0.03, 0.11);
        let light = if rng.chance(0.15) {
            muted(rng)
        } else {
            hsv(hue, rng.between(0.15, 0.65), rng.between(0.3, 0.9))
        };
        let boards = if rng.chance(0.4) { 1 } else { ((extent / rng.between(0.05, 0.2)) as usize).max(1) };
        let uneven = rng.between(0.02, 0.2);
        Self {
            colors: [light, light * rng.between(0.35, 0.85)],
            tones: (0..boards).map(|_| 1.0 + uneven * rng.normal().clamp(-2.0, 2.0)).collect(),
            gap: if boards == 1 || rng.chance(0.3) { 0.0 } else { rng.between(0.01, 0.04) },
            rings: rng.log_between(15.0, 80.0),
            contrast: [rng.between(0.1, 0.8), rng.between(0.1, 0.5)],
            seed: rng.count(0, 1 << 30) as u32,
        }
    }

    /// `along` the boards.
    fn color(&self, x: f32, along: f32, extent: f32) -> Color {
        let boards = self.tones.len();
        let place = x / extent * boards as f32;
        let board = (place as usize).min(boards - 1);
        let within = place.fract();
        // A sheet is mirrored, boards end at their gaps.
        let across = if boards == 1 { 0.5 * extent * (1.0 - (2.0 * within - 1.0).abs()) } else { x };
        let offset = 3.7 * board as f32;
        let bend = noise::fractal(&Vector3::new(across * 7.0, along * 1.6 + offset, offset), 2, self.seed);
        let ring = 0.5 + 0.5 * (self.rings * (across + 0.06 * bend) * std::f32::consts::TAU * 0.5).sin();
        let fibre = noise::value(&Vector3::new(across * 500.0, along * 14.0, offset), self.seed ^ 5);
        let dark = self.contrast[0] * ring * ring + self.contrast[1] * (0.5 + 0.5 * fibre);
        let gap = if within < self.gap { 0.35 } else { 1.0 };
        self.colors[0].lerp(&self.colors[1], dark.clamp(0.0, 1.0)) * (self.tones[board] * gap)
    }
}

/// Two patterns laid over each other.
struct Mixed {
    patterns: [Pattern; 2],
    mean: Color,
    contrast: f32,
    mix: f32,
    /// Most tables, floors and walls are wooden, grey, beige, black or white.
    mute: f32,
}

impl Mixed {
    fn draw(extent: f32, rng: &mut ChaCha8Rng) -> Self {
        let mut patterns = [Pattern::any(extent, rng), Pattern::any(extent * 0.5, rng)];
        if rng.chance(0.4) {
            patterns[1] = Pattern::plain(rng);
        }
        if rng.chance(0.15) {
            patterns[0] = Pattern::plain(rng);
        }
        Self {
            mean: patterns[0].color(&Vector3::zeros()),
            patterns,
            mix: if rng.chance(0.5) { 0.0 } else { rng.between(0.1, 0.5) },
            contrast: rng.between(0.25, 1.0),
            mute: if rng.chance(0.6) { rng.between(0.4, 0.9) } else { 0.0 },
        }
    }

    fn color(&self, p: &Vector3<f32>) -> Color {
        let [first, second] = &self.patterns;
        let color = self.mean.lerp(&first.color(p), self.contrast);
        let color = if self.mix > 0.0 { color.lerp(&second.color(p), self.mix) } else { color };
        color.lerp(&Color::repeat(color.mean()), self.mute)
    }
}
