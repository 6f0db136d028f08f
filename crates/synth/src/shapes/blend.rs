//! Smooth unions of primitives, meshed from their signed distance by surface nets (Gibson 1998).

use nalgebra::{Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;

use super::solid::Solid;
use crate::random::Draw;

/// Grid cells along the longest side.
const CELLS: usize = 44;

/// A primitive, lengths in its own frame.
enum Shape {
    Ellipsoid([f32; 3]),
    RoundBox([f32; 3], f32),
    /// Segment half length along z and radius.
    Capsule(f32, f32),
    /// Ring radius and thickness.
    Torus(f32, f32),
}

/// A placed primitive.
struct Part {
    shape: Shape,
    center: Vector3<f32>,
    t_local_world: Rotation3<f32>,
}

impl Part {
    /// Signed distance (for the ellipsoid a bound of it), negative inside.
    fn distance(&self, p: &Vector3<f32>) -> f32 {
        let q = self.t_local_world * (p - self.center);
        match &self.shape {
            Shape::Ellipsoid(half) => {
                let scaled = Vector3::from_fn(|i, _| q[i] / half[i]);
                let gradient = Vector3::from_fn(|i, _| scaled[i] / half[i]);
                let k = scaled.norm();
                if k < 1e-6 {
                    -half.iter().copied().fold(f32::MAX, f32::min)
                } else {
                    k * (k - 1.0) / gradient.norm()
                }
            }
            Shape::RoundBox(half, round) => {
                let d = Vector3::from_fn(|i, _| q[i].abs() - half[i] + round);
                d.map(|x| x.max(0.0)).norm() + d.max().min(0.0) - round
            }
            Shape::Capsule(half, radius) => (q - Vector3::z() * q.z.clamp(-half, *half)).norm() - radius,
            Shape::Torus(ring, thick) => ((q.xy().norm() - ring).powi(2) + q.z * q.z).sqrt() - thick,
        }
    }
}

/// Polynomial smooth minimum.
fn smooth_min(a: f32, b: f32, width: f32) -> f32 {
    let h = (width - (a - b).abs()).max(0.0) / width;
    a.min(b) - 0.25 * h * h * width
}

/// Two to five primitives, each joined smoothly to an earlier one.
pub(super) fn blend(rng: &mut ChaCha8Rng) -> Solid {
    let width = rng.between(0.05, 0.4);
    let mut parts: Vec<Part> = Vec::new();
    for k in 0..rng.count(2, 5) {
        let size = rng.between(0.3, 1.0);
        let mut side = || size * rng.between(0.25, 0.6);
        let (a, b, c) = (side(), side(), side());
        let shape = match rng.count(0, 3) {
            0 => Shape::Ellipsoid([a, b, c]),
            1 => Shape::RoundBox([a, b, c], 0.3 * a.min(b).min(c)),
            2 => Shape::Capsule(a * 1.6, b * 0.6),
            _ => Shape::Torus(a * 1.3, 0.35 * b + 0.05),
        };
        let center = match k {
            0 => Vector3::zeros(),
            _ => parts[rng.count(0, k - 1)].center + rng.unit_vector() * rng.between(0.25, 0.6),
        };
        let t_local_world = Rotation3::from_scaled_axis(rng.unit_vector() * rng.between(0.0, 3.1));
        parts.push(Part { shape, center, t_local_world });
    }
    let field = |p: &Vector3<f32>| parts.iter().map(|s| s.distance(p)).reduce(|a, b| smooth_min(a, b, width));
    let nearest = |p: &Vector3<f32>| {
        let distances = parts.iter().map(|s| s.distance(p)).enumerate();
        distances.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(i, _)| i as u8)
    };
    surface_nets(&|p| field(p).unwrap_or(1.0), &nearest, &parts)
}

fn surface_nets(
    field: &dyn Fn(&Vector3<f32>) -> f32,
    part: &dyn Fn(&Vector3<f32>) -> u8,
    parts: &[Part],
) -> Solid {
    let reach = |p: &Part| match p.shape {
        Shape::Ellipsoid(h) | Shape::RoundBox(h, _) => Vector3::from(h).norm(),
        Shape::Capsule(half, radius) => half + radius,
        Shape::Torus(ring, thick) => ring + thick,
    };
    let margin = Vector3::repeat(0.12);
    let low =
        parts.iter().map(|p| p.center.add_scalar(-reach(p))).reduce(|a, b| a.inf(&b)).unwrap_or_default();
    let high =
        parts.iter().map(|p| p.center.add_scalar(reach(p))).reduce(|a, b| a.sup(&b)).unwrap_or_default();
    let (low, high) = (low - margin, high + margin);
    let step = (high - low).max() / CELLS as f32;
    let n: [usize; 3] = std::array::from_fn(|i| ((high[i] - low[i]) / step).ceil() as usize + 2);
    let at = |i: [usize; 3]| low + Vector3::new(i[0] as f32, i[1] as f32, i[2] as f32) * step;
    let flat = |i: [usize; 3]| (i[2] * n[1] + i[1]) * n[0] + i[0];
    let cells = (0..n[2]).flat_map(|z| (0..n[1]).flat_map(move |y| (0..n[0]).map(move |x| [x, y, z])));
    let values: Vec<f32> = cells.clone().map(|i| field(&at(i))).collect();
    let mut solid = Solid::default();
    let mut vertex = vec![u32::MAX; values.len()];
    for i in cells.clone().filter(|i| (0..3).all(|k| i[k] + 1 < n[k])) {
        let corner = |c: usize| [i[0] + (c & 1), i[1] + (c >> 1 & 1), i[2] + (c >> 2 & 1)];
        let (mut sum, mut count) = (Vector3::zeros(), 0.0);
        for (a, b) in (0..8).flat_map(|a| [1, 2, 4].map(|bit| (a, a | bit))).filter(|(a, b)| a != b) {
            let (va, vb) = (values[flat(corner(a))], values[flat(corner(b))]);
            if (va < 0.0) != (vb < 0.0) {
                sum += at(corner(a)).lerp(&at(corner(b)), va / (va - vb));
                count += 1.0;
            }
        }
        if count > 0.0 {
            let mut p = sum / count;
            // One Newton step onto the surface.
            let e = 0.1 * step;
            let gradient = Vector3::from_fn(|k, _| {
                let shift = Vector3::from_fn(|j, _| if j == k { e } else { 0.0 });
                (field(&(p + shift)) - field(&(p - shift))) / (2.0 * e)
            });
            let correction = gradient * (field(&p) / gradient.norm_squared().max(0.1));
            p -= correction.cap_magnitude(0.4 * step);
            vertex[flat(i)] = solid.push(p, part(&p));
        }
    }
    for i in cells.filter(|i| (0..3).all(|k| i[k] > 0 && i[k] + 1 < n[k])) {
        for axis in 0..3 {
            let mut next = i;
            next[axis] += 1;
            let (inside, outside) = (values[flat(i)] < 0.0, values[flat(next)] < 0.0);
            if inside == outside {
                continue;
            }
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let quad = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(du, dv)| {
                let mut cell = i;
                (cell[u], cell[v]) = (cell[u] - du, cell[v] - dv);
                vertex[flat(cell)]
            });
            // Counter-clockwise seen from outside: along +axis when the inside lies behind.
            let q = if inside { [quad[0], quad[3], quad[2], quad[1]] } else { quad };
            let q = [q[0], q[3], q[2], q[1]];
            solid.mesh.faces.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
        }
    }
    solid
}
