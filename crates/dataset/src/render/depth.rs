//! Depth of one mesh in one pose, as a ray through every pixel centre would meet it.
//!
//! Triangles are rasterised with homogeneous edge functions (Olano and Greer, "Triangle scan conversion using
//! 2D homogeneous coordinates"): no clipping, and the two triangles at an edge evaluate exactly opposite
//! numbers there, so that no ray slips between them. Double precision keeps coverage and depth equal to a ray
//! caster's but for rays that graze an edge.

use unopose_core::{
    frame::{BoundingBox, DepthMap},
    geometry::{Intrinsics, Pose},
};

use crate::mesh::TriangleMesh;

/// Surfaces nearer than this along the axis are not drawn, metres.
const NEAR: f64 = 1e-3;

/// Depth inside the part of the image that the mesh can cover.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthWindow {
    /// Pixels the window covers, inside the image; empty (maximum = minimum) when nothing is seen.
    pub bounds: BoundingBox,
    /// Row-major depth along the axis inside `bounds`, metres, 0 where the ray misses.
    pub depth: Vec<f32>,
}

impl DepthWindow {
    /// Depth at an image pixel, 0 outside the window.
    pub fn get(&self, col: u32, row: u32) -> f32 {
        let b = &self.bounds;
        if (b.col_min..b.col_max).contains(&col) && (b.row_min..b.row_max).contains(&row) {
            self.depth[((row - b.row_min) * (b.col_max - b.col_min) + col - b.col_min) as usize]
        } else {
            0.0
        }
    }

    /// The window in an image of the given size.
    pub fn to_depth_map(&self, width: u32, height: u32) -> DepthMap {
        let mut map = DepthMap::zeros(width, height);
        for row in self.bounds.row_min..self.bounds.row_max.min(height) {
            for col in self.bounds.col_min..self.bounds.col_max.min(width) {
                map.data[(row * width + col) as usize] = self.get(col, row);
            }
        }
        map
    }
}

/// Renders the depth of `mesh` (both sides of its faces) in an image of `width` x `height` pixels.
pub fn render_depth(
    mesh: &TriangleMesh,
    t_camera_object: &Pose,
    camera: &Intrinsics,
    width: u32,
    height: u32,
) -> DepthWindow {
    let corners: Vec<[f64; 3]> =
        mesh.vertices.iter().map(|v| homogeneous(v, t_camera_object, camera)).collect();
    let triangles: Vec<Triangle> = mesh
        .faces
        .iter()
        .filter_map(|face| {
            let [a, b, c] = face.map(|i| corners.get(i as usize).copied());
            Triangle::new([a?, b?, c?], width, height)
        })
        .collect();
    let empty = BoundingBox { col_min: width, row_min: height, col_max: 0, row_max: 0 };
    let bounds = triangles.iter().fold(empty, |b, t| BoundingBox {
        col_min: b.col_min.min(t.bounds.col_min),
        row_min: b.row_min.min(t.bounds.row_min),
        col_max: b.col_max.max(t.bounds.col_max),
        row_max: b.row_max.max(t.bounds.row_max),
    });
    if triangles.is_empty() {
        let bounds = BoundingBox { col_min: 0, row_min: 0, col_max: 0, row_max: 0 };
        return DepthWindow { bounds, depth: Vec::new() };
    }
    let stride = (bounds.col_max - bounds.col_min) as usize;
    let mut depth = vec![f32::INFINITY; stride * (bounds.row_max - bounds.row_min) as usize];
    for triangle in &triangles {
        let b = &triangle.bounds;
        for row in b.row_min..b.row_max {
            let start = (row - bounds.row_min) as usize * stride;
            let span = (b.col_min - bounds.col_min) as usize..(b.col_max - bounds.col_min) as usize;
            triangle.draw_row(f64::from(row), f64::from(b.col_min), &mut depth[start..start + stride][span]);
        }
    }
    for z in &mut depth {
        if z.is_infinite() {
            *z = 0.0;
        }
    }
    DepthWindow { bounds, depth }
}

