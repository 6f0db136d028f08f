//! The Gauss-Newton iterations.

use nalgebra::{Matrix3, Matrix6, Rotation3, SymmetricEigen, Vector3, Vector6};
use unopose_core::geometry::Pose;

use super::{
    super::surface::{Surface, vector},
    color::{Color, ColorField, Colors, Gain},
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
/// Distance limit, in extents, above which blurred colours count: their gradients reach as far.
const BLURRED_FROM: f64 = 0.06;
/// Deviation of the distances across the surface, in cells, and of the colours, below which they count no more.
const LEAST_DEVIATION_CELLS: f64 = 0.25;
const LEAST_COLOR_DEVIATION: f64 = 0.02;
/// Least sum of weights of a determined motion.
const MIN_WEIGHT: f64 = 6.0;

/// Query to reference camera, from `start`; `first` is the first distance limit in extents.
pub fn iterate(
    query: &Surface,
    reference: &Surface,
    colors: Option<(&Colors, &ColorField)>,
    start: Pose,
    first: f64,
    settings: &IcpSettings,
) -> Pose {
    let mut t_reference_query = start;
    let scale = reference.extent / 2.0;
    let last = settings.last_limit.max(2.5 * f64::from(reference.cell) / reference.extent) * reference.extent;
    let mut limit = first * reference.extent;
    for _ in 0..settings.iterations {
        let level = usize::from(limit > BLURRED_FROM * reference.extent);
        let colors = colors.map(|(own, field)| (own, field, level));
        let step = gauss_newton_step(query, reference, colors, &t_reference_query, limit, scale, settings);
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
    colors: Option<(&Colors, &ColorField, usize)>,
    t_reference_query: &Pose,
    limit: f64,
    scale: f64,
    settings: &IcpSettings,
) -> Option<Pose> {
    let (mut normal_matrix, mut right, mut total) = (Matrix6::zeros(), Vector6::zeros(), 0.0);
    let mut photometric: Vec<PhotometricMatch> = Vec::new();
    let mut across = 0.0;
    let step = query.points.len().div_ceil(MAX_QUERY_POINTS).max(1);
    for (index, (q, query_normal)) in query.points.iter().zip(&query.normals).enumerate().step_by(step) {
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
        across += weight * normal.dot(&error).powi(2);
        if let Some((own, field, level)) = colors {
            photometric.push(PhotometricMatch {
                arm,
                along: error - normal * normal.dot(&error),
                weight,
                query: own.0[index][level],
                reference: field.colors.0[nearest.index][level],
                gradient: field.gradients[nearest.index][level],
            });
        }
    }
    if total < MIN_WEIGHT {
        return None;
    }
    if !photometric.is_empty() {
        let floor = LEAST_DEVIATION_CELLS * f64::from(reference.cell);
        let across = (across / total).max(floor * floor);
        add_photometric(&photometric, across, &mut normal_matrix, &mut right);
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

/// Two matched points as the colours see them.
struct PhotometricMatch {
    /// From the reference's centre, in scales.
    arm: Vector3<f64>,
    /// From the reference's point to the query's, along the surface, metres.
    along: Vector3<f64>,
    weight: f64,
    query: Color,
    reference: Color,
    gradient: [Vector3<f64>; 3],
}

/// Adds the equations of the colours. Both kinds of residuals count by their own variance; `across`: that of the distances.
fn add_photometric(
    matches: &[PhotometricMatch],
    across: f64,
    normal_matrix: &mut Matrix6<f64>,
    right: &mut Vector6<f64>,
) {
    let pairs: Vec<(Color, Color)> = matches.iter().map(|m| (m.query, m.reference)).collect();
    let gains = Gain::between(&pairs);
    let error = |m: &PhotometricMatch, channel: usize| {
        m.reference[channel] + m.gradient[channel].dot(&m.along) - gains[channel].apply(m.query[channel])
    };
    let total: f64 = matches.iter().map(|m| m.weight).sum();
    for channel in 0..3 {
        let squares = matches.iter().map(|m| m.weight * error(m, channel).powi(2)).sum::<f64>();
        let factor = across / (squares / total).max(LEAST_COLOR_DEVIATION * LEAST_COLOR_DEVIATION);
        for m in matches {
            let (gradient, weight) = (m.gradient[channel], m.weight * factor);
            let moment = m.arm.cross(&gradient);
            let row = Vector6::new(moment.x, moment.y, moment.z, gradient.x, gradient.y, gradient.z);
            *normal_matrix += row * row.transpose() * weight;
            *right -= row * (error(m, channel) * weight);
        }
    }
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
