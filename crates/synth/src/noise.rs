//! Lattice noise in three dimensions.

use nalgebra::Vector3;

/// Integer hash to [0, 1).
pub(crate) fn hash(x: i32, y: i32, z: i32, seed: u32) -> f32 {
    let mut h = seed ^ 0x9E37_79B9;
    for v in [x, y, z] {
        h = (h ^ v as u32).wrapping_mul(0x85EB_CA6B);
        h ^= h >> 15;
    }
    h = h.wrapping_mul(0xC2B2_AE35);
    ((h ^ (h >> 13)) >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Cell of the lattice and place in it; without a call into libm on plain x86-64.
fn cell(x: f32) -> (i32, f32) {
    let truncated = x as i32;
    let floor = truncated - i32::from((truncated as f32) > x);
    (floor, x - floor as f32)
}

/// Value noise, smooth, in [-1, 1], feature size 1.
pub(crate) fn value(p: &Vector3<f32>, seed: u32) -> f32 {
    let [(x, fx), (y, fy), (z, fz)] = [p.x, p.y, p.z].map(cell);
    let f = Vector3::new(fx, fy, fz).map(|t| t * t * (3.0 - 2.0 * t));
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let edge = |dy: i32, dz: i32| mix(hash(x, y + dy, z + dz, seed), hash(x + 1, y + dy, z + dz, seed), f.x);
    let sheet = |dz: i32| mix(edge(0, dz), edge(1, dz), f.y);
    2.0 * mix(sheet(0), sheet(1), f.z) - 1.0
}

/// Sum of `octaves` of [`value`], each twice as fine and half as strong; about [-1, 1].
pub(crate) fn fractal(p: &Vector3<f32>, octaves: u32, seed: u32) -> f32 {
    let (mut sum, mut weight, mut total, mut q) = (0.0, 1.0, 0.0, *p);
    for octave in 0..octaves {
        sum += weight * value(&q, seed.wrapping_add(octave.wrapping_mul(0x51ED)));
        total += weight;
        weight *= 0.5;
        q *= 2.03;
    }
    sum / total
}

/// Distance to the nearest and second nearest point of a jittered grid of cell size 1, and the nearest cell's hash.
pub(crate) fn cells(p: &Vector3<f32>, seed: u32) -> (f32, f32, f32) {
    let base = [p.x, p.y, p.z].map(|x| cell(x).0);
    let (mut first, mut second, mut id) = (f32::MAX, f32::MAX, 0.0);
    for i in 0..27 {
        let [x, y, z] = [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1];
        let (cx, cy, cz) = (base[0] + x, base[1] + y, base[2] + z);
        let jitter = |k: u32| hash(cx, cy, cz, seed.wrapping_add(k));
        let center = Vector3::new(cx as f32 + jitter(1), cy as f32 + jitter(2), cz as f32 + jitter(3));
        let distance = (center - p).norm();
        if distance < first {
            (second, first, id) = (first, distance, jitter(4));
        } else if distance < second {
            second = distance;
        }
    }
    (first, second, id)
}
