//! The look of an object: a material per part, prints on top, wear, reflection.

use image::RgbaImage;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use unopose_dataset::render::Finish;

use super::{
    pattern::{Color, Pattern, object_color},
    print,
};
use crate::{noise, photographs::Photographs, random::Draw, shapes::Symmetry};

/// A print on the surface.
#[derive(Clone, Debug)]
struct Decal {
    picture: RgbaImage,
    center: Vector3<f32>,
    /// Right and up in the print's plane, unit vectors.
    right: Vector3<f32>,
    up: Vector3<f32>,
    half: [f32; 2],
    /// Wrapped around the z axis instead of projected: half width is an angle.
    around: bool,
}

impl Decal {
    fn color(&self, p: &Vector3<f32>, normal: &Vector3<f32>) -> Option<Color> {
        let out = self.right.cross(&self.up);
        let (u, v) = if self.around {
            let angle = (p.y.atan2(p.x) - out.y.atan2(out.x)).rem_euclid(std::f32::consts::TAU);
            let angle = if angle > std::f32::consts::PI { angle - std::f32::consts::TAU } else { angle };
            let outward = p.x * normal.x + p.y * normal.y;
            if outward <= 0.0 || normal.z.abs() > 0.8 {
                return None;
            }
            (angle / self.half[0], (p.z - self.center.z) / self.half[1])
        } else {
            if normal.dot(&out) < 0.35 {
                return None;
            }
            let d = p - self.center;
            (d.dot(&self.right) / self.half[0], d.dot(&self.up) / self.half[1])
        };
        if u.abs() >= 1.0 || v.abs() >= 1.0 {
            return None;
        }
        let (w, h) = (self.picture.width(), self.picture.height());
        let x = ((0.5 + 0.5 * u) * w as f32) as u32;
        let y = ((0.5 - 0.5 * v) * h as f32) as u32;
        let [r, g, b, a] = self.picture.get_pixel(x.min(w - 1), y.min(h - 1)).0;
        (a > 0).then(|| Vector3::new(r, g, b).map(|c| f32::from(c) / 255.0))
    }
}

/// Everything that colours an object.
#[derive(Clone, Debug)]
pub(crate) struct Look {
    patterns: Vec<Pattern>,
    decals: Vec<Decal>,
    /// Strength and seed of scratches and stains.
    wear: (f32, u32),
    pub finish: Finish,
}

/// Longer side of a label all around a package, and of one on a side, pixels.
const WRAP_PIXELS: u32 = 420;
const FACE_PIXELS: u32 = 220;
/// Distinct part numbers that families use.
const PARTS: usize = 5;

impl Look {
    /// A look for an object of the given full size (metres); `revolved` objects may get wrapped labels.
    pub fn draw(size: [f32; 3], textureless_share: f32, revolved: bool, rng: &mut ChaCha8Rng) -> Self {
        let diameter = Vector3::from(size).norm();
        let textureless = rng.chance(textureless_share);
        let one_color = rng.chance(0.4);
        let mut patterns: Vec<Pattern> = Vec::new();
        for part in 0..PARTS {
            let pattern = match (textureless, part) {
                (true, _) => Pattern::plain(rng),
                (false, 0) => Pattern::any(diameter, rng),
                _ if rng.chance(0.5) => Pattern::plain(rng),
                _ => Pattern::any(diameter, rng),
            };
            let repeated = part > 0 && textureless && one_color;
            patterns.push(if repeated { patterns[0].clone() } else { pattern });
        }
        let prints = match textureless {
            true => 0,
            false => *rng.pick(&[0, 1, 2, 3, 4, 6, 8]),
        };
        let decals = (0..prints).map(|_| decal(size, revolved, rng)).collect();
        let metal = rng.chance(0.15);
        let finish = Finish {
            roughness: if metal { rng.between(0.2, 0.6) } else { rng.between(0.25, 1.0) },
            metallic: if metal { rng.between(0.6, 1.0) } else { 0.0 },
        };
        let wear = if textureless || rng.chance(0.5) { 0.0 } else { rng.between(0.1, 0.7) };
        Self { patterns, decals, wear: (wear, rng.count(0, 1 << 30) as u32), finish }
    }

