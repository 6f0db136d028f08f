//! Support and background planes: one-point RANSAC over cells with normals, refined by least squares.

use nalgebra::{Matrix3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::grid::{Grid, dot, tolerance};

/// Planes looked for at most.
const MAX_PLANES: usize = 4;
/// Hypotheses per plane.
const TRIALS: usize = 160;
/// Cells that a hypothesis is judged by.
const SAMPLES: usize = 3000;
/// Least cosine between a cell's normal and the plane's.
const COSINE: f32 = 0.87;
/// Least share of the measured cells.
const MIN_SHARE: f64 = 0.05;
/// Least area of a background plane, square metres. Larger faces of objects are rare; the share of the image below is
/// enough for a table that is seen from near.
const MIN_AREA: f32 = 0.07;
/// Share of the measured cells from which on a plane is background whatever its area.
const LARGE_SHARE: f64 = 0.35;

/// `normal . p = offset`, metres, the normal towards the camera.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    pub normal: [f32; 3],
    pub offset: f32,
}

impl Plane {
    /// Signed distance, positive on the camera's side.
    pub fn distance(&self, point: [f32; 3]) -> f32 {
        dot(self.normal, point) - self.offset
    }
}

/// Planes that are background, largest first, and the cells that lie on one of them.
pub fn background_planes(grid: &Grid) -> (Vec<Plane>, Vec<bool>) {
    let mut on_plane = vec![false; grid.len()];
    let measured: Vec<usize> = (0..grid.len()).filter(|&c| grid.measured(c)).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut planes: Vec<Plane> = Vec::new();
    let mut rest: Vec<usize> = measured.iter().copied().filter(|&c| grid.normals[c] != [0.0; 3]).collect();
    while planes.len() < MAX_PLANES && rest.len() > measured.len() / 50 + 20 {
        let Some(plane) = best_plane(grid, &rest, &mut rng) else { break };
        let members: Vec<usize> = rest.iter().copied().filter(|&c| is_on(grid, &plane, c)).collect();
        let share = members.len() as f64 / measured.len().max(1) as f64;
        if share < MIN_SHARE {
            break;
        }
        rest.retain(|&c| !is_on(grid, &plane, c));
        let area: f32 = members.iter().map(|&c| cell_area(grid, c)).sum();
        if area >= MIN_AREA || share >= LARGE_SHARE {
            planes.push(plane);
        }
    }
    for &cell in &measured {
        on_plane[cell] = planes.iter().any(|plane| is_near(grid, plane, cell));
    }
    (planes, on_plane)
}

fn best_plane(grid: &Grid, cells: &[usize], rng: &mut ChaCha8Rng) -> Option<Plane> {
    if cells.is_empty() {
        return None;
    }
    let sample: Vec<usize> =
        (0..SAMPLES.min(cells.len())).map(|_| cells[rng.random_range(0..cells.len())]).collect();
    let support = |plane: &Plane| sample.iter().filter(|&&c| is_on(grid, plane, c)).count();
    let mut best: Option<(usize, Plane)> = None;
    for _ in 0..TRIALS {
        let cell = cells[rng.random_range(0..cells.len())];
        let normal = grid.normals[cell];
        let plane = Plane { normal, offset: dot(normal, grid.points[cell]) };
        let count = support(&plane);
        if best.as_ref().is_none_or(|(most, _)| count > *most) {
            best = Some((count, plane));
        }
    }
    let (_, mut plane) = best?;
    for _ in 0..4 {
        let members: Vec<[f32; 3]> =
            cells.iter().filter(|&&c| is_on(grid, &plane, c)).map(|&c| grid.points[c]).collect();
        plane = fitted(&members, &plane)?;
    }
    Some(plane)
}

/// Least squares of the distances.
fn fitted(points: &[[f32; 3]], near: &Plane) -> Option<Plane> {
    if points.len() < 3 {
        return None;
    }
    let vector = |p: &[f32; 3]| Vector3::from(p.map(f64::from));
    let mean = points.iter().map(vector).sum::<Vector3<f64>>() / points.len() as f64;
    let scatter = points.iter().map(|p| (vector(p) - mean) * (vector(p) - mean).transpose());
    let eigen = scatter.sum::<Matrix3<f64>>().symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let mut normal = eigen.eigenvectors.column(least).into_owned();
    if normal.dot(&vector(&near.normal)) < 0.0 {
        normal = -normal;
    }
    Some(Plane { normal: [normal.x, normal.y, normal.z].map(|v| v as f32), offset: normal.dot(&mean) as f32 })
}

fn is_on(grid: &Grid, plane: &Plane, cell: usize) -> bool {
    is_near(grid, plane, cell) && dot(grid.normals[cell], plane.normal) > COSINE
}

fn is_near(grid: &Grid, plane: &Plane, cell: usize) -> bool {
    let point = grid.points[cell];
    plane.distance(point).abs() < tolerance(point[2])
}

/// Area that a cell sees, square metres.
fn cell_area(grid: &Grid, cell: usize) -> f32 {
    let p = grid.points[cell];
    let length = dot(p, p).sqrt().max(1e-9);
    let slant = (-dot(grid.normals[cell], p) / length).clamp(0.2, 1.0);
    (p[2] * grid.ray_step).powi(2) / slant
}
