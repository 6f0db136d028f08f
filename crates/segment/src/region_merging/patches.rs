//! What lies flat on a plane: patches of another colour, which depth cannot tell from the plane.

use super::{
    adjacency::partition,
    grid::{Grid, minus, norm},
    regions::regions,
};

/// From this share of the image on a patch is the plane itself.
const PLANE_SHARE: f32 = 0.05;
/// Least colour difference to the plane.
const DIFFERENCE: f32 = 10.0;

/// Background cells in patches of another colour than that of the plane.
pub fn flat_patches(grid: &Grid, background: &[bool]) -> Vec<bool> {
    let (labels, count) = regions(grid, background, 1.0);
    let (found, _) = partition(grid, &labels, count);
    let limit = PLANE_SHARE * grid.len() as f32;
    let planes: Vec<[f32; 3]> = found.iter().filter(|r| r.cells >= limit).map(|r| r.mean_lab()).collect();
    let differs = |lab: [f32; 3]| planes.iter().all(|&plane| norm(minus(plane, lab)) > DIFFERENCE);
    let is_patch: Vec<bool> =
        found.iter().map(|r| !planes.is_empty() && r.cells < limit && differs(r.mean_lab())).collect();
    labels.iter().map(|&label| is_patch.get(label as usize).copied().unwrap_or(false)).collect()
}