    /// A package: a label all around or one on every side, each with its own picture.
    pub fn package(size: [f32; 3], revolved: bool, photographs: &Photographs, rng: &mut ChaCha8Rng) -> Self {
        let patterns: Vec<Pattern> = (0..PARTS).map(|_| Pattern::plain(rng)).collect();
        // Most sides of a package have the colours of its brand.
        let brand = [object_color(rng), object_color(rng)];
        let mut decals = Vec::new();
        if revolved {
            let half = [std::f32::consts::PI, 0.5 * size[2] * rng.between(0.6, 1.0)];
            let center = Vector3::new(0.0, 0.0, 0.5 * size[2] * rng.between(-0.1, 0.1));
            let (s, c) = rng.between(0.0, std::f32::consts::TAU).sin_cos();
            let aspect = half[0] * 0.5 * size[0] / half[1];
            let picture = print::package(aspect, WRAP_PIXELS, brand, photographs, rng);
            let right = Vector3::new(-s, c, 0.0);
            decals.push(Decal { picture, center, right, up: Vector3::z(), half, around: true });
        }
        for axis in if revolved { 2..3 } else { 0..3 } {
            for sign in [1.0, -1.0] {
                if revolved && rng.chance(0.4) {
                    continue;
                }
                let mut out = Vector3::zeros();
                out[axis] = sign;
                let mut up = Vector3::zeros();
                up[if axis == 2 { 1 } else { 2 }] = 1.0;
                let right = up.cross(&out);
                let extent = |d: &Vector3<f32>| (0..3).map(|k| d[k].abs() * 0.5 * size[k]).sum::<f32>();
                let share = if revolved { rng.between(0.5, 0.9) } else { rng.between(0.92, 1.02) };
                let half = [extent(&right) * share, extent(&up) * share];
                let aspect = half[0] / half[1].max(1e-6);
                let picture = print::package(aspect, FACE_PIXELS, brand, photographs, rng);
                decals.push(Decal { picture, center: Vector3::zeros(), right, up, half, around: false });
            }
        }
        let metal = rng.chance(0.15);
        let finish = Finish {
            roughness: rng.between(0.25, 0.9),
            metallic: if metal { rng.between(0.3, 0.9) } else { 0.0 },
        };
        let wear = if rng.chance(0.7) { 0.0 } else { rng.between(0.1, 0.4) };
        Self { patterns, decals, wear: (wear, rng.count(0, 1 << 30) as u32), finish }
    }

    /// What is left of a shape's symmetry with these colours on the given parts.
    pub fn remaining_symmetry(&self, symmetry: Symmetry, parts: &[u8]) -> Symmetry {
        let used: Vec<&Pattern> = (0..PARTS)
            .filter(|&k| parts.iter().any(|&p| p as usize % PARTS == k))
            .map(|k| &self.patterns[k])
            .collect();
        let (plain, axial) = (used.iter().all(|p| p.is_even()), used.iter().all(|p| p.is_axial()));
        if !self.decals.is_empty() || self.wear.0 > 0.0 || !axial {
            return Symmetry::default();
        }
        Symmetry { flip: symmetry.flip && plain, ..symmetry }
    }

    /// sRGB at a surface point.
    pub fn color(&self, p: &Vector3<f32>, normal: &Vector3<f32>, part: u8) -> Color {
        let printed = self.decals.iter().rev().find_map(|d| d.color(p, normal));
        let color = printed.unwrap_or_else(|| self.patterns[part as usize % PARTS].color(p));
        let (wear, seed) = self.wear;
        if wear == 0.0 {
            return color;
        }
        let stain = noise::fractal(&(p * 35.0), 3, seed);
        let scratch = noise::value(&Vector3::new(p.x * 700.0, p.y * 60.0, p.z * 60.0), seed ^ 3);
        let dark = 1.0 - wear * 0.6 * (stain - 0.15).max(0.0);
        let bright = wear * 0.35 * (scratch - 0.7).max(0.0);
        color * dark + Color::repeat(bright)
    }
}

fn decal(size: [f32; 3], revolved: bool, rng: &mut ChaCha8Rng) -> Decal {
    let around = revolved && rng.chance(0.7);
    if around {
        let half = [rng.between(0.5, 3.1), 0.5 * size[2] * rng.between(0.12, 0.6)];
        let center = Vector3::new(0.0, 0.0, size[2] * rng.between(-0.25, 0.25));
        let (s, c) = rng.between(0.0, std::f32::consts::TAU).sin_cos();
        let aspect = half[0] * 0.5 * size[0] / half[1];
        let picture = print::label(aspect, 220, rng);
        return Decal { picture, center, right: Vector3::new(-s, c, 0.0), up: Vector3::z(), half, around };
    }
    // On one of the six sides, upright or turned by quarter turns, sometimes at any angle.
    let axis = rng.count(0, 2);
    let mut out = Vector3::zeros();
    out[axis] = if rng.chance(0.5) { 1.0 } else { -1.0 };
    let mut up = Vector3::zeros();
    up[if axis == 2 { 1 } else { 2 }] = 1.0;
    let turn = *rng.pick(&[0.0, 0.0, 0.0, 90.0, 180.0, 270.0, 30.0, 200.0]);
    let turn = nalgebra::Rotation3::from_scaled_axis(out * f32::to_radians(turn));
    let up = turn * up;
    let right = up.cross(&out);
    let extent = |d: &Vector3<f32>| (0..3).map(|k| d[k].abs() * 0.5 * size[k]).sum::<f32>();
    let full = rng.chance(0.3);
    let mut share = || if full { rng.between(0.9, 1.02) } else { rng.between(0.15, 0.7) };
    let half = [extent(&right) * share(), extent(&up) * share()];
    let free = |d: &Vector3<f32>, h: f32, rng: &mut ChaCha8Rng| {
        d * (extent(d) - h).max(0.0) * rng.between(-0.9, 0.9)
    };
    let center = free(&right, half[0], rng) + free(&up, half[1], rng);
    let picture = print::label(half[0] / half[1].max(1e-6), 200, rng);
    Decal { picture, center, right, up, half, around }
}
