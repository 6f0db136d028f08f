//! Unions of closed parts: tools, controllers, toys, bent tubes.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::{
    boxes::rounded_box,
    loft::{self, Section},
    solid::Solid,
};
use crate::random::Draw;

fn cylinder(radius: f32, height: f32, part: u8) -> Solid {
    let (half, edge) = (0.5 * height, 0.08 * radius.min(height));
    let profile =
        [[radius - edge, -half], [radius, -half + edge], [radius, half - edge], [radius - edge, half]];
    loft::revolve(&profile, 28, |_| part)
}

fn ellipsoid(half: [f32; 3], part: u8) -> Solid {
    let profile: Vec<[f32; 2]> = (1..16)
        .map(|k| {
            let (s, c) = (std::f32::consts::PI * (k as f32 / 16.0 - 0.5)).sin_cos();
            [c, s]
        })
        .collect();
    loft::revolve(&profile, 28, |_| part).map(|p| Vector3::new(p.x * half[0], p.y * half[1], p.z * half[2]))
}

fn torus(radius: f32, thick: f32, part: u8) -> Solid {
    let rings: Vec<Vec<Vector3<f32>>> = (0..14)
        .map(|k| {
            let (s, c) = (std::f32::consts::TAU * k as f32 / 14.0).sin_cos();
            loft::lift(&loft::superellipse(40, 1.0, 1.0, 2.0), thick * s, radius + thick * c)
        })
        .collect();
    loft::cyclic(&rings, part)
}

/// A primitive of about the given size with random proportions.
fn primitive(rng: &mut ChaCha8Rng, size: f32, part: u8) -> Solid {
    let mut side = |low: f32, high: f32| size * rng.between(low, high);
    let (a, b, c) = (side(0.5, 1.2), side(0.5, 1.2), side(0.5, 1.2));
    match rng.count(0, 4) {
        0 => rounded_box([a, b, c], 0.12 * size * rng.between(0.1, 1.0), part),
        1 => cylinder(0.5 * a, c, part),
        2 => ellipsoid([0.55 * a, 0.55 * b, 0.55 * c], part),
        3 => torus(0.45 * a, 0.12 * size, part),
        _ => loft::revolve(&[[0.5 * a, 0.0], [0.5 * a, 0.1 * c], [0.12 * a, c]], 28, |_| part),
    }
}

/// Straight or curved handle with a grip and a head across it.
pub(super) fn tool(rng: &mut ChaCha8Rng) -> Solid {
    let (thick, bow) =
        (rng.between(0.03, 0.07), if rng.chance(0.4) { rng.between(-0.15, 0.15) } else { 0.0 });
    let flat = rng.between(0.6, 1.6);
    let steps = 20;
    let path: Vec<Vector3<f32>> = (0..=steps)
        .map(|k| {
            let t = k as f32 / steps as f32;
            Vector3::new(bow * (std::f32::consts::PI * t).sin(), 0.0, t)
        })
        .collect();
    let (grip, swell) = (rng.between(0.35, 0.6), rng.between(1.1, 1.7));
    let sections: Vec<Section> = (0..=steps)
        .map(|k| {
            let t = k as f32 / steps as f32;
            let gain = if t < grip { swell } else { 1.0 };
            Section { a: thick * gain, b: thick * gain * flat, exponent: rng.between(2.0, 2.2) }
        })
        .collect();
    let mut solid = loft::sweep(&path, &sections, 24, 0.8, 0);
    for (v, part) in solid.mesh.vertices.iter().zip(&mut solid.parts) {
        *part = u8::from(v[2] < grip);
    }
    let top = Vector3::new(0.0, 0.0, 1.0);
    let head = match rng.count(0, 4) {
        0 => {
            let length = rng.between(0.25, 0.5);
            let body = rounded_box([length, 0.1, 0.11], 0.02, 2);
            let mut body = body.moved(Vector3::new(rng.between(-0.08, 0.08), 0.0, 0.0));
            body.append(
                &cylinder(0.075, 0.12, 2).turned(Vector3::y(), 90.0).moved(Vector3::x() * 0.5 * length),
            );
            body
        }
        1 => rounded_box([rng.between(0.12, 0.3), 0.03, rng.between(0.15, 0.4)], 0.01, 2),
        2 => cylinder(rng.between(0.06, 0.2), rng.between(0.05, 0.2), 2).turned(Vector3::x(), 90.0),
        3 => torus(rng.between(0.1, 0.18), rng.between(0.025, 0.05), 2).turned(Vector3::x(), 90.0),
        _ => {
            let mut fork = rounded_box([0.26, 0.05, 0.07], 0.01, 2);
            for side in [-0.11, 0.11] {
                let prong = rounded_box([0.05, 0.05, rng.between(0.12, 0.25)], 0.01, 2);
                fork.append(&prong.moved(Vector3::new(side, 0.0, 0.08)));
            }
            fork
        }
    };
    solid.append(&head.moved(top));
    if rng.chance(0.4) {
        solid.append(&cylinder(thick * swell * 1.25, 0.04, 3).moved(Vector3::new(
            0.0,
            0.0,
            rng.between(0.0, grip),
        )));
    }
    solid
}