/// `z * (u, v, 1)` of a vertex, which needs no division and has no pole at the camera plane.
fn homogeneous(vertex: &[f32; 3], t_camera_object: &Pose, camera: &Intrinsics) -> [f64; 3] {
    let p = t_camera_object.transform(&nalgebra::Point3::from(vertex.map(f64::from)));
    [camera.fx * p.x + camera.cx * p.z, camera.fy * p.y + camera.cy * p.z, p.z]
}

/// A triangle ready to be drawn.
struct Triangle {
    /// Coefficients (of u, v and 1) of the three edge functions.
    edges: [[f64; 3]; 3],
    /// Sum of the edge functions; depth is `volume` divided by it.
    sum: [f64; 3],
    volume: f64,
    /// Pixels it can cover.
    bounds: BoundingBox,
}

impl Triangle {
    /// `None` when it covers no pixel centre of the image or is seen exactly from the side.
    fn new(q: [[f64; 3]; 3], width: u32, height: u32) -> Option<Self> {
        let bounds = pixel_bounds(&q, width, height)?;
        let edges = [cross(&q[1], &q[2]), cross(&q[2], &q[0]), cross(&q[0], &q[1])];
        let sum = std::array::from_fn(|i| edges[0][i] + edges[1][i] + edges[2][i]);
        let volume = (0..3).map(|i| q[0][i] * edges[0][i]).sum();
        (volume != 0.0).then_some(Self { edges, sum, volume, bounds })
    }

    fn draw_row(&self, v: f64, first_u: f64, depth: &mut [f32]) {
        let constant = |e: &[f64; 3]| e[1] * v + e[2];
        let [c0, c1, c2] = [0, 1, 2].map(|i| constant(&self.edges[i]));
        let [s0, s1, s2] = [0, 1, 2].map(|i| self.edges[i][0]);
        let (sum_slope, sum_constant) = (self.sum[0], constant(&self.sum));
        for (i, nearest) in depth.iter_mut().enumerate() {
            let u = first_u + i as f64;
            let (e0, e1, e2) = (s0 * u + c0, s1 * u + c1, s2 * u + c2);
            let inside = (e0 >= 0.0 && e1 >= 0.0 && e2 >= 0.0) || (e0 <= 0.0 && e1 <= 0.0 && e2 <= 0.0);
            if inside {
                let z = self.volume / (sum_slope * u + sum_constant);
                if z >= NEAR && (z as f32) < *nearest {
                    *nearest = z as f32;
                }
            }
        }
    }
}

/// Pixels whose centres may lie in the projected triangle, after cutting it at the near plane.
fn pixel_bounds(q: &[[f64; 3]; 3], width: u32, height: u32) -> Option<BoundingBox> {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut include = |p: [f64; 3]| {
        for axis in 0..2 {
            let pixel = p[axis] / p[2];
            low[axis] = low[axis].min(pixel);
            high[axis] = high[axis].max(pixel);
        }
    };
    for i in 0..3 {
        let (a, b) = (q[i], q[(i + 1) % 3]);
        if a[2] >= NEAR {
            include(a);
        }
        if (a[2] >= NEAR) != (b[2] >= NEAR) {
            let share = (NEAR - a[2]) / (b[2] - a[2]);
            include([a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), NEAR]);
        }
    }
    // Half a thousandth of a pixel covers the rounding of the division; the edge functions decide.
    let first = |x: f64| (x - 5e-4).ceil().max(0.0);
    let end = |x: f64, size: u32| (x + 5e-4).floor().min(f64::from(size) - 1.0) + 1.0;
    let (col_min, col_max) = (first(low[0]), end(high[0], width));
    let (row_min, row_max) = (first(low[1]), end(high[1], height));
    (col_min < col_max && row_min < row_max).then_some(BoundingBox {
        col_min: col_min as u32,
        row_min: row_min as u32,
        col_max: col_max as u32,
        row_max: row_max as u32,
    })
}

/// Exactly antisymmetric, which makes shared edges watertight.
fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
#[path = "depth_tests.rs"]
mod tests;
