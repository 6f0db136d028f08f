//! Surfaces of revolution: bottles, cans, bowls, mugs.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::{
    loft::{self, Section},
    solid::{Solid, Symmetry},
};
use crate::random::Draw;

const SEGMENTS: usize = 48;

/// Straight pieces between profile corners, each cut into `steps`.
fn refine(corners: &[[f32; 2]], steps: usize) -> Vec<[f32; 2]> {
    let mut profile = Vec::new();
    for pair in corners.windows(2) {
        for k in 0..steps {
            let t = k as f32 / steps as f32;
            profile.push([
                pair[0][0] + (pair[1][0] - pair[0][0]) * t,
                pair[0][1] + (pair[1][1] - pair[0][1]) * t,
            ]);
        }
    }
    profile.extend(corners.last());
    profile
}

/// Body, shoulder, neck and cap; also vases and skittles.
pub(super) fn bottle(rng: &mut ChaCha8Rng) -> Solid {
    let (height, radius) = (1.0, rng.between(0.13, 0.32));
    let neck = radius * rng.between(0.25, 0.65);
    let (shoulder, neck_start) = (rng.between(0.4, 0.7), rng.between(0.72, 0.86));
    let waist = if rng.chance(0.4) { rng.between(-0.2, 0.15) } else { 0.0 };
    let (belly, cap) = (rng.between(2.0, 6.0), neck * rng.between(1.0, 1.35));
    let cap_start = rng.between(0.88, 0.94);
    let mut profile = vec![[radius * 0.85, 0.0], [radius * 0.97, 0.012]];
    for k in 0..=12 {
        let t = k as f32 / 12.0;
        let bulge = 1.0 + waist * (t * belly).sin();
        profile.push([radius * bulge, 0.03 + t * (shoulder - 0.03)]);
    }
    let last = profile[profile.len() - 1][0];
    for k in 1..=8 {
        let t = k as f32 / 8.0;
        let s = t * t * (3.0 - 2.0 * t);
        profile.push([last + (neck - last) * s, shoulder + t * (neck_start - shoulder)]);
    }
    profile.push([neck, cap_start]);
    let body = profile.len();
    profile.extend([[cap, cap_start + 0.004], [cap, height - 0.01], [cap * 0.94, height]]);
    Solid { symmetry: Symmetry::axis(false), ..loft::revolve(&profile, SEGMENTS, |i| u8::from(i >= body)) }
}

/// Cylinder with rims: tins, jars with lids, rolls, pucks.
pub(super) fn can(rng: &mut ChaCha8Rng) -> Solid {
    let (radius, rim) = (rng.log_between(0.15, 0.7), rng.between(0.0, 0.05));
    let lid = if rng.chance(0.5) { rng.between(0.75, 0.95) } else { 1.0 };
    let (taper, inset) =
        (if rng.chance(0.3) { rng.between(0.75, 1.0) } else { 1.0 }, rng.between(0.02, 0.06));
    let at = |t: f32| radius * (taper + (1.0 - taper) * t);
    let mut corners = vec![[at(0.0) - inset * radius, 0.0], [at(0.0), 0.02], [at(lid - 0.02), lid - 0.02]];
    if lid < 1.0 {
        corners.extend([
            [at(lid) * (1.0 + rim), lid],
            [at(1.0) * (1.0 + rim), 0.99],
            [at(1.0) * (0.97 + rim), 1.0],
        ]);
    } else {
        corners.extend([[at(1.0) - inset * radius, 1.0], [at(1.0) - 2.0 * inset * radius, 0.985]]);
    }
    let profile = refine(&corners, 4);
    let top = if lid < 1.0 { 12 } else { usize::MAX };
    Solid { symmetry: Symmetry::axis(false), ..loft::revolve(&profile, SEGMENTS, |i| u8::from(i >= top)) }
}

/// Outside and inside of an open vessel; `flare` gives the radius over height 0..1.
fn vessel(height: f32, wall: f32, floor: f32, flare: impl Fn(f32) -> f32) -> Solid {
    let steps = 14;
    let mut profile = vec![[flare(0.0) * 0.9, 0.0]];
    profile.extend(
        (0..=steps).map(|k| k as f32 / steps as f32).map(|t| [flare(t), (0.012 + 0.988 * t) * height]),
    );
    let outer = profile.len();
    profile.push([flare(1.0) - 0.5 * wall, height + 0.3 * wall]);
    for k in (0..=steps).rev() {
        let t = k as f32 / steps as f32;
        let z = floor + t * (height - floor);
        profile.push([(flare(z / height) - wall).max(0.02), z]);
    }
    loft::revolve(&profile, SEGMENTS, |i| u8::from(i > outer))
}

/// Bowls, plates and basins.
pub(super) fn bowl(rng: &mut ChaCha8Rng) -> Solid {
    let (height, foot) = (rng.between(0.15, 0.75), rng.between(0.25, 0.7));
    let power = rng.between(0.35, 1.3);
    let wall = rng.between(0.03, 0.06);
    let flare = |t: f32| 0.5 * (foot + (1.0 - foot) * t.max(0.0).powf(power));
    Solid { symmetry: Symmetry::axis(false), ..vessel(height, wall, wall * 1.2, flare) }
}

/// Cup with a handle, sometimes two, sometimes none.
pub(super) fn mug(rng: &mut ChaCha8Rng) -> Solid {
    let (radius, wall) = (rng.between(0.3, 0.5), rng.between(0.03, 0.05));
    let (taper, belly) = (rng.between(-0.15, 0.2), rng.between(-0.05, 0.12));
    let flare = |t: f32| radius * (1.0 + taper * (t - 0.5) + belly * (t * std::f32::consts::PI).sin());
    let mut solid = vessel(1.0, wall, wall * 1.5, flare);
    let handles = *rng.pick(&[0, 1, 1, 1, 1, 2]);
    let (low, high) = (rng.between(0.15, 0.3), rng.between(0.7, 0.88));
    let (reach, square) = (rng.between(0.22, 0.42), rng.between(1.0, 2.5));
    let section =
        Section { a: rng.between(0.03, 0.05), b: rng.between(0.03, 0.09), exponent: rng.between(2.0, 4.0) };
    for side in 0..handles {
        let sign = if side == 0 { 1.0 } else { -1.0 };
        let path: Vec<Vector3<f32>> = (0..=16)
            .map(|k| {
                let t = k as f32 / 16.0;
                let z = low + (high - low) * t;
                let out = (t * std::f32::consts::PI).sin().max(0.0).powf(1.0 / square);
                Vector3::new(sign * (flare(z) - 0.5 * wall + reach * out), 0.0, z)
            })
            .collect();
        solid.append(&loft::sweep(&path, &[section; 17], 12, 0.0, 1));
    }
    solid.symmetry = match handles {
        0 => Symmetry::axis(false),
        2 => Symmetry::folds(2),
        _ => Symmetry::default(),
    };
    solid
}
