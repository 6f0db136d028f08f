//! What the two stages computed of one pair, and the estimate that follows from it.

use unopose_core::{
    config::HypothesisConfig,
    geometry::{CoarsePose, FinePose, Pose, fine_pose, nearest_distances},
};
use unopose_pairs::{
    appearance::Detail,
    data::{CloudInput, metric_pose},
};

use super::{
    CloudPair, Evidence, Judge, Matched, PairEstimate, confidence::Support, point_features::PointFeatures,
};

/// Angle from which a hypothesis counts as another answer, degrees.
pub(super) const APART_DEG: f64 = 30.0;
/// Distance to the reference (radii) up to which a query point fits, as in the fine stage.
const FITTING_DISTANCE: f32 = 0.15;

/// One pair's way through the network; poses and points in the matching frames (radii).
#[derive(Clone, Debug)]
pub struct PairTrace {
    /// Assignment of the sparse points.
    pub coarse: Matched,
    /// The hypotheses and the chosen one.
    pub coarse_pose: CoarsePose,
    /// The colour encoder's features of the query's dense points, where poses are judged by them.
    pub(super) features: Option<PointFeatures>,
    /// Results from different starts, the best judged first; empty without a fine stage.
    pub fine: Vec<FineTrace>,
}

/// The fine stage.
#[derive(Clone, Debug)]
pub struct FineTrace {
    /// Where it began.
    pub start: Pose,
    /// Assignment of the dense points.
    pub matched: Matched,
    /// Weighted Procrustes and score.
    pub solved: FinePose,
    /// By which results from several starts are compared.
    pub judged: f64,
}

impl FineTrace {
    /// From the stage's start and assignment.
    pub(super) fn new(
        pair: &CloudPair<'_>,
        start: Pose,
        matched: Matched,
        config: &HypothesisConfig,
    ) -> Self {
        let solved = fine_pose(&matched.assignment, &pair.query.points, &pair.reference.points);
        let judged = Judge::new(pair, config).score(&solved.pose, Detail::Fine);
        Self { start, matched, solved, judged }
    }
}

impl PairTrace {
    /// The best result of the fine stage, `None` without one.
    pub fn fine(&self) -> Option<&FineTrace> {
        self.fine.first()
    }

    /// Pose and confidence.
    pub fn estimate(&self, pair: &CloudPair<'_>) -> PairEstimate {
        self.estimate_of(0, pair)
    }

    /// Those of one of the results in `fine`.
    pub(super) fn estimate_of(
        &self,
        result: usize,
        &CloudPair { query, reference, radius }: &CloudPair<'_>,
    ) -> PairEstimate {
        let metric = |pose: &Pose| metric_pose(pose, query.center, reference.center, radius);
        let fine = self.fine.get(result);
        let (pose, score, matched) = match fine {
            Some(fine) => (fine.solved.pose, fine.solved.score, &fine.matched),
            None => (self.coarse_pose.pose, self.coarse_confidence(query, reference), &self.coarse),
        };
        PairEstimate {
            t_query_reference: metric(&pose),
            score,
            t_query_reference_coarse: metric(&self.coarse_pose.pose),
            coarse_score: self.coarse_pose.score,
            overlap: matched.mean_overlap(),
            matched: matched.matched_share(),
            evidence: self.evidence(query, fine, &pose, score, matched),
        }
    }

    fn evidence(
        &self,
        query: &CloudInput,
        fine: Option<&FineTrace>,
        pose: &Pose,
        score: f64,
        matched: &Matched,
    ) -> Evidence {
        let start = fine.map_or(&self.coarse_pose.pose, |fine| &fine.start);
        let Support { mass, residual } = match fine {
            Some(fine) => Support::of(&fine.solved, &query.points),
            None => Support::NONE,
        };
        let [overlap_query, overlap_reference] = matched.mean_overlap();
        Evidence {
            fit: score,
            overlap_query,
            overlap_reference,
            matched: matched.matched_share(),
            mass,
            residual,
            coarse_score: self.coarse_pose.score,
            rival: self.rival(pose),
            agreement_deg: pose.rotation_angle_deg(start),
            ..Evidence::default()
        }
    }

    /// Score of the best hypothesis that is turned against the pose, in shares of the winner's.
    fn rival(&self, pose: &Pose) -> f64 {
        let CoarsePose { hypotheses, kept, kept_scores, score, .. } = &self.coarse_pose;
        let apart = |&(&h, _): &(&usize, &f64)| hypotheses[h].pose.rotation_angle_deg(pose) > APART_DEG;
        let rival =
            kept.iter().zip(kept_scores).filter(apart).map(|(_, &score)| score).max_by(f64::total_cmp);
        rival.map_or(0.0, |rival| rival / score.max(1e-8)).min(1.0)
    }

    /// The fine stage's score (`docs/network.md`, section 6) on the coarse matches.
    fn coarse_confidence(&self, query: &CloudInput, reference: &CloudInput) -> f64 {
        let t_reference_query = self.coarse_pose.pose.inverse();
        let moved: Vec<[f32; 3]> =
            sparse_points(query).iter().map(|p| t_reference_query.transform_f32(p)).collect();
        let distances = nearest_distances(&moved, &reference.points);
        let labels = &self.coarse.assignment.label_query;
        let near =
            labels.iter().zip(&distances).filter(|&(&label, &d)| label > 0 && d < FITTING_DISTANCE).count();
        near as f64 / labels.len().max(1) as f64
    }
}

/// The points of a cloud that the coarse stage matches.
pub fn sparse_points(cloud: &CloudInput) -> Vec<[f32; 3]> {
    cloud.sparse.iter().map(|&i| cloud.points[i as usize]).collect()
}
