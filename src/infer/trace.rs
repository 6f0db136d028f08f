//! What the two stages computed of one pair, and the estimate that follows from it.

use super::{Evidence, Matched, PairEstimate, confidence::Support};
use crate::{
    data::{CloudInput, PreparedReference, metric_pose},
    geometry::{CoarsePose, FinePose, Pose, fine_pose, nearest_distances},
};

/// Angle from which two hypotheses, or two poses, count as different answers, degrees.
const APART_DEG: f64 = 30.0;
/// Distance to the reference (radii) up to which a query point fits, as in the fine stage.
const FITTING_DISTANCE: f32 = 0.15;

/// One pair's way through the network; poses and points in the matching frames (radii).
#[derive(Clone, Debug)]
pub struct PairTrace {
    pub coarse: Matched,
    pub coarse_pose: CoarsePose,
    /// One per start of the fine stage, the one with the best score first; empty without a fine stage.
    pub fine: Vec<FineTrace>,
}

/// The fine stage from one start.
#[derive(Clone, Debug)]
pub struct FineTrace {
    pub start: Pose,
    pub matched: Matched,
    pub solved: FinePose,
}

impl PairTrace {
    /// From the coarse stage and the fine stage's assignments with their starts.
    pub(super) fn new(
        query: &CloudInput,
        reference: &PreparedReference,
        coarse: Matched,
        coarse_pose: CoarsePose,
        fine: Vec<(Pose, Matched)>,
    ) -> Self {
        let solve = |(start, matched): (Pose, Matched)| FineTrace {
            solved: fine_pose(&matched.assignment, &query.points, &reference.cloud.points),
            start,
            matched,
        };
        let mut fine: Vec<FineTrace> = fine.into_iter().map(solve).collect();
        // The sort is stable: of equal scores the better hypothesis comes first.
        fine.sort_by(|a, b| b.solved.score.total_cmp(&a.solved.score));
        Self { coarse, coarse_pose, fine }
    }

    /// Pose and confidence.
    pub fn estimate(&self, query: &CloudInput, reference: &PreparedReference) -> PairEstimate {
        let metric = |pose: &Pose| metric_pose(pose, query.center, reference.cloud.center, reference.radius);
        let (pose, score, matched) = match self.fine.first() {
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
            evidence: self.evidence(query, &pose, score, matched),
        }
    }

    fn evidence(&self, query: &CloudInput, pose: &Pose, score: f64, matched: &Matched) -> Evidence {
        let start = self.fine.first().map_or(&self.coarse_pose.pose, |fine| &fine.start);
        let Support { mass, residual } = match self.fine.first() {
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
            points: 0,
        }
    }

    /// Score of the best answer that is turned against the given one, in shares of that one's: of the fine poses where the
    /// fine stage had several starts, else of the coarse hypotheses.
    fn rival(&self, pose: &Pose) -> f64 {
        let share =
            |rival: Option<f64>, best: f64| rival.map_or(0.0, |rival| rival / best.max(1e-8)).min(1.0);
        let apart = |other: &Pose, pose: &Pose| other.rotation_angle_deg(pose) > APART_DEG;
        if self.fine.len() > 1 {
            let rivals = self.fine.iter().filter(|fine| apart(&fine.solved.pose, pose));
            return share(rivals.map(|f| f.solved.score).max_by(f64::total_cmp), self.fine[0].solved.score);
        }
        let CoarsePose { hypotheses, kept, kept_scores, score, pose, .. } = &self.coarse_pose;
        let scored = kept.iter().zip(kept_scores);
        let rivals = scored.filter(|&(&h, _)| apart(&hypotheses[h].pose, pose)).map(|(_, &score)| score);
        share(rivals.max_by(f64::total_cmp), *score)
    }

    /// The fine stage's score (network page, section 6) on the coarse matches.
    fn coarse_confidence(&self, query: &CloudInput, reference: &PreparedReference) -> f64 {
        let t_reference_query = self.coarse_pose.pose.inverse();
        let moved: Vec<[f32; 3]> =
            sparse_points(query).iter().map(|p| t_reference_query.transform_f32(p)).collect();
        let distances = nearest_distances(&moved, &reference.cloud.points);
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

/// The winning hypothesis and up to `count - 1` others by descending score, each turned against all before it.
pub(super) fn starts(coarse: &CoarsePose, count: usize) -> Vec<Pose> {
    let mut starts = vec![coarse.pose];
    if count > 1 {
        let mut ranked: Vec<(f64, &Pose)> = coarse
            .kept
            .iter()
            .zip(&coarse.kept_scores)
            .map(|(&h, &s)| (s, &coarse.hypotheses[h].pose))
            .collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, pose) in ranked {
            if starts.len() == count {
                break;
            }
            if starts.iter().all(|start| start.rotation_angle_deg(pose) > APART_DEG) {
                starts.push(*pose);
            }
        }
    }
    starts
}
