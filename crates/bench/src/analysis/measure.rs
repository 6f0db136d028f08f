//! One pair's stages against its true pose.

use unopose_core::geometry::{Pose, nearest_distances};
use unopose_eval::metrics::EvalObject;
use unopose_infer::{
    CloudPair, InferError, Matched, PoseEstimator, Query, Trace, refine_with, sparse_points,
};
use unopose_pairs::data::{metric_pose, normalised_pose};

use super::{
    local_frames::frame_differences,
    record::{PoseError, PrecisionRecall, StageMeasures},
};

/// Coarse matches count as right up to here, radii: about the spacing of the sparse points.
pub(crate) const COARSE_DISTANCE: f32 = 0.3;
/// Fine matches count as right up to here, radii.
pub(crate) const FINE_DISTANCE: f32 = 0.1;
/// Points overlap when the other cloud has a point this near, radii (as in training).
const OVERLAP_DISTANCE: f32 = 0.15;
/// Overlaps above this are predicted.
const PREDICTED: f32 = 0.5;

/// The true poses of a pair: object to camera in both views.
pub(crate) struct Truth<'a> {
    pub t_query_object: Pose,
    pub t_reference_object: Pose,
    pub object: &'a EvalObject,
}

impl Truth<'_> {
    /// Of the relative poses that the object's symmetries make equal, the one turned least against `near`.
    pub(crate) fn relative(&self, near: &Pose) -> Pose {
        let t_object_reference = self.t_reference_object.inverse();
        let poses = self.object.symmetries.iter().map(|s| self.t_query_object * *s * t_object_reference);
        let closest = poses.min_by(|a, b| a.rotation_angle_deg(near).total_cmp(&b.rotation_angle_deg(near)));
        closest.unwrap_or(self.t_query_object * t_object_reference)
    }

    /// Object to query camera that a relative pose amounts to.
    pub(crate) fn implied(&self, t_query_reference: &Pose) -> Pose {
        *t_query_reference * self.t_reference_object
    }

    /// Error of a relative pose, against the nearest of the equal truths.
    pub(crate) fn error(&self, t_query_reference: &Pose) -> PoseError {
        let truth = self.relative(t_query_reference);
        let shift = self.implied(t_query_reference).translation_distance(&self.implied(&truth));
        PoseError {
            rotation_deg: truth.rotation_angle_deg(t_query_reference),
            translation: shift / self.object.diameter,
        }
    }
}

/// All stages of a trace.
pub(crate) fn measure(
    estimator: &PoseEstimator,
    query: &Query<'_>,
    trace: &Trace,
    network: &Pose,
    truth: &Truth<'_>,
) -> Result<StageMeasures, InferError> {
    let (cloud, stages) = (&trace.cloud, &trace.stages);
    let CloudPair { reference, radius, .. } = query.reference.pair(cloud);
    let relative = truth.relative(network);
    let normalised = |pose: &Pose| normalised_pose(pose, cloud.center, reference.center, radius);
    let true_pose = normalised(&relative);
    let last = stages.fine().map_or(&stages.coarse, |fine| &fine.matched);
    let (sparse_query, sparse_reference) = (sparse_points(cloud), sparse_points(reference));
    let last_points = match stages.fine() {
        Some(_) => [&cloud.points, &reference.points],
        None => [&sparse_query, &sparse_reference],
    };
    let t_reference_query = true_pose.inverse();
    let distances = [
        nearest_distances(&moved(&t_reference_query, last_points[0]), last_points[1]),
        nearest_distances(&moved(&true_pose, last_points[1]), last_points[0]),
    ];
    let hypotheses = &stages.coarse_pose.hypotheses;
    // Symmetric truths are equal here, too; without symmetries this is the angle to the only one.
    let angle = |index: usize| {
        let t = metric_pose(&hypotheses[index].pose, cloud.center, reference.center, radius);
        t.rotation_angle_deg(&truth.relative(&t))
    };
    let kept = stages.coarse_pose.kept.iter().map(|&index| angle(index));
    // Every tenth of thousands: the best of them is little different, the symmetries make each expensive.
    let step = if truth.object.symmetries.len() > 1 { 10 } else { 1 };
    let all = (0..hypotheses.len()).step_by(step).map(angle);
    let [overlap_query, overlap_reference] =
        [0, 1].map(|side| predicted(&last.overlap[side], &distances[side]));
    let (fine_distance, fine_inliers) = fine_matches(trace, &t_reference_query, &distances[0]);
    let from_truth = estimator.fine_from(query, &relative)?;
    let refined_truth = estimator.refinement().settings().and_then(|settings| {
        let points = query.frame.masked_points(query.mask);
        let surface = query.reference.surface()?;
        Some(truth.error(&refine_with(&points, surface, &relative, &settings).t_query_reference))
    });
    Ok(StageMeasures {
        coarse_inliers: coarse_inliers(&stages.coarse, &sparse_query, &sparse_reference, &t_reference_query),
        drawn_inliers: drawn_inliers(trace, &sparse_query, &sparse_reference, &t_reference_query),
        best_hypothesis_deg: all.min_by(f64::total_cmp),
        best_kept_deg: kept.min_by(f64::total_cmp),
        coarse: truth.error(&trace.estimate.t_query_reference_coarse),
        fine_distance,
        fine_inliers,
        fine: truth.error(network),
        fine_from_truth: from_truth.map(|pose| truth.error(&pose)),
        refined: truth.error(&trace.estimate.t_query_reference),
        refined_truth,
        overlap_query,
        overlap_reference,
        local_frames: frame_differences(
            &cloud.points,
            &reference.points,
            &t_reference_query,
            estimator.config(),
        ),
    })
}

