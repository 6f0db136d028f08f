//! The Gauss-Newton iterations.

use nalgebra::{Matrix3, Matrix6, Rotation3, SymmetricEigen, Vector3, Vector6};
use unopose_core::geometry::Pose;

use super::{
    super::surface::{Surface, vector},
    motion::{MAX_ROTATION_DEG, MAX_TRANSLATION, motion},
    settings::{IcpSettings, Metric},
};

/// At most this many query points, evenly spaced, count in an iteration.
const MAX_QUERY_POINTS: usize = 1200;

/// Motion, in extents, below which the iterations end.
const CONVERGED: f64 = 1e-5;
/// Variance across a surface when that along it is 1 (Segal et al., section III.B).
const PLANE_EPSILON: f64 = 1e-2;
/// Cosine of the largest angle between the normals of matched points.
const MIN_NORMAL_COSINE: f64 = 0.5;
/// Least sum of weights of a determined motion.
const MIN_WEIGHT: f64 = 6.0;

/// Query to reference camera, from `start`; `first` is the first distance limit in extents.
pub fn iterate(
    query: &Surface,
    reference: &Surface,
    start: Pose,
    first: f64,
    settings: &IcpSettings,
) -> Pose {
    let mut t_reference_query = start;
    let scale = reference.extent / 2.0;
    let last = settings.last_limit.max(2.5 * f64::from(reference.cell) / reference.extent) * reference.extent;
    let mut limit = first * reference.extent;
    for _ in 0..settings.iterations {
        let step = gauss_newton_step(query, reference, &t_reference_query, limit, scale, settings);
        let Some(step) = step else { break };
        let moved = step * t_reference_query;
        let [shift, turn] = motion(&start.inverse(), &moved.inverse(), &reference.center);
        if shift > MAX_TRANSLATION || turn > MAX_ROTATION_DEG {
            break;
        }
        t_reference_query = moved;
        let turn = step.rotation_angle_deg(&Pose::identity()).to_radians();
        let shift = step.rotation * reference.center + step.translation - reference.center;
        if limit <= last && shift.norm() + turn * scale < CONVERGED * reference.extent {
            break;
        }
        limit = (limit * settings.shrink).max(last);
    }
    t_reference_query
}

/// One Gauss-Newton step: the small motion in the reference frame that minimises the weighted distances; `None` when too few points are near.
fn gauss_newton_step(
    query: &Surface,
    reference: &Surface,
    t_reference_query: &Pose,
    limit: f64,
    scale: f64,
    settings: &IcpSettings,
) -> Option<Pose> {
    let (mut normal_matrix, mut right, mut total) = (Matrix6::zeros(), Vector6::zeros(), 0.0);
    let step = query.points.len().div_ceil(MAX_QUERY_POINTS).max(1);
    for (q, query_normal) in query.points.iter().zip(&query.normals).step_by(step) {
        let p = t_reference_query.rotation * vector(q) + t_reference_query.translation;
        let nearest = reference.nearest(&p.cast::<f32>().into());
        let ratio = f64::from(nearest.squared_distance) / (limit * limit);
        if ratio >= 1.0 {
            continue;
        }
        let normal = reference.normals[nearest.index];
        let turned = t_reference_query.rotation * query_normal;
        if turned.dot(&normal) < MIN_NORMAL_COSINE {
            continue;
        }
        // Tukey's weight.
        let weight = (1.0 - ratio) * (1.0 - ratio);
        let error = p - vector(&reference.points[nearest.index]);
        let arm = (p - reference.center) / scale;
        match settings.metric {
            Metric::PointToPlane => {
                let moment = arm.cross(&normal);
                let row = Vector6::new(moment.x, moment.y, moment.z, normal.x, normal.y, normal.z);
                normal_matrix += row * row.transpose() * weight;
                right -= row * (normal.dot(&error) * weight);
            }
            Metric::PlaneToPlane => {
                let information = plane_information(&normal, &turned);
                // Columns: rotation about x, y, z (in 1 / scale), then translation.
                let cross = -arm.cross_matrix();
                let weighted = information * weight;
                let turned_part = cross.transpose() * weighted;
                add_block(&mut normal_matrix, 0, 0, &(turned_part * cross));
                add_block(&mut normal_matrix, 0, 3, &turned_part);
                add_block(&mut normal_matrix, 3, 0, &turned_part.transpose());
                add_block(&mut normal_matrix, 3, 3, &weighted);
                let (moment, force) = (turned_part * error, weighted * error);
                right -= Vector6::new(moment.x, moment.y, moment.z, force.x, force.y, force.z);
            }
        }
        total += weight;
    }
    if total < MIN_WEIGHT {
        return None;
    }
    let eigen = SymmetricEigen::new(normal_matrix / total);
    let solution: Vector6<f64> = eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
        .filter(|&(&value, _)| value >= settings.min_eigenvalue)
        .map(|(value, direction)| direction * (direction.dot(&right) / (total * value)))
        .sum();
    let turn = Vector3::new(solution[0], solution[1], solution[2]) / scale;
    let rotation = *Rotation3::new(turn).matrix();
    let shift = Vector3::new(solution[3], solution[4], solution[5]);
    // About the reference's centre.
    Some(Pose::new(rotation, reference.center - rotation * reference.center + shift))
}

/// Inverse of the summed covariances of two surface points, scaled so that equal normals give 1 across the surface.
fn plane_information(reference_normal: &Vector3<f64>, query_normal: &Vector3<f64>) -> Matrix3<f64> {
    let covariance = |n: &Vector3<f64>| Matrix3::identity() - n * n.transpose() * (1.0 - PLANE_EPSILON);
    let sum = covariance(reference_normal) + covariance(query_normal);
    sum.try_inverse().map_or_else(Matrix3::zeros, |inverse| inverse * (2.0 * PLANE_EPSILON))
}

fn add_block(matrix: &mut Matrix6<f64>, row: usize, column: usize, block: &Matrix3<f64>) {
    let mut view = matrix.fixed_view_mut::<3, 3>(row, column);
    view += block;
}
