//! The reference surface: a thinned cloud with normals and a search tree.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rayon::prelude::*;

/// Cells along the cloud's extent: about 2500 points of a filled view.
const CELLS: f32 = 70.0;
/// Neighbours of a normal: a disc of about 2.5 cells' radius.
const NORMAL_NEIGHBORS: NonZeroUsize = NonZeroUsize::new(20).unwrap();
/// A point is stray when its neighbours' median distance is above this many cells.
const STRAY_CELLS: f32 = 4.0;
/// Fewest points of a surface.
const MIN_POINTS: usize = 8;

/// A reference cloud as [`super::refine`] needs it, in the reference camera's frame, metres. Kept for all queries.
pub struct IcpReference {
    pub(super) points: Vec<[f32; 3]>,
    pub(super) normals: Vec<Vector3<f64>>,
    pub(super) tree: ImmutableKdTree<f32, 3>,
    /// Side of the thinning cells.
    pub(super) cell: f32,
    pub(super) center: Vector3<f64>,
    /// Twice the distance to the centre that 95 % of the points stay below.
    pub(super) extent: f64,
}

impl IcpReference {
    /// From all points of a masked view (metres, camera frame); `None` when too few are left to make a surface.
    pub fn new(points: &[[f32; 3]]) -> Option<Self> {
        if points.len() < MIN_POINTS {
            return None;
        }
        let (_, extent) = center_and_extent(points);
        let cell = extent as f32 / CELLS;
        if !(cell.is_finite() && cell > 0.0) {
            return None;
        }
        let thinned = thin(points, cell);
        if thinned.len() < MIN_POINTS {
            return None;
        }
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&thinned);
        let surface: Vec<_> =
            thinned.par_iter().filter_map(|p| normal_at(p, &thinned, &tree, cell)).collect();
        let (points, normals): (Vec<[f32; 3]>, Vec<Vector3<f64>>) = surface.into_iter().unzip();
        if points.len() < MIN_POINTS {
            return None;
        }
        let tree = ImmutableKdTree::new_from_slice(&points);
        let (center, extent) = center_and_extent(&points);
        Some(Self { points, normals, tree, cell, center, extent })
    }

    /// The thinned cloud.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    /// Squared distance to and index of the nearest point.
    pub(super) fn nearest(&self, p: &[f32; 3]) -> (f64, usize) {
        let nearest = self.tree.nearest_one::<SquaredEuclidean>(p);
        (f64::from(nearest.distance), nearest.item as usize)
    }
}

/// Mean point of every occupied cell, in the order of the cells.
pub(super) fn thin(points: &[[f32; 3]], cell: f32) -> Vec<[f32; 3]> {
    let mut keyed: Vec<([i32; 3], u32)> =
        points.iter().zip(0..).map(|(p, i)| (p.map(|x| (x / cell).floor() as i32), i)).collect();
    keyed.sort_unstable();
    let mean = |run: &[([i32; 3], u32)]| {
        let sum = run.iter().fold([0.0f64; 3], |sum, &(_, i)| {
            std::array::from_fn(|axis| sum[axis] + f64::from(points[i as usize][axis]))
        });
        sum.map(|s| (s / run.len() as f64) as f32)
    };
    keyed.chunk_by(|a, b| a.0 == b.0).map(mean).collect()
}

/// The point with the direction of least spread among its neighbours, towards the camera; `None` for a stray point.
fn normal_at(
    point: &[f32; 3],
    points: &[[f32; 3]],
    tree: &ImmutableKdTree<f32, 3>,
    cell: f32,
) -> Option<([f32; 3], Vector3<f64>)> {
    let neighbors = tree.nearest_n::<SquaredEuclidean>(point, NORMAL_NEIGHBORS);
    if neighbors.get(neighbors.len() / 2)?.distance.sqrt() > STRAY_CELLS * cell {
        return None;
    }
    let vectors = || neighbors.iter().map(|n| vector(&points[n.item as usize]));
    let mean = vectors().sum::<Vector3<f64>>() / neighbors.len() as f64;
    let covariance = vectors().map(|p| (p - mean) * (p - mean).transpose()).sum::<Matrix3<f64>>();
    let eigen = SymmetricEigen::new(covariance);
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    Some((*point, if normal.dot(&vector(point)) > 0.0 { -normal } else { normal }))
}

fn center_and_extent(points: &[[f32; 3]]) -> (Vector3<f64>, f64) {
    let center = points.iter().map(vector).sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let mut distances: Vec<f64> = points.iter().map(|p| (vector(p) - center).norm()).collect();
    let rank = distances.len() * 95 / 100;
    let extent =
        if distances.is_empty() { 0.0 } else { *distances.select_nth_unstable_by(rank, f64::total_cmp).1 };
    (center, 2.0 * extent)
}

pub(super) fn vector(p: &[f32; 3]) -> Vector3<f64> {
    Vector3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))
}