fn moved(pose: &Pose, points: &[[f32; 3]]) -> Vec<[f32; 3]> {
    points.iter().map(|p| pose.transform_f32(p)).collect()
}

fn distance(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>().sqrt()
}

fn share(hits: impl Iterator<Item = bool>) -> Option<f64> {
    let (count, hit) = hits.fold((0usize, 0usize), |(n, k), hit| (n + 1, k + usize::from(hit)));
    (count > 0).then(|| hit as f64 / count as f64)
}

/// Of the query points with a match, those whose match is near the truth.
fn coarse_inliers(
    coarse: &Matched,
    query: &[[f32; 3]],
    reference: &[[f32; 3]],
    t_reference_query: &Pose,
) -> Option<f64> {
    let matches = query.iter().zip(&coarse.assignment.label_query).filter_map(|(q, &label)| {
        let p = reference.get((label as usize).checked_sub(1)?)?;
        Some(distance(&t_reference_query.transform_f32(q), p) <= COARSE_DISTANCE)
    });
    share(matches)
}

/// Of the matches that the hypotheses were made of, those near the truth.
fn drawn_inliers(
    trace: &Trace,
    query: &[[f32; 3]],
    reference: &[[f32; 3]],
    t_reference_query: &Pose,
) -> Option<f64> {
    let query = moved(t_reference_query, query);
    let pairs = trace.stages.coarse_pose.hypotheses.iter().flat_map(|hypothesis| hypothesis.pairs);
    share(pairs.filter_map(|(q, p)| {
        Some(distance(query.get(q as usize)?, reference.get(p as usize)?) <= COARSE_DISTANCE)
    }))
}

/// Median distance of the soft matches to the truth, and the share near it, of the points that overlap and are matched.
fn fine_matches(trace: &Trace, t_reference_query: &Pose, nearest: &[f32]) -> (Option<f64>, Option<f64>) {
    let Some(fine) = trace.stages.fine() else { return (None, None) };
    let points = trace.cloud.points.iter().zip(&fine.solved.predicted).zip(&fine.solved.weights);
    let mut distances: Vec<f32> = points
        .zip(nearest)
        .filter(|&((_, &weight), &near)| weight > 0.0 && near <= OVERLAP_DISTANCE)
        .map(|(((q, predicted), _), _)| distance(&t_reference_query.transform_f32(q), predicted))
        .collect();
    distances.sort_by(f32::total_cmp);
    let median = distances.get(distances.len() / 2).map(|&d| f64::from(d));
    (median, share(distances.iter().map(|&d| d <= FINE_DISTANCE)))
}

fn predicted(overlap: &[f32], nearest: &[f32]) -> PrecisionRecall {
    let points = || overlap.iter().zip(nearest).map(|(&o, &d)| (o > PREDICTED, d <= OVERLAP_DISTANCE));
    PrecisionRecall {
        precision: share(points().filter(|(predicted, _)| *predicted).map(|(_, overlaps)| overlaps)),
        recall: share(points().filter(|(_, overlaps)| *overlaps).map(|(predicted, _)| predicted)),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3, Vector3};
    use unopose_dataset::{formats::ObjectSymmetries, mesh::TriangleMesh};

    use super::*;

    #[test]
    fn errors_know_symmetries_and_are_in_diameters() {
        let turn = |degrees: f64, t: [f64; 3]| {
            Pose::new(*Rotation3::new(Vector3::z() * degrees.to_radians()).matrix(), Vector3::from(t))
        };
        let half = Pose::new(Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0)), Vector3::zeros());
        let symmetries = ObjectSymmetries { discrete: vec![half], continuous: vec![] };
        let object = EvalObject::new(TriangleMesh::default(), 0.2, &symmetries);
        let (t_query_object, t_reference_object) =
            (turn(30.0, [0.0, 0.1, 0.7]), turn(-50.0, [0.1, 0.0, 0.6]));
        let truth = Truth { t_query_object, t_reference_object, object: &object };
        // Off by 170 degrees about the axis of a half turn, and 3 cm.
        let off = turn(30.0 + 170.0, [0.03, 0.1, 0.7]) * t_reference_object.inverse();
        let error = truth.error(&off);
        assert!((error.rotation_deg - 10.0).abs() < 1e-6, "{error:?}");
        assert!((error.translation - 0.15).abs() < 1e-9, "{error:?}");
    }

    #[test]
    fn precision_and_recall_of_overlap() {
        let found = predicted(&[0.9, 0.8, 0.2, 0.1, 0.6], &[0.0, 0.5, 0.1, 0.9, 0.1]);
        assert_eq!((found.precision, found.recall), (Some(2.0 / 3.0), Some(2.0 / 3.0)));
        assert_eq!(predicted(&[0.1], &[0.9]), PrecisionRecall { precision: None, recall: None });
    }
}
