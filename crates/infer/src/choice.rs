//! The candidates for a pair's pose, and the choice among them.

use unopose_core::geometry::Pose;
use unopose_pairs::{
    appearance::Detail,
    data::CloudInput,
    registration::{Axis, PseudoSymmetries, Refinement, icp::refine_query},
};

use super::{
    Alternative, Candidate, Judge, PairEstimate, PairTrace, PoseEstimator, Query,
    point_features::FeatureAgreement, trace::APART_DEG,
};

/// Score of a pose, in shares of the best one's, from which the evidence does not tell them apart.
const AS_GOOD: f64 = 0.75;
/// Angle between two poses that are told as alternatives, degrees.
const ALTERNATIVES_APART_DEG: f64 = 20.0;
/// Most alternatives of an estimate.
const MAX_ALTERNATIVES: usize = 8;
/// What free space and colours say of a turn about an axis, in shares of what they say of the answer, up to which it is not
/// ruled out; the silhouettes of real views never agree.
const NOT_RULED_OUT: f64 = 0.35;
/// Share of such turns from which the angle about the axis is free.
const FREE_SHARE: f64 = 0.5;

/// Judged candidates of a pair.
pub(super) struct Choice {
    /// At least one.
    pub candidates: Vec<Candidate>,
    best: usize,
    /// In the reference camera's frame: the evidence does not fix the angle about it.
    pub free_axis: Option<Axis>,
}

impl Choice {
    pub fn best(&self) -> &Candidate {
        &self.candidates[self.best]
    }

    /// Score of the best candidate that is turned against the chosen one, in shares of its own; 0 without any.
    pub fn runner_up(&self) -> f64 {
        let best = self.best();
        let apart =
            self.candidates.iter().filter(|other| other.pose.rotation_angle_deg(&best.pose) > APART_DEG);
        let score = apart.map(|other| other.judged.score).fold(0.0, f64::max);
        (score / best.judged.score.max(1e-12)).min(1.0)
    }

    /// Poses that the evidence does not tell from the chosen one, the best first.
    pub fn alternatives(&self) -> Vec<Alternative> {
        let best = self.best();
        let relative = |candidate: &Candidate| candidate.judged.score / best.judged.score.max(1e-12);
        let mut others: Vec<&Candidate> =
            self.candidates.iter().filter(|candidate| relative(candidate) >= AS_GOOD).collect();
        others.sort_by(|a, b| b.judged.score.total_cmp(&a.judged.score));
        let mut alternatives: Vec<Alternative> = Vec::new();
        for other in others {
            let apart = |pose: &Pose| pose.rotation_angle_deg(&other.pose) > ALTERNATIVES_APART_DEG;
            if alternatives.len() < MAX_ALTERNATIVES
                && apart(&best.pose)
                && alternatives.iter().all(|known| apart(&known.t_query_reference))
            {
                alternatives
                    .push(Alternative { t_query_reference: other.pose, score: relative(other).min(1.0) });
            }
        }
        alternatives
    }
}

impl PoseEstimator {
    /// The poses from every start and the turns of the best of them that its shape hardly tells apart, refined; the one
    /// for which both views speak most is the answer.
    pub(super) fn choose(
        &self,
        query: &Query<'_>,
        cloud: &CloudInput,
        stages: &PairTrace,
        refinement: Refinement,
    ) -> Choice {
        let clouds = query.reference.pair(cloud);
        let refine_to = refinement.settings().and_then(|settings| {
            let reference = query.reference.surface()?;
            let points = query.frame.masked_points(query.mask);
            Some((settings, reference.query(&points, cloud.view.as_ref())?, reference))
        });
        let turns = self.config.hypotheses.turns;
        let surface = query.reference.surface().filter(|_| turns > 0);
        let symmetries = surface.and_then(|surface| surface.pseudo_symmetries());
        let features = stages.features.as_ref().zip(query.reference.features());
        let features = features.and_then(|(own, other)| {
            let points = [&clouds.query.points[..], &clouds.reference.points];
            FeatureAgreement::new(points, [own, other])
        });
        let judge = Judge::new(&clouds, &self.config.hypotheses).with_features(features);
        let judge = match symmetries {
            Some(_) => judge.of_revolution(),
            None => judge,
        };
        let refined = |pose: Pose, colored: bool| match &refine_to {
            Some((settings, surface, reference)) => {
                let settings = if colored { settings.colored() } else { *settings };
                refine_query(surface, reference, &pose, &settings).t_query_reference
            }
            None => pose,
        };
        let candidate = |pair: PairEstimate, pose: Pose| {
            let pose = refined(pose, false);
            Candidate { judged: judge.judge(&pose, Detail::Fine), pair, pose }
        };
        let mut candidates: Vec<Candidate> = (0..stages.fine.len().max(1))
            .map(|result| {
                let pair = stages.estimate_of(result, &clouds);
                candidate(pair, pair.t_query_reference)
            })
            .collect();
        if let Some(symmetries) = symmetries {
            let Candidate { pair, pose, .. } = candidates[Candidate::best(&candidates)];
            let turned = judge.turned(&pose, &symmetries.turns, turns);
            candidates.extend(turned.into_iter().map(|turned| candidate(pair, turned)));
        }
        let best = Candidate::best(&candidates);
        // Only the winner: colours that all candidates were fitted to would tell less which one is right.
        let Candidate { pose, judged, .. } = &mut candidates[best];
        let colored = refined(*pose, true);
        let with_colors = judge.judge(&colored, Detail::Fine);
        if with_colors.score > judged.score {
            (*pose, *judged) = (colored, with_colors);
        }
        let free_axis = symmetries.and_then(|PseudoSymmetries { axis, turns }| {
            let views = |pose: &Pose| judge.judge(pose, Detail::Blurred).views;
            let (pose, own) = (candidates[best].pose, views(&candidates[best].pose));
            let possible = turns.iter().filter(|turn| views(&(pose * **turn)) >= NOT_RULED_OUT * own).count();
            (possible as f64 >= FREE_SHARE * turns.len() as f64).then_some(*axis)
        });
        Choice { candidates, best, free_axis }
    }
}
