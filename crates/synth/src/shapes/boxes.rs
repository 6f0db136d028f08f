//! Boxes and unions of boxes.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::{
    loft,
    solid::{Solid, Symmetry},
};
use crate::random::Draw;

/// Box of full size `size` around the origin with edges bevelled by `bevel`.
pub(super) fn rounded_box(size: [f32; 3], bevel: f32, part: u8) -> Solid {
    let [a, b, c] = size.map(|s| 0.5 * s);
    let bevel = bevel.min(0.45 * size[0].min(size[1]).min(size[2]));
    let outline = |inset: f32| -> Vec<[f32; 2]> {
        let (x, y) = (a - inset, b - inset);
        let r = (bevel - inset).max(bevel * 0.15);
        let mut points = Vec::new();
        for (corner, (sx, sy)) in [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].into_iter().enumerate()
        {
            for k in 0..4 {
                let angle = std::f32::consts::FRAC_PI_2 * (corner as f32 + k as f32 / 3.0);
                points.push([sx * (x - r) + r * angle.cos(), sy * (y - r) + r * angle.sin()]);
            }
        }
        points
    };
    let steps = [1.0, 0.45, 0.12, 0.0];
    let drop = [0.0, 0.12, 0.45, 1.0];
    let mut rings: Vec<Vec<Vector3<f32>>> = Vec::new();
    for k in 0..4 {
        rings.push(loft::lift(&outline(steps[k] * bevel), -c + drop[k] * bevel, 1.0));
    }
    for k in (0..4).rev() {
        rings.push(loft::lift(&outline(steps[k] * bevel), c - drop[k] * bevel, 1.0));
    }
    loft::capped(&rings, Vector3::new(0.0, 0.0, -c), Vector3::new(0.0, 0.0, c), part)
}

/// Cartons, tins, cases: one box, perhaps tapered, perhaps with a lid or a gable.
pub(super) fn carton(rng: &mut ChaCha8Rng) -> Solid {
    let size = [rng.between(0.35, 1.0), rng.between(0.2, 0.9), rng.between(0.25, 1.2)];
    let bevel = rng.log_between(0.01, 0.12);
    match rng.count(0, 4) {
        0 => {
            let lid = rng.between(0.12, 0.4) * size[2];
            let over = rng.between(1.02, 1.1);
            let mut solid = rounded_box(size, bevel, 0);
            let top = rounded_box([size[0] * over, size[1] * over, lid], bevel, 1);
            solid.append(&top.moved(Vector3::new(0.0, 0.0, 0.5 * size[2])));
            Solid { symmetry: Symmetry::folds(2), ..solid }
        }
        1 => {
            let taper = rng.between(0.55, 0.95);
            let height = size[2];
            let shrink = move |z: f32| 1.0 + (taper - 1.0) * (z / height + 0.5);
            let solid = rounded_box(size, bevel, 0);
            let solid = solid.map(|p| Vector3::new(p.x * shrink(p.z), p.y * shrink(p.z), p.z));
            Solid { symmetry: Symmetry::folds(2), ..solid }
        }
        2 => {
            // Gable top: the upper part closes to a ridge.
            let (height, ridge) = (size[2], rng.between(0.15, 0.4));
            let solid = rounded_box([size[0], size[1], height], bevel * 0.5, 0);
            let mut roof = rounded_box([size[0] * 0.98, size[1] * 0.98, ridge * 2.0], bevel * 0.3, 1);
            roof = roof.map(|p| {
                let t = (p.z / ridge).max(0.0);
                Vector3::new(p.x, p.y * (1.0 - 0.92 * t), p.z)
            });
            let mut solid = solid;
            solid.append(&roof.moved(Vector3::new(0.0, 0.0, 0.5 * height)));
            Solid { symmetry: Symmetry::folds(2), ..solid }
        }
        _ => {
            let solid = rounded_box(size, bevel, 0);
            Solid { symmetry: Symmetry { folds: 2, flip: true, continuous: false }, ..solid }
        }
    }
}

/// Page block between covers with a spine.
pub(super) fn book(rng: &mut ChaCha8Rng) -> Solid {
    let (width, height, thick) = (rng.between(0.55, 0.85), 1.0, rng.between(0.06, 0.35));
    let (cover, over) = (rng.between(0.01, 0.025), rng.between(0.0, 0.03));
    let mut solid = rounded_box([width, height, thick], 0.004, 0);
    for sign in [-1.0, 1.0] {
        let board = rounded_box([width + 2.0 * over, height + 2.0 * over, cover], cover * 0.3, 1);
        solid.append(&board.moved(Vector3::new(0.0, 0.0, sign * 0.5 * thick)));
    }
    let spine = rounded_box([cover, height + 2.0 * over, thick + cover], cover * 0.3, 1);
    solid.append(&spine.moved(Vector3::new(-0.5 * width - over, 0.0, 0.0)));
    solid
}

/// Beams joined at right angles, with ribs and bosses.
pub(super) fn bracket(rng: &mut ChaCha8Rng) -> Solid {
    let (width, thick) = (rng.between(0.15, 0.5), rng.between(0.06, 0.2));
    let bevel = rng.log_between(0.008, 0.03);
    let mut solid = rounded_box([1.0, width, thick], bevel, 0);
    let arms = rng.count(1, 3);
    for arm in 0..arms {
        let height = rng.between(0.3, 0.9);
        let x = *rng.pick(&[-0.5, 0.5, 0.0, -0.25, 0.25]) * (1.0 - thick);
        let up = if rng.chance(0.75) { 1.0 } else { -1.0 };
        let depth = width * rng.between(0.5, 1.0);
        let post = rounded_box([thick * rng.between(0.8, 1.6), depth, height], bevel, 1 + (arm % 2) as u8);
        solid.append(&post.moved(Vector3::new(x, 0.0, up * 0.5 * height)));
    }
    for _ in 0..rng.count(0, 3) {
        let radius = rng.between(0.04, 0.12);
        let boss = loft::revolve(
            &[[radius, -0.5 * thick], [radius, thick], [radius * 0.9, thick * 1.15]],
            20,
            |_| 3,
        );
        let at = Vector3::new(rng.between(-0.42, 0.42), rng.between(-0.3, 0.3) * width, 0.0);
        solid.append(&boss.moved(at));
    }
    solid
}
