//! A cloud downsampled on a voxel grid, with normals and a search tree.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Vector3, Vector6};
use rayon::prelude::*;
use unopose_core::geometry::Pose;

use super::RegistrationError;

/// Neighbours of a normal: a disc of about 2.5 cells' radius.
const NORMAL_NEIGHBORS: NonZeroUsize = NonZeroUsize::new(20).unwrap();
/// A point is an outlier when its neighbours' median distance is above this many cells.
const OUTLIER_CELLS: f32 = 4.0;
/// Eigenvalue of the normalised normal equations below which nothing but noise holds a direction.
const UNCONSTRAINED_EIGENVALUE: f64 = 1e-3;
/// Fewest points of a surface.
const MIN_POINTS: usize = 8;

/// A downsampled surface in its camera's frame, metres.
pub struct Surface {
    /// Mean point of every occupied cell.
    pub points: Vec<[f32; 3]>,
    /// Unit vectors towards the camera.
    pub(super) normals: Vec<Vector3<f64>>,
    tree: ImmutableKdTree<f32, 3>,
    /// Side of the voxel grid's cells.
    pub(super) cell: f32,
    /// Mean of the points.
    pub(super) center: Vector3<f64>,
    /// Twice the distance to the centre that 95 % of the points stay below.
    pub(super) extent: f64,
}

/// A point near another one.
#[derive(Clone, Copy, Debug)]
pub struct Neighbor {
    pub index: usize,
    pub squared_distance: f32,
}

impl Surface {
    /// One point per occupied cell of side `cell`. `view` names the cloud in errors.
    pub fn new(points: &[[f32; 3]], cell: f32, view: &'static str) -> Result<Self, RegistrationError> {
        let too_few = |points| RegistrationError::TooFewPoints { view, points, minimum: MIN_POINTS };
        let downsampled = voxel_downsampled(&finite(points), cell);
        if downsampled.len() < MIN_POINTS {
            return Err(too_few(downsampled.len()));
        }
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&downsampled);
        let surface: Vec<_> = downsampled
            .par_iter()
            .with_min_len(64)
            .filter_map(|p| normal_at(p, &downsampled, &tree, cell))
            .collect();
        let (points, normals): (Vec<[f32; 3]>, Vec<Vector3<f64>>) = surface.into_iter().unzip();
        if points.len() < MIN_POINTS {
            return Err(too_few(points.len()));
        }
        let tree = ImmutableKdTree::new_from_slice(&points);
        let (center, extent) = center_and_extent(&points);
        Ok(Self { points, normals, tree, cell, center, extent })
    }

    /// With a pose to find: an error for a plane or a sphere, which three or more directions of motion map onto themselves.
    pub(super) fn with_pose(self) -> Result<Self, RegistrationError> {
        let unconstrained = self.unconstrained_directions();
        if unconstrained < 3 { Ok(self) } else { Err(RegistrationError::Degenerate { unconstrained }) }
    }

    /// The same surface seen from elsewhere.
    #[cfg(test)]
    pub(super) fn moved(&self, motion: &Pose) -> Self {
        let points: Vec<[f32; 3]> = self.points.iter().map(|p| motion.transform_f32(p)).collect();
        Self {
            tree: ImmutableKdTree::new_from_slice(&points),
            normals: self.normals.iter().map(|n| motion.rotation * n).collect(),
            center: motion.rotation * self.center + motion.translation,
            points,
            ..*self
        }
    }

    /// Nearest point.
    pub(super) fn nearest(&self, p: &[f32; 3]) -> Neighbor {
        let nearest = self.tree.nearest_one::<SquaredEuclidean>(p);
        Neighbor { index: nearest.item as usize, squared_distance: nearest.distance }
    }

    /// Indices of the `count` nearest points, the nearest first.
    pub(super) fn nearest_n(&self, p: &[f32; 3], count: usize) -> Vec<usize> {
        let Some(count) = NonZeroUsize::new(count) else { return Vec::new() };
        self.tree.nearest_n::<SquaredEuclidean>(p, count).iter().map(|n| n.item as usize).collect()
    }

    /// All points closer than `radius`, in no particular order.
    pub(super) fn within(&self, p: &[f32; 3], radius: f32) -> Vec<Neighbor> {
        let found = self.tree.within_unsorted::<SquaredEuclidean>(p, radius * radius);
        let neighbor = |n: &kiddo::NearestNeighbour<f32, u64>| Neighbor {
            index: n.item as usize,
            squared_distance: n.distance,
        };
        found.iter().map(neighbor).collect()
    }

    /// Directions of motion that the normals do not constrain: of the six, those along which all points slide on themselves. Three
    /// for a plane, one for a cylinder or a body of revolution, three for a sphere.
    fn unconstrained_directions(&self) -> usize {
        let rows = self.points.iter().zip(&self.normals).map(|(p, n)| {
            let moment = ((vector(p) - self.center) / (0.5 * self.extent)).cross(n);
            Vector6::new(moment.x, moment.y, moment.z, n.x, n.y, n.z)
        });
        let sum = rows.map(|row| row * row.transpose()).sum::<Matrix6<f64>>() / self.points.len() as f64;
        SymmetricEigen::new(sum).eigenvalues.iter().filter(|&&value| value < UNCONSTRAINED_EIGENVALUE).count()
    }

    /// Share of the points of another surface that lie closer than `distance` metres to this one once moved.
    pub(super) fn inlier_ratio(&self, other: &Surface, t_this_other: &Pose, distance: f32) -> f64 {
        let near = |p: &&[f32; 3]| {
            self.nearest(&t_this_other.transform_f32(p)).squared_distance < distance * distance
        };
        other.points.iter().filter(near).count() as f64 / other.points.len().max(1) as f64
    }
}

/// Twice the distance to the mean that 95 % of the points stay below, metres.
pub fn extent(points: &[[f32; 3]], view: &'static str) -> Result<f64, RegistrationError> {
    let points = finite(points);
    if points.len() < MIN_POINTS {
        return Err(RegistrationError::TooFewPoints { view, points: points.len(), minimum: MIN_POINTS });
    }
    let (_, extent) = center_and_extent(&points);
    // A tenth of a millimetre is below the resolution of any depth sensor.
    if extent > 1e-4 { Ok(extent) } else { Err(RegistrationError::NoExtent { view, extent }) }
}

/// The points whose coordinates all are finite.
pub fn finite(points: &[[f32; 3]]) -> Vec<[f32; 3]> {
    points.iter().copied().filter(|p| p.iter().all(|x| x.is_finite())).collect()
}

/// Mean point of every occupied cell, in the order of the cells.
fn voxel_downsampled(points: &[[f32; 3]], cell: f32) -> Vec<[f32; 3]> {
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

/// The point with the direction of least variance among its neighbours, towards the camera; `None` for an outlier.
fn normal_at(
    point: &[f32; 3],
    points: &[[f32; 3]],
    tree: &ImmutableKdTree<f32, 3>,
    cell: f32,
) -> Option<([f32; 3], Vector3<f64>)> {
    let neighbors = tree.nearest_n::<SquaredEuclidean>(point, NORMAL_NEIGHBORS);
    if neighbors.get(neighbors.len() / 2)?.distance.sqrt() > OUTLIER_CELLS * cell {
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

pub fn vector(p: &[f32; 3]) -> Vector3<f64> {
    Vector3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))
}
