//! Fine pose: every query point's soft match, weighted registration, and the share of points that fit.

use rayon::prelude::*;

use super::{Assignment, Pose, nearest_distances, weighted_procrustes};

/// Assigned weight below which a point does not count in the registration.
const WEIGHT_THRESHOLD: f32 = 1e-3;
/// Distance to the reference (radii) up to which a query point fits.
const FITTING_DISTANCE: f32 = 0.15;

/// The registered pose and what led to it.
#[derive(Clone, Debug)]
pub struct FinePose {
    /// Reference to query in the units of the clouds.
    pub pose: Pose,
    /// Share of matched points that fit, times the share of matched points.
    pub score: f64,
    /// Assigned weight per query point, `[N]`.
    pub weights: Vec<f32>,
    /// Soft-matched reference point per query point, `[N]`; the origin for points matched to the background.
    pub predicted: Vec<[f32; 3]>,
    /// Distance of every query point to the reference under the pose, `[N]`.
    pub distances: Vec<f32>,
}

/// Pose of `reference` in `query` (both in radii) from the assignment of their points.
///
/// # Panics
/// When the clouds' sizes differ from the assignment's.
pub fn fine_pose(assignment: &Assignment, query: &[[f32; 3]], reference: &[[f32; 3]]) -> FinePose {
    assert_eq!((query.len(), reference.len()), (assignment.queries(), assignment.references()));
    // Background columns contribute nothing: their homogeneous coordinates are zero.
    let homogeneous: Vec<[f32; 4]> = reference
        .iter()
        .zip(&assignment.label_reference)
        .map(|(p, &label)| if label > 0 { [p[0], p[1], p[2], 1.0] } else { [0.0; 4] })
        .collect();
    let (predicted, weights): (Vec<[f32; 3]>, Vec<f32>) = (0..query.len())
        .into_par_iter()
        .with_min_len(32)
        .map(|i| {
            if assignment.label_query[i] == 0 {
                return ([0.0; 3], 0.0);
            }
            let [x, y, z, total] = weighted_sum(assignment.row(i), &homogeneous);
            let scale = 1.0 / (total + 1e-6);
            ([x * scale, y * scale, z * scale], total)
        })
        .unzip();
    let pose = weighted_procrustes(&predicted, query, Some(&weights), WEIGHT_THRESHOLD);

    let inverse = pose.inverse();
    let moved: Vec<[f32; 3]> = query.iter().map(|q| inverse.transform_f32(q)).collect();
    let distances = nearest_distances(&moved, reference);
    let matched = assignment.label_query.iter().filter(|&&l| l > 0).count() as f64;
    let fitting = distances
        .iter()
        .zip(&assignment.label_query)
        .filter(|&(&d, &label)| label > 0 && d < FITTING_DISTANCE)
        .count() as f64;
    let score = fitting / (matched + 1e-8) * (matched / query.len().max(1) as f64);
    FinePose { pose, score, weights, predicted, distances }
}

/// Sum of `weights[j] * points[j]` in four independent accumulators.
fn weighted_sum(weights: &[f32], points: &[[f32; 4]]) -> [f32; 4] {
    let mut lanes = [[0.0f32; 4]; 4];
    let (weight_runs, weight_rest) = weights.as_chunks::<4>();
    let (point_runs, point_rest) = points.as_chunks::<4>();
    for (w, p) in weight_runs.iter().zip(point_runs) {
        for l in 0..4 {
            (0..4).for_each(|c| lanes[l][c] += w[l] * p[l][c]);
        }
    }
    for (&w, p) in weight_rest.iter().zip(point_rest) {
        (0..4).for_each(|c| lanes[0][c] += w * p[c]);
    }
    std::array::from_fn(|c| (lanes[0][c] + lanes[1][c]) + (lanes[2][c] + lanes[3][c]))
}
