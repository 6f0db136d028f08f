//! Outlines with height: gears, knobs, stars, rings, nuts.

use std::f32::consts::TAU;

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::{
    boxes, loft,
    solid::{Solid, Symmetry},
};
use crate::random::Draw;

const POINTS: usize = 96;

/// Star-shaped outline r(angle) with periodic teeth, lobes or corners.
fn outline(rng: &mut ChaCha8Rng, folds: usize) -> Vec<[f32; 2]> {
    let depth = rng.between(0.06, 0.3);
    let kind = rng.count(0, 2);
    let sharp = rng.between(1.5, 6.0);
    (0..POINTS)
        .map(|i| {
            let angle = TAU * i as f32 / POINTS as f32;
            let phase = angle * folds as f32;
            let r = match kind {
                // Teeth: a cosine with clipped tops and roots.
                0 => 1.0 - depth * (0.5 - 0.5 * (sharp * phase.cos()).clamp(-1.0, 1.0)),
                // Lobes.
                1 => 1.0 - depth * (0.5 - 0.5 * phase.cos()),
                // Regular polygon.
                _ => {
                    let sides = folds.clamp(3, 8) as f32;
                    let step = TAU / sides;
                    let local = (angle + 0.5 * step).rem_euclid(step) - 0.5 * step;
                    (0.5 * step).cos() / local.cos()
                }
            };
            [0.5 * r * angle.cos(), 0.5 * r * angle.sin()]
        })
        .collect()
}

/// A disc with teeth or corners, with or without a hole and a hub, sometimes with a crank that breaks the symmetry.
pub(super) fn gear(rng: &mut ChaCha8Rng) -> Solid {
    // Divisors of the number of outline points, so that the outline repeats exactly.
    let folds = *rng.pick(&[3, 4, 6, 6, 8, 8, 12, 16]);
    let outer = outline(rng, folds);
    let symmetric_folds = folds as u32;
    let (height, bevel) = (rng.log_between(0.06, 0.6), rng.between(0.96, 0.995));
    let hole = rng.chance(0.5).then(|| rng.between(0.1, 0.3));
    let half = 0.5 * height;
    let edge = 0.1 * height.min(0.2);
    let mut rings = vec![
        loft::lift(&outer, -half, bevel),
        loft::lift(&outer, -half + edge, 1.0),
        loft::lift(&outer, half - edge, 1.0),
        loft::lift(&outer, half, bevel),
    ];
    let mut solid = match hole {
        Some(radius) => {
            let inner = loft::superellipse(POINTS, radius, radius, 2.0);
            rings.extend([loft::lift(&inner, half, 1.0), loft::lift(&inner, -half, 1.0)]);
            loft::cyclic(&rings, 0)
        }
        None => loft::capped(&rings, Vector3::new(0.0, 0.0, -half), Vector3::new(0.0, 0.0, half), 0),
    };
    let mut symmetry = Symmetry { continuous: false, folds: symmetric_folds, flip: true };
    if hole.is_none() && rng.chance(0.7) {
        let (r, h) = (rng.between(0.08, 0.3), rng.between(0.1, 0.9));
        let hub = loft::revolve(&[[r, 0.0], [r, h * 0.97], [r * 0.93, h]], 32, |_| 1);
        solid.append(&hub.moved(Vector3::new(0.0, 0.0, half * 0.5)));
        symmetry.flip = false;
        symmetry.folds = gcd(symmetric_folds, 32);
    }
    if rng.chance(0.35) {
        let arm = boxes::rounded_box(
            [rng.between(0.3, 0.7), rng.between(0.08, 0.2), height * rng.between(0.5, 0.9)],
            0.01,
            1,
        );
        solid.append(&arm.moved(Vector3::new(0.6, 0.0, 0.0)));
        symmetry = Symmetry::default();
    }
    if symmetry.folds == 1 && !symmetry.flip {
        symmetry = Symmetry::default();
    }
    Solid { symmetry, ..solid }
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}
