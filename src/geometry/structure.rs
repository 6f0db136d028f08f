//! Geometric structure of a small cloud: pairwise distances and triplet angles (GeoTransformer), in the units that
//! the sinusoidal embedding takes.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::procrustes::vector;

/// Inputs of the geometric structure embedding for `size` points, the background point first.
#[derive(Clone, Debug, PartialEq)]
pub struct StructureIndices {
    pub size: usize,
    /// Angles per pair of points.
    pub k: usize,
    /// `[size, size]`, distance / sigma_d.
    pub distances: Vec<f32>,
    /// `[size, size, k]`, angle between the direction to the other point and to each of the k nearest / sigma_a.
    pub angles: Vec<f32>,
}

/// Distances and angles between all pairs of `points` (frame coordinates with the background point (1, 1, 1) in
/// front). `sigma_d` in the points' unit, `sigma_a` in degrees. A point with fewer than `k` others gets angles 0.
pub fn structure_indices(points: &[[f32; 3]], sigma_d: f32, sigma_a: f32, k: usize) -> StructureIndices {
    let size = points.len();
    let points: Vec<Vector3<f64>> = points.iter().map(vector).collect();
    let per_degree = 180.0 / (sigma_a * std::f32::consts::PI);
    let mut distances = vec![0.0f32; size * size];
    let mut angles = vec![0.0f32; size * size * k];
    distances
        .par_chunks_mut(size.max(1))
        .zip(angles.par_chunks_mut((size * k).max(1)))
        .enumerate()
        .with_min_len(16)
        .for_each(|(i, (row, angle_row))| {
            let offsets: Vec<Vector3<f64>> = points.iter().map(|p| p - points[i]).collect();
            for (d, offset) in row.iter_mut().zip(&offsets) {
                *d = (offset.norm() / sigma_d as f64) as f32;
            }
            for (slot, neighbor) in nearest_others(&offsets, k).into_iter().enumerate() {
                let to_neighbor = offsets[neighbor];
                for (j, offset) in offsets.iter().enumerate() {
                    // Adding 0 turns -0 into 0: a pair of the same point has angle 0, not pi.
                    let (sin, cos) = (to_neighbor.cross(offset).norm(), to_neighbor.dot(offset) + 0.0);
                    angle_row[j * k + slot] = (sin as f32).atan2(cos as f32) * per_degree;
                }
            }
        });
    StructureIndices { size, k, distances, angles }
}

/// The 2nd to (k+1)-th of the shortest offsets: the first is dropped, whichever point it is.
fn nearest_others(offsets: &[Vector3<f64>], k: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..offsets.len()).collect();
    let key = |&i: &usize| offsets[i].norm_squared();
    let kept = (k + 1).min(order.len());
    if kept < order.len() {
        order.select_nth_unstable_by(kept, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
    }
    order.truncate(kept);
    order.sort_by(|a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
    order.into_iter().skip(1).collect()
}
