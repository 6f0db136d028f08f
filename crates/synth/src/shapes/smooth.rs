//! Superquadrics, displaced spheres and shoe-like lofts.

use std::f32::consts::{FRAC_PI_2, TAU};

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::{
    boxes, loft,
    solid::{Solid, Symmetry},
};
use crate::{noise, random::Draw};

const RINGS: usize = 32;
const SEGMENTS: usize = 56;

/// Closed surface from a direction-to-point map, sampled on a globe.
fn globe(point: impl Fn(f32, f32) -> Vector3<f32>) -> Solid {
    let ring = |k: usize| {
        let latitude = -FRAC_PI_2 + std::f32::consts::PI * (k as f32 + 1.0) / (RINGS as f32 + 1.0);
        (0..SEGMENTS).map(|i| point(latitude, TAU * i as f32 / SEGMENTS as f32)).collect::<Vec<_>>()
    };
    let rings: Vec<_> = (0..RINGS).map(ring).collect();
    loft::capped(&rings, point(-FRAC_PI_2, 0.0), point(FRAC_PI_2, 0.0), 0)
}

/// Signed power; the rounding error of a zero stays zero.
fn power(x: f32, e: f32) -> f32 {
    if x.abs() < 1e-6 { 0.0 } else { x.signum() * x.abs().powf(e) }
}

/// Superquadric, perhaps tapered, bent or twisted.
pub(super) fn superquadric(rng: &mut ChaCha8Rng) -> Solid {
    let (e1, e2) = (rng.log_between(0.25, 1.8), rng.log_between(0.25, 1.8));
    let half = [rng.between(0.35, 1.0), rng.between(0.3, 1.0), rng.between(0.3, 1.3)];
    let solid = globe(|latitude, longitude| {
        let ((sl, cl), (so, co)) = (latitude.sin_cos(), longitude.sin_cos());
        let waist = power(cl, e1);
        Vector3::new(
            half[0] * waist * power(co, e2),
            half[1] * waist * power(so, e2),
            half[2] * power(sl, e1),
        )
    });
    if rng.chance(0.35) {
        return Solid { symmetry: Symmetry { continuous: false, folds: 2, flip: true }, ..solid };
    }
    let (taper, bend, twist) = (rng.between(-0.6, 0.6), rng.between(-0.5, 0.5), rng.between(-0.8, 0.8));
    let height = half[2];
    solid.map(move |p| {
        let t = p.z / height;
        let scale = 1.0 + taper * 0.5 * t;
        let (s, c) = (twist * t).sin_cos();
        let (x, y) = (p.x * scale, p.y * scale);
        Vector3::new(c * x - s * y + bend * t * t, s * x + c * y, p.z)
    })
}

/// A lumpy closed surface: low-frequency displacement of an ellipsoid, sometimes with ribs.
pub(super) fn organic(rng: &mut ChaCha8Rng) -> Solid {
    let seed = rng.count(0, 1 << 30) as u32;
    let half = [rng.between(0.5, 1.0), rng.between(0.45, 1.0), rng.between(0.4, 1.2)];
    let (amount, frequency) = (rng.between(0.1, 0.45), rng.between(0.8, 2.4));
    let fine = rng.between(0.0, 0.04);
    let (ribs, rib_depth) =
        (rng.count(3, 9) as f32, if rng.chance(0.3) { rng.between(0.02, 0.1) } else { 0.0 });
    globe(|latitude, longitude| {
        let ((sl, cl), (so, co)) = (latitude.sin_cos(), longitude.sin_cos());
        let d = Vector3::new(cl * co, cl * so, sl);
        let lump = noise::fractal(&(d * frequency), 2, seed);
        let grain = noise::value(&(d * 9.0), seed ^ 7);
        let r = 1.0 + amount * lump + fine * grain + rib_depth * cl * (ribs * longitude).cos();
        Vector3::new(half[0] * d.x, half[1] * d.y, half[2] * d.z) * r.max(0.25)
    })
}

/// Sole, instep and heel: cross-sections along y whose width and height follow the foot.
pub(super) fn shoe(rng: &mut ChaCha8Rng) -> Solid {
    let (width, heel, toe) = (rng.between(0.14, 0.22), rng.between(0.25, 0.55), rng.between(0.08, 0.16));
    let (curve, sole, flat) = (rng.between(-0.08, 0.08), rng.between(0.02, 0.09), rng.between(2.2, 4.5));
    let instep = rng.between(0.25, 0.5);
    let steps = 28;
    let ring = |k: usize| -> Vec<Vector3<f32>> {
        let t = k as f32 / steps as f32;
        let y = t - 0.5;
        // Blunt at both ends.
        let end = (1.0 - (2.0 * t - 1.0).abs().powf(6.0)).max(0.02).sqrt();
        let waist = 1.0 - 0.25 * (-((t - 0.4) / 0.15).powi(2)).exp();
        let rise = toe + (heel - toe) * (1.0 / (1.0 + ((t - instep) * 14.0).exp()));
        let (w, h) = (width * end * waist, rise * (0.55 + 0.45 * end));
        let shift = curve * (std::f32::consts::PI * t).sin();
        loft::superellipse(40, w, 0.5 * h, flat)
            .into_iter()
            .map(|p| {
                // Narrower towards the top.
                let up = p[1] / h + 0.5;
                Vector3::new(-(p[0] * (1.0 - 0.45 * up) + shift), y, p[1] + 0.5 * h)
            })
            .collect()
    };
    let rings: Vec<_> = (0..=steps).map(ring).collect();
    let mean = |r: &Vec<Vector3<f32>>| r.iter().sum::<Vector3<f32>>() / r.len() as f32;
    let mut solid = loft::capped(&rings, mean(&rings[0]), mean(&rings[steps]), 0);
    for (v, part) in solid.mesh.vertices.iter().zip(&mut solid.parts) {
        *part = u8::from(v[2] < sole);
    }
    if rng.chance(0.6) {
        let tongue = boxes::rounded_box([width * 0.8, 0.22, 0.05], 0.02, 2);
        let tilt = tongue.turned(Vector3::x(), -35.0);
        solid.append(&tilt.moved(Vector3::new(0.0, instep - 0.42, 0.75 * heel)));
    }
    solid
}
