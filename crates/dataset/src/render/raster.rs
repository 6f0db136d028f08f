//! Perspective triangle rasteriser shared by colour, masks and shadow maps.

use nalgebra::{Point3, Vector3};
use unopose_core::geometry::{Intrinsics, Pose};

/// Faces with a vertex nearer than this to the camera plane are left out, metres.
const NEAR: f32 = 0.02;

/// A vertex in front of a camera: pixel position and inverse depth.
#[derive(Clone, Copy, Debug)]
pub struct Projected {
    pub u: f32,
    pub v: f32,
    /// 1 / z; 0 when the vertex is not in front of the camera.
    pub inv_z: f32,
}

/// A pixel covered by a face.
#[derive(Clone, Copy, Debug)]
pub struct Fragment {
    pub col: i32,
    pub row: i32,
    pub inv_z: f32,
    /// Weights of the second and third corner on the screen, each times the corner's inverse depth.
    scaled: [f32; 2],
}

impl Fragment {
    /// Perspective-correct weights of the second and third corner.
    pub fn weights(&self) -> [f32; 2] {
        let z = 1.0 / self.inv_z;
        self.scaled.map(|w| w * z)
    }
}

/// Pixels `min <= (col, row) < max`.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    pub min: [i32; 2],
    pub max: [i32; 2],
}

/// Projects object vertices.
pub fn project(vertices: &[[f32; 3]], t_camera_object: &Pose, intrinsics: &Intrinsics) -> Vec<Projected> {
    let rotation = t_camera_object.rotation.cast::<f32>();
    let translation: Vector3<f32> = t_camera_object.translation.cast();
    let [fx, fy, cx, cy] = [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy].map(|x| x as f32);
    vertices
        .iter()
        .map(|v| {
            let p = Point3::from(rotation * Vector3::from(*v) + translation);
            if p.z < NEAR {
                return Projected { u: 0.0, v: 0.0, inv_z: 0.0 };
            }
            let inv_z = 1.0 / p.z;
            Projected { u: fx * p.x * inv_z + cx, v: fy * p.y * inv_z + cy, inv_z }
        })
        .collect()
}

/// Calls `hit` for every pixel centre (integer coordinates) of the window inside the triangle, edges included.
pub fn triangle(corners: [Projected; 3], window: &Window, mut hit: impl FnMut(Fragment)) {
    let [a, b, c] = corners;
    if a.inv_z <= 0.0 || b.inv_z <= 0.0 || c.inv_z <= 0.0 {
        return;
    }
    let area = (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let span = |x: f32, y: f32, z: f32, axis: usize| {
        let (low, high) = (x.min(y).min(z), x.max(y).max(z));
        ceil(low).max(window.min[axis])..floor(high).saturating_add(1).min(window.max[axis])
    };
    let (cols, rows) = (span(a.u, b.u, c.u, 0), span(a.v, b.v, c.v, 1));
    if cols.is_empty() || rows.is_empty() {
        return;
    }
    let inv_area = 1.0 / area;
    // Barycentric weights of b and c are affine in the pixel position.
    let weight_b = [(c.v - a.v) * inv_area, -(c.u - a.u) * inv_area];
    let weight_c = [-(b.v - a.v) * inv_area, (b.u - a.u) * inv_area];
    for row in rows {
        let dv = row as f32 - a.v;
        let (row_b, row_c) = (weight_b[1] * dv, weight_c[1] * dv);
        for col in cols.clone() {
            let du = col as f32 - a.u;
            let wb = weight_b[0] * du + row_b;
            let wc = weight_c[0] * du + row_c;
            let wa = 1.0 - wb - wc;
            // Slightly inclusive, so that rounding opens no gap between neighbouring faces.
            if wa < -1e-6 || wb < -1e-6 || wc < -1e-6 {
                continue;
            }
            let inv_z = wa * a.inv_z + wb * b.inv_z + wc * c.inv_z;
            hit(Fragment { col, row, inv_z, scaled: [wb * b.inv_z, wc * c.inv_z] });
        }
    }
}

/// Without a call into libm on plain x86-64; saturates.
fn floor(x: f32) -> i32 {
    let truncated = x as i32;
    truncated.saturating_sub(i32::from(truncated as f32 > x))
}

fn ceil(x: f32) -> i32 {
    floor(-x).saturating_neg()
}