/// A rounded body with buttons, sticks and screens; sometimes with grips or a guard ring.
pub(super) fn controller(rng: &mut ChaCha8Rng) -> Solid {
    let (width, height) = (rng.between(0.22, 0.6), rng.between(0.1, 0.24));
    let steps = 24;
    let (waist, droop, exponent) = (rng.between(-0.3, 0.25), rng.between(-0.25, 0.25), rng.between(2.0, 4.5));
    let at = |t: f32| Vector3::new(0.0, t - 0.5, droop * (t - 0.5) * (t - 0.5));
    let gain = |t: f32| 1.0 + waist * (std::f32::consts::TAU * t).cos() * 0.5;
    let path: Vec<_> = (0..=steps).map(|k| at(k as f32 / steps as f32)).collect();
    // The sweep's first axis is vertical for a path along y.
    let sections: Vec<Section> = (0..=steps)
        .map(|k| k as f32 / steps as f32)
        .map(|t| Section { a: 0.5 * width * gain(t), b: 0.5 * height, exponent })
        .collect();
    let mut solid = loft::sweep(&path, &sections, 40, 0.9, 0);
    let bounds = solid.mesh.bounds().size();
    // The sweep's transported frame decides which way its width lies; lay the wide side flat.
    if bounds[2] > bounds[0] {
        solid = solid.turned(Vector3::y(), 90.0);
    }
    let top = solid.mesh.bounds().max[2];
    for button in 0..rng.count(2, 9) {
        let t = rng.between(0.1, 0.9);
        let size = rng.between(0.03, 0.1);
        let part = 1 + (button % 3) as u8;
        let bump = match rng.count(0, 2) {
            0 => cylinder(0.5 * size, 0.12, part),
            1 => rounded_box([size * rng.between(0.8, 2.0), size, 0.11], 0.01, part),
            _ => ellipsoid([0.6 * size, 0.6 * size, 0.09], part),
        };
        let x = rng.between(-0.32, 0.32) * width;
        solid.append(&bump.moved(Vector3::new(x, t - 0.5, top - 0.04)));
    }
    if rng.chance(0.4) {
        let ring = torus(rng.between(0.22, 0.4), rng.between(0.02, 0.05), 4);
        let tilt = ring.turned(Vector3::x(), rng.between(-60.0, 60.0));
        solid.append(&tilt.moved(Vector3::new(0.0, 0.5, rng.between(-0.05, 0.15))));
    }
    if rng.chance(0.35) {
        for side in [-1.0, 1.0] {
            let grip = ellipsoid([0.11, 0.3, 0.11], 0).turned(Vector3::z(), side * 15.0);
            solid.append(&grip.moved(Vector3::new(side * 0.5 * width, -0.4, -0.05)));
        }
    }
    solid
}

/// Primitives stuck to a body, some of them mirrored.
pub(super) fn toy(rng: &mut ChaCha8Rng) -> Solid {
    let mut solid = primitive(rng, 1.0, 0);
    let parts = rng.count(2, 7);
    for k in 0..parts {
        let size = rng.between(0.25, 0.75);
        let axis = rng.unit_vector();
        let part = primitive(rng, size, 1 + (k % 4) as u8).turned(axis, rng.between(0.0, 180.0));
        let toward = rng.unit_vector() * rng.between(0.3, 0.6);
        if rng.chance(0.5) {
            // A mirrored copy would be inside out; the half-turned one is not.
            let other = part.clone().turned(Vector3::z(), 180.0);
            solid.append(&other.moved(Vector3::new(-toward.x, -toward.y, toward.z)));
        }
        solid.append(&part.moved(toward));
    }
    solid
}

/// Bent tubes: hooks, springs, handles, letters.
pub(super) fn tube(rng: &mut ChaCha8Rng) -> Solid {
    let steps = 40;
    let (turns, pitch) = (rng.between(0.3, 1.6), rng.between(0.1, 0.6));
    let (grow, wave) = (rng.between(-0.5, 0.6), rng.between(0.0, 0.3));
    let thick = rng.between(0.05, 0.16);
    let path: Vec<Vector3<f32>> = (0..=steps)
        .map(|k| {
            let t = k as f32 / steps as f32;
            let (s, c) = (turns * std::f32::consts::TAU * t).sin_cos();
            let r = 0.5 * (1.0 + grow * t);
            Vector3::new(r * c, r * s, pitch * t * turns.max(1.0) + wave * (5.0 * t).sin())
        })
        .collect();
    let (a, b) = (thick * rng.between(0.7, 1.0), thick * rng.between(0.7, 1.4));
    let (exponent, taper) = (rng.between(2.0, 5.0), rng.between(0.5, 1.0));
    let sections: Vec<Section> = (0..=steps)
        .map(|k| 1.0 + (taper - 1.0) * k as f32 / steps as f32)
        .map(|g| Section { a: a * g, b: b * g, exponent })
        .collect();
    let mut solid = loft::sweep(&path, &sections, 20, 0.7, 0);
    for end in [path[0], path[steps]] {
        if rng.chance(0.5) {
            let size = thick * rng.between(2.2, 4.0);
            let knob = primitive(rng, size, 1);
            solid.append(&knob.moved(end));
        }
    }
    solid
}
